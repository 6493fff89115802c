"""Tests of the collision monitor without ROS: limited commands, obstacle memory and scanner faults."""

import math
from dataclasses import replace

import numpy as np
import pytest

from applr_ros1.common.angles import compose
from applr_ros1.common.scan import LaserScan
from applr_ros1.monitor.known_space import CELL_M, ObstacleMemory, SeenSpace
from applr_ros1.monitor.monitor import PASS, SLOW, STOP, CollisionMonitor, Verdict
from applr_ros1.monitor.scanner import FROZEN_SCANS, ScannerCheck
from applr_ros1.monitor.settings import MonitorSettings
from applr_ros1.monitor.stopping import EVERYTHING, half_planes, penetration, safe_scale
from applr_ros1.planner.move_base import MoveBase
from applr_ros1.robots import JACKAL
from sim_bridge.lidar import Lidar

SETTINGS = MonitorSettings.of(JACKAL)
BRAKES_WELL = replace(SETTINGS, deceleration=4.0, yaw_deceleration=12.0)

BEAMS, ANGLE = 720, 2.35619
LASER = 0.12


def scan_of(points, pose, stamp=0.0, **changes):
    """Return the scan of a Jackal at `pose` among discs of 5 cm radius at points (n, 2) in the odometry frame."""
    place = pose[0] + LASER * math.cos(pose[2]), pose[1] + LASER * math.sin(pose[2]), pose[2]
    discs = [(*point, 0.05) for point in points]
    ranges = Lidar(JACKAL.laser, discs, np.zeros((0, 5))).scan(*place)
    return replace(LaserScan(stamp, -ANGLE, 2 * ANGLE / (BEAMS - 1), 0.1, 30.0, ranges, place), **changes)


def wall(x, half_width=1.0):
    return [(x, y) for y in np.arange(-half_width, half_width, 0.04)]


def seen_all_around(points, settings=None):
    """Return a monitor at (0, 0, 0) and time 0 that has scanned discs at points (n, 2) behind and then ahead."""
    monitor = CollisionMonitor(settings)
    for stamp, yaw in ((-0.1, math.pi), (0.0, 0.0)):
        monitor.add_scan(scan_of(points, (0.0, 0.0, yaw), stamp))
    return monitor


@pytest.mark.parametrize(
    ("command", "action", "blocked"),
    [((0.04, -0.1), SLOW, True), ((0.0, 0.0), STOP, True), ((0.0, 0.2), SLOW, False), ((-0.06, 0.0), SLOW, False)],
)
def test_a_command_limited_to_almost_zero_is_blocked(command, action, blocked):
    assert Verdict(command, action).blocked is blocked
    assert not Verdict(command).blocked


def test_without_obstacles_commands_pass_unchanged():
    monitor = CollisionMonitor()
    assert monitor.add_scan(scan_of([(4.0, 0.0)] * 2, (0, 0, 0))) == ""
    assert monitor.filter(0.0, (0, 0, 0), (1.9, 0.0), (2.0, 0.3)).command == (2.0, 0.3)


@pytest.mark.parametrize("way", [1.0, -1.0])
def test_braking_stays_within_the_friction_limit(way):
    for points, asked, expected in (
        ([(9.0, 0.0)], [0.5, 1.7, -1.0], [1.8, 1.7, 1.6]),
        ([(way * 1.2, 0.0)], [0, 0, 0], [1.8, 1.6, 1.5]),
    ):
        monitor = seen_all_around(points, replace(SETTINGS, deceleration=2.0, memory_radius=8.0))
        monitor._given = 0.0, 2.0 * way, 0.0
        commands = [
            monitor.filter(t, (0, 0, 0), (2.0 * way, 0.0), (way * v, 0.0)) for t, v in zip((0.1, 0.2, 0.25), asked)
        ]
        assert [way * verdict.command[0] for verdict in commands] == pytest.approx(expected)
    assert monitor.braked(0.35, 1.0 * way)[0] == pytest.approx(0.8 * way), "the wheels are slower than commanded"
    assert monitor.braked(0.40, -0.5 * way) == (0.0, 0.0)
    assert monitor.braked(0.41, 2.0 * way) == (0.0, 0.0)


