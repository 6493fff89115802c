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
        ("gazebo", "is not known: give pybullet or kinematic, or my_file.py:Class"),
    ):
        with pytest.raises(sim_bridge.SimulatorError, match=words):
            sim_bridge.make(name)


def test_a_class_of_ones_own_may_stand_in_a_file(tmp_path, monkeypatch):
    text = (
        "from sim_bridge.kinematic_simulator import KinematicSimulator\n\n\nclass Mine(KinematicSimulator):\n    pass\n"
    )
    (tmp_path / "my_simulator.py").write_text(text)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("sys.path", sys.path[:])
    assert type(sim_bridge.make("my_simulator:Mine")).__name__ == "Mine"  # also without the folder on PYTHONPATH
    assert type(sim_bridge.make("my_simulator.py:Mine")).__name__ == "Mine"
    assert sim_bridge.find("%s/my_simulator.py:Mine" % tmp_path) is sim_bridge.find("my_simulator.py:Mine")
    with pytest.raises(sim_bridge.SimulatorError, match="cannot be imported"):
        sim_bridge.find("no_simulator.py:Mine")


class NeedsAFile(KinematicSimulator):
    def __init__(self, **options):
        raise OSError(2, "No such file or directory", "terrain.stl")


def test_a_constructor_that_raises_is_one_line():
    """What it raised stays with the error, for the person's own debugging."""
    words = r"FileNotFoundError: terrain.stl: No such file or directory \(test_simulator_check\.py, line \d+\)"
    name = "test_simulator_check:NeedsAFile"
    with pytest.raises(sim_bridge.SimulatorError, match="^simulator %s cannot be made: %s$" % (name, words)) as no:
        sim_bridge.make(name)
    assert no.value.__cause__ is not None
    with pytest.raises(sim_bridge.SimulatorError, match="^randomisation slip"):  # not its own fault
        sim_bridge.make("test_simulator_check:MirroredScan", slip="wide")


def test_a_module_that_raises_is_one_line(tmp_path, monkeypatch):
    (tmp_path / "broken_simulator.py").write_text("1 / 0")
    monkeypatch.syspath_prepend(str(tmp_path))
    with pytest.raises(sim_bridge.SimulatorError, match=r"cannot be imported \(ZeroDivisionError: .*\): check"):
        sim_bridge.make("broken_simulator:Simulator")


def test_the_command():
    done = subprocess.run(
        [sys.executable, "-m", "sim_bridge.check", "nonsense"], capture_output=True, text=True, timeout=60, check=False
    )
    assert done.returncode == 1
    assert done.stderr.count("\n") == 1
