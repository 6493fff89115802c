"""Tests of measure_braking.py on the simulated Jackal in an open world."""

import re
import time
from types import SimpleNamespace
from typing import NamedTuple

import numpy as np
import pytest
import rospy
import yaml

from applr_ros1.common.angles import normalize_angle
from applr_ros1.nodes.conversions import Reading
from applr_ros1.nodes.tools.measure_braking import (
    MeasuredBase,
    MeasuredStop,
    dead_band,
    deceleration,
    reaction,
    stop_of,
)
from applr_ros1.robots import JACKAL
from tests.support.refusals import refused
from tests.support.ros import Kept, session, wait_for
from worlds import Course, World
from worlds.sdf_writer import write

pytestmark = pytest.mark.ros


class Ended(NamedTuple):
    """Exit status and output of the command, and the time for which a busy machine let it wait
    [s].
    """

    status: int
    text: str
    waited: float


def measure(*options):
    """Run the command until its end."""
    stopwatch = Kept()
    child = session().node("measure_braking", *options)

    def has_ended():
        # An ended thread keeps its last waiting time, which must be read before its end.
        stopwatch.waiting()
        time.sleep(0.1)
        return not child.alive()

    wait_for(has_ended, "its end")
    return Ended(child.process.returncode, child.text, stopwatch.waiting())


def stop(speed, began, brakes):
    """Return the MeasuredStop of a base that brakes with `brakes` [m/s^2] after `began` [s]."""
    return MeasuredStop(speed, 1.0, began, speed * began + speed**2 / (2.0 * brakes))


@pytest.mark.parametrize(("is_turn", "scale"), [(False, 2.0), (True, 1.0)])
def test_a_stop_is_measured_by_the_odometry_around_its_command(is_turn, scale):
    # Times [s], angles [rad] and turn rates [rad/s]. Places and speeds are twice as many, and
    # negative. The speed before is the mean of 0.3 s, of which a tenth is soon lost.
    run = [
        (0.5, 0.0, 0.5),
        (0.75, 0.2, 1.5),
        (1.0, 0.6, 1.7),
        (1.25, 3.0, 1.45),
        (1.5, 4.0, 1.43),
    ]
    readings = []
    for time_s, angle, rate in run:
        pose = (0.0, -2.0 * angle, normalize_angle(angle))
        readings.append(Reading(time_s, pose, (-2.0 * rate, rate)))
    measured = stop_of(readings, brake_time=1.0, command=-0.8 * scale, is_turn=is_turn)
    # It turned by 2.4 and 1 rad, past pi.
    expected = MeasuredStop(1.6 * scale, gain=2.0, reaction=0.5, way=3.4 * scale)
    assert measured == pytest.approx(expected)


def test_a_late_stop_is_not_mistaken_for_weak_brakes():
    # The first of the straight runs had a late reaction, and weak brakes, too.
    straight_stops = [
        stop(speed=1.2, began=0.4, brakes=0.8),
        stop(speed=0.9, began=0.1, brakes=1.5),
        stop(speed=1.8, began=0.1, brakes=2.0),
    ]
    turn_stops = [stop(speed=1.0, began=0.1, brakes=3.0)] * 4
    assert deceleration(straight_stops, 0.1) < 0.6
    reaction_time = reaction(straight_stops, turn_stops)
    measured_braking = deceleration(straight_stops, reaction_time)
    assert (reaction_time, measured_braking) == pytest.approx((0.4, 0.8))


def test_of_equivalent_reaction_times_the_least_from_the_median_up_is_chosen():
    turn_stops = [stop(speed=1.0, began=began, brakes=3.0) for began in (0.0, 0.05, 0.1, 0.3)]
    straight_stop = stop(speed=1.8, began=0.1, brakes=2.0)
    assert reaction([straight_stop], turn_stops) == 0.1


class Ignoring:
    """Stand-in for MeasuredBase: a robot that drives at any command above its dead band."""

    def __init__(self, band):
        self.band = band
        self.readings = [Reading(0.0, (1.0, 2.0, 3.0), (0.0, 0.0))]

    def drive(self, v, w, until, seconds):
        if abs(v) < self.band[0]:
            v = 0.0
        if abs(w) < self.band[1]:
            w = 0.0
        latest_reading = self.readings[-1]
        x, y, yaw = latest_reading.pose
        # The dead band is measured by the distance, whatever its direction.
        pose = (x, y - v * seconds, normalize_angle(yaw + w * seconds))
        self.readings.append(Reading(latest_reading.time + seconds, pose, (v, w)))