@pytest.mark.parametrize("way", [1.0, -1.0])
def test_a_stop_follows_the_arc(way):
    """The robot stops on the arc of the previous command, which was free. A requested turn keeps its turn rate."""
    monitor = seen_all_around([(9.0, 0.0)], replace(SETTINGS, deceleration=2.0))
    for asked, given in (((0.0, 0.0), 0.9), ((0.0, 0.5), 0.5)):
        monitor._given = 0.0, 2.0 * way, 1.0
        verdict = monitor.filter(0.1, (0, 0, 0), (2.0 * way, 1.0), asked)
        assert verdict.command == pytest.approx((1.8 * way, given))


@pytest.mark.parametrize(("twist", "command"), [((1.0, 0.0), (1.0, 2.5)), ((1.0, 2.5), (1.0, 0.0))])
@pytest.mark.parametrize("post", [(0.45, -0.18), (0.35, 0.35)])
def test_a_new_turn_must_be_free_with_and_without_delay(twist, command, post):
    """A post stands straight ahead or inside the turn. Until the base responds, it may still drive its old arc."""
    points, planes = np.array([post]), half_planes(SETTINGS.body)
    rest = ((0.0, 0.15), (4.0, 12.0), EVERYTHING)
    assert 0.0 < safe_scale(points, planes, 0.03, twist, command, *rest)[0] < 1.0
    turning = (1.0, 2.5)
    assert safe_scale(points, planes, 0.03, turning, turning, *rest)[0] < 1.0, "the robot may leave the turn"
    if post[1] > 0.0:
        assert safe_scale(points, planes, 0.03, (1.0, 0.0), (1.0, 0.0), *rest)[0] == 1.0


@pytest.mark.parametrize("speed", [0.3, 1.0, 2.0])
def test_the_robot_drives_up_to_a_wall_and_stops_before_it(speed):
    """The base accelerates at once and brakes with the specified deceleration."""
    monitor, x, v = CollisionMonitor(), 0.0, 0.0
    obstacles = wall(2.0)
    for step in range(400):
        now = 0.05 * step
        monitor.add_scan(scan_of(obstacles, (x, 0, 0), now))
        verdict = monitor.filter(now, (x, 0, 0), (v, 0.0), (speed, 0.0))
        target = verdict.command[0]
        v = target if target > v else max(target, v - monitor.settings.deceleration * 0.05)
        x += 0.05 * v
    front = x + 0.229
    assert 1.95 - 0.15 < front < 1.95
    assert verdict.action == STOP
    assert verdict.reason


def test_a_tighter_turn_passes_if_straight_on_is_blocked():
    monitor, pose = seen_all_around(wall(0.55, 0.1), BRAKES_WELL), (0, 0, 0)
    assert monitor.filter(0.0, pose, (1.0, 0.0), (1.0, 0.0)).action == SLOW
    assert monitor.filter(0.0, pose, (0.0, 0.0), (0.0, 2.0)).action == PASS


def test_backing_up_a_long_way_stops_before_remembered_obstacles():
    """An obstacle three metres behind is remembered until the robot has backed up to it."""
    monitor, behind = CollisionMonitor(), [(-0.6, y) for y in np.arange(-0.3, 0.31, 0.03)]
    monitor.add_scan(scan_of(behind, (0, 0, math.pi)))
    there_and_back = [*np.arange(0.0, 3.0, 0.2), *np.arange(3.0, -0.3, -0.1)]
    for step, x in enumerate(there_and_back):
        pose, now = (float(x), 0.0, 0.0), 0.1 * (step + 1)
        monitor.add_scan(scan_of([], pose, now, ranges=np.full(BEAMS, 20.0 + now, np.float32)))
        verdict = monitor.filter(now, pose, (0, 0), (-0.5, 0.0))
        assert x < 0.0 or verdict.action == PASS
    assert verdict.action != PASS


