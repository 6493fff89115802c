"""The ways that the monitor keeps free, in metres and radians, as the sums of physics have them."""

import math
from dataclasses import replace

import numpy as np
import pytest

from applr_ros1.monitor.monitor import PASS, SLOW, STOP, CollisionMonitor
from applr_ros1.monitor.settings import MonitorSettings
from applr_ros1.monitor.stopping import EVERYTHING, half_planes, safe_scale
from applr_ros1.robots import JACKAL
from tests.monitor.test_collision_monitor import scan_of, seen_all_around, wall

SETTINGS = replace(MonitorSettings.of(JACKAL), turn_gain=1.0, turn_ahead=0.0)
FRONT, SIDE, MARGIN = 0.229, 0.208, 0.03
HERE = (0.0, 0.0, 0.0)
TOLERANCE = 0.045  # [m] of the ways: the time between two checked poses at 2 m/s


def least(low, high, passes):
    """The least number for which `passes` is true, which it is from there on."""
    for _ in range(10):
        middle = 0.5 * (low + high)
        low, high = (low, middle) if passes(middle) else (middle, high)
    return high


@pytest.mark.parametrize(
    ("measured", "commanded", "old", "way"),
    [  # braking at 4 m/s^2 after 0.15 s
        (2.0, 2.0, 0.0, 2.0 * 0.15 + 2.0**2 / 8),
        (0.0, 2.0, 0.0, 2.0 * 0.15 + 2.0**2 / 8),  # gains speed at once
        (2.0, 0.5, 0.0, 2.0**2 / 8),  # loses it as it brakes
        (1.0, 1.0, 0.3, 1.0 * 0.45 + 1.0 / 8),
        (1.0, 2.0, 0.3, 1.0 * 0.3 + 2.0 * 0.15 + 2.0**2 / 8),
    ],
)
@pytest.mark.parametrize("side", [1.0, -1.0])
def test_the_way_to_a_stop(measured, commanded, old, way, side):
    planes = half_planes(SETTINGS.body)

    def passes(distance):
        points = np.array([[side * (FRONT + MARGIN + distance), y] for y in (-0.2, 0.0, 0.2)])
        twist, command = (side * measured, 0.0), (side * commanded, 0.0)
        rest = ((old, 0.15), (4.0, 12.0), EVERYTHING)
        return safe_scale(points, planes, MARGIN, twist, command, *rest)[0] == 1.0

    assert least(0.0, 3.0, passes) == pytest.approx(way, abs=TOLERANCE)


def test_the_turn_to_a_stop():
    """A post beside the robot, .28 m from its middle: a corner comes to it, at 2 rad/s with .15 s and 4 rad/s^2."""
    planes, radius = half_planes(SETTINGS.body), 0.28
    first = math.asin((SIDE + MARGIN) / radius)  # direction in which the outline, widened, is so far away

    def passes(turn):
        points = np.array([[radius * math.cos(first + turn), radius * math.sin(first + turn)]])
        rest = ((0.0, 0.15), (1.9, 4.0), EVERYTHING)
        return safe_scale(points, planes, MARGIN, (0.0, 2.0), (0.0, 2.0), *rest)[0] == 1.0

    assert least(0.0, 1.5, passes) == pytest.approx(2.0 * 0.15 + 2.0**2 / 8, abs=TOLERANCE)


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_a_slide_ends_with_the_drive(side):
    """At 1 m/s ahead and .6 m/s aside: .15 s of it, then both fall to 0 with 1.9 m/s^2 ahead."""
    planes = half_planes(SETTINGS.body)

    def passes(distance):
        post = np.array([[0.3, side * (SIDE + MARGIN + distance)]])
        rest = ((0.0, 0.15), (1.9, 3.3), EVERYTHING, (0.0, 1.0, 0.0, side * 0.6))
        return safe_scale(post, planes, MARGIN, (1.0, 0.0), (1.0, 0.0), *rest)[0] == 1.0

    assert least(0.0, 1.0, passes) == pytest.approx(0.6 * (0.15 + 0.5 / 1.9), abs=0.02)


@pytest.mark.parametrize(
    ("scan", "ages", "way"),
    [  # at 1 m/s; what is old adds to the reaction, the pose's age also to what was driven since
        (0.0, (0.0, 0.0), 0.15),
        (0.3, (0.0, 0.0), 0.45),
        (0.0, (0.0, 0.3), 0.45),
        (0.0, (0.3, 0.0), 0.75),
    ],
)
def test_the_way_that_a_command_needs_by_the_ages_of_what_it_is_judged_by(scan, ages, way):
    def passes(distance):
        monitor = seen_all_around(wall(FRONT + MARGIN + distance + 0.05), SETTINGS)
        return monitor.filter(scan, HERE, (1.0, 0.0), (1.0, 0.0), ages).action == PASS

    assert least(0.0, 2.0, passes) == pytest.approx(way + 1.0 / (2 * 1.9), abs=TOLERANCE)


def test_a_fast_base_is_stopped_for_what_only_its_own_speed_reaches():
    """2 m/s measured, .3 m/s commanded, a wall after .75 m: it lies beyond the stopping distance of the command."""
    monitor = seen_all_around(wall(1.0), SETTINGS)
    verdict = monitor.filter(0.0, HERE, (2.0, 0.0), (0.3, 0.0))
    assert (verdict.action, verdict.reason) == (STOP, "braking: an obstacle is too near to stop")


def test_turning_into_the_unseen_is_as_slow_as_creeping():
    """The corner of the body moves at creep_speed."""
    monitor = CollisionMonitor(SETTINGS)
    monitor.see(scan_of(wall(2.0), HERE))
    verdict = monitor.filter(0.0, HERE, (0.0, 0.0), (0.0, 1.5))
    assert verdict.action == SLOW
    assert "creeping" in verdict.reason
    assert verdict.command == pytest.approx((0.0, SETTINGS.creep_speed / math.hypot(FRONT, SIDE)))
