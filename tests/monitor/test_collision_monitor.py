"""Tests of the monitor without ROS: limited commands, obstacle memory, scanner faults."""

import math
from dataclasses import replace

import numpy as np
import pytest

from applr_ros1.common.angles import compose
from applr_ros1.monitor.known_space import CELL_M, ObstacleMemory, SeenSpace
from applr_ros1.monitor.monitor import (
    BRAKE,
    PASS,
    SLOW,
    STOP,
    CollisionMonitor,
    MonitorOutput,
    Verdict,
)
from applr_ros1.monitor.scanner import ScannerCheck, geometry_fault
from applr_ros1.monitor.settings import MonitorSettings
from applr_ros1.monitor.stopping import BaseMotion, half_planes, penetration
from applr_ros1.robots import JACKAL
from tests.monitor.scenes import (
    AT_REST,
    BEAMS,
    BEHIND,
    BODY,
    BRAKES_WELL,
    CLOSE_BEHIND,
    FRONT,
    HERE,
    LASER,
    SETTINGS,
    TURN,
    across,
    posts,
    safe_scale_of,
    scan_of,
    seen_all_around,
    verdict_on,
    wall,
)

# Commands (v, w) [m/s, rad/s]
STRAIGHT_ON = (1.0, 0.0)
BACKWARDS = (-0.5, 0.0)


@pytest.mark.parametrize(
    ("command", "action", "blocked"),
    [
        ((0.04, -0.1), SLOW, True),
        ((0.0, 0.0), STOP, True),
        ((0.0, 0.2), SLOW, False),
        ((-0.06, 0.0), SLOW, False),
    ],
)
def test_a_command_limited_to_almost_zero_is_blocked(command, action, blocked):
    assert Verdict(command, action).blocked is blocked
    assert not Verdict(command).blocked


@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize(
    ("post_x", "asked", "expected"),
    [
        (9.0, [0.5, 1.7, -1.0], [1.8, 1.7, 1.6]),  # far away: the planner slows down
        (1.2, [0.0, 0.0, 0.0], [1.8, 1.6, 1.5]),  # near: the monitor stops the base
    ],
)
def test_braking_stays_within_the_friction_limit(sign, post_x, asked, expected):
    # 2 m/s^2 take 0.2 m/s off in a tenth of a second, and 0.1 m/s in half of it.
    settings = replace(SETTINGS, deceleration=2.0, memory_radius=8.0)
    monitor = seen_all_around([(sign * post_x, 0.0)], settings)
    monitor.output = MonitorOutput(0.0, 2.0 * sign, 0.0)
    speeds = []
    for time, asked_v in zip((0.1, 0.2, 0.25), asked):
        command = (sign * asked_v, 0.0)
        v, _ = monitor.filter(time, HERE, (2.0 * sign, 0.0), command).command
        speeds.append(sign * v)
    assert speeds == pytest.approx(expected)


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_base_slower_than_commanded_is_braked_from_its_measured_speed(sign):
    monitor = CollisionMonitor(replace(SETTINGS, deceleration=2.0))
    monitor.output = MonitorOutput(0.25, 1.5 * sign, 0.0)
    v, _ = monitor.braked(0.35, 1.0 * sign)
    assert v == pytest.approx(0.8 * sign)
    # It rolls back already: a command ahead would drive it on. Nor does it gain speed again.
    assert monitor.braked(0.40, -0.5 * sign) == (0.0, 0.0)
    assert monitor.braked(0.41, 2.0 * sign) == (0.0, 0.0)


def test_a_clock_that_was_set_back_speeds_no_base_up():
    """The negative time since the last output would add to the speed, instead of braking."""
    monitor = CollisionMonitor()
    monitor.braked(10.0, 1.0, (1.0, 0.5))
    assert monitor.braked(9.0, 1.0) == (0.0, 0.0)


@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize(
    ("asked", "w"),
    [
        ((0.0, 0.0), 0.9),
        ((0.0, 0.5), 0.5),
    ],
)
def test_a_stop_follows_the_arc(sign, asked, w):
    """The robot stops on the arc of the previous command, which was free.

    A requested turn keeps its turn rate.
    """
    monitor = seen_all_around([(9.0, 0.0)], replace(SETTINGS, deceleration=2.0))
    monitor.output = MonitorOutput(0.0, 2.0 * sign, 1.0)
    verdict = monitor.filter(0.1, HERE, (2.0 * sign, 1.0), asked)
    assert verdict.command == pytest.approx((1.8 * sign, w))


@pytest.mark.parametrize(
    ("twist", "command"),
    [
        (STRAIGHT_ON, (1.0, 2.5)),
        ((1.0, 2.5), STRAIGHT_ON),
    ],
)
@pytest.mark.parametrize("post", [(0.45, -0.18), (0.35, 0.35)])
def test_a_new_turn_must_be_free_with_and_without_delay(twist, command, post):
    """A post stands straight ahead or inside the turn.

    Until the base responds, it may still drive its old arc.
    """
    assert 0.0 < safe_scale_of([post], BaseMotion(*twist), command) < 1.0
    turning = (1.0, 2.5)
    assert safe_scale_of([post], BaseMotion(*turning), turning) < 1.0, "it may leave the turn"
    if post[1] > 0.0:
        assert safe_scale_of([post], BaseMotion(1.0, 0.0), STRAIGHT_ON) == 1.0


