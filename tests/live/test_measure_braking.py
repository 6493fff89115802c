"""Tests of measure_braking.py on the simulated Jackal in an open world."""

import re
import time

import numpy as np
import pytest
import rospy

from applr_ros1.common.angles import normalize_angle
from applr_ros1.nodes.conversions import Reading
from applr_ros1.nodes.tools.measure_braking import Stop, dead_band, deceleration, reaction
from tests.support.ros import Kept, session, wait_for
from worlds import Course, World
from worlds.sdf_writer import write

pytestmark = pytest.mark.ros


def measure(*options):
    """Run the command. Return (exit status, output, time for which a busy machine let it wait
    [s]).
    """
    kept = Kept()
    child = session().node("measure_braking", *options)

    def has_ended():
        # An ended thread keeps its last waiting time, which must be read before its end.
        kept.waiting()
        time.sleep(0.1)
        return not child.alive()

    wait_for(has_ended, "its end")
    return child.process.returncode, child.text, kept.waiting()


def stop(speed, began, brakes):
    """Return the Stop of a base that brakes with `brakes` [m/s^2] after `began` [s]."""
    return Stop(speed, 1.0, began, speed * began + speed**2 / (2.0 * brakes))


def test_a_late_stop_is_not_mistaken_for_weak_brakes():
    # The first of the straight runs had a late reaction, and weak brakes, too.
    straight = [stop(0.4, 0.4, 0.8), stop(0.9, 0.1, 1.5), stop(1.8, 0.1, 2.0)]
    turns = [stop(1.0, 0.1, 3.0)] * 4
    assert deceleration(straight, 0.1) < 0.4
    reaction_time = reaction(straight, turns)
    assert (reaction_time, deceleration(straight, reaction_time)) == pytest.approx((0.4, 0.8))


def test_of_equivalent_reaction_times_the_least_from_the_median_up_is_chosen():
    turns = [stop(1.0, began, 3.0) for began in (0.0, 0.05, 0.1, 0.3)]
    assert reaction([stop(1.8, 0.1, 2.0)], turns) == 0.1


class Ignoring:
    """Stand-in for Base, of a robot that drives at any command except those below its dead band."""

    def __init__(self, band):
        self.band = band
        self.readings = [Reading(0.0, (1.0, 2.0, 3.0), (0.0, 0.0))]

    def drive(self, v, w, until, seconds):
        if abs(v) < self.band[0]:
            v = 0.0
        if abs(w) < self.band[1]:
            w = 0.0
        last = self.readings[-1]
        x, y, yaw = last.pose
        pose = (x, y - v * seconds, normalize_angle(yaw + w * seconds))
        self.readings.append(Reading(last.time + seconds, pose, (v, w)))


@pytest.mark.parametrize("band", [(0.0, 0.0), (0.075, 0.25), (0.155, 0.0), (0.0, 0.7)])
def test_the_dead_band_is_the_smallest_command_that_moves_the_base(band):
    v = dead_band(Ignoring(band), is_turn=False)
    w = dead_band(Ignoring(band), is_turn=True)
    assert v == pytest.approx(band[0], abs=0.01)
    assert w == pytest.approx(band[1], abs=0.03)
    assert v >= band[0]
    assert w >= band[1]


@pytest.fixture(scope="module")
def robot(tmp_path_factory):
    """Provide the simulated Jackal in an open world, with the kinematic simulator."""
    path = tmp_path_factory.mktemp("open") / "open.world"
    course = Course(
        (0.0, 0.0, 0.0), (10.0, 0.0, 0.0), None, 0.5, np.array([[0.0, 0.0], [10.0, 0.0]])
    )
    write(World("open", np.array([(15.0, 0.0, 0.1)]), np.empty((0, 5)), course), str(path))
    ros = session()
    rospy.set_param("/use_sim_time", True)
    options = "_simulator:=kinematic", "_world:=%s" % path, "_real_time_factor:=1"
    child = ros.node("sim_bridge", *options)
    child.until("ready")
    yield child
    rospy.set_param("/use_sim_time", False)
    child.end()


def test_the_command_does_not_drive_without_confirmation_that_the_way_is_free(robot):
    for options, words in (((), "give --yes"), (("--yes", "--free", "1"), "--free 1 ")):
        status, text, _ = measure("--free", "6", *options)
        assert status == 1
        assert words in text
        assert len(text.splitlines()) == 1


@pytest.mark.slow
def test_the_printed_braking_limits_hold_for_every_run(robot):
    status, text, waited = measure(
        "--free", "4", "--yes", "--repeats", "1", "--odometry", "sim_bridge/ground_truth"
    )
    assert status == 0, text
    *_, line = text.splitlines()
    reaction, brake, turn_brake = map(
        float, re.search("reaction_time: (.*), dec.*: (.*), yaw_dec.*: (.*)}", line).groups()
    )
    assert 0.10 < reaction < 0.35 + waited
    # It is rounded down, and depends on the angles at which the wheels lock.
    assert 0.3 <= brake < 7.0
    assert turn_brake > 2.0
    assert "  dead_band: [0, 0]  # in the section base\n" in text
    runs = re.findall(r"([0-9.]+) driven, .* within ([0-9.]+) m$", text, re.M)
    assert len(runs) == 3
    for speed, way in ((float(a), float(b)) for a, b in runs):
        assert way <= speed * reaction + speed**2 / (2.0 * brake)
