"""Tests of motions in the monitor: arcs, forgotten points, lateral slip, odometry."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from applr_ros1.common.scan import LaserScan
from applr_ros1.monitor.known_space import CELL_M, LOOK_S, MISSES, ObstacleMemory, SeenSpace
from applr_ros1.monitor.monitor import PASS, SLOW, STOP, CollisionMonitor
from applr_ros1.monitor.motion import PoseMotion
from applr_ros1.monitor.stopping import BaseMotion, Braking
from applr_ros1.robots import JACKAL
from sim_bridge.lidar import Lidar
from tests.monitor.scenes import (
    ANGLE,
    AT_REST,
    BEAMS,
    BEHIND,
    BRAKES_WELL,
    HERE,
    LASER,
    SETTINGS,
    SIDE,
    TURN,
    safe_scale_of,
    scan_of,
    seen_all_around,
    verdict_on,
    wall,
)
from tests.support.seeds import examples

# The Jackal's limits, m/s^2 and rad/s^2, without its turn gain and its centre of rotation.
BRAKING = Braking(1.9, 3.3)
STEP_S = 0.05  # time between two commands [s]


@pytest.mark.parametrize("command", [(0.5, 1.0), (0.5, -1.0), (0.5, 0.2)])
def test_a_braking_base_turns_no_faster_than_commanded_now_or_before(command):
    monitor = CollisionMonitor()
    command_v, command_w = command
    monitor.braked(0.0, 2.0, (2.0, 0.4))
    v, w = monitor.braked(0.05, 2.0, command, SETTINGS.turn_gain * command_w)
    assert v == pytest.approx(2.0 - 1.9 * 0.05)
    w_on_arc = abs(command_w) * v / command_v
    largest_w = max(abs(command_w), 0.4)
    assert abs(w) == pytest.approx(min(w_on_arc, largest_w))
    assert w * command_w > 0.0


@pytest.mark.parametrize(
    ("measured_w", "asked_w", "expected"),
    [
        (0.0, 4.0, 0.33),
        (1.35, 4.0, 1.33),
        (-1.35, 4.0, 0.0),
        (2.7, 0.5, 1.67),
    ],
)
def test_a_braking_base_gets_only_reachable_turn_rates(measured_w, asked_w, expected):
    """The turn rate changes by at most 3.3 rad/s^2 for a tenth of a second, and never reverses."""
    monitor = CollisionMonitor()
    monitor.braked(0.0, 2.0, (2.0, asked_w))
    braked = monitor.braked(0.05, 2.0, (1.0, asked_w), measured_w)
    assert braked == pytest.approx((1.905, expected))
    assert monitor.braked(0.1, 2.0, (2.0, asked_w)) == (2.0, asked_w), "the base no longer brakes"


def test_a_rare_command_is_judged_by_the_time_it_stays_in_force():
    """At 5 Hz each command applies longer, so the safe speed is lower.

    Braking shortens `silence`.
    """
    allowed_speeds = {}
    for period, silence in ((0.05, 0.1), (0.2, 0.15)):
        monitor = seen_all_around(wall(1.4))
        for step in range(4):
            monitor.add_scan(scan_of(wall(1.4), HERE, step * period))
            verdict = verdict_on(monitor, 2.0, step * period)
        assert monitor.silence == pytest.approx(silence)
        allowed_speeds[period], _ = verdict.command

    # Both stop within the same distance: the command applies for .2 or .15 s, then the base brakes.
    rare_speed = allowed_speeds[0.2]
    speed = allowed_speeds[0.05]
    rare_distance = rare_speed * 0.2 + rare_speed**2 / 3.8
    distance = speed * 0.15 + speed**2 / 3.8
    assert rare_distance == pytest.approx(distance, abs=0.06)

    # A base that brakes is silent for a shorter time.
    monitor.braked(1.0, 2.0, (2.0, 0.0))
    assert monitor.silence == pytest.approx(0.15)
    monitor.braked(1.05, 2.0, (1.0, 0.0))
    assert monitor.silence == pytest.approx(0.1)


@pytest.mark.parametrize(
    ("y", "action"),
    [
        (-0.7, SLOW),
        (-2.0, PASS),
    ],
)
@pytest.mark.parametrize("side", [1.0, -1.0], ids=["ahead", "behind"])
def test_the_swept_area_of_a_turn_about_a_point_far_ahead_or_behind_counts(y, action, side):
    """The base turns three times as fast as commanded about a point .5 m ahead, or behind.

    A rear corner, or one at the front, then reaches .7 m.
    """
    settings = replace(SETTINGS, turn_gain=3.0, turn_ahead=side * 0.5)
    # 0.7 m to the side: far outside the circle that the body needs to turn about its own centre.
    monitor = seen_all_around([(side * 0.17, side * y)], settings)
    assert monitor.filter(0.0, HERE, AT_REST, (0.0, 1.0)).action == action


def test_a_braking_base_may_leave_its_turn_outwards():
    """In a steady left turn, a post ahead is outside the path, and that of a faster turn."""
    motion = BaseMotion(1.0, 1.5, commanded_w=1.5)
    braking = Braking(1.9, 3.3, turn_gain=1.35, turn_ahead=0.13)
    command = (1.0, 1.5)
    # 10 cm decide: the nearer post is in the outer edge of the turn.
    near_post = (0.65, -0.2)
    far_post = (0.65, -0.3)
    assert 0.0 < safe_scale_of([near_post], motion, command, braking) < 1.0
    assert safe_scale_of([far_post], motion, command, braking) == 1.0


def free_gap(speed, side):
    """Return the gap [m] to a rail beside the path at which a base stops freely from a speed."""
    braking = BRAKING._replace(turn_ahead=0.13)
    # From just beyond the margin of 3 cm
    for gap in np.arange(0.032, 0.07, 0.002):
        rail = [(x, side * (SIDE + gap)) for x in np.arange(-0.3, 0.8, 0.01)]
        scale = safe_scale_of(
            rail,
            BaseMotion(speed, 0.0),
            (speed, 0.0),
            braking,
            reaction=0.1,
        )
        if scale == 1.0:
            return gap
    return math.inf


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_the_outline_may_swing_at_the_end_of_a_stop(side):
    """A stop from .3 m/s or more may swing the body by .15 rad, and a rear corner by .05 m.

    Slower stops swing less.
    """
    rear_corner = 0.359  # distance from the centre of rotation along the body [m]
    swung = rear_corner * math.sin(0.15) - SIDE * (1.0 - math.cos(0.15))
    assert free_gap(0.3, side) == pytest.approx(swung, abs=0.006)
    assert free_gap(0.6, side) == pytest.approx(free_gap(0.3, side), abs=0.003)
    assert free_gap(0.15, side) < 0.04


@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize(
    ("speed", "deceleration", "used"),
    [
        (0.5, 1.9, 1.9),
        (0.3, 1.9, 0.6),
        (0.3, 0.2, 0.2),
    ],
)
def test_a_slow_base_is_braked_gently(sign, speed, deceleration, used):
    """Slowed down at 1.9 m/s^2 from .3 m/s, wheels locked, and the body slid into posts."""
    monitor = CollisionMonitor(replace(SETTINGS, deceleration=deceleration))
    monitor.braked(0.0, sign * speed, (sign * speed, 0.0))
    v, _ = monitor.braked(STEP_S, sign * speed)
    assert v == pytest.approx(sign * (speed - used * STEP_S))


def test_a_stop_in_a_turn_follows_its_arc_to_the_end():
    """Neither a command nor odometry arrives, so that the current turn rate is unknown."""
    monitor = CollisionMonitor()
    monitor.filter(0.0, HERE, (1.0, 1.35 * 1.5), (1.0, 1.5))
    monitor.braked(0.0, 1.0, (1.0, 1.5))
    speed = 1.0
    for step in range(1, 14):
        v, w = monitor.braked(STEP_S * step, speed)
        assert w == pytest.approx(1.5 * v), step
        speed = v
    assert v < 0.2


def positions_while_forgetting(reason):
    """Return the x [m] of each scan while the robot waits, drives away and back, or sees much."""
    if reason == "distance":
        return [*np.arange(0.0, 9.1, 0.3), *np.arange(9.0, -0.1, -0.3)]
    return [0.0] * (4 if reason == "time" else 6)


@pytest.mark.parametrize("radius", [0.02, 0.1], ids=["4 cm", "20 cm"])
@pytest.mark.parametrize("reason", ["time", "distance", "capacity"])
def test_forgotten_points_become_unknown_space(radius, reason, monkeypatch):
    """The robot turns away from an observed post. Once it has forgotten it, it may creep there."""
    if reason == "capacity":
        monkeypatch.setattr("applr_ros1.monitor.known_space.CAPACITY_POINTS", 1500)
    monitor = CollisionMonitor()
    post = np.array([-0.65, 0.0])
    # Points on the side of the post that the robot sees
    edge = []
    for angle in np.arange(-1.4, 1.41, 0.1):
        direction = np.array([math.cos(angle), math.sin(angle)])
        edge.append(post + radius * direction)
    for stamp, pose in ((0.0, BEHIND), (0.1, HERE)):
        ranges = scan_of(edge, pose, stamp).ranges
        # The room differs from scan to scan: identical scans would count as frozen.
        ranges = np.minimum(ranges, np.float32(9.0 + stamp))
        monitor.add_scan(scan_of([], pose, stamp, ranges=ranges))
    backwards = (-1.0, 0.0)
    verdict = monitor.filter(0.1, HERE, AT_REST, backwards)
    assert "obstacle" in verdict.reason
    nearest_point = edge[len(edge) // 2]
    indices = np.floor(nearest_point / CELL_M).astype(int)
    cell = tuple(indices % len(monitor.seen.cells))
    assert monitor.seen.cells[cell] == 1

    stamp = 0.1
    noise = np.random.default_rng(0)
    for x in positions_while_forgetting(reason):
        stamp += 100.0 if reason == "time" else 0.1
        # Nearer points occlude old ones, so that the memory fills up.
        distance = 9.0 - 10.0 * stamp if reason == "capacity" else 8.0
        errors = noise.normal(0.0, 0.003, BEAMS)
        ranges = (distance + errors).astype(np.float32)
        # The synthetic ranges fit no room.
        monitor.matcher.clear()
        pose = (float(x), 0.0, 0.0)
        assert monitor.add_scan(scan_of([], pose, stamp, ranges=ranges)) == ""

    assert not len(monitor.memory.around(HERE, 0.6)), "the post is still remembered"
    assert monitor.seen.cells[cell] == 0
    assert monitor.filter(stamp, HERE, AT_REST, backwards).action == SLOW
    nearer_pose = (-0.2, 0.0, 0.0)
    verdict = monitor.filter(stamp, nearer_pose, AT_REST, backwards)
    assert "creeping" in verdict.reason


@pytest.mark.parametrize(
    ("beams", "range_max"), [(BEAMS, 3.5), (181, 30.0)], ids=["too far", "too thin"]
)
def test_points_are_cleared_only_from_a_distance_at_which_they_are_visible(beams, range_max):
    memory = ObstacleMemory()
    geometry = dict(
        angle_increment=2 * ANGLE / (beams - 1),
        range_max=range_max,
    )
    point_counts = []
    # The post is measured, then looked for from 4 m away, where a beam may miss it or not reach
    # it, and then from nearby.
    stamp = 0.0
    for x, scans in ((0.0, 1), (-4.0, MISSES), (0.5, MISSES)):
        ranges = np.full(beams, np.inf, np.float32)
        if x == 0.0:
            ranges[beams // 2 - 1 : beams // 2 + 1] = 0.9
        for _ in range(scans):
            memory.update(scan_of([], (x, 0.0, 0.0), stamp, ranges=ranges, **geometry))
            stamp += LOOK_S
        point_counts.append(len(memory.points))
    measured, from_afar, from_nearby = point_counts
    assert measured == from_afar > 0
    assert from_nearby == 0


@pytest.mark.parametrize(
    ("range_max", "radius"),
    [
        (0.2, 8.0),
        (1.0, 8.0),
        (30.0, 1.0),
    ],
)
def test_space_is_observed_within_the_range_of_scanner_and_memory(range_max, radius):
    monitor = CollisionMonitor(replace(SETTINGS, memory_radius=radius))
    monitor.add_scan(scan_of(wall(1.6), HERE, range_max=range_max))
    assert verdict_on(monitor, 1.5).action == SLOW


@pytest.mark.parametrize("axis", [0, 1])
@pytest.mark.parametrize(("beyond", "rows_forgotten"), [(-1, 4), (0, 3), (1, 2), (2, 1), (3, 0)])
@pytest.mark.parametrize("is_high", [False, True])
def test_a_forgotten_point_at_the_edge_of_the_window_leaves_the_other_edge(
    axis, beyond, rows_forgotten, is_high
):
    """The window's cells are stored modulo its side, so both edges lie side by side."""
    # Given: a window of observed space that is not at the origin
    space = SeenSpace(1.0)
    space.stand(np.zeros((0, 3)), 0.0, (1.0, -2.0, 0.0))
    space.cells[:] = 1
    side_cells = len(space.cells)

    # When: a point is forgotten, some cells (`beyond`) inside or outside one edge
    cell = space.corner + side_cells // 2
    edge_cell = space.corner[axis] + side_cells - 1 if is_high else space.corner[axis]
    cell[axis] = edge_cell + (beyond if is_high else -beyond)
    space.forget(CELL_M * (cell[np.newaxis] + 0.5))

    # Then: cells within .1 m of the point that lie in the window are unknown, no others
    unknown = np.argwhere(space.cells == 0)
    expected = []
    for offset in range(rows_forgotten):
        edge_slot = (edge_cell - offset if is_high else edge_cell + offset) % side_cells
        for beside in range(-2, 3):
            slots = (cell + beside) % side_cells
            slots[axis] = edge_slot
            expected.append(tuple(slots))
    assert set(map(tuple, unknown)) == set(expected)


