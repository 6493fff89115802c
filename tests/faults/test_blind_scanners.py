"""Blind scanners and late data while the robot drives at 2 m/s towards a wall, which it must never
touch.

The drives are in process, with the kinematic simulator, the monitor, and a planner that always
commands full speed.
"""

import math
from dataclasses import replace
from typing import NamedTuple, Optional

import numpy as np
import pytest

import sim_bridge
from applr_ros1.monitor.monitor import CollisionMonitor
from applr_ros1.robots import JACKAL
from tests.support.scenes import small_world

LASER = JACKAL.laser
WALL_M = 6.0  # distance of the wall from the start [m]
SPEED = 2.0  # the Jackal's largest speed [m/s]
PERIOD = 0.05  # time between two commands [s]
BLOCKED = small_world([(WALL_M, post_y, 0.1) for post_y in np.arange(-3, 3, 0.15)])


def ranges_of(value):
    """Return a fault in which all beams have one range [m]."""
    return lambda scan, _: replace(scan, ranges=np.full(len(scan.ranges), value, np.float32))


BLIND = {
    "all below range_min": ranges_of(0.02),
    "all zero": ranges_of(0.0),
    "all +inf though obstacles are in range": ranges_of(np.inf),
    "all range_max though obstacles are in range": ranges_of(LASER.range_max),
    "all NaN": ranges_of(np.nan),
    "all -inf": ranges_of(-np.inf),
    "a frozen image under new stamps": lambda scan, first: replace(scan, ranges=first),
    "an increment of 0": lambda scan, _: replace(scan, angle_increment=0.0),
    "an increment of half a radian": lambda scan, _: replace(scan, angle_increment=0.5),
    "an increment of NaN": lambda scan, _: replace(scan, angle_increment=np.nan),
    "range_max below range_min": lambda scan, _: replace(scan, range_max=0.01),
    "no beams": lambda scan, _: replace(scan, ranges=np.zeros(0, np.float32)),
    "no scan": lambda scan, _: None,
}


# These faults are detected by obstacles of an earlier scan, so the first scan must be valid.
NEEDS_A_SCAN_BEFORE = (
    "all +inf though obstacles are in range",
    "all range_max though obstacles are in range",
)
BLIND_FROM = (0.0, 1.0, 2.5, 4.0, 5.0)  # distances driven until the fault begins [m]


class Driven(NamedTuple):
    """Whether the robot touched the wall, and the time from the fault until it was at rest [s]."""

    contact: bool
    stood_after: Optional[float]


def drive(fault, blind_from, monitor, late=0.0, late_twist=0.0):
    """Drive at full speed towards the wall.

    Args:
        fault: Function (scan, ranges of the first scan) -> scan that makes the scanner blind.
        blind_from: Distance driven when the fault begins [m].
        monitor: The collision monitor, None for none.
        late: Delay of scans and poses [s].
        late_twist: Delay of the twist [s].
    """
    simulator = sim_bridge.make("kinematic")
    state = simulator.reset(BLOCKED, 0)
    frozen_ranges = None
    blind_since = None
    stood_after = None
    scans = []
    poses = []
    twists = []

    def delayed(values, delay):
        """Return the value of `delay` [s] ago, or the first one."""
        return values[max(0, len(values) - 1 - round(delay / PERIOD))]

    # Eight seconds; without a stop the robot would be at the wall after three.
    for _ in range(160):
        scan = simulator.laser_scan()
        if state.pose[0] >= blind_from:
            if blind_since is None:
                blind_since = state.time
                frozen_ranges = scan.ranges
            scan = fault(scan, frozen_ranges)

        command = (SPEED, 0.0)
        if monitor is not None:
            scans.append(scan)
            poses.append(state.odom_pose)
            twists.append(state.odom_twist)
            latest_scan = delayed(scans, late)
            if latest_scan is not None:
                monitor.add_scan(latest_scan)
            pose = delayed(poses, late)
            twist = delayed(twists, late_twist)
            verdict = monitor.filter(state.time, pose, twist, command, (late, late_twist))
            command = verdict.command
        simulator.command(*command)

        state = simulator.advance(PERIOD)
        if state.contact:
            return Driven(contact=True, stood_after=None)
        is_at_rest = abs(state.twist[0]) < 0.01
        if blind_since is not None and is_at_rest and stood_after is None:
            stood_after = state.time - blind_since
    return Driven(contact=False, stood_after=stood_after)


@pytest.mark.fault("11b")
@pytest.mark.parametrize("kind", BLIND)
def test_a_robot_with_a_blind_scanner_stops_before_the_wall(kind, measured):
    # From 6 m to 1 m before the wall
    for blind_from in BLIND_FROM[kind in NEEDS_A_SCAN_BEFORE :]:
        driven = drive(BLIND[kind], blind_from, CollisionMonitor())
        assert not driven.contact, "contact, blind from x = %g" % blind_from
        assert driven.stood_after is not None, "it never came to rest"
        measured("stands after", driven.stood_after, "s")


@pytest.mark.fault("12b")
@pytest.mark.parametrize(("late", "late_twist"), [(0.15, 0.0), (0.3, 0.0), (0.3, 0.3)])
def test_late_transforms_and_odometry_cause_no_contact(late, late_twist):
    """Each of these drives would hit the wall if the monitor ignored the ages of its inputs."""
    driven = drive(None, math.inf, CollisionMonitor(), late, late_twist)
    assert not driven.contact


@pytest.mark.fault("11b")
def test_without_the_monitor_the_robot_hits_the_wall():
    assert drive(BLIND["all NaN"], 2.5, monitor=None).contact