def test_a_tighter_turn_passes_if_straight_on_is_blocked():
    # A narrow wall 0.5 m ahead, out of reach of the corners of a turning body.
    monitor = seen_all_around(wall(0.55, 0.1), BRAKES_WELL)
    assert monitor.filter(0.0, HERE, STRAIGHT_ON, STRAIGHT_ON).action == SLOW
    assert monitor.filter(0.0, HERE, AT_REST, (0.0, 2.0)).action == PASS


def test_backing_up_a_long_way_stops_before_remembered_obstacles():
    """An obstacle three metres behind is remembered until the robot has backed up to it."""
    monitor = CollisionMonitor()
    wall_behind = across(-0.6, -0.3, 0.31, 0.03)
    monitor.add_scan(scan_of(wall_behind, BEHIND))
    there_and_back = [
        *np.arange(0.0, 3.0, 0.2),
        *np.arange(3.0, -0.3, -0.1),
    ]
    for step, x in enumerate(there_and_back):
        pose = (float(x), 0.0, 0.0)
        time = 0.1 * (step + 1)
        # Each scan differs from the one before: identical scans would count as frozen.
        ranges = np.full(BEAMS, 20.0 + time, np.float32)
        monitor.add_scan(scan_of([], pose, time, ranges=ranges))
        verdict = monitor.filter(time, pose, AT_REST, BACKWARDS)
        assert x < 0.0 or verdict.action == PASS
    assert verdict.action != PASS


def test_noisy_edges_do_not_fill_the_memory():
    rng = np.random.default_rng(0)
    monitor = CollisionMonitor()
    discs = across(0.8, -0.9, 0.9, 0.18)
    clean_ranges = scan_of(discs + wall(1.6, 1.5), HERE).ranges
    point_counts = []
    for step in range(200):
        noise = rng.normal(0.0, 0.002, BEAMS)
        noisy_ranges = clean_ranges + noise.astype(np.float32)
        monitor.add_scan(scan_of([], HERE, 0.05 * step, ranges=noisy_ranges))
        point_counts.append(len(monitor.memory.points))
    # Each point of an edge that moved by more than the tolerance would be one more obstacle.
    assert point_counts[-1] < 1.5 * point_counts[0]


@pytest.mark.parametrize(
    ("geometry", "beams"),
    [
        pytest.param({}, BEAMS, id="270 degrees"),
        pytest.param(TURN, 360, id="a full turn"),
    ],
)
def test_the_ends_of_a_scan_do_not_fill_the_memory(geometry, beams):
    rng = np.random.default_rng(0)
    memory = ObstacleMemory()
    point_counts = []
    for step in range(100):
        ranges = rng.normal(2.0, 0.003, beams).astype(np.float32)
        memory.update(scan_of([], HERE, 0.1 * step, ranges=ranges, **geometry))
        point_counts.append(len(memory.points))
    assert point_counts[-1] < 1.1 * point_counts[0]


def distances_from_laser(memory):
    """Return the distances [m] of a memory's points from the laser of a robot at HERE."""
    x, y = memory.points.T
    return np.hypot(x - LASER, y)


def updated_memory(*scans):
    """Return a memory that was updated with full turns of these ranges, .1 s apart."""
    memory = ObstacleMemory()
    for step, ranges in enumerate(scans):
        memory.update(scan_of([], HERE, 0.1 * step, ranges=ranges, **TURN))
    return memory


def test_obstacles_gone_at_the_ends_of_a_scan_are_cleared():
    # The wall is slightly more than TOLERANCE_M behind the post.
    without_post = np.full(360, 1.2, np.float32)
    with_post = without_post.copy()
    with_post[[-2, -1, 0, 1]] = 1.0
    memory = updated_memory(with_post)
    assert np.sum(distances_from_laser(memory) < 1.1) == 4
    cleared_memory = updated_memory(with_post, without_post)
    assert np.sum(distances_from_laser(cleared_memory) < 1.1) == 0


def test_occluded_points_are_kept():
    far_wall = np.full(360, 1.0, np.float32)
    near_wall = np.full(360, 0.85, np.float32)
    distances = distances_from_laser(updated_memory(far_wall, near_wall))
    assert np.sum(distances > 0.95) == 360
    # Points at this distance are nearer to each other than SPACING_M, so every second one is kept.
    assert np.sum(distances < 0.95) == 180


@pytest.mark.parametrize(
    ("beside", "measured", "kept"),
    [
        (-1, 0.5, 1),
        (1, 0.5, 1),
        (2, 0.5, 0),
        (-1, math.inf, 1),
        (0, math.inf, 1),
        (1, math.inf, 1),
        (2, math.inf, 0),
        # Some drivers report range_max for a beam without a return.
        (0, 30.0, 1),
    ],
)
def test_a_point_is_cleared_at_once_only_if_three_beams_return_from_behind(beside, measured, kept):
    # A beam may pass beside a thin post, so both of its neighbours must pass, too.
    with_post = np.full(360, 1.4, np.float32)
    changed_beside = with_post.copy()
    with_post[180] = 1.0
    changed_beside[180 + beside] = measured
    distances = distances_from_laser(updated_memory(with_post, changed_beside))
    is_at_post = np.abs(distances - 1.0) < 0.01
    assert np.sum(is_at_post) == kept