def test_noisy_edges_do_not_fill_the_memory():
    rng, monitor, pose = np.random.default_rng(0), CollisionMonitor(), (0.0, 0.0, 0.0)
    discs = [(0.8, y) for y in np.arange(-0.9, 0.9, 0.18)]
    clean = scan_of(discs + wall(1.6, 1.5), pose)
    counts = []
    for step in range(200):
        noisy = clean.ranges + rng.normal(0.0, 0.002, BEAMS).astype(np.float32)
        monitor.add_scan(scan_of([], pose, 0.05 * step, ranges=noisy))
        counts.append(len(monitor.memory.points))
    assert counts[-1] < 1.5 * counts[0]


TURN = {"angle_min": 0.0, "angle_increment": 2 * math.pi / 359}  # TurtleBot3's laser, whose ends meet straight ahead


@pytest.mark.parametrize("geometry", [{}, TURN], ids=["270 degrees", "a full turn"])
def test_the_ends_of_a_scan_do_not_fill_the_memory(geometry):
    rng, memory, pose = np.random.default_rng(0), ObstacleMemory(), (0.0, 0.0, 0.0)
    counts = []
    for step in range(100):
        ranges = rng.normal(2.0, 0.003, 360 if geometry else BEAMS).astype(np.float32)
        memory.update(scan_of([], pose, 0.1 * step, ranges=ranges, **geometry))
        counts.append(len(memory.points))
    assert counts[-1] < 1.1 * counts[0]


def test_obstacles_gone_at_the_ends_of_a_scan_are_cleared():
    memory, pose = ObstacleMemory(), (0.0, 0.0, 0.0)
    empty = np.full(360, 1.2, np.float32)  # range slightly more than TOLERANCE_M behind the post
    post = empty.copy()
    post[[-2, -1, 0, 1]] = 1.0
    for stamp, ranges, left in ((0.0, post, 4), (0.1, empty, 0)):
        memory.update(scan_of([], pose, stamp, ranges=ranges, **TURN))
        assert np.sum(np.hypot(memory.points[:, 0] - LASER, memory.points[:, 1]) < 1.1) == left


def test_occluded_points_are_kept():
    memory, pose = ObstacleMemory(), (0.0, 0.0, 0.0)
    for stamp, distance in ((0.0, 1.0), (0.1, 0.85)):
        memory.update(scan_of([], pose, stamp, ranges=np.full(360, distance, np.float32), **TURN))
    away = np.hypot(memory.points[:, 0] - LASER, memory.points[:, 1])
    assert (np.sum(away > 0.95), np.sum(away < 0.95)) == (360, 180)


@pytest.mark.parametrize(("beside", "left"), [(-1, 1), (1, 1), (2, 0)])
def test_a_point_is_cleared_only_if_the_neighbouring_beams_pass_too(beside, left):
    memory, pose = ObstacleMemory(), (0.0, 0.0, 0.0)
    post, nearer = np.full((2, 360), 1.4, np.float32)
    post[180], nearer[180 + beside] = 1.0, 0.5
    for stamp, ranges in ((0.0, post), (0.1, nearer)):
        memory.update(scan_of([], pose, stamp, ranges=ranges, **TURN))
    away = np.hypot(memory.points[:, 0] - LASER, memory.points[:, 1])
    assert np.sum(np.abs(away - 1.0) < 0.01) == left


def test_a_full_memory_forgets_the_oldest_points(monkeypatch):
    monkeypatch.setattr("applr_ros1.monitor.known_space.CAPACITY_POINTS", 1000)
    memory, newest = ObstacleMemory(), ObstacleMemory()
    for x in (0.0, 2.0, 4.0, 6.0, 8.0):  # Each pose is outside the space observed by the previous scan.
        pose = (x, 0.0, 0.0)
        scan = scan_of([], pose, x, ranges=np.full(BEAMS, 0.9, np.float32))
        memory.update(scan)
    newest.update(scan)
    assert len(newest.points) < len(memory.points) <= 1000
    assert np.array_equal(memory.points[-len(newest.points) :], newest.points)