@pytest.mark.parametrize("direction", [(1, 0), (-1, 0), (0, 1), (0, -1)])
def test_space_that_enters_the_window_is_unknown(direction):
    """Its cells are stored where those were that the window has left, and these were observed."""
    # Given: a window of observed space
    no_body = np.zeros((0, 3)), 0.0
    space = SeenSpace(1.0)
    space.stand(*no_body, HERE)
    space.cells[:] = 1
    side_cells = len(space.cells)
    old_corner = space.corner.copy()

    # When: the robot drives on by 7.5 cells
    x, y = 7.5 * CELL_M * np.array(direction)
    space.stand(*no_body, (x, y, 0.0))

    # Then: the cells that were in the window before are observed, no others
    assert abs(space.corner - old_corner).max() >= 7
    indices = space.corner[:, None] + np.arange(side_cells)
    was_inside = (indices >= old_corner[:, None]) & (indices < old_corner[:, None] + side_cells)
    stored_x, stored_y = indices % side_cells
    is_observed = space.cells[stored_x[:, None], stored_y] == 1
    np.testing.assert_array_equal(is_observed, np.outer(*was_inside))


def test_a_scan_without_returns_observes_the_space_within_its_reach_on_all_sides():
    """Farther than 1.14 m, beams one degree apart may have an obstacle of 2 cm between them."""
    seen = SeenSpace(8.0)
    no_returns = np.full(360, np.inf, np.float32)
    scan = scan_of([], (0.3, -0.2, 0.5), ranges=no_returns, **TURN)
    seen.update(scan)

    # Distances of the centres of all cells from the laser. The grid is stored modulo its size.
    side = len(seen.cells)
    indices = seen.corner[:, None] + np.arange(side)
    x, y = (indices + 0.5) * CELL_M
    laser_x, laser_y, _ = scan.sensor_pose
    distances = np.hypot(x[:, None] - laser_x, y - laser_y)
    stored_x, stored_y = indices % side
    is_observed = seen.cells[stored_x[:, None], stored_y] == 1

    reach = 0.02 / TURN["angle_increment"]
    assert is_observed[distances <= reach - CELL_M].all()
    assert not is_observed[distances > reach].any()