@pytest.mark.parametrize(
    ("period", "step", "hits", "gone_after"),
    [
        pytest.param(3.0, 0.0, [0], 20, id="at rest"),
        pytest.param(0.75, 0.0, [0], 80, id="at rest, with a fast laser"),
        pytest.param(0.01, 0.06, [0], 20, id="driving"),
        pytest.param(0.01, 0.03, [0], 40, id="driving, with a fast laser"),
        pytest.param(3.0, 0.0, range(0, 100, 15), None, id="one hit in fifteen scans"),
    ],
)
def test_a_point_that_twenty_looks_in_a_row_miss_is_cleared(period, step, hits, gone_after):
    """Nothing is behind the post. Looks are three seconds or 5 cm apart.

    Scans arrive every `period` [s] from places `step` [m] apart. Those in `hits` show the post.
    """
    memory = ObstacleMemory()
    missed = np.full(360, np.inf, np.float32)
    measured = missed.copy()
    measured[50] = 0.78  # half a metre ahead of the middle of the drive
    first_missing = None
    for count in range(100):
        pose = (0.0, step * count - 0.6, 0.0)
        ranges = measured if count in hits else missed
        memory.update(scan_of([], pose, period * count, ranges=ranges, **TURN))
        if first_missing is None and not len(memory.points):
            first_missing = count
    assert first_missing == gone_after


@pytest.mark.parametrize(("distance", "is_kept"), [(0.08, True), (0.12, False)])
def test_an_obstacle_within_range_min_is_kept_whatever_the_beams_show(distance, is_kept):
    """The robot drives up to a post. Nearer than 0.1 m, no beam can end on it."""
    far_ranges = np.full(360, 3.0, np.float32)
    with_post = far_ranges.copy()
    with_post[[-2, -1, 0, 1, 2]] = 0.5
    post_x = LASER + 0.5
    memory = ObstacleMemory()
    memory.update(scan_of([], HERE, 0.0, ranges=with_post, **TURN))

    pose = (0.5 - distance, 0.0, 0.0)
    memory.update(scan_of([], pose, 1.0, ranges=far_ranges, **TURN))

    x, y = memory.points.T
    is_at_post = np.hypot(x - post_x, y) < 0.05
    assert is_at_post.any() == is_kept


def test_a_full_memory_forgets_the_oldest_points(monkeypatch):
    monkeypatch.setattr("applr_ros1.monitor.known_space.CAPACITY_POINTS", 1000)
    memory = ObstacleMemory()
    ranges = np.full(BEAMS, 0.9, np.float32)
    for x in (0.0, 2.0, 4.0, 6.0, 8.0):
        # Each pose is outside the space observed by the previous scan.
        scan = scan_of([], (x, 0.0, 0.0), x, ranges=ranges)
        memory.update(scan)
    memory_of_last_scan = ObstacleMemory()
    memory_of_last_scan.update(scan)
    last_points = memory_of_last_scan.points
    assert len(last_points) < len(memory.points) <= 1000
    assert np.array_equal(memory.points[-len(last_points) :], last_points)


def test_a_robot_in_contact_may_only_drive_away():
    # The front is at 0.229 m, and the posts have 0.05 m: with its margin the body touches them.
    monitor = seen_all_around(across(0.30, -0.2, 0.2, 0.03))
    assert verdict_on(monitor, 0.3).action == STOP
    assert verdict_on(monitor, -0.3).action == PASS


def test_a_blind_scanner_stops_the_robot_and_a_good_scan_frees_it():
    monitor = CollisionMonitor()
    good_scan = scan_of(wall(5.0, 2.0), HERE)
    monitor.add_scan(good_scan)
    assert monitor.filter(0.0, HERE, STRAIGHT_ON, STRAIGHT_ON).action == PASS

    invalid_ranges = np.full(BEAMS, np.nan, np.float32)
    blind_scan = scan_of([], HERE, 0.1, ranges=invalid_ranges)
    assert "scanner" in monitor.add_scan(blind_scan)
    assert monitor.filter(0.1, HERE, STRAIGHT_ON, STRAIGHT_ON).action == STOP

    monitor.add_scan(replace(good_scan, stamp=0.2))
    assert monitor.filter(0.2, HERE, STRAIGHT_ON, STRAIGHT_ON).action == PASS


@pytest.mark.parametrize(
    ("motion", "is_frozen"),
    [
        ((0.031, 0.0, 0.0), True),
        ((0.0, -0.031, 0.0), True),
        ((0.0, 0.0, 0.031), True),
        ((0.0, 0.0, -0.031), True),
        ((0.029, 0.0, 0.029), False),
    ],
)
def test_six_identical_scans_of_a_robot_that_drives_or_turns_are_frozen(motion, is_frozen):
    """It moves by 3 cm, or turns by 0.03 rad, from the first scan to the sixth."""
    check = ScannerCheck()
    scan = scan_of(wall(3.0), HERE)
    faults = []
    for share in np.linspace(0.0, 1.0, 6).tolist():
        offset = [share * part for part in motion]
        faults.append(check.fault(replace(scan, sensor_pose=compose(scan.sensor_pose, offset))))
    assert faults[:5] == [""] * 5
    assert ("frozen" in faults[5]) == is_frozen