def test_a_robot_in_contact_may_only_drive_away():
    monitor, pose = seen_all_around([(0.30, y) for y in np.arange(-0.2, 0.2, 0.03)]), (0, 0, 0)
    assert monitor.filter(0.0, pose, (0, 0), (0.3, 0.0)).action == STOP
    assert monitor.filter(0.0, pose, (0, 0), (-0.3, 0.0)).action == PASS


def test_a_blind_scanner_stops_the_robot_and_a_good_scan_frees_it():
    monitor, pose, beams = CollisionMonitor(), (0, 0, 0), math.nan
    good = scan_of(wall(5.0, 2.0), pose)
    monitor.add_scan(good)
    assert monitor.filter(0.0, pose, (1.0, 0), (1.0, 0)).action == PASS
    assert "scanner" in monitor.add_scan(scan_of([], pose, 0.1, ranges=np.full(BEAMS, beams, np.float32)))
    assert monitor.filter(0.1, pose, (1.0, 0), (1.0, 0)).action == STOP
    good.stamp = 0.2
    monitor.add_scan(good)
    assert monitor.filter(0.2, pose, (1.0, 0), (1.0, 0)).action == PASS


def test_a_frozen_image_with_new_stamps_stops_a_moving_robot():
    monitor = CollisionMonitor()
    image = scan_of(wall(3.0), (0, 0, 0)).ranges
    faults = []
    for step in range(FROZEN_SCANS + 3):
        pose = (0.05 * step, 0, 0)
        faults.append(monitor.add_scan(scan_of([], pose, 0.05 * step, ranges=image)))
    assert faults[0] == ""
    assert "frozen" in faults[-1]
    standing = CollisionMonitor()
    assert not any(standing.add_scan(scan_of([], (0, 0, 0), 0.05 * k, ranges=image)) for k in range(50))


@pytest.mark.parametrize("pose", [(0.006, 0, 0), (0, -0.006, 0), (0, 0, 0.006), (0, 0, -0.006), (0, 0, 0.004)])
def test_an_identical_image_is_a_repeat_if_the_robot_moved_or_turned_by_more_than_5_mm_or_mrad(pose):
    """A scan with repeated ranges contains old data, and does not become the latest scan."""
    check, monitor, scan = ScannerCheck(), CollisionMonitor(), scan_of(wall(2.0), (0.0, 0.0, 0.0))
    for at, place in ((0.0, scan.sensor_pose), (0.1, (scan.sensor_pose[0] + pose[0], *pose[1:]))):
        now = replace(scan, stamp=at, sensor_pose=place)
        assert not check.fault(now)
        assert check.repeats == (at > 0.0 and max(map(abs, pose)) > 0.005)
        monitor.add_scan(now)
    monitor.filter(0.2, (0.0, 0.0, 0.0), (0.0, 0.0), (0.5, 0.0))
    assert monitor.ages[0] == pytest.approx(0.2 if check.repeats else 0.1)


def test_a_scan_older_than_the_latest_is_ignored():
    monitor = seen_all_around(wall(1.0))
    assert monitor.add_scan(scan_of(wall(5.0, 4.0), (0.0, 0.0, 0.0), -0.05)) == ""
    assert monitor.filter(0.0, (0.0, 0.0, 0.0), (0.0, 0.0), (1.5, 0.0)).action == SLOW


