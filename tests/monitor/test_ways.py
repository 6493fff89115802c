"""Tests of stopping distances and angles, compared with closed-form physics."""

import math
from dataclasses import replace

import numpy as np
import pytest

from applr_ros1.common.angles import inverse, transform_point
from applr_ros1.monitor.known_space import CELL_M
from applr_ros1.monitor.monitor import PASS, SLOW, STOP, CollisionMonitor, MonitorOutput
from applr_ros1.monitor.motion import PoseVelocity
from applr_ros1.monitor.rays import beam_at
from applr_ros1.monitor.stopping import (
    BaseMotion,
    BodyOutline,
    BodyPose,
    Braking,
    SeenCells,
    braking_time,
    is_deeper,
    is_seen,
    obstacles_of,
    penetration,
)
from tests.monitor import scenes
from tests.monitor.scenes import (
    AT_REST,
    BODY,
    FRONT,
    HERE,
    SIDE,
    safe_scale_of,
    scan_of,
    seen_all_around,
    verdict_on,
    wall,
)

# Closed forms are simple for a base that turns as commanded, about its own centre.
SETTINGS = replace(scenes.SETTINGS, turn_gain=1.0, turn_ahead=0.0)
MARGIN = BODY.margin
BRAKING = Braking(1.9, 3.3)  # the Jackal's limits [m/s^2, rad/s^2]
# Tolerance of a stopping distance [m], from the step between poses at 2 m/s.
TOLERANCE = 0.045
STRAIGHT_ON = (1.0, 0.0)  # command (v, w) [m/s, rad/s]


def braking_distance(speed, deceleration):
    """Return the braking distance [m] of a base that brakes gently below .3 m/s."""
    gentle_speed = min(speed, 0.3)
    hard = (speed**2 - gentle_speed**2) / (2 * deceleration)
    gentle = gentle_speed**2 / (2 * 0.6)
    return hard + gentle


def smallest_passing(lowest, highest, passes):
    """Return the smallest number for which the monotone predicate `passes` is true."""
    # Ten halvings: a thousandth of the interval.
    for _ in range(10):
        middle = 0.5 * (lowest + highest)
        if passes(middle):
            highest = middle
        else:
            lowest = middle
    return highest


@pytest.mark.parametrize(
    ("measured", "commanded", "age", "expected"),
    [
        # The base brakes with 4 m/s^2 after 0.15 s.
        (2.0, 2.0, 0.0, 2.0 * 0.15 + braking_distance(2.0, 4.0)),
        # It gains speed at once.
        (0.0, 2.0, 0.0, 2.0 * 0.15 + braking_distance(2.0, 4.0)),
        # It loses speed as in braking.
        (2.0, 0.5, 0.0, braking_distance(2.0, 4.0)),
        # It keeps its speed for as long as its pose is old.
        (1.0, 1.0, 0.3, 1.0 * 0.45 + braking_distance(1.0, 4.0)),
        (1.0, 2.0, 0.3, 1.0 * 0.3 + 2.0 * 0.15 + braking_distance(2.0, 4.0)),
    ],
)
@pytest.mark.parametrize("side", [1.0, -1.0])
def test_the_stopping_distance(measured, commanded, age, expected, side):
    def passes(distance):
        x = side * (FRONT + MARGIN + distance)
        # Three points across the way: the body's front is straight.
        points = [(x, y) for y in (-0.2, 0.0, 0.2)]
        motion = BaseMotion(side * measured, 0.0)
        command = (side * commanded, 0.0)
        return safe_scale_of(points, motion, command, pose_age=age) == 1.0

    assert smallest_passing(0.0, 3.0, passes) == pytest.approx(expected, abs=TOLERANCE)


@pytest.mark.parametrize(
    ("deceleration", "braking"),
    [
        (1.9, 0.3**2 / 1.2),  # below .3 m/s with 0.6 m/s^2
        (0.5, 0.3**2 / 1.0),  # weaker brakes are gentle anyway
    ],
)
def test_the_last_part_of_braking_is_gentle(deceleration, braking):
    """Nearly stopped wheels may have less friction than fast ones.

    Without this, the Jackal hit walls at .26 m/s.
    """

    def passes(distance):
        scale = safe_scale_of(
            [(FRONT + MARGIN + distance, 0.0)],
            BaseMotion(0.3, 0.0),
            (0.3, 0.0),
            Braking(deceleration, 3.3),
            reaction=0.1,
        )
        return scale == 1.0

    expected = 0.3 * 0.1 + braking
    assert smallest_passing(0.0, 1.0, passes) == pytest.approx(expected, abs=0.01)