def test_a_heading_beside_the_half_turn_changes_little_across_it():
    """From 3.14 to -3.14 rad the robot turns by 3 mrad: its scanner is not frozen."""
    check = ScannerCheck()
    scan = scan_of(wall(3.0), HERE)
    for yaw in (3.14, -3.14) * 5:
        assert check.fault(replace(scan, sensor_pose=(0.0, 0.0, yaw))) == ""


def test_a_scanner_is_blind_from_95_percent_of_invalid_ranges_on():
    # 95 % of 720 beams are 684. range_min is 0.1 m.
    for invalid_beams, is_blind in ((683, False), (684, True)):
        ranges = np.full(BEAMS, 3.0, np.float32)
        ranges[:300] = np.nan
        ranges[300:600] = 0.05
        ranges[600:invalid_beams] = -np.inf
        fault = ScannerCheck().fault(scan_of([], HERE, ranges=ranges))
        assert fault.startswith("the scanner is blind: 684 of 720 beams") == is_blind
        assert bool(fault) == is_blind
    # +inf is a measurement of free space.
    no_returns = np.full(BEAMS, np.inf, np.float32)
    assert ScannerCheck().fault(scan_of([], HERE, ranges=no_returns)) == ""


@pytest.mark.parametrize(
    ("motion", "is_repeat"),
    [
        ((0.006, 0.0, 0.0), True),
        ((0.0, -0.006, 0.0), True),
        ((0.0, 0.0, 0.006), True),
        ((0.0, 0.0, -0.006), True),
        ((0.0, 0.0, 0.004), False),
    ],
)
def test_an_identical_image_is_a_repeat_if_the_robot_has_moved_by_5_mm_or_mrad(motion, is_repeat):
    """A scan with repeated ranges contains old data, and does not become the latest scan."""
    first_scan = scan_of(wall(2.0), HERE)
    x, y, yaw = first_scan.sensor_pose
    dx, dy, turn = motion
    second_scan = replace(
        first_scan,
        stamp=0.1,
        sensor_pose=(x + dx, y + dy, yaw + turn),
    )

    check = ScannerCheck()
    assert not check.fault(first_scan)
    assert not check.repeats
    assert not check.fault(second_scan)
    assert check.repeats == is_repeat

    # The age is that of the first scan if the second one is a repeat.
    monitor = CollisionMonitor()
    monitor.add_scan(first_scan)
    monitor.add_scan(second_scan)
    verdict_on(monitor, 0.5, 0.2)
    assert monitor.ages.scan == pytest.approx(0.2 if is_repeat else 0.1)


def test_a_scan_older_than_the_latest_is_ignored():
    monitor = seen_all_around(wall(1.0))
    assert monitor.add_scan(scan_of(wall(5.0, 4.0), HERE, -0.05)) == ""
    # The older scan had the wall at 5 m, so far away that the command would pass.
    assert verdict_on(monitor, 1.5).action == SLOW


def scan_with_hits(distances):
    """Return a scan with a beam for each distance [m], and no other hit within 10 m."""
    ranges = np.full(BEAMS, np.inf, np.float32)
    ranges[300 : 300 + len(distances)] = distances
    return scan_of([], HERE, ranges=ranges, range_max=10.0)


@pytest.mark.parametrize(
    ("earlier_scans", "expected_hits"),
    [
        ([[8.9] * 4], 0),
        ([[8.9] * 5], 5),
        # Beyond nine tenths of the range an obstacle may return no beam.
        ([[8.9] * 4 + [9.1] * 4], 0),
        ([[8.9] * 5 + [9.1] * 4], 5),
        # A scan with fewer hits does not replace the one before it.
        ([[3.0] * 8, [3.0] * 4], 8),
        ([[3.0] * 8, [3.0] * 5], 5),
    ],
)
def test_a_scan_without_hits_is_a_fault_if_five_earlier_ones_are_in_range(
    earlier_scans, expected_hits
):
    check = ScannerCheck()
    for distances in earlier_scans:
        assert check.fault(scan_with_hits(distances)) == ""
    expected = ""
    if expected_hits:
        points = f"{expected_hits} obstacle points of the previous scan"
        expected = f"the scanner returns no hit, but {points} are in range"
    assert check.fault(scan_with_hits([])) == expected


def doubted_beams(check, scan, ranges):
    """Return the indices of the beams that are not believed in a scan of these ranges."""
    changed_scan = replace(scan, ranges=ranges)
    check.fault(changed_scan)
    is_doubted = np.isnan(check.believed(changed_scan).ranges)
    return np.flatnonzero(is_doubted).tolist()