def test_a_failed_sector_recovers_once_its_beams_return():
    check, scan = ScannerCheck(), scan_of([], (0.0, 0.0, 0.0), ranges=np.full(BEAMS, 1.5, np.float32))
    failed = scan.ranges.copy()
    failed[200:400] = np.inf
    for ranges, doubted in ((scan.ranges, 0), (failed, 200), (scan.ranges - np.float32(0.01), 0), (failed, 200)):
        now = replace(scan, ranges=ranges)
        check.fault(now)
        assert np.isnan(check.believed(now).ranges).sum() == doubted
    failed[200:300] = 1.5
    check.fault(replace(scan, ranges=failed))
    assert np.flatnonzero(np.isnan(check.believed(replace(scan, ranges=failed)).ranges)).tolist() == [*range(300, 400)]


def test_missing_and_stale_inputs_and_invalid_commands_stop_the_robot():
    monitor, pose = CollisionMonitor(), (0, 0, 0)
    assert monitor.filter(0.0, pose, (0, 0), (1, 0)).action == STOP
    monitor.add_scan(scan_of([], pose))
    assert monitor.filter(0.4, pose, (0, 0), (1, 0)).action == PASS
    assert "scan is 0.60 s old" in monitor.filter(0.6, pose, (0, 0), (1, 0)).reason
    assert "pose is 0.60 s old" in monitor.filter(0.1, pose, (0, 0), (1, 0), (0.6, 0.0)).reason
    assert "odometry is 0.60 s old" in monitor.filter(0.1, pose, (0, 0), (1, 0), (0.0, 0.6)).reason
    assert "0.45 s ahead of the clock" in monitor.filter(-0.45, pose, (0, 0), (1, 0)).reason
    assert monitor.filter(0.1, pose, (0, 0), (math.nan, 0)).command == (0.0, 0.0)
    assert monitor.filter(0.1, pose, (0, 0), (1e-7, -1e-7)) == Verdict((0.0, 0.0))


def test_absurd_commands_are_limited_to_a_speed_that_can_be_stopped():
    monitor, pose, command = CollisionMonitor(), (0, 0, 0), (1e300, 1e300)
    monitor.add_scan(scan_of(wall(5.0), pose))
    verdict = monitor.filter(0.0, pose, (0, 0), command)
    assert verdict.action == SLOW
    assert [abs(v) <= limit + 1e-9 for v, limit in zip(verdict.command, monitor.fastest)] == [True, True]
    assert verdict.command != (0.0, 0.0)
    v, _ = monitor.fastest
    assert v * 0.15 + v * v / (2 * SETTINGS.deceleration) == pytest.approx(2.0)
    v, _ = monitor.filter(0.0, pose, (0, 0), (1e3, 0.0), (0.0, 0.3)).command  # The odometry is .3 s old.
    assert v * 0.45 + v * v / (2 * SETTINGS.deceleration) == pytest.approx(2.0)
    for factor in (1.9, 2.1):  # Odometry that reports more than twice the fastest command is impossible.
        for twist in ((factor * monitor.fastest[0], 0.0), (0.0, factor * monitor.fastest[1])):
            assert ("too fast" in monitor.filter(0.0, pose, twist, (0.5, 0.0)).reason) == (factor > 2.0)


def test_the_scale_is_the_largest_safe_one():
    """For random points and commands, a slightly larger scale is not safe."""
    rng = np.random.default_rng(5)
    planes, rest = half_planes(SETTINGS.body), ((0.0, 0.15), (4.0, 12.0), EVERYTHING)
    scales = []
    for _ in range(60):
        points = rng.uniform(-1.2, 1.2, (30, 2))
        points = points[[penetration(planes, 0.05, x, y) < 0 for x, y in points]]
        command = (float(rng.uniform(-0.5, 2.0)), float(rng.uniform(-2, 2)))
        scale, free = safe_scale(points, planes, 0.03, (0.0, 0.0), command, *rest)
        assert free
        scales.append(scale)
        scaled = (scale * command[0], scale * command[1])
        assert safe_scale(points, planes, 0.03, (0.0, 0.0), scaled, *rest)[0] == 1.0
        more = (min(1.0, scale + 0.05) * command[0], min(1.0, scale + 0.05) * command[1])
        assert scale == 1.0 or safe_scale(points, planes, 0.03, (0.0, 0.0), more, *rest)[0] < 1.0
    assert 0 < sum(scale < 1.0 for scale in scales) < 60


