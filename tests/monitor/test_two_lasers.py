"""Tests of a second laser.

It adds obstacles, clears none of the first laser, and stops the base if it is silent.
"""

import math

import numpy as np
import pytest

from applr_ros1.monitor.monitor import PASS, SLOW, STOP, CollisionMonitor
from tests.monitor.scenes import (
    AT_REST,
    BEAMS,
    BEHIND,
    CLOSE_BEHIND,
    HERE,
    across,
    posts,
    scan_of,
    verdict_on,
    wall,
)

# Commands (v, w) [m/s, rad/s].
BACK = (-0.5, 0.0)
AHEAD = (0.5, 0.0)
WALL_BEHIND = across(-0.4, -0.3, 0.31, 0.03)


def behind(points, stamp=0.0, **changes):
    """Return the scan of a laser that faces backwards."""
    return scan_of(points, BEHIND, stamp, **changes)


def seen_both(ahead, back):
    """Return a monitor that has a scan of each laser."""
    monitor = CollisionMonitor(more_scans=["rear"])
    assert monitor.add_scan(scan_of(ahead, HERE)) == ""
    assert monitor.add_scan(behind(back), "rear") == ""
    return monitor


def test_the_robot_backs_up_as_far_as_the_second_laser_observes():
    # Behind the robot, no scan of the front laser has looked.
    front_alone = CollisionMonitor()
    front_alone.add_scan(scan_of(wall(3.0), HERE))
    assert "creeping" in front_alone.filter(0.0, HERE, AT_REST, BACK).reason

    free_behind = seen_both(wall(3.0), [(-3.0, 0.0), (-3.0, 0.1)])
    assert free_behind.filter(0.0, HERE, AT_REST, BACK).action == PASS

    wall_behind = seen_both(wall(3.0), WALL_BEHIND)
    verdict = wall_behind.filter(0.0, HERE, AT_REST, BACK)
    assert "obstacle" in verdict.reason
    assert verdict.action in (SLOW, STOP)


def laser_scan(name, stamp, **changes):
    """Return a scan of the laser `name` in a corridor between two walls."""
    if name == "rear":
        return behind(wall(-3.0), stamp, **changes)
    return scan_of(wall(3.0), HERE, stamp, **changes)


@pytest.mark.parametrize(
    ("name", "other", "old", "blind"),
    [
        ("", "rear", "latest scan is 0.60 s old", "the scanner is blind"),
        ("rear", "", "latest scan on rear is 0.60 s old", "scan on rear: the scanner"),
    ],
)
def test_each_silent_or_blind_laser_stops_the_robot(name, other, old, blind):
    monitor = CollisionMonitor(more_scans=["rear"])
    monitor.add_scan(laser_scan(other, 0.0), other)
    assert "no scan has arrived yet" in monitor.filter(0.0, HERE, AT_REST, AHEAD).reason
    monitor.add_scan(laser_scan(name, 0.0), name)
    assert monitor.filter(0.0, HERE, AT_REST, AHEAD).action == PASS

    # Scans of the other laser are no substitute.
    monitor.add_scan(laser_scan(other, 0.6), other)
    assert old in monitor.filter(0.6, HERE, AT_REST, AHEAD).reason

    invalid = np.full(BEAMS, np.nan, np.float32)
    monitor.add_scan(laser_scan(name, 0.6, ranges=invalid), name)
    verdict = monitor.filter(0.6, HERE, AT_REST, AHEAD)
    assert verdict.action == STOP
    assert verdict.reason.startswith(blind)


def test_a_laser_does_not_clear_the_memory_of_another():
    """A low step ahead is in the scan plane of the first laser only."""
    monitor = CollisionMonitor(more_scans=["high"])
    monitor.add_scan(scan_of(wall(1.0), HERE))
    # The high laser looks over the step to a wall 4 m ahead.
    for stamp in (0.0, 0.1):
        monitor.add_scan(scan_of(wall(4.0, 3.0), HERE, stamp), "high")
    monitor.add_scan(scan_of(wall(1.0), HERE, 0.1))
    assert verdict_on(monitor, 2.0, 0.1).action != PASS


