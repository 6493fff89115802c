"""Tests of the collision monitor's stopping distances and angles, compared with closed-form physics."""

import math
from dataclasses import replace

import numpy as np
import pytest

from applr_ros1.monitor.known_space import CELL_M
from applr_ros1.monitor.monitor import PASS, SLOW, STOP, CollisionMonitor
from applr_ros1.monitor.scan_matching import beam_at
from applr_ros1.monitor.settings import MonitorSettings
from applr_ros1.monitor.stopping import (
    EVERYTHING,
    _is_deeper,
    _is_seen,
    braking_time,
    edge_points,
    half_planes,
    penetration,
    safe_scale,
)
from applr_ros1.robots import JACKAL
from tests.monitor.test_collision_monitor import scan_of, seen_all_around, wall

SETTINGS = replace(MonitorSettings.of(JACKAL), turn_gain=1.0, turn_ahead=0.0)
FRONT, SIDE, MARGIN = 0.229, 0.208, 0.03
HERE = (0.0, 0.0, 0.0)
TOLERANCE = 0.045  # tolerance of a stopping distance [m], from the step between two checked poses at 2 m/s


def braking_way(speed, deceleration):
    """Return the braking distance [m] of a base whose deceleration is at most .6 m/s^2 below .3 m/s."""
    last = min(speed, 0.3)
    return (speed**2 - last**2) / (2 * deceleration) + last**2 / (2 * 0.6)


def least(low, high, passes):
    """Return the smallest number for which the monotone predicate `passes` is true."""
    for _ in range(10):
        middle = 0.5 * (low + high)
        low, high = (low, middle) if passes(middle) else (middle, high)
    return high


@pytest.mark.parametrize(
    ("measured", "commanded", "old", "way"),
    [  # braking with 4 m/s^2 after 0.15 s
        (2.0, 2.0, 0.0, 2.0 * 0.15 + braking_way(2.0, 4.0)),
        (0.0, 2.0, 0.0, 2.0 * 0.15 + braking_way(2.0, 4.0)),  # The base gains speed at once.
        (2.0, 0.5, 0.0, braking_way(2.0, 4.0)),  # The base loses speed as in braking.
        (1.0, 1.0, 0.3, 1.0 * 0.45 + braking_way(1.0, 4.0)),
        (1.0, 2.0, 0.3, 1.0 * 0.3 + 2.0 * 0.15 + braking_way(2.0, 4.0)),
    ],
)
@pytest.mark.parametrize("side", [1.0, -1.0])
def test_the_stopping_distance(measured, commanded, old, way, side):
    planes = half_planes(SETTINGS.body)

    def passes(distance):
        points = np.array([[side * (FRONT + MARGIN + distance), y] for y in (-0.2, 0.0, 0.2)])
        twist, command = (side * measured, 0.0), (side * commanded, 0.0)
        rest = ((old, 0.15), (4.0, 12.0), EVERYTHING)
        return safe_scale(points, planes, MARGIN, twist, command, *rest)[0] == 1.0

    assert least(0.0, 3.0, passes) == pytest.approx(way, abs=TOLERANCE)


@pytest.mark.parametrize(("deceleration", "way"), [(1.9, 0.3**2 / 1.2), (0.5, 0.3**2 / 1.0)])
def test_the_last_part_of_braking_is_gentle(deceleration, way):
    """Nearly stopped wheels may have less friction than fast ones: without this, the Jackal hit walls at .26 m/s."""
    planes = half_planes(SETTINGS.body)

    def passes(distance):
        points, twist = np.array([[FRONT + MARGIN + distance, 0.0]]), (0.3, 0.0)
        return safe_scale(points, planes, MARGIN, twist, twist, (0.0, 0.1), (deceleration, 3.3), EVERYTHING)[0] == 1.0

    assert least(0.0, 1.0, passes) == pytest.approx(0.3 * 0.1 + way, abs=0.01)


def test_braking_ends_gently_for_any_deceleration():
    assert braking_time(2.0, 1.9) == pytest.approx(1.7 / 1.9 + 0.3 / 0.6)
    assert braking_time(0.2, 1.9) == pytest.approx(0.2 / 0.6)
    assert braking_time(1.0, 0.5) == pytest.approx(1.0 / 0.5)