def test_settings_are_checked():
    for name, value in (("deceleration", 0.0), ("deceleration", 1e-300), ("turn_gain", 1e300), ("margin", math.nan)):
        with pytest.raises(ValueError, match=f"{name} is .*: give a number from"):
            replace(SETTINGS, **{name: value})
    with pytest.raises(ValueError, match="memory_radius is 1000000000.0"):
        replace(SETTINGS, memory_radius=1e9)


@pytest.mark.parametrize("world", ["generated:3", "generated:299"])
def test_a_faulty_planner_causes_no_collision_in_simulation(world):
    """The planner commands full speed straight ahead. The monitor stops the Jackal before the first obstacle."""
    pytest.importorskip("gymnasium")
    import sim_bridge
    import worlds
    from training.env.episode import Episode

    class Mad(MoveBase):
        def step(self, *arguments):
            cycle = super().step(*arguments)
            cycle.command = (2.0, 0.0)
            return cycle

    touched = {}
    for monitor in (False, True):
        parts = sim_bridge.make("kinematic"), Mad(JACKAL.parameters())
        episode = Episode(*parts, period=2.0, time_limit=10.0, monitor=monitor)
        outcome = episode.reset(worlds.load(world), 0)
        while not outcome.over:
            outcome = episode.decide(episode.space.theta0)
        touched[monitor] = outcome.collided
    assert touched == {False: True, True: False}


def posts(seed):
    """Return random positions (n, 2) [m] of posts, none of them at the robot."""
    places = np.random.default_rng(seed).uniform(-4.0, 4.0, (40, 2))
    return places[np.hypot(*places.T) > 0.8]


def turned_away_from(behind):
    """Return a monitor that has observed posts at (n, 2) [m] before the robot turned to yaw 0, at time 3.9 s."""
    monitor = CollisionMonitor()
    for step, yaw in enumerate(np.linspace(-math.pi, 0.0, 40)):
        monitor.add_scan(scan_of(behind, (0.0, 0.0, yaw), 0.1 * step))
    assert monitor.filter(3.9, (0, 0, 0), (0, 0), (-0.5, 0.0)).blocked
    return monitor


CLOSE_BEHIND = [(-0.32, y) for y in np.arange(-0.2, 0.21, 0.05)]


@pytest.mark.parametrize("odometry_jumps", [False, True])
def test_another_place_clears_the_memory(odometry_jumps):
    """Either the robot is carried to another place, or only its odometry jumps."""
    monitor = turned_away_from(before := [*posts(0), *CLOSE_BEHIND])
    place, after = ((1.9, 0.3, 0.5), before) if odometry_jumps else ((0.0, 0.0, 0.0), posts(1))
    scan = scan_of(after, (0.01, 0.0, 0.0), 4.0, sensor_pose=compose(place, (LASER, 0.0, 0.0)))
    monitor.add_scan(scan)
    only = ObstacleMemory()
    only.update(scan)
    assert len(monitor.memory.points) == len(only.points)
    assert "another place" in monitor.filter(4.0, place, (0, 0), (-0.5, 0.0)).reason
    monitor.add_scan(replace(scan, stamp=4.1))
    assert monitor.filter(4.1, place, (0, 0), (-0.5, 0.0)).command == pytest.approx((-0.1, 0.0))  # unknown space


def test_alternating_scans_of_two_robots_stop_the_robot():
    monitor, pose = CollisionMonitor(), (0.0, 0.0, 0.0)
    for step in range(10):
        monitor.add_scan(scan_of(posts(step % 2), pose, 0.05 * step))
        verdict = monitor.filter(0.05 * step, pose, (0.0, 0.0), (1.0, 0.0))
        assert (verdict.action == STOP) == (step > 0)