def test_another_place_clears_the_memories_of_all_lasers():
    # The posts of another seed: no motion explains the change.
    monitor = seen_both(posts(0), CLOSE_BEHIND)
    assert "another place" in monitor.add_scan(scan_of(posts(1), HERE, 0.05))
    monitor.add_scan(scan_of(posts(1), HERE, 0.1))
    creeping = monitor.filter(0.1, HERE, AT_REST, BACK)
    assert creeping.command == pytest.approx((-0.1, 0.0)), "the space behind is unknown"


def test_only_the_first_laser_corrects_the_pose():
    """The pose of the second laser has an error of 3 cm. The first laser faces the same way."""
    monitor = CollisionMonitor(more_scans=["rear"])
    monitor.add_scan(scan_of(wall(2.0), HERE))
    shifted = scan_of(wall(2.0), HERE, 0.05, sensor_pose=(0.15, 0.0, 0.0))
    assert monitor.add_scan(shifted, "rear") == ""
    assert monitor.matcher.correction == (0.0, 0.0, 0.0)


def test_a_laser_may_be_added_later():
    """The second laser shares the topic of the first one, but has its own frame."""
    monitor = CollisionMonitor()
    monitor.add_scan(scan_of(wall(3.0), HERE))
    monitor.add_scan(behind(WALL_BEHIND, frame="rear"))
    assert "obstacle" in monitor.filter(0.0, HERE, AT_REST, BACK).reason
    monitor.add_scan(scan_of(wall(3.0), HERE, 0.6))
    verdict = monitor.filter(0.6, HERE, AT_REST, AHEAD)
    assert "scan of frame rear is 0.60 s old" in verdict.reason


def went_on(monitor, since, until, name="", frame=""):
    """Add scans of one laser at 10 Hz, and return the strays that they let go."""
    strays = []
    for stamp in np.arange(since, until, 0.1):
        scan = laser_scan(name, stamp, frame=frame)
        assert monitor.add_scan(scan) == ""
        strays += monitor.strays
    return strays


@pytest.mark.parametrize("is_first", [False, True])
@pytest.mark.parametrize(
    ("points", "changes"),
    [
        (CLOSE_BEHIND, {}),
        (wall(-3.0), {}),
        (CLOSE_BEHIND, {"ranges": np.full(BEAMS, np.nan, np.float32)}),
    ],
    ids=["obstacles", "free space", "blind"],
)
def test_a_stray_scan_of_another_frame_stops_the_robot_only_for_seconds(is_first, points, changes):
    """It may even be the first scan on the topic, or invalid."""
    monitor = CollisionMonitor()
    if not is_first:
        assert went_on(monitor, 0.0, 9.95) == []
    monitor.add_scan(scan_of(points, BEHIND, 10.0, frame="stray", **changes))

    # Until it is let go, its silence counts as that of a laser.
    assert went_on(monitor, 10.0, 14.95) == []
    assert monitor.filter(14.9, HERE, AT_REST, AHEAD).action == STOP
    (stray,) = went_on(monitor, 15.0, 15.35)
    assert (stray.frame, stray.count) == ("stray", 1)
    assert monitor.filter(15.3, HERE, AT_REST, AHEAD).action == PASS
    # Nothing of it remains: neither obstacles nor observed space.
    assert "not been observed" in monitor.filter(15.3, HERE, AT_REST, BACK).reason

    # The remaining laser is the robot's first one: its silence stops the robot.
    assert "the latest scan is 0.60 s old" in monitor.filter(15.9, HERE, AT_REST, AHEAD).reason


