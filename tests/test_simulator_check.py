"""The contract of a simulator: both of ours keep it, and simulators that break a promise are found out."""

import re
import subprocess
import sys

import numpy as np
import pytest

import sim_bridge
from sim_bridge.check import check_simulator
from sim_bridge.kinematic_simulator import KinematicSimulator
from sim_bridge.simulator import Simulator


@pytest.mark.parametrize("name", sim_bridge.NAMES)
def test_ours_keep_the_contract(name):
    assert check_simulator(lambda **options: sim_bridge.make(name, **options)) == []


class TurnsTheOtherWay(KinematicSimulator):
    def command(self, v, w):
        super().command(v, -w)


class NeverTouches(KinematicSimulator):
    def advance(self, duration):
        super().advance(duration).contact = False
        return self.state


class DrivesOn(KinematicSimulator):
    def _target(self, time):
        target = super()._target(time)
        self._last = target if any(target) else getattr(self, "_last", target)
        return self._last


class AcceptsAnything(KinematicSimulator):
    def command(self, v, w):
        super().command(*np.nan_to_num((v, w)))


class MirroredScan(KinematicSimulator):
    def scan(self):
        return super().scan()[::-1]


class BlindForMovers(KinematicSimulator):
    def mover_circles(self, time=None):
        return super().mover_circles(time)[:0]


class OwnRandomNumbers(KinematicSimulator):
    def _place(self, pose, new_world, seed):
        super()._place(pose, new_world, np.random.SeedSequence().entropy % 2**31)


class OdometryFromTheWorld(KinematicSimulator):
    def _place(self, pose, new_world, seed):
        super()._place(pose, new_world, seed)
        self.state.odom_pose = pose


class StartsAnywhere(KinematicSimulator):
    def _place(self, pose, new_world, seed):
        super()._place(tuple(2.0 * value for value in pose), new_world, seed)


class RoundsTime(KinematicSimulator):
    def advance(self, duration):
        return super().advance(round(duration, 1) or 0.1)


class ClosesOnce(KinematicSimulator):
    def close(self):
        del self.parameters


@pytest.mark.parametrize(
    ("kind", "words"),
    [
        (TurnsTheOtherWay, r"command \(0, 1\) is driven at w = -1"),
        (NeverTouches, "no contact is reported"),
        (DrivesOn, "one second after the last command"),
        (AcceptsAnything, r"the command \(nan, 0\) is accepted"),
        (MirroredScan, "to the left it sees"),
        (BlindForMovers, "IndexError"),
        (OwnRandomNumbers, "second drive with the same seed differs"),
        (OdometryFromTheWorld, "odom_pose is"),
        (StartsAnywhere, "it stands at"),
        (RoundsTime, "the time is"),
        (ClosesOnce, "AttributeError was raised"),
    ],
)
def test_a_broken_promise_is_found(kind, words):
    problems = check_simulator(kind)
    assert len(problems) >= 1
    assert all("\n" not in line for line in problems)
    assert any(re.search(words, line) for line in problems), problems


def test_a_class_of_ones_own_is_taken_by_name():
    made = sim_bridge.make("test_simulator_check:MirroredScan", slip=0.0)
    assert isinstance(made, Simulator)
    for name, words in (
        ("test_simulator_check:check_simulator", "is no sim_bridge.Simulator"),
        ("test_simulator_check:Missing", "cannot be imported"),
        ("no_such_module:Missing", "cannot be imported"),
        ("gazebo", "is not known: give pybullet or kinematic, or module:Class"),
    ):
        with pytest.raises(sim_bridge.SimulatorError, match=words):
            sim_bridge.make(name)


def test_the_command():
    done = subprocess.run(
        [sys.executable, "-m", "sim_bridge.check", "nonsense"], capture_output=True, text=True, timeout=60, check=False
    )
    assert done.returncode == 1
    assert done.stderr.count("\n") == 1