def test_a_failed_sector_recovers_once_its_beams_return():
    check = ScannerCheck()
    complete = np.full(BEAMS, 1.5, np.float32)
    scan = scan_of([], HERE, ranges=complete)
    failed = complete.copy()
    failed[200:400] = np.inf
    assert doubted_beams(check, scan, complete) == []
    assert doubted_beams(check, scan, failed) == [*range(200, 400)]
    # A centimetre nearer, or the scan would be a repeat of the first one.
    assert doubted_beams(check, scan, complete - np.float32(0.01)) == []
    assert doubted_beams(check, scan, failed) == [*range(200, 400)]
    failed[200:300] = 1.5
    assert doubted_beams(check, scan, failed) == [*range(300, 400)]


@pytest.mark.parametrize(
    ("sector_beams", "obstacle_beams", "has_failed"),
    [
        (44, 44, False),  # A narrower obstacle may have gone away.
        (46, 46, True),
        (100, 29, False),  # There was little that could vanish.
        (100, 31, True),
    ],
)
def test_a_sector_of_45_degrees_fails_if_30_percent_of_it_had_obstacles(
    sector_beams, obstacle_beams, has_failed
):
    """Beams are one degree apart. All returns of a sector are lost from one scan to the next."""
    begin = 150
    end = begin + sector_beams
    ranges = np.full(360, 1.5, np.float32)
    ranges[begin + obstacle_beams : end] = np.inf
    lost = ranges.copy()
    lost[begin:end] = np.inf
    check = ScannerCheck()
    scan = scan_of([], HERE, ranges=ranges, **TURN)
    assert doubted_beams(check, scan, ranges) == []
    expected_beams = [*range(begin, end)] if has_failed else []
    assert doubted_beams(check, scan, lost) == expected_beams


@pytest.mark.parametrize("source", ["scan", "pose", "odometry"])
@pytest.mark.parametrize(("lead", "action"), [(0.09, PASS), (0.11, STOP), (math.nan, STOP)])
def test_a_stamp_may_be_a_tenth_of_a_second_ahead_of_the_clock(source, lead, action):
    monitor = seen_all_around([(9.0, 0.0)])
    ages = {"scan": 0.0, "pose": 0.0, "odometry": 0.0, source: -lead}
    # The latest scan has stamp 0.
    time = ages["scan"]
    pose_and_twist = (ages["pose"], ages["odometry"])
    verdict = monitor.filter(time, HERE, AT_REST, STRAIGHT_ON, pose_and_twist)
    assert verdict.action == action
    line = f"the latest {source} is stamped {lead:.2f} s ahead of the clock"
    assert (line in verdict.reason) == (action == STOP)


@pytest.mark.parametrize("points", [[(9.0, 0.0)], CLOSE_BEHIND], ids=["free", "wall behind"])
def test_after_a_reset_neither_obstacles_nor_observed_space_are_known(points):
    """The odometry has begun anew: what was seen is elsewhere."""
    monitor = seen_all_around(points)
    monitor.reset()
    monitor.add_scan(scan_of([(9.0, 0.0)], HERE, 0.1))
    creeping = verdict_on(monitor, -0.5, 0.1)
    assert creeping.command == pytest.approx((-0.1, 0.0)), "the space behind is unknown"


def test_missing_and_stale_inputs_and_invalid_commands_stop_the_robot():
    monitor = CollisionMonitor()
    assert monitor.filter(0.0, HERE, AT_REST, STRAIGHT_ON).action == STOP
    monitor.add_scan(scan_of([], HERE))
    assert monitor.filter(0.4, HERE, AT_REST, STRAIGHT_ON).action == PASS

    old_scan = monitor.filter(0.6, HERE, AT_REST, STRAIGHT_ON)
    assert "scan is 0.60 s old" in old_scan.reason
    old_pose = monitor.filter(0.1, HERE, AT_REST, STRAIGHT_ON, (0.6, 0.0))
    assert "pose is 0.60 s old" in old_pose.reason
    old_twist = monitor.filter(0.1, HERE, AT_REST, STRAIGHT_ON, (0.0, 0.6))
    assert "odometry is 0.60 s old" in old_twist.reason

    assert verdict_on(monitor, math.nan, 0.1).command == (0.0, 0.0)
    # Numbers so small are zero, as a filter's remainders are.
    tiny_command = (1e-7, -1e-7)
    assert monitor.filter(0.1, HERE, AT_REST, tiny_command) == Verdict((0.0, 0.0))


def stopping_distance(v, reaction):
    """Return the distance [m] in which the Jackal stops from v [m/s] after a reaction time [s]."""
    return v * reaction + v * v / (2 * SETTINGS.deceleration)


def test_absurd_commands_are_limited_to_a_speed_that_can_be_stopped():
    monitor = CollisionMonitor()
    fastest_v, fastest_w = monitor.fastest
    monitor.add_scan(scan_of(wall(5.0), HERE))
    verdict = monitor.filter(0.0, HERE, AT_REST, (1e300, 1e300))
    v, w = verdict.command
    assert verdict.action == SLOW
    assert "stopped within 2 m" in verdict.reason
    assert abs(v) <= fastest_v + 1e-9
    assert abs(w) <= fastest_w + 1e-9
    assert verdict.command != (0.0, 0.0)
    # The memory reaches 2 m, so the base must stop within them.
    assert stopping_distance(fastest_v, 0.15) == pytest.approx(2.0)
    # The odometry is .3 s old.
    v, _ = monitor.filter(0.0, HERE, AT_REST, (1e3, 0.0), (0.0, 0.3)).command
    assert stopping_distance(v, 0.45) == pytest.approx(2.0)