def test_the_pose_is_not_corrected_by_a_stray_that_came_first():
    """The stray's pose has an error of 3 cm. Both lasers see the same wall."""
    monitor = CollisionMonitor()
    stray_scan = scan_of(wall(3.0), HERE, 9.9, sensor_pose=(0.15, 0.0, 0.0), frame="stray")
    monitor.add_scan(stray_scan)
    went_on(monitor, 10.0, 15.35)
    assert monitor.matcher.correction == pytest.approx((0.0, 0.0, 0.0), abs=1e-6)


def test_the_frame_of_planners_does_not_jump_when_a_stray_is_let_go():
    monitor = CollisionMonitor()
    monitor.add_scan(scan_of(wall(3.0), HERE, 9.9, frame="stray"))
    monitor.matcher.correction = (0.5, -0.2, 0.3)
    assert len(went_on(monitor, 10.0, 15.35)) == 1
    assert monitor.matcher.correction == pytest.approx((0.5, -0.2, 0.3), abs=0.02)


def test_an_established_laser_that_falls_silent_stops_the_robot_for_good():
    monitor = CollisionMonitor()
    for stamp in np.arange(0.0, 9.95, 0.1):
        monitor.add_scan(laser_scan("", stamp))
        monitor.add_scan(laser_scan("rear", stamp, frame="rear"))
    assert monitor.filter(9.9, HERE, AT_REST, AHEAD).action == PASS
    assert went_on(monitor, 10.0, 99.95) == []
    verdict = monitor.filter(99.9, HERE, AT_REST, AHEAD)
    assert verdict.action == STOP
    assert "the latest scan of frame rear is 90.00 s old" in verdict.reason


def test_a_stray_does_not_replace_a_laser_that_pauses():
    monitor = CollisionMonitor()
    assert went_on(monitor, 0.0, 0.95) == []
    # Only an established laser may let go of another one.
    assert went_on(monitor, 9.0, 9.35, frame="stray") == []
    verdict = monitor.filter(9.3, HERE, AT_REST, AHEAD)
    assert "the latest scan is 8.40 s old" in verdict.reason


def test_a_configured_laser_is_never_let_go():
    monitor = CollisionMonitor(more_scans=["rear"])
    monitor.add_scan(laser_scan("rear", 0.0), "rear")
    assert went_on(monitor, 0.0, 99.95) == []
    assert "scan on rear is 99.90 s old" in monitor.filter(99.9, HERE, AT_REST, AHEAD).reason


def test_a_stray_does_not_survive_a_clock_jump():
    monitor = CollisionMonitor()
    assert went_on(monitor, 10.0, 19.95) == []
    monitor.add_scan(laser_scan("", 19.9, frame="stray"))
    monitor.reset()
    assert went_on(monitor, 0.0, 0.35) == []
    assert monitor.filter(0.3, HERE, AT_REST, AHEAD).action == PASS


def test_an_infinite_range_max_is_valid():
    # Some drivers give no largest range. Without any number, the scan would mean nothing.
    monitor = CollisionMonitor()
    assert monitor.add_scan(scan_of(wall(1.0), HERE, range_max=math.inf)) == ""
    assert verdict_on(monitor, 2.0).action == SLOW
    without_minimum = scan_of(wall(1.0), HERE, 0.1, range_min=math.nan)
    assert "not finite" in monitor.add_scan(without_minimum)
    without_maximum = scan_of(wall(1.0), HERE, 0.2, range_max=math.nan)
    assert "the scan has range_min" in monitor.add_scan(without_maximum)


def test_the_silence_of_a_laser_counts_from_the_reset_on():
    monitor = CollisionMonitor()
    start = 1.7e9  # stamps of a clock [s]
    assert went_on(monitor, start, start + 2.95, frame="front") == []
    assert went_on(monitor, start, start + 5.95, frame="rear") == []
    monitor.reset()
    assert went_on(monitor, start + 9.0, start + 13.95, frame="rear") == []
    assert "no scan has arrived yet" in monitor.filter(start + 13.9, HERE, AT_REST, AHEAD).reason
    (stray,) = went_on(monitor, start + 14.0, start + 14.35, frame="rear")
    assert stray.frame == "front"