DARK_SECTORS = 24  # sectors of the fan, each of which may return nothing for a while


def dark_room_drive(no_return, seed):
    """Drive along a room of 5 x 4 m, in which surfaces return nothing for half a second at a time.

    Returns:
        Number of certain movers of all scans, and the actions of the monitor.
    """
    rng = np.random.default_rng(seed)
    monitor = CollisionMonitor(SETTINGS)
    walls = [(x, 0.0, 0.0, 0.02, 4.0) for x in (-1.0, 4.0)]
    walls += [(1.5, y, 0.0, 5.0, 0.02) for y in (-2.0, 2.0)]
    lidar = Lidar(JACKAL.laser, np.zeros((0, 3)), np.array(walls))
    mover_count = 0
    actions = []
    for step in range(40):
        time = 0.1 * step
        x = 0.05 * step
        if step % 5 == 0:
            is_dark = rng.random(DARK_SECTORS) < 0.5
        ranges = lidar.scan(x, 0.0, 0.0)
        ranges[np.repeat(is_dark, BEAMS // DARK_SECTORS)] = np.inf
        scan = scan_of([], HERE, time, ranges=ranges, sensor_pose=(x, 0.0, 0.0))
        monitor.add_scan(replace(scan, no_return=no_return))
        mover_count += len(monitor.lasers.first.movers.x)
        pose = (x - LASER, 0.0, 0.0)
        actions.append(monitor.filter(time, pose, (0.5, 0.0), (0.5, 0.0)).action)
    return mover_count, actions


@pytest.mark.parametrize("seed", [0, 19, 21])
def test_dark_surfaces_of_a_room_neither_move_nor_slow_the_robot(seed):
    """The driver has a value of its own for no return, as that of a URG-04LX."""
    mover_count, actions = dark_room_drive(0.0, seed)
    assert mover_count == 0
    assert actions.count(PASS) >= 0.95 * len(actions)
    # Without that value, each surface that returns something again has come into free space.
    mover_count, _ = dark_room_drive(None, seed)
    assert mover_count > 0


def test_poses_give_forward_lateral_and_turn_velocity():
    motion = PoseMotion()
    for step in range(10):
        stamp = STEP_S * step
        yaw = math.pi / 2 + 0.3 * stamp
        motion.take(stamp, (-0.2 * stamp, 1.5 * stamp, yaw), 1.0)
    velocity = motion.velocity
    assert (velocity.v, velocity.w) == pytest.approx((1.5, 0.3), abs=0.06)
    # The base heads along +y, so its left is -x, until the heading has turned by .1 rad.
    assert velocity.leftward == pytest.approx(0.2 - 1.5 * 0.3 * 0.325, abs=0.06)
    # The odometry measures 1 m/s.
    assert motion.slide == pytest.approx(velocity.v - 1.0)

    # The base stops at once, and stands for a quarter of a second.
    for step in range(1, 6):
        motion.take(stamp + 0.0501 * step, (-0.2 * stamp, 1.5 * stamp, yaw), 0.0)
    assert motion.velocity == pytest.approx((0.0, 0.0, 0.0), abs=1e-9)

    # The clock is set back.
    motion.take(0.1, HERE, 0.0)
    assert motion.velocity == (0.0, 0.0, 0.0)


@pytest.mark.parametrize("reported", [-2.0, 0.3, 2.0])
def test_a_measured_velocity_that_poses_contradict_does_not_hide_the_wall(reported):
    """The poses show 2 m/s, .9 m before a wall, while the odometry's twist is -2, .3 or 2 m/s."""
    monitor = CollisionMonitor(replace(SETTINGS, deceleration=1.9))
    for step in range(12):
        pose = (0.1 * step, 0.0, 0.0)
        time = STEP_S * step
        monitor.add_scan(scan_of(wall(2.2, 2.0), pose, time))
        verdict = monitor.filter(time, pose, (reported, 0.0), (2.0, 0.0))
    assert verdict.action == STOP
    v, _ = verdict.command
    assert reported < 0.0 or v > 1.0, "v falls from the speed of the poses"


def test_a_base_that_rolls_back_may_reverse_at_once():
    """The command towards a wall is the same for a base that rolls backwards as for one at rest."""
    commands = []
    for v in (0.0, -0.33):
        monitor = CollisionMonitor()
        monitor.add_scan(scan_of(wall(0.7), HERE, 0.0))
        # All space is observed.
        monitor.seen.cells[:] = 1
        verdict = monitor.filter(0.0, HERE, (v, 0.0), (2.0, 0.0))
        commands.append(verdict.command)
    at_rest, rolling_back = commands
    assert rolling_back == at_rest
    assert 0.1 < at_rest[0] < 1.0


def test_a_base_that_drives_on_is_not_taken_for_one_that_turns_on_the_spot():
    """A turn on the spot would meet the post beside the body before the base can be braked."""
    actions = []
    for v in (0.8, 0.0):
        monitor = CollisionMonitor(BRAKES_WELL)
        monitor.add_scan(scan_of([(0.1, 0.27)], HERE, 0.0))
        # All space is observed.
        monitor.seen.cells[:] = 1
        verdict = monitor.filter(0.0, HERE, (v, 1.5), (0.3, 0.0))
        actions.append(verdict.action)
    assert actions == [SLOW, STOP]


# Smallest and largest doubles, and what is no number
EXTREMES = [5e-324, -5e-324, -0.0, 1e308, -1e308, math.nan, math.inf, 1e-300]
FLOATS = st.one_of(st.floats(), st.sampled_from(EXTREMES))
PAIRS = st.tuples(FLOATS, FLOATS)
TURNING = (1.0, 0.1)


@examples(300)
@given(st.tuples(FLOATS, FLOATS, FLOATS), PAIRS, PAIRS, PAIRS)
def test_no_input_makes_a_command_invalid(pose, twist, command, ages):
    monitor = seen_all_around(wall(3.0))
    fastest_v, fastest_w = monitor.fastest
    monitor.filter(0.0, HERE, TURNING, TURNING)
    verdicts = [
        monitor.filter(0.05, pose, TURNING, TURNING),
        monitor.filter(0.05, HERE, twist, TURNING),
        monitor.filter(0.05, HERE, TURNING, command, ages),
    ]
    for verdict in verdicts:
        v, w = verdict.command
        assert math.isfinite(v)
        assert math.isfinite(w)
        assert abs(v) <= fastest_v + 1e-9
        assert abs(w) <= fastest_w + 1e-9


@examples(300)
@example(numbers=[0.0] * 7, ranges=[0.0] * 3, field=3)  # range_min 0, and no return is 0 m
@given(
    st.lists(FLOATS, min_size=7, max_size=7),
    st.lists(FLOATS, min_size=3, max_size=12),
    st.integers(0, 6),
)
def test_no_input_makes_a_scan_fail(numbers, ranges, field):
    """One field, all fields, or the ranges are arbitrary. add_scan then returns a fault as text."""
    good = [0.05, -2.0, 0.5, 0.1, 10.0, 0.1, 0.2]
    one_wrong = list(good)
    one_wrong[field] = numbers[field]
    for values in (one_wrong, numbers, good):
        # In the order of LaserScan's fields, and x and yaw of its pose
        *geometry, x, yaw = values
        monitor = seen_all_around(wall(3.0))
        with np.errstate(over="ignore"):
            numpy_ranges = np.array(ranges, np.float32)
        scan = LaserScan(*geometry, numpy_ranges, (x, 0.0, yaw))
        assert isinstance(monitor.add_scan(scan), str)
        verdict = monitor.filter(0.05, HERE, AT_REST, (0.5, 0.5))
        assert all(math.isfinite(value) for value in verdict.command)