@pytest.mark.parametrize("gain", [1.0, 1.6])
def test_the_stopping_angle(gain):
    """A corner turns at 2 rad/s towards a post .28 m from the robot's centre, and stops after .15 s with 4 rad/s^2."""
    planes, radius, turning = half_planes(SETTINGS.body), 0.28, (0.0, 2.0 / gain)
    first = math.asin((SIDE + MARGIN) / radius)  # direction in which the widened outline is `radius` away [rad]

    def passes(turn):
        points = np.array([[radius * math.cos(first + turn), radius * math.sin(first + turn)]])
        rest = ((0.0, 0.15), (1.9, 4.0), EVERYTHING, (0.0, gain, 0.0, 0.0))
        return safe_scale(points, planes, MARGIN, turning, turning, *rest)[0] == 1.0

    assert least(0.0, 1.0, passes) == pytest.approx(2.0 * 0.15 + 2.0**2 / 8, abs=TOLERANCE)


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_lateral_slip_ends_with_the_forward_motion(side):
    """At 1 m/s forward and .6 m/s of slip, both are constant for .15 s and then fall to 0 together."""
    planes = half_planes(SETTINGS.body)

    def passes(distance):
        post = np.array([[0.3, side * (SIDE + MARGIN + distance)]])
        rest = ((0.0, 0.15), (1.9, 3.3), EVERYTHING, (0.0, 1.0, 0.0, side * 0.6))
        return safe_scale(post, planes, MARGIN, (1.0, 0.0), (1.0, 0.0), *rest)[0] == 1.0

    assert least(0.0, 1.0, passes) == pytest.approx(0.6 * (0.15 + braking_way(1.0, 1.9)), abs=0.02)


def test_lateral_slip_may_end_in_a_turn_faster_than_commanded():
    """The base slides to the left, away from a post, and turns to the right."""
    post, planes = np.array([[0.5, -0.3]]), half_planes(SETTINGS.body)
    rest = (post, planes, MARGIN, (1.0, 0.0), (1.0, -0.5), (0.0, 0.15), (1.9, 3.3), EVERYTHING)
    assert safe_scale(*rest, (0.0, 1.0, 0.0, 0.6))[0] == 1.0
    assert safe_scale(*rest, (0.0, 2.0, 0.0, 0.6))[0] < 1.0


def moving(velocity, **changes):
    """Return a monitor in an empty room whose poses imply the velocity (v, w, s)."""
    monitor = seen_all_around(wall(9.0), replace(SETTINGS, **changes))
    monitor.motion.take, monitor.motion.velocity = lambda *_: None, velocity
    return monitor


def test_lateral_slip_excludes_the_turn_of_the_poses():
    """The turn is about a point .13 m ahead. The turn rate in the odometry's twist, which is newer, is not used."""
    monitor = moving((1.0, 1.0, 0.2), turn_ahead=0.13)
    assert monitor._twists((1.0, 1.3)) == [(1.0, 1.3, pytest.approx(0.33))]


def test_slipping_wheels_are_braked_from_the_speed_of_the_poses():
    """1 m/s was commanded a tenth of a second ago, and the wheels nearly stand or turn backwards."""
    for reported in (0.2, -0.1):
        monitor = moving((-1.0, 0.0, 0.0))
        monitor._given = -0.1, -1.0, 0.0
        verdict = monitor.filter(0.0, HERE, (-reported, 0.0), (0.0, 0.0))
        assert verdict.command[0] == pytest.approx(-1.0 + 1.9 * 0.1)


def test_the_velocity_of_the_poses_refers_to_their_stamps():
    """The robot drives at 1 m/s, and its last pose is .05 s old."""
    monitor = seen_all_around(wall(9.0), SETTINGS)
    for now, age in ((0.0, 0.0), (0.1, 0.0), (0.25, 0.05)):
        monitor.filter(now, (now - age, 0.0, 0.0), (1.0, 0.0), (1.0, 0.0), (age, 0.0))
    assert monitor.motion.velocity[0] == pytest.approx(1.0)


def test_the_previous_turn_rate_limits_the_arc_of_a_slower_command():
    """Between posts, a base drives straight on at 1 m/s, was commanded to turn at 2 rad/s, and must now slow down."""
    monitor = CollisionMonitor(SETTINGS)
    monitor._given, brake, limited = (0.0, 1.0, 2.0), (SETTINGS.deceleration, SETTINGS.yaw_deceleration), set()
    for x, y in [(x, y) for x in np.arange(0.2, 0.7, 0.05) for y in np.arange(0.2, 0.7, 0.05)]:
        given = (1.0, 0.0), (0.5, 1.0), (0.0, 0.15)
        scale = monitor._scale(np.array([[x, y]]), [(1.0, 0.0, 0.0)], *given[1:], EVERYTHING)
        arguments = np.array([[x, y]]), monitor._planes, MARGIN, *given, brake, EVERYTHING
        assert scale == safe_scale(*arguments, (2.0, 1.0, 0.0, 0.0))
        limited.add(scale == safe_scale(*arguments, (1.0, 1.0, 0.0, 0.0)))
    assert limited == {True, False}


def test_poses_faster_than_any_command_stop_the_robot_at_once():
    """The odometry was set to a place 1 km away. Checking a command at the resulting speed would take minutes."""
    monitor = seen_all_around(wall(9.0), SETTINGS)
    for stamp, x in ((-0.1, 0.0), (0.0, 1000.0)):
        verdict = monitor.filter(stamp, (x, 0.0, 0.0), (0.0, 0.0), (1.0, 0.0))
    assert verdict.action == STOP
    assert verdict.reason == "the poses imply 10000 m/s and 0 rad/s, which is too fast: check the odometry"