@pytest.mark.parametrize(
    ("twist", "steps", "action"),
    [((1.0, 0.0), 8, STOP), ((0.0, 0.5), 8, STOP), ((0.0, 0.0), 8, PASS), ((0.002, 0.006), 400, PASS)],
)
def test_a_constant_pose_with_nonzero_velocity_is_a_stop(twist, steps, action):
    """A base at rest with constant encoders and a drifting gyroscope must not be stopped for this reason."""
    monitor = seen_all_around([(9.0, 0.0)])
    for step in range(steps):
        monitor.add_scan(scan_of([(9.0, 0.0)], (0, 0, 0), 0.05 * step))
        verdict = monitor.filter(0.05 * step, (0.0, 0.0, 0.0), twist, (0.5, 0.1))
    assert verdict.action == action
    assert ("frozen" in verdict.reason) == (action == STOP)


def test_space_between_widely_spaced_beams_is_unknown():
    """Nine beams have no return. A scan with more beams than the capacity of the memory is rejected."""
    monitor, pose = CollisionMonitor(), (0.0, 0.0, 0.0)
    few = scan_of([], pose, angle_increment=2 * ANGLE / 8, ranges=np.full(9, np.inf, np.float32))
    assert monitor.add_scan(few) == ""
    assert "creeping" in monitor.filter(0.0, pose, (0, 0), (1.0, 0.0)).reason
    many = scan_of([], pose, 0.1, angle_increment=1e-4, ranges=np.full(20000, 3.0, np.float32))
    assert "20000 beams" in monitor.add_scan(many)


def test_remembered_obstacles_block_the_robot_until_a_scan_clears_them():
    """Waiting does not free the robot. After it has turned and observed the free space behind it, it may drive."""
    monitor, pose = turned_away_from(obstacles := [*posts(0), *CLOSE_BEHIND]), (0.0, 0.0, 0.0)
    for now in np.arange(4.0, 104.0, 1.0):
        monitor.add_scan(scan_of(obstacles, pose, now))
        assert monitor.filter(now, pose, (0, 0), (-0.5, 0.0)).blocked
    for now, yaw in ((104.0, math.pi), (104.1, 0.0)):
        monitor.add_scan(scan_of(posts(0), (0.0, 0.0, yaw), now))
    assert monitor.filter(104.1, pose, (0, 0), (-0.5, 0.0)).action == PASS


@pytest.mark.fault("11d")
def test_an_obstacle_that_vanishes_ahead_does_not_clear_those_behind():
    """A door 1 m ahead, which most of the beams hit, is open in the next scan."""
    monitor = turned_away_from(before := [*wall(1.0, 1.5), (3.0, 3.0), (3.0, -3.0), *CLOSE_BEHIND])
    monitor.add_scan(scan_of([place for place in before if place[0] != 1.0], (0.0, 0.0, 0.0), 4.0))
    assert monitor.filter(4.0, (0, 0, 0), (0, 0), (-0.5, 0.0)).blocked


@pytest.mark.fault("11e")
def test_the_robot_creeps_in_unobserved_space_and_drives_in_observed_space():
    monitor, pose = CollisionMonitor(), (0.0, 0.0, 0.0)
    verdict = None
    for step in range(30):  # The robot drives 1.45 m ahead.
        pose, now = (0.05 * step, 0.0, 0.0), 0.05 * step
        monitor.add_scan(scan_of(posts(0), pose, now))
        verdict = verdict or monitor.filter(now, pose, (0, 0), (-0.5, 0.0))
        assert monitor.filter(now, pose, (1.0, 0.0), (1.0, 0.0)).action == PASS
    assert verdict.command == pytest.approx((-0.1, 0.0))
    assert monitor.filter(now, pose, (0, 0), (-0.5, 0.0)).action == PASS
    assert CollisionMonitor(replace(SETTINGS, creep_speed=0.05)).settings.creep_speed == 0.05