@pytest.mark.parametrize("band", [(0.0, 0.0), (0.075, 0.25), (0.155, 0.0), (0.0, 0.7)])
def test_the_dead_band_is_the_smallest_command_that_moves_the_base(band):
    speed_band, turn_band = band
    measured_speed = dead_band(Ignoring(band), is_turn=False)
    measured_turn = dead_band(Ignoring(band), is_turn=True)
    assert measured_speed == pytest.approx(speed_band, abs=0.01)
    assert measured_turn == pytest.approx(turn_band, abs=0.03)
    # A smaller value would promise that the base moves at a command that it ignores.
    assert measured_speed >= speed_band
    assert measured_turn >= turn_band


def test_a_base_that_does_not_move_has_no_dead_band():
    stopped_base = Ignoring(band=(1.0, 2.0))
    refused(lambda: dead_band(stopped_base, is_turn=False), "0.3 m/s", "emergency stop")
    refused(lambda: dead_band(stopped_base, is_turn=True), "0.9 rad/s", "emergency stop")


@pytest.fixture(scope="module")
def robot(tmp_path_factory):
    """Provide the simulated Jackal in an open world, with the kinematic simulator."""
    world_file = tmp_path_factory.mktemp("open") / "open.world"
    course = Course(
        start=(0.0, 0.0, 0.0),
        goal=(10.0, 0.0, 0.0),
        finish_y=None,
        goal_tolerance=0.5,
        path=np.array([[0.0, 0.0], [10.0, 0.0]]),
    )
    # A single post, far beyond every run
    post = np.array([(15.0, 0.0, 0.1)])
    write(World("open", post, np.empty((0, 5)), course), str(world_file))
    ros = session()
    rospy.set_param("/use_sim_time", True)
    options = "_simulator:=kinematic", "_world:=%s" % world_file, "_real_time_factor:=1"
    child = ros.node("sim_bridge", *options)
    child.until("ready")
    yield child
    rospy.set_param("/use_sim_time", False)
    child.end()


def test_a_base_whose_odometry_falls_silent_is_stopped(monkeypatch):
    """Nobody would know how far it drives."""
    # Given: a base that was heard once, and has half a minute to drive
    monkeypatch.setattr(rospy, "get_time", time.time)
    monkeypatch.setattr(rospy, "is_shutdown", lambda: False)
    sent = []
    base = MeasuredBase.__new__(MeasuredBase)
    vars(base).update(
        free=6.0,
        readings=[Reading(0.0, (3.0, 0.0, 0.0), (0.0, 0.0))],
        start=(0.0, 0.0, 0.0),
        _arrived=time.monotonic(),
        _commands=SimpleNamespace(publish=lambda twist: sent.append(twist.linear.x)),
        _rate=SimpleNamespace(sleep=lambda: time.sleep(0.02)),
    )
    began = time.monotonic()
    refused(lambda: base.drive(-0.5, 0.0, lambda: False), "stopped: no odometry for 0.5 s")
    assert time.monotonic() - began < 5.0
    assert (sent[0], sent[-1]) == (-0.5, 0.0)


def test_the_command_does_not_drive_without_confirmation_that_the_way_is_free(robot):
    for options, remedy in (((), "give --yes"), (("--yes", "--free", "1"), "--free 1 ")):
        ended = measure("--free", "6", *options)
        assert ended.status == 1
        assert remedy in ended.text
        assert len(ended.text.splitlines()) == 1


@pytest.mark.slow
def test_the_printed_braking_limits_hold_for_every_run(robot):
    ended = measure(
        "--free", "4", "--yes", "--repeats", "1", "--odometry", "sim_bridge/ground_truth"
    )
    assert ended.status == 0, ended.text
    limits_line = ended.text.splitlines()[-1]
    printed = yaml.safe_load(limits_line)["monitor"]
    # The line replaces that of robot.yaml.
    assert printed.keys() == JACKAL.monitor.model_dump().keys()
    assert printed["turn_ahead"] == JACKAL.monitor.turn_ahead
    reaction_s = printed["reaction_time"]
    brake = printed["deceleration"]
    turn_brake = printed["yaw_deceleration"]
    (largest_gain,) = re.findall("turn rate over commanded turn rate: .* to (.*)", ended.text)
    assert printed["turn_gain"] == pytest.approx(max(1.0, float(largest_gain)), abs=0.011)
    assert 0.10 < reaction_s < 0.35 + ended.waited
    # It is rounded down, and depends on the angles at which the wheels lock.
    assert 0.3 <= brake < 7.0
    assert turn_brake > 2.0
    assert "  dead_band: [0, 0]  # in the section base\n" in ended.text
    runs = re.findall(r"([0-9.]+) driven, .* within ([0-9.]+) m$", ended.text, re.M)
    assert len(runs) == 3
    for printed_speed, printed_distance in runs:
        speed = float(printed_speed)
        stopping_distance = float(printed_distance)
        assert stopping_distance <= speed * reaction_s + speed**2 / (2.0 * brake)