@pytest.mark.parametrize(("factor", "is_impossible"), [(1.9, False), (2.1, True)])
def test_odometry_of_more_than_twice_the_fastest_command_is_impossible(factor, is_impossible):
    monitor = CollisionMonitor()
    fastest_v, fastest_w = monitor.fastest
    monitor.add_scan(scan_of(wall(5.0), HERE))
    for twist in ((factor * fastest_v, 0.0), (0.0, factor * fastest_w)):
        verdict = monitor.filter(0.0, HERE, twist, (0.5, 0.0))
        assert ("too fast" in verdict.reason) == is_impossible


@pytest.mark.parametrize("axis", [0, 1, 2], ids=["x", "y", "yaw"])
@pytest.mark.parametrize(("value", "is_stop"), [(0.9e6, False), (1.1e6, True), (-1.1e6, True)])
def test_a_pose_beyond_a_million_metres_or_radians_is_a_stop(axis, value, is_stop):
    monitor = seen_all_around([(9.0, 0.0)])
    pose = [0.0, 0.0, 0.0]
    pose[axis] = value
    verdict = monitor.filter(0.0, pose, AT_REST, STRAIGHT_ON)
    assert (verdict.action == STOP) == is_stop
    assert ("too far away: check the odometry" in verdict.reason) == is_stop


def test_the_depth_inside_a_body_whose_sides_differ():
    # A body with its longest side on the left: x from -0.2 to 0.4 m, y from -0.1 to 0.3 m
    planes = half_planes([(-0.2, -0.1), (0.4, -0.1), (0.4, 0.3), (-0.2, 0.3)])
    for point, depth in (
        ((0.0, 0.25), 0.05),
        ((0.0, -0.15), -0.05),
        ((0.35, 0.1), 0.05),
        ((-0.25, 0.1), -0.05),
    ):
        assert penetration(planes, 0.0, *point) == pytest.approx(depth)
        assert penetration(planes, 0.02, *point) == pytest.approx(depth + 0.02)


def test_the_scale_is_the_largest_safe_one():
    """For random points and commands, a slightly larger scale is not safe."""
    rng = np.random.default_rng(5)
    motion = BaseMotion(0.0, 0.0)
    scales = []
    for _ in range(60):
        # Given: points around the robot, and a command
        points = rng.uniform(-1.2, 1.2, (30, 2))
        is_outside = [penetration(BODY.planes, 0.05, x, y) < 0 for x, y in points]
        points = points[is_outside]
        v = float(rng.uniform(-0.5, 2.0))
        w = float(rng.uniform(-2, 2))

        # Then: the scaled command is safe, and one of 5 % more is not
        scale = safe_scale_of(points, motion, (v, w))
        scales.append(scale)
        assert safe_scale_of(points, motion, (scale * v, scale * w)) == 1.0
        larger_scale = min(1.0, scale + 0.05)
        larger_command = (larger_scale * v, larger_scale * w)
        is_larger_safe = safe_scale_of(points, motion, larger_command) == 1.0
        assert scale == 1.0 or not is_larger_safe
    # Among the 60 are both, or the comparison would be of one kind.
    assert 0 < sum(scale < 1.0 for scale in scales) < 60


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("deceleration", 0.0),
        ("deceleration", 1e-300),
        ("turn_gain", 1e300),
        ("margin", math.nan),
        ("memory_radius", 1e9),
    ],
)
def test_settings_are_checked(name, value):
    with pytest.raises(ValueError, match=f"{name} is .*: give a number from"):
        replace(SETTINGS, **{name: value})


@pytest.mark.parametrize(
    ("width", "half_width"),
    [
        (0.5, 0.25),
        (0.5002, 0.251),  # rounded up to whole millimetres, or a corner would stick out
    ],
)
def test_the_outline_of_the_monitor_contains_the_robot(width, half_width):
    # The Jackal's wheels end at 0.208 m to both sides.
    body = JACKAL.body.model_copy(update={"size": (0.6, width, 0.2)})
    outline = MonitorSettings.of(replace(JACKAL, body=body)).body
    assert {y for _, y in outline} == {half_width, -half_width}


def turned_away_from(behind):
    """Return a monitor that has seen posts behind it before it turned to yaw 0.

    The posts are at (n, 2) [m], the time is 3.9 s.
    """
    monitor = CollisionMonitor()
    for step, yaw in enumerate(np.linspace(-math.pi, 0.0, 40)):
        monitor.add_scan(scan_of(behind, (0.0, 0.0, yaw), 0.1 * step))
    assert verdict_on(monitor, -0.5, 3.9).blocked
    return monitor