def test_braking_ends_gently_for_any_deceleration():
    assert braking_time(2.0, 1.9) == pytest.approx(1.7 / 1.9 + 0.3 / 0.6)
    assert braking_time(0.2, 1.9) == pytest.approx(0.2 / 0.6)
    assert braking_time(1.0, 0.5) == pytest.approx(1.0 / 0.5)


@pytest.mark.parametrize("gain", [1.0, 1.6])
def test_the_stopping_angle(gain):
    """A corner turns at 2 rad/s towards a post .28 m from the centre, and stops with 4 rad/s^2."""
    radius = 0.28
    command_w = 2.0 / gain
    # Direction in which the widened outline is `radius` away [rad].
    direction = math.asin((SIDE + MARGIN) / radius)

    def passes(turn):
        angle = direction + turn
        scale = safe_scale_of(
            [(radius * math.cos(angle), radius * math.sin(angle))],
            BaseMotion(0.0, command_w),
            (0.0, command_w),
            Braking(1.9, 4.0, turn_gain=gain),
        )
        return scale == 1.0

    expected = 2.0 * 0.15 + 2.0**2 / 8
    assert smallest_passing(0.0, 1.0, passes) == pytest.approx(expected, abs=TOLERANCE)


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_lateral_slip_ends_with_the_forward_motion(side):
    """At 1 m/s and .6 m/s of slip, both are constant for .15 s and then fall to 0 together."""

    def passes(distance):
        points = [(0.3, side * (SIDE + MARGIN + distance))]
        motion = BaseMotion(1.0, 0.0, slip=side * 0.6)
        return safe_scale_of(points, motion, STRAIGHT_ON, BRAKING) == 1.0

    expected = 0.6 * (0.15 + braking_distance(1.0, 1.9))
    assert smallest_passing(0.0, 1.0, passes) == pytest.approx(expected, abs=0.02)


def test_lateral_slip_may_end_in_a_turn_faster_than_commanded():
    """The base slides to the left, away from a post, and turns to the right."""
    post = [(0.5, -0.3)]
    motion = BaseMotion(1.0, 0.0, slip=0.6)
    command = (1.0, -0.5)
    twice_as_fast = BRAKING._replace(turn_gain=2.0)
    assert safe_scale_of(post, motion, command, BRAKING) == 1.0
    assert safe_scale_of(post, motion, command, twice_as_fast) < 1.0


def moving(velocity, **changes):
    """Return a monitor in an empty room whose poses imply a PoseVelocity."""
    monitor = seen_all_around(wall(9.0), replace(SETTINGS, **changes))
    monitor.motion.take = lambda stamp, pose, v: None
    monitor.motion.velocity = velocity
    return monitor


def test_lateral_slip_excludes_the_turn_of_the_poses():
    """The turn is about a point .13 m ahead. The twist's turn rate, which is newer, is not used."""
    monitor = moving(PoseVelocity(1.0, 1.0, 0.2), turn_ahead=0.13)
    by_wheels, by_poses = monitor.motions((1.0, 1.3))
    assert by_wheels == (1.0, 1.3, pytest.approx(0.33), 0.0)
    assert by_poses == (1.0, 1.0, pytest.approx(0.33), 0.0)


@pytest.mark.parametrize("reported", [0.2, -0.1])
def test_slipping_wheels_are_braked_from_the_speed_of_the_poses(reported):
    """1 m/s was commanded a tenth of a second ago; the wheels nearly stand or turn backwards."""
    monitor = moving(PoseVelocity(-1.0, 0.0, 0.0))
    monitor.output = MonitorOutput(-0.1, -1.0, 0.0)
    v, _ = monitor.filter(0.0, HERE, (-reported, 0.0), (0.0, 0.0)).command
    # A tenth of a second of braking with 1.9 m/s^2
    assert v == pytest.approx(-1.0 + 1.9 * 0.1)


def test_the_velocity_of_the_poses_refers_to_their_stamps():
    """The robot drives at 1 m/s, and its last pose is .05 s old."""
    monitor = seen_all_around(wall(9.0), SETTINGS)
    for time, age in (
        (0.0, 0.0),
        (0.1, 0.0),
        (0.25, 0.05),
    ):
        pose = (time - age, 0.0, 0.0)
        monitor.filter(time, pose, STRAIGHT_ON, STRAIGHT_ON, (age, 0.0))
    assert monitor.motion.velocity.v == pytest.approx(1.0)


