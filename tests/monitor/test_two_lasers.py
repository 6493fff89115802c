"""Tests of a second laser: it adds obstacles, clears none of the first laser, and stops the base if it is silent."""

import math

import numpy as np
import pytest

from applr_ros1.monitor.monitor import PASS, SLOW, STOP, CollisionMonitor
from tests.monitor.test_collision_monitor import BEAMS, CLOSE_BEHIND, posts, scan_of, wall

HERE = (0.0, 0.0, 0.0)
BACK = (-0.5, 0.0)


def behind(points, stamp=0.0, **changes):
    """Return the scan of a laser that faces backwards."""
    return scan_of(points, (0.0, 0.0, math.pi), stamp, **changes)


def seen_both(ahead, back):
    monitor = CollisionMonitor(more_scans=["rear"])
    assert monitor.add_scan(scan_of(ahead, HERE)) == ""
    assert monitor.add_scan(behind(back), "rear") == ""
    return monitor


def test_the_robot_backs_up_as_far_as_the_second_laser_observes():
    one = CollisionMonitor()
    one.add_scan(scan_of(wall(3.0), HERE))
    assert "creeping" in one.filter(0.0, HERE, (0.0, 0.0), BACK).reason
    free = seen_both(wall(3.0), [(-3.0, 0.0), (-3.0, 0.1)])
    assert free.filter(0.0, HERE, (0.0, 0.0), BACK).action == PASS
    near = seen_both(wall(3.0), [(-0.4, y) for y in np.arange(-0.3, 0.31, 0.03)])
    verdict = near.filter(0.0, HERE, (0.0, 0.0), BACK)
    assert "obstacle" in verdict.reason
    assert verdict.action in (SLOW, STOP)


@pytest.mark.parametrize("name", ["", "rear"])
def test_each_silent_or_blind_laser_stops_the_robot(name):
    monitor = CollisionMonitor(more_scans=["rear"])
    other = "rear" if not name else ""

    def scan(of, stamp, **changes):
        return behind(wall(-3.0), stamp, **changes) if of else scan_of(wall(3.0), HERE, stamp, **changes)

    monitor.add_scan(scan(other, 0.0), other)
    assert "no scan has arrived yet" in monitor.filter(0.0, HERE, (0.0, 0.0), (0.5, 0.0)).reason
    monitor.add_scan(scan(name, 0.0), name)
    assert monitor.filter(0.0, HERE, (0.0, 0.0), (0.5, 0.0)).action == PASS
    monitor.add_scan(scan(other, 0.6), other)
    named = "scan on rear" if name else "scan"
    assert f"latest {named} is 0.60 s old" in monitor.filter(0.6, HERE, (0.0, 0.0), (0.5, 0.0)).reason
    monitor.add_scan(scan(name, 0.6, ranges=np.full(BEAMS, np.nan, np.float32)), name)
    verdict = monitor.filter(0.6, HERE, (0.0, 0.0), (0.5, 0.0))
    assert verdict.action == STOP
    assert verdict.reason.startswith("rear: the scanner is blind" if name else "the scanner is blind")


def test_a_laser_does_not_clear_the_memory_of_another():
    """A low step ahead is in the scan plane of the first laser only."""
    monitor = CollisionMonitor(more_scans=["high"])
    monitor.add_scan(scan_of(wall(1.0), HERE))
    for stamp in (0.0, 0.1):
        monitor.add_scan(scan_of(wall(4.0, 3.0), HERE, stamp), "high")
    monitor.add_scan(scan_of(wall(1.0), HERE, 0.1))
    assert monitor.filter(0.1, HERE, (0.0, 0.0), (2.0, 0.0)).action != PASS


def test_another_place_clears_the_memories_of_all_lasers():
    monitor = seen_both(posts(0), CLOSE_BEHIND)
    assert "another place" in monitor.add_scan(scan_of(posts(1), HERE, 0.05))
    monitor.add_scan(scan_of(posts(1), HERE, 0.1))
    assert monitor.filter(0.1, HERE, (0.0, 0.0), BACK).command == pytest.approx((-0.1, 0.0))  # unknown space


def test_only_the_first_laser_corrects_the_pose():
    """The pose of the second laser has an error of 3 cm. The first laser faces the same way."""
    monitor = CollisionMonitor(more_scans=["rear"])
    monitor.add_scan(scan_of(wall(2.0), HERE))
    assert monitor.add_scan(scan_of(wall(2.0), HERE, 0.05, sensor_pose=(0.15, 0.0, 0.0)), "rear") == ""
    assert monitor.matcher.correction == (0.0, 0.0, 0.0)


def test_a_laser_may_be_added_later():
    """The second laser shares the topic of the first one, but has its own frame."""
    monitor = CollisionMonitor()
    monitor.add_scan(scan_of(wall(3.0), HERE))
    monitor.add_scan(behind([(-0.4, y) for y in np.arange(-0.3, 0.31, 0.03)]), "scan of rear")
    assert "obstacle" in monitor.filter(0.0, HERE, (0.0, 0.0), BACK).reason
    monitor.add_scan(scan_of(wall(3.0), HERE, 0.6))
    assert "scan on scan of rear is 0.60 s old" in monitor.filter(0.6, HERE, (0.0, 0.0), (0.5, 0.0)).reason


def test_an_infinite_range_max_is_valid():
    monitor = CollisionMonitor()
    assert monitor.add_scan(scan_of(wall(1.0), HERE, range_max=math.inf)) == ""
    assert monitor.filter(0.0, HERE, (0.0, 0.0), (2.0, 0.0)).action == SLOW
    assert "not finite" in monitor.add_scan(scan_of(wall(1.0), HERE, 0.1, range_min=math.nan))
    assert "the scan has range_min" in monitor.add_scan(scan_of(wall(1.0), HERE, 0.2, range_max=math.nan))