def test_the_robot_creeps_no_faster_than_a_remembered_obstacle_allows():
    monitor = seen_all_around(wall(0.229 + 0.03 + 0.05 + 0.015, 0.5))  # body front, margin, post radius, 15 mm
    monitor.seen.clear()
    verdict = monitor.filter(0.0, (0.0, 0.0, 0.0), (0.0, 0.0), (1.0, 0.0))
    assert "creeping" in verdict.reason
    assert 0.0 < verdict.command[0] < 0.07


def test_the_whole_way_to_the_stop_must_be_observed():
    monitor = seen_all_around([(9.0, 0.0)])
    assert monitor.filter(0.0, (0.0, 0.0, 0.0), (0.0, 0.0), (1.8, 0.0)).action == PASS
    monitor.seen.cells[int(0.5 / CELL_M)] = 0  # a strip of 5 cm far before the stopping point
    assert monitor.filter(0.0, (0.0, 0.0, 0.0), (0.0, 0.0), (1.8, 0.0)).action == SLOW


def test_space_behind_an_obstacle_or_the_robot_is_unknown():
    seen = SeenSpace(8.0)
    seen.update(scan_of(wall(1.0), (0.0, 0.0, 0.0)))
    places = np.array([(0.8, 0.0), (1.15, 0.0), (-0.6, 0.0), (0.0, 1.5), (7.0, 0.0)])
    cells = np.floor(places / CELL_M).astype(int) % len(seen.cells)
    assert [seen.cells[tuple(cell)] for cell in cells] == [1, 0, 0, 1, 0]


@pytest.mark.fault("11c")
@pytest.mark.parametrize("value", [math.nan, math.inf])
def test_obstacles_in_a_failed_sector_are_kept(value):
    """A quarter turn ahead, with a wall 1.4 m away, loses all returns from one scan to the next."""
    monitor, pose = seen_all_around(wall(1.4, 2.0)), (0.0, 0.0, 0.0)
    for stamp in (0.1, 0.2):
        failed = scan_of(wall(1.4, 2.0), pose, stamp)
        failed.ranges[BEAMS * 3 // 8 : BEAMS * 5 // 8] = value
        monitor.add_scan(failed)
    assert monitor.filter(0.2, pose, (0, 0), (2.0, 0.0)).action == SLOW
    monitor.add_scan(scan_of(wall(5.0, 4.0), pose, 0.3))
    assert monitor.filter(0.3, pose, (0, 0), (1.5, 0.0)).action == PASS


def test_a_failed_sector_is_detected_even_if_less_than_half_had_an_obstacle():
    """A wall .7 m wide is 1.4 m ahead. Everything else is 28 m away, too far for a return to be expected."""
    monitor, pose = CollisionMonitor(), (0.0, 0.0, 0.0)
    clean = np.minimum(scan_of(wall(1.4, 0.35), pose).ranges, np.float32(28.0))
    failed = clean.copy()
    failed[BEAMS * 3 // 8 : BEAMS * 5 // 8] = math.inf
    for stamp, ranges in ((0.0, clean), (0.1, failed)):
        monitor.add_scan(scan_of([], pose, stamp, ranges=ranges))
    assert monitor.filter(0.1, pose, (0, 0), (2.0, 0.0)).action == SLOW


@pytest.mark.parametrize(("late", "ages"), [(0.3, (0.3, 0.0)), (0.0, (0.0, 0.3)), (0.0, (0.0, 0.0))])
def test_stale_poses_shorten_the_free_distance(late, ages):
    """A wall is 1.1 m ahead of the body. With a pose or twist 300 ms old, the command is limited more."""
    v, looks = 1.6, [((0.0, 0.0, 0.0), (0.0, 0.0)), ((-1.6 * late, 0.0, 0.0), ages)]
    here, seen = (
        seen_all_around(wall(1.379, 1.0)).filter(0.0, pose, (v, 0.0), (2.0, 0.0), old).command[0] for pose, old in looks
    )
    assert seen < here - 0.2 if any(ages) else seen == here