def test_the_previous_turn_rate_limits_the_arc_of_a_slower_command():
    """Between posts, a base goes straight on at 1 m/s, but was commanded to turn at 2 rad/s.

    It must now slow down. What its previous command was matters for some posts and not for others.
    """
    monitor = CollisionMonitor(SETTINGS)
    monitor.output = MonitorOutput(0.0, 1.0, 2.0)
    motion, _ = monitor.motions(STRAIGHT_ON)
    assert motion.commanded_w == 2.0
    turned_less = motion._replace(commanded_w=1.0)
    # For some posts the turn before matters, for others it does not.
    outcomes = set()
    command = (0.5, 1.0)
    for x in np.arange(0.2, 0.7, 0.05):
        for y in np.arange(0.2, 0.7, 0.05):
            post = [(x, y)]
            scale = safe_scale_of(post, motion, command, BRAKING)
            scale_if_turned_less = safe_scale_of(post, turned_less, command, BRAKING)
            outcomes.add(scale == scale_if_turned_less)
    assert outcomes == {True, False}


def test_poses_faster_than_any_command_stop_the_robot_at_once():
    """The odometry was set to a place 1 km away.

    Checking a command at the resulting speed would take minutes.
    """
    monitor = seen_all_around(wall(9.0), SETTINGS)
    verdict_on(monitor, 1.0, -0.1)
    verdict = monitor.filter(0.0, (1000.0, 0.0, 0.0), AT_REST, STRAIGHT_ON)
    assert verdict.action == STOP
    problem = "the poses imply 10000 m/s and 0 rad/s, which is too fast: check the odometry"
    assert verdict.reason == problem


@pytest.mark.parametrize(
    ("scan_age", "ages", "expected"),
    [
        # At 1 m/s: ages add to the reaction time. That of the pose also adds the distance since.
        (0.0, (0.0, 0.0), 0.15),
        (0.3, (0.0, 0.0), 0.45),
        (0.0, (0.0, 0.3), 0.45),
        (0.0, (0.3, 0.0), 0.75),
    ],
)
def test_the_stopping_distance_depends_on_the_ages_of_the_inputs(scan_age, ages, expected):
    def passes(distance):
        wall_x = FRONT + MARGIN + distance + 0.05
        monitor = seen_all_around(wall(wall_x), SETTINGS)
        verdict = monitor.filter(scan_age, HERE, STRAIGHT_ON, STRAIGHT_ON, ages)
        return verdict.action == PASS

    stopping = expected + braking_distance(1.0, 1.9)
    assert smallest_passing(0.0, 2.0, passes) == pytest.approx(stopping, abs=TOLERANCE)


def test_a_fast_base_stops_for_an_obstacle_that_only_its_current_speed_reaches():
    """At 2 m/s, with .3 m/s commanded, a wall is .75 m ahead, beyond the command's way to stop."""
    monitor = seen_all_around(wall(1.0), SETTINGS)
    verdict = monitor.filter(0.0, HERE, (2.0, 0.0), (0.3, 0.0))
    assert verdict.action == STOP
    assert verdict.reason == "braking: an obstacle is too near to stop"


@pytest.mark.parametrize(
    ("changes", "command", "age", "post"),
    [
        # The robot turns up to three times as fast as commanded, for 2.6 s.
        pytest.param(
            {"turn_gain": 3.0, "yaw_deceleration": 0.3},
            (1.0, 0.26),
            0.0,
            (1.28, 0.82),
            id="turn",
        ),
        # The pose is 1.5 s old.
        pytest.param(
            {"scan_timeout": 2.0},
            (0.3, 0.0),
            1.5,
            (1.2, 0.0),
            id="age",
        ),
    ],
)
def test_obstacle_points_count_as_far_as_the_body_may_reach(changes, command, age, post):
    for points, action in (([post], SLOW), ([], PASS)):
        monitor = seen_all_around(points, replace(SETTINGS, **changes))
        # The space was observed from other places.
        monitor.seen.cells[:] = 1
        verdict = monitor.filter(0.0, HERE, command, command, (age, 0.0))
        assert verdict.action == action


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_the_space_just_past_the_stop_must_be_observed(side):
    """A cell that was observed in part counts as observed: the robot keeps 1.5 cells away."""
    speed = 0.5
    # All cells up to x = 0 are observed. They are stored modulo their number.
    cells = np.ones((120, 120), np.uint8)
    cells[:20] = 0
    cos_yaw = side  # Driving backwards, it faces away from there.

    def passes(distance):
        seen = SeenCells(cells, -100, -60, BodyPose(-(FRONT + distance), 0.0, cos_yaw, 0.0))
        command = (side * speed, 0.0)
        return safe_scale_of([], BaseMotion(*command), command, BRAKING, seen=seen) == 1.0

    expected = speed * 0.15 + braking_distance(speed, 1.9) + 1.5 * CELL_M
    assert smallest_passing(0.0, 2.0, passes) == pytest.approx(expected, abs=0.02)