@pytest.mark.parametrize(
    ("scan", "ages", "way"),
    [  # at 1 m/s: ages add to the reaction time, and the age of the pose also adds the distance driven since
        (0.0, (0.0, 0.0), 0.15),
        (0.3, (0.0, 0.0), 0.45),
        (0.0, (0.0, 0.3), 0.45),
        (0.0, (0.3, 0.0), 0.75),
    ],
)
def test_the_stopping_distance_depends_on_the_ages_of_the_inputs(scan, ages, way):
    def passes(distance):
        monitor = seen_all_around(wall(FRONT + MARGIN + distance + 0.05), SETTINGS)
        return monitor.filter(scan, HERE, (1.0, 0.0), (1.0, 0.0), ages).action == PASS

    assert least(0.0, 2.0, passes) == pytest.approx(way + braking_way(1.0, 1.9), abs=TOLERANCE)


def test_a_fast_base_stops_for_an_obstacle_that_only_its_current_speed_reaches():
    """At 2 m/s, with .3 m/s commanded, a wall is .75 m ahead, beyond the stopping distance of the command."""
    monitor = seen_all_around(wall(1.0), SETTINGS)
    verdict = monitor.filter(0.0, HERE, (2.0, 0.0), (0.3, 0.0))
    assert (verdict.action, verdict.reason) == (STOP, "braking: an obstacle is too near to stop")


@pytest.mark.parametrize(
    ("changes", "command", "age", "post"),
    [  # The robot turns up to three times as fast as commanded, for 2.6 s. The pose is 1.5 s old.
        ({"turn_gain": 3.0, "yaw_deceleration": 0.3}, (1.0, 0.26), 0.0, (1.28, 0.82)),
        ({"scan_timeout": 2.0}, (0.3, 0.0), 1.5, (1.2, 0.0)),
    ],
    ids=["turn", "age"],
)
def test_obstacle_points_count_as_far_as_the_body_may_reach(changes, command, age, post):
    for points, action in (([post], SLOW), ([], PASS)):
        monitor = seen_all_around(points, replace(SETTINGS, **changes))
        monitor.seen.cells[:] = 1  # The space was observed from other places.
        assert monitor.filter(0.0, HERE, command, command, (age, 0.0)).action == action


def test_turning_into_unobserved_space_is_limited_to_creep_speed():
    """The fastest corner of the body moves at creep_speed."""
    monitor = CollisionMonitor(SETTINGS)
    monitor.add_scan(scan_of(wall(2.0), HERE))
    verdict = monitor.filter(0.0, HERE, (0.0, 0.0), (0.0, 1.5))
    assert verdict.action == SLOW
    assert "creeping" in verdict.reason
    assert verdict.command == pytest.approx((0.0, SETTINGS.creep_speed / math.hypot(FRONT, SIDE)))


def test_vectorised_kernels_equal_the_scalar_computation():
    """Points in the body, cells under its edge, and the beam towards a bearing are equal to the last bit."""
    random, planes, edge = np.random.default_rng(3), half_planes(SETTINGS.body), edge_points(SETTINGS.body)
    n, outcomes = 60, set()
    for _ in range(300):
        (x, y, yaw), rows = random.uniform(-0.3, 0.3, 3), random.uniform(-0.6, 0.6, (7, 20))
        c, s, rows[2] = math.cos(yaw), math.sin(yaw), random.uniform(0.0, 0.3, 20)
        depths = [
            penetration(planes, MARGIN, c * (px - x) + s * (py - y), c * (py - y) - s * (px - x))
            for px, py in rows[:2].T
        ]
        deeper = any(depth > most for depth, most in zip(depths, rows[2]))
        assert _is_deeper(rows, rows[2], planes, MARGIN, (x, y, c, s)) == deeper

        cells = (random.random((n, n)) > 0.002).astype(np.uint8)
        corner, pose = random.integers(-200, 200, 2), (0.0, 0.0, random.uniform(-3.0, 3.0))
        pose = (*(CELL_M * (corner + random.uniform(8.0, n - 8.0, 2))), pose[2])
        pc, ps, seen = math.cos(pose[2]), math.sin(pose[2]), True
        for ahead, aside in edge:
            ex, ey = x + c * ahead - s * aside, y + s * ahead + c * aside
            place = (pose[0] + pc * ex - ps * ey) / CELL_M, (pose[1] + ps * ex + pc * ey) / CELL_M
            i, j = map(math.floor, place)
            window = 0 <= i - corner[0] < n and 0 <= j - corner[1] < n
            seen = seen and window and bool(cells[i % n, j % n])
        assert _is_seen((cells, *map(int, corner), edge, pose), (x, y, c, s)) == seen
        outcomes |= {("deeper", deeper), ("seen", seen)}

        first, step, bearing = random.uniform(-3.2, 3.2), random.choice([-1.0, 1.0]) * 0.01, random.uniform(-20.0, 20.0)
        plain = bearing - first
        plain = plain % (2.0 * math.pi) if step > 0.0 else -((-plain) % (2.0 * math.pi))
        assert beam_at(first, step, bearing) == plain / step
    assert len(outcomes) == 4