@pytest.mark.parametrize(
    ("pose", "scene"),
    [
        pytest.param((0.0, 0.0, 0.0), 1, id="carried"),
        pytest.param((1.9, 0.3, 0.5), 0, id="odometry"),
    ],
)
def test_another_place_clears_the_memory(pose, scene):
    """Either the robot is carried to another place, or only its odometry jumps."""
    monitor = turned_away_from([*posts(0), *CLOSE_BEHIND])
    points_around = posts(1) if scene else [*posts(0), *CLOSE_BEHIND]
    sensor_pose = compose(pose, (LASER, 0.0, 0.0))
    scan = scan_of(points_around, (0.01, 0.0, 0.0), 4.0, sensor_pose=sensor_pose)
    monitor.add_scan(scan)
    memory_of_this_scan = ObstacleMemory()
    memory_of_this_scan.update(scan)
    assert len(monitor.memory.points) == len(memory_of_this_scan.points)
    verdict = monitor.filter(4.0, pose, AT_REST, BACKWARDS)
    assert "another place" in verdict.reason

    # A second scan from there makes it the place.
    monitor.add_scan(replace(scan, stamp=4.1))
    creeping = monitor.filter(4.1, pose, AT_REST, BACKWARDS)
    assert creeping.command == pytest.approx((-0.1, 0.0)), "the space behind is unknown"


def test_alternating_scans_of_two_robots_stop_the_robot():
    monitor = CollisionMonitor()
    # Two robots publish on one topic: no robot can be at both places in turn.
    for step in range(10):
        time = 0.05 * step
        monitor.add_scan(scan_of(posts(step % 2), HERE, time))
        verdict = verdict_on(monitor, 1.0, time)
        assert (verdict.action == STOP) == (step > 0)


@pytest.mark.parametrize(
    ("twist", "steps", "action"),
    [
        (STRAIGHT_ON, 8, STOP),
        ((0.0, 0.5), 8, STOP),
        ((0.0, 0.0), 8, PASS),
        ((0.002, 0.006), 400, PASS),
    ],
)
def test_a_constant_pose_with_nonzero_velocity_is_a_stop(twist, steps, action):
    """A base at rest with constant encoders and a drifting gyroscope must not be stopped for it."""
    monitor = seen_all_around([(9.0, 0.0)])
    # Odometry that repeats its pose, although the twist says that the robot drives.
    for step in range(steps):
        time = 0.05 * step
        monitor.add_scan(scan_of([(9.0, 0.0)], HERE, time))
        verdict = monitor.filter(time, HERE, twist, (0.5, 0.1))
    assert verdict.action == action
    assert ("frozen" in verdict.reason) == (action == STOP)


def test_a_pose_that_is_late_is_not_frozen():
    monitor = seen_all_around([(9.0, 0.0)])
    for step in range(9):
        time = 0.05 * step
        monitor.add_scan(scan_of([(9.0, 0.0)], (time, 0.0, 0.0), time))
        verdict = monitor.filter(time, HERE, STRAIGHT_ON, (0.5, 0.1), (time, 0.0))
        assert "frozen" not in verdict.reason


def test_a_scan_with_more_beams_than_the_memory_has_points_is_refused():
    # More than CAPACITY_POINTS: each scan would push the one before out of the memory.
    ranges = np.full(20000, 3.0, np.float32)
    huge_scan = scan_of([], HERE, 0.1, angle_increment=1e-4, ranges=ranges)
    assert "20000 beams" in CollisionMonitor().add_scan(huge_scan)


FULL_TURN = 2.0 * math.pi


@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize(
    ("beams", "increment", "fault"),
    [
        (2, 0.5, "the scan has 2 beams: use a scanner with 3 to 16384"),
        (3, 0.5, ""),
        (3, 1.1e-5, ""),
        (3, 0.9e-5, "this is not a planar scan"),
        # Drivers round the angle of a full turn.
        (361, (FULL_TURN + 0.019) / 360, ""),
        (361, (FULL_TURN + 0.021) / 360, "this is not a planar scan"),
    ],
)
def test_a_scan_has_three_beams_or_more_within_a_full_turn(beams, increment, fault, sign):
    ranges = np.full(beams, 3.0, np.float32)
    reported = geometry_fault(scan_of([], HERE, ranges=ranges, angle_increment=sign * increment))
    assert fault in reported
    assert bool(reported) == bool(fault)


@pytest.mark.parametrize(
    "change",
    [
        pytest.param({"angle_min": 1e7}, id="first angle"),
        pytest.param({"sensor_pose": (1e7, 0.0, 0.0)}, id="x"),
        pytest.param({"sensor_pose": (0.0, 0.0, -1e7)}, id="yaw"),
    ],
)
def test_a_scan_from_an_absurd_place_or_direction_is_refused(change):
    scan = replace(scan_of(posts(0), HERE), **change)
    assert "check the driver and the odometry" in CollisionMonitor().add_scan(scan)


def test_remembered_obstacles_block_the_robot_until_a_scan_clears_them():
    """Waiting does not free the robot.

    After it has turned and observed the free space behind it, it may drive.
    """
    obstacles = [*posts(0), *CLOSE_BEHIND]
    monitor = turned_away_from(obstacles)
    # Points are forgotten by new ones only, not by time that passes at rest.
    for time in np.arange(4.0, 104.0, 1.0):
        monitor.add_scan(scan_of(obstacles, HERE, time))
        assert verdict_on(monitor, -0.5, time).blocked
    # The wall is seen where the posts were.
    wall_behind = across(-1.5, -3.0, 3.0, 0.04)
    monitor.add_scan(scan_of([*posts(0), *wall_behind], BEHIND, 104.0))
    monitor.add_scan(scan_of(posts(0), HERE, 104.1))
    assert verdict_on(monitor, -0.5, 104.1).action == PASS