def test_turning_into_unobserved_space_is_limited_to_creep_speed():
    """The fastest corner of the body moves at creep_speed."""
    monitor = CollisionMonitor(SETTINGS)
    monitor.add_scan(scan_of(wall(2.0), HERE))
    verdict = monitor.filter(0.0, HERE, AT_REST, (0.0, 1.5))
    assert verdict.action == SLOW
    assert "creeping" in verdict.reason
    corner_radius = math.hypot(FRONT, SIDE)
    largest_w = SETTINGS.creep_speed / corner_radius
    assert verdict.command == pytest.approx((0.0, largest_w))


@pytest.mark.parametrize("command", [(-0.5, 0.0), (-0.5, 1.5), (-0.5, -1.5), (-0.1, 0.4)])
def test_no_point_of_the_body_creeps_faster_than_creep_speed(command):
    """In a turn, its outer corners are up to twice as fast as its origin."""
    monitor = CollisionMonitor(SETTINGS)
    monitor.add_scan(scan_of(wall(2.0), HERE))
    verdict = monitor.filter(0.0, HERE, AT_REST, command)
    assert "creeping" in verdict.reason
    v, w = verdict.command
    speeds = []
    for x, y in SETTINGS.body:
        speeds.append(math.hypot(v - w * y, w * x))
    assert max(speeds) == pytest.approx(SETTINGS.creep_speed)


@pytest.mark.parametrize(
    "outline",
    [
        [(0.3, 0.2), (-0.3, 0.2), (-0.3, -0.2), (0.3, -0.2)],
        [(0.9, 0.0), (-0.1, 0.1), (-0.1, -0.1)],  # Its widened tip is far ahead.
    ],
)
def test_no_point_of_a_widened_outline_is_farther_than_its_radius(outline):
    body = BodyOutline.of(outline, margin=0.05)

    def has_points_at(distance):
        for bearing in np.linspace(0.0, math.tau, 7200):
            x = distance * math.cos(bearing)
            y = distance * math.sin(bearing)
            if penetration(body.planes, body.margin, x, y) > 0.0:
                return True
        return False

    assert has_points_at(0.99 * body.radius)
    assert not has_points_at(1.001 * body.radius)


def test_points_in_the_body_are_those_of_the_scalar_computation():
    """The kernel, which handles all points plane by plane, is equal to the last bit."""
    rng = np.random.default_rng(3)
    outcomes = set()
    for _ in range(300):
        pose = rng.uniform(-0.3, 0.3, 3)
        points = rng.uniform(-0.6, 0.6, (20, 2))
        limits = rng.uniform(0.0, 0.3, 20)
        in_body = transform_point(inverse(pose), *points.T)
        depths = [penetration(BODY.planes, MARGIN, *point) for point in zip(*in_body)]
        expected = bool((depths > limits).any())
        obstacles = obstacles_of(points, BODY)
        assert is_deeper(obstacles, limits, BODY.planes, MARGIN, place_of(pose)) == expected
        outcomes.add(expected)
    assert outcomes == {True, False}


def place_of(pose):
    """Return a pose (x, y, yaw) as the kernels have it."""
    x, y, yaw = pose
    return BodyPose(x, y, math.cos(yaw), math.sin(yaw))


def test_the_body_is_seen_if_all_cells_under_its_edge_are():
    """The kernel, which avoids modulo, is compared with the definition of the cells."""
    rng = np.random.default_rng(3)
    side = 60
    outcomes = set()
    for _ in range(300):
        pose = rng.uniform(-0.3, 0.3, 3)
        # A few cells are unknown.
        cells = (rng.random((side, side)) > 0.002).astype(np.uint8)
        corner = rng.integers(-200, 200, 2)
        robot_place = CELL_M * (corner + rng.uniform(8.0, side - 8.0, 2))
        robot_pose = (*robot_place, rng.uniform(-3.0, 3.0))
        # From the body to the robot's current pose, then to the frame of the cells
        on_map = transform_point(robot_pose, *transform_point(pose, *BODY.edge.T))
        indices = np.floor(np.column_stack(on_map) / CELL_M).astype(int)
        is_in_window = ((indices >= corner) & (indices < corner + side)).all()
        expected = bool(is_in_window and cells[tuple((indices % side).T)].all())
        seen = SeenCells(cells, *corner.tolist(), place_of(robot_pose))
        assert is_seen(seen, BODY.edge, place_of(pose)) == expected
        outcomes.add(expected)
    assert outcomes == {True, False}


def test_the_beam_towards_a_bearing_is_that_of_the_modulo():
    rng = np.random.default_rng(3)
    for _ in range(300):
        first = rng.uniform(-3.2, 3.2)
        step = rng.choice([-1.0, 1.0]) * 0.01
        bearing = rng.uniform(-20.0, 20.0)
        turn = (bearing - first) % (2.0 * math.pi)
        if step < 0.0:
            turn = -((first - bearing) % (2.0 * math.pi))
        assert beam_at(first, step, bearing) == turn / step