@pytest.mark.fault("11d")
def test_an_obstacle_that_vanishes_ahead_does_not_clear_those_behind():
    """A door 1 m ahead, which most of the beams hit, is open in the next scan."""
    room = [(3.0, 3.0), (3.0, -3.0), *CLOSE_BEHIND]
    door = wall(1.0, 1.5)
    monitor = turned_away_from([*door, *room])
    monitor.add_scan(scan_of(room, HERE, 4.0))
    assert verdict_on(monitor, -0.5, 4.0).blocked


@pytest.mark.fault("11e")
def test_the_robot_creeps_in_unobserved_space_and_drives_in_observed_space():
    monitor = CollisionMonitor()
    monitor.add_scan(scan_of(posts(0), HERE, 0.0))
    creeping = verdict_on(monitor, -0.5)
    assert creeping.command == pytest.approx((-0.1, 0.0))
    # The robot drives 1.45 m ahead.
    for step in range(30):
        time = 0.05 * step
        pose = (time, 0.0, 0.0)
        monitor.add_scan(scan_of(posts(0), pose, time))
        assert monitor.filter(time, pose, STRAIGHT_ON, STRAIGHT_ON).action == PASS
    # The poses still move ahead, but nothing limits the way back.
    assert monitor.filter(time, pose, AT_REST, BACKWARDS).action == BRAKE


def test_the_robot_creeps_no_faster_than_a_remembered_obstacle_allows():
    gap = 0.015  # space between the margin and the posts [m]
    # The posts have a radius of 5 cm.
    wall_x = FRONT + BODY.margin + gap + 0.05
    monitor = seen_all_around(wall(wall_x, 0.5))
    monitor.seen.clear()
    verdict = verdict_on(monitor, 1.0)
    assert "creeping" in verdict.reason
    v, _ = verdict.command
    assert 0.0 < v < 0.07


def test_the_whole_way_to_the_stop_must_be_observed():
    monitor = seen_all_around([(9.0, 0.0)])
    assert verdict_on(monitor, 1.8).action == PASS
    # One row of cells is unknown, far before the stopping point.
    monitor.seen.cells[int(0.5 / CELL_M)] = 0
    assert verdict_on(monitor, 1.8).action == SLOW


@pytest.mark.parametrize(
    ("x", "y", "is_seen"),
    [
        (0.8, 0.0, 1),
        (1.15, 0.0, 0),
        (-0.6, 0.0, 0),
        (0.0, 1.5, 1),
        (7.0, 0.0, 0),
    ],
)
def test_space_behind_an_obstacle_or_the_robot_is_unknown(x, y, is_seen):
    seen = SeenSpace(8.0)
    seen.update(scan_of(wall(1.0), HERE))
    # The grid is stored modulo its size.
    side = len(seen.cells)
    stored_x = math.floor(x / CELL_M) % side
    stored_y = math.floor(y / CELL_M) % side
    assert seen.cells[stored_x, stored_y] == is_seen


AHEAD = slice(BEAMS * 3 // 8, BEAMS * 5 // 8)  # beams of a quarter turn ahead


@pytest.mark.fault("11c")
@pytest.mark.parametrize("value", [math.nan, math.inf])
def test_obstacles_in_a_failed_sector_are_kept(value):
    """A quarter turn ahead, with a wall 1.4 m away, loses all returns from one scan to the next."""
    monitor = seen_all_around(wall(1.4, 2.0))
    for stamp in (0.1, 0.2):
        failed_scan = scan_of(wall(1.4, 2.0), HERE, stamp)
        failed_scan.ranges[AHEAD] = value
        monitor.add_scan(failed_scan)
    assert verdict_on(monitor, 2.0, 0.2).action == SLOW
    monitor.add_scan(scan_of(wall(5.0, 4.0), HERE, 0.3))
    assert verdict_on(monitor, 1.5, 0.3).action == PASS


def test_a_failed_sector_may_lie_across_the_ends_of_a_full_turn():
    """The ends meet straight ahead. Each half of the sector is too narrow to count as failed."""
    full_turn = {
        "angle_min": 0.0,
        "angle_increment": 2.0 * math.pi / (BEAMS - 1),
    }
    clean_ranges = np.full(BEAMS, 0.9, np.float32)
    failed_ranges = clean_ranges.copy()
    failed_ranges[: BEAMS // 12] = math.inf
    failed_ranges[-BEAMS // 12 :] = math.inf

    # A scanner that never saw anything there may have free space in the sector.
    open_ahead = CollisionMonitor()
    open_ahead.add_scan(scan_of([], HERE, 0.0, ranges=failed_ranges, **full_turn))
    assert verdict_on(open_ahead, 1.5).action == PASS

    # A scanner that saw something there has failed.
    monitor = CollisionMonitor()
    monitor.add_scan(scan_of([], HERE, 0.0, ranges=clean_ranges, **full_turn))
    monitor.add_scan(scan_of([], HERE, 0.1, ranges=failed_ranges, **full_turn))
    assert verdict_on(monitor, 1.5, 0.1).action == SLOW
