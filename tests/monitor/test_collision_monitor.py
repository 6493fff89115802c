"""The collision monitor without ROS: what passes, what is remembered, which scanners are not believed."""

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
    """What a Jackal's laser at `pose` sees of discs of 5 cm radius at points (n, 2) in the odometry frame."""
    place = pose[0] + LASER * math.cos(pose[2]), pose[1] + LASER * math.sin(pose[2]), pose[2]
    discs = [(*point, 0.05) for point in points]
    ranges = Lidar(JACKAL.laser, discs, np.zeros((0, 5))).scan(*place)
    return replace(LaserScan(stamp, -ANGLE, 2 * ANGLE / (BEAMS - 1), 0.1, 30.0, ranges, place), **changes)


def wall(x, half_width=1.0):
    return [(x, y) for y in np.arange(-half_width, half_width, 0.04)]


def seen_all_around(points, settings=None):
    """A monitor at (0, 0, 0) whose scanner has looked ahead and, before, back, at the points (n, 2); time is 0."""
    monitor = CollisionMonitor(settings)
    for stamp, yaw in ((-0.1, math.pi), (0.0, 0.0)):
        monitor.add_scan(scan_of(points, (0.0, 0.0, yaw), stamp))
    return monitor


@pytest.mark.parametrize(
    ("command", "action", "blocked"),
    [((0.04, -0.1), SLOW, True), ((0.0, 0.0), STOP, True), ((0.0, 0.2), SLOW, False), ((-0.06, 0.0), SLOW, False)],
)
def test_a_command_of_which_next_to_nothing_passes_is_blocked(command, action, blocked):
    assert Verdict(command, action).blocked is blocked
    assert not Verdict(command).blocked


def test_nothing_near_changes_no_command():
    monitor = CollisionMonitor()
    assert monitor.add_scan(scan_of([(4.0, 0.0)] * 2, (0, 0, 0))) == ""
    assert monitor.filter(0.0, (0, 0, 0), (1.9, 0.0), (2.0, 0.3)).command == (2.0, 0.3)


@pytest.mark.parametrize("way", [1.0, -1.0])
def test_brakes_and_stops_as_its_wheels_can_without_locking(way):
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
    assert monitor.braked(0.35, 1.0 * way)[0] == pytest.approx(0.8 * way), "its wheels are slower than commanded"
    assert monitor.braked(0.40, -0.5 * way) == (0.0, 0.0)
    assert monitor.braked(0.41, 2.0 * way) == (0.0, 0.0)


@pytest.mark.parametrize("way", [1.0, -1.0])
def test_a_stop_keeps_the_arc(way):
    """Of the command before it, whose way was found free; a turn that is asked for is turned as asked."""
    monitor = seen_all_around([(9.0, 0.0)], replace(SETTINGS, deceleration=2.0))
    for asked, given in (((0.0, 0.0), 0.9), ((0.0, 0.5), 0.5)):
        monitor._given = 0.0, 2.0 * way, 1.0
        verdict = monitor.filter(0.1, (0, 0, 0), (2.0 * way, 1.0), asked)
        assert verdict.command == pytest.approx((1.8 * way, given))


@pytest.mark.parametrize(("twist", "command"), [((1.0, 0.0), (1.0, 2.5)), ((1.0, 2.5), (1.0, 0.0))])
@pytest.mark.parametrize("post", [(0.45, -0.18), (0.35, 0.35)])
def test_a_new_turn_is_free_where_the_robot_may_turn_at_once_and_where_it_may_not_yet(twist, command, post):
    """One post stands straight on, one at the inside of the turn; a robot may go either way before it follows."""
    points, planes = np.array([post]), half_planes(SETTINGS.body)
    rest = ((0.0, 0.15), (4.0, 12.0), EVERYTHING)
    assert 0.0 < safe_scale(points, planes, 0.03, twist, command, *rest)[0] < 1.0
    turning = (1.0, 2.5)
    assert safe_scale(points, planes, 0.03, turning, turning, *rest)[0] < 1.0, "it may not follow the turn any more"
    if post[1] > 0.0:
        assert safe_scale(points, planes, 0.03, (1.0, 0.0), (1.0, 0.0), *rest)[0] == 1.0


@pytest.mark.parametrize("speed", [0.3, 1.0, 2.0])
def test_drives_up_to_a_wall_and_stands_before_it(speed):
    """A base that accelerates at once and brakes as the settings promise never touches the wall, and gets near it."""
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


def test_a_tighter_turn_is_let_through_where_straight_on_is_not():
    monitor, pose = seen_all_around(wall(0.55, 0.1), BRAKES_WELL), (0, 0, 0)
    assert monitor.filter(0.0, pose, (1.0, 0.0), (1.0, 0.0)).action == SLOW
    assert monitor.filter(0.0, pose, (0.0, 0.0), (0.0, 2.0)).action == PASS


def test_backs_out_along_a_long_way_only_as_far_as_what_was_seen_there_allows():
    """What was passed and lay three metres behind still stands there when the robot has backed up to it."""
    monitor, behind = CollisionMonitor(), [(-0.6, y) for y in np.arange(-0.3, 0.31, 0.03)]
    monitor.add_scan(scan_of(behind, (0, 0, math.pi)))
    there_and_back = [*np.arange(0.0, 3.0, 0.2), *np.arange(3.0, -0.3, -0.1)]
    for step, x in enumerate(there_and_back):
        pose, now = (float(x), 0.0, 0.0), 0.1 * (step + 1)
        monitor.add_scan(scan_of([], pose, now, ranges=np.full(BEAMS, 20.0 + now, np.float32)))
        verdict = monitor.filter(now, pose, (0, 0), (-0.5, 0.0))
        assert x < 0.0 or verdict.action == PASS
    assert verdict.action != PASS


def test_a_long_time_before_edges_does_not_fill_the_memory():
    rng, monitor, pose = np.random.default_rng(0), CollisionMonitor(), (0.0, 0.0, 0.0)
    discs = [(0.8, y) for y in np.arange(-0.9, 0.9, 0.18)]
    clean = scan_of(discs + wall(1.6, 1.5), pose)
    counts = []
    for step in range(200):
        noisy = clean.ranges + rng.normal(0.0, 0.002, BEAMS).astype(np.float32)
        monitor.add_scan(scan_of([], pose, 0.05 * step, ranges=noisy))
        counts.append(len(monitor.memory.points))
    assert counts[-1] < 1.5 * counts[0]


TURN = {"angle_min": 0.0, "angle_increment": 2 * math.pi / 359}  # a TurtleBot3's laser, whose ends meet ahead


@pytest.mark.parametrize("geometry", [{}, TURN], ids=["270 degrees", "a full turn"])
def test_the_ends_of_a_scan_do_not_fill_the_memory(geometry):
    rng, memory, pose = np.random.default_rng(0), ObstacleMemory(), (0.0, 0.0, 0.0)
    counts = []
    for step in range(100):
        ranges = rng.normal(2.0, 0.003, 360 if geometry else BEAMS).astype(np.float32)
        memory.update(scan_of([], pose, 0.1 * step, ranges=ranges, **geometry))
        counts.append(len(memory.points))
    assert counts[-1] < 1.1 * counts[0]


def test_what_has_gone_where_the_ends_of_a_scan_meet_is_forgotten():
    memory, pose = ObstacleMemory(), (0.0, 0.0, 0.0)
    empty = np.full(360, 1.2, np.float32)  # seen through by little more than a range may differ
    post = empty.copy()
    post[[-2, -1, 0, 1]] = 1.0
    for stamp, ranges, left in ((0.0, post, 4), (0.1, empty, 0)):
        memory.update(scan_of([], pose, stamp, ranges=ranges, **TURN))
        assert np.sum(np.hypot(memory.points[:, 0] - LASER, memory.points[:, 1]) < 1.1) == left


def test_what_is_hidden_by_something_a_little_nearer_is_kept():
    memory, pose = ObstacleMemory(), (0.0, 0.0, 0.0)
    for stamp, distance in ((0.0, 1.0), (0.1, 0.85)):
        memory.update(scan_of([], pose, stamp, ranges=np.full(360, distance, np.float32), **TURN))
    away = np.hypot(memory.points[:, 0] - LASER, memory.points[:, 1])
    assert (np.sum(away > 0.95), np.sum(away < 0.95)) == (360, 180)


@pytest.mark.parametrize(("beside", "left"), [(-1, 1), (1, 1), (2, 0)])
def test_a_point_is_gone_only_where_the_beams_beside_it_pass_too(beside, left):
    memory, pose = ObstacleMemory(), (0.0, 0.0, 0.0)
    post, nearer = np.full((2, 360), 1.4, np.float32)
    post[180], nearer[180 + beside] = 1.0, 0.5
    for stamp, ranges in ((0.0, post), (0.1, nearer)):
        memory.update(scan_of([], pose, stamp, ranges=ranges, **TURN))
    away = np.hypot(memory.points[:, 0] - LASER, memory.points[:, 1])
    assert np.sum(np.abs(away - 1.0) < 0.01) == left


def test_a_full_memory_forgets_the_oldest(monkeypatch):
    monkeypatch.setattr("applr_ros1.monitor.known_space.CAPACITY_POINTS", 1000)
    memory, newest = ObstacleMemory(), ObstacleMemory()
    for x in (0.0, 2.0, 4.0, 6.0, 8.0):  # each time far beyond what the scan before has shown
        pose = (x, 0.0, 0.0)
        scan = scan_of([], pose, x, ranges=np.full(BEAMS, 0.9, np.float32))
        memory.update(scan)
    newest.update(scan)
    assert len(newest.points) < len(memory.points) <= 1000
    assert np.array_equal(memory.points[-len(newest.points) :], newest.points)


def test_a_robot_in_touch_may_leave_and_not_press():
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


def test_a_frozen_image_under_new_stamps_stops_the_robot_that_moves():
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


@pytest.mark.parametrize(
    ("pose", "repeats"),
    [
        ((0.006, 0, 0), True),
        ((0, -0.006, 0), True),
        ((0, 0, 0.006), True),
        ((0, 0, -0.006), True),
        ((0, 0, 0.004), False),
    ],
)
def test_an_image_repeats_where_it_is_the_same_though_the_robot_moved_or_turned(pose, repeats):
    check, scan = ScannerCheck(), scan_of(wall(2.0), (0.0, 0.0, 0.0))
    assert not check.fault(scan)
    assert not check.repeats
    assert not check.fault(replace(scan, sensor_pose=(scan.sensor_pose[0] + pose[0], *pose[1:])))
    assert check.repeats == repeats


def test_a_sector_is_believed_again_once_its_beams_return():
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


def test_no_scan_old_scan_and_nonsense_commands_stop():
    monitor, pose = CollisionMonitor(), (0, 0, 0)
    assert monitor.filter(0.0, pose, (0, 0), (1, 0)).action == STOP
    monitor.add_scan(scan_of([], pose))
    assert monitor.filter(0.4, pose, (0, 0), (1, 0)).action == PASS
    assert "scan is 0.60 s old" in monitor.filter(0.6, pose, (0, 0), (1, 0)).reason
    assert "pose is 0.60 s old" in monitor.filter(0.1, pose, (0, 0), (1, 0), (0.6, 0.0)).reason
    assert "odometry is 0.60 s old" in monitor.filter(0.1, pose, (0, 0), (1, 0), (0.0, 0.6)).reason
    assert "0.45 s ahead of the clock" in monitor.filter(-0.45, pose, (0, 0), (1, 0)).reason  # it was set back
    assert monitor.filter(0.1, pose, (0, 0), (math.nan, 0)).command == (0.0, 0.0)
    assert monitor.filter(0.1, pose, (0, 0), (1e-7, -1e-7)) == Verdict((0.0, 0.0))


def test_commands_beyond_all_bounds_are_reduced_to_what_can_be_stopped():
    monitor, pose, command = CollisionMonitor(), (0, 0, 0), (1e300, 1e300)
    monitor.add_scan(scan_of(wall(5.0), pose))
    verdict = monitor.filter(0.0, pose, (0, 0), command)
    assert verdict.action == SLOW
    assert [abs(v) <= limit + 1e-9 for v, limit in zip(verdict.command, monitor.fastest)] == [True, True]
    assert verdict.command != (0.0, 0.0)
    v, _ = monitor.fastest
    assert v * 0.15 + v * v / (2 * SETTINGS.deceleration) == pytest.approx(2.0)
    v, _ = monitor.filter(0.0, pose, (0, 0), (1e3, 0.0), (0.0, 0.3)).command  # by odometry of .3 s ago
    assert v * 0.45 + v * v / (2 * SETTINGS.deceleration) == pytest.approx(2.0)
    assert monitor.filter(0.0, pose, command, (0.5, 0.0)).action == STOP  # odometry that cannot be


def test_scale_is_the_largest_safe_one():
    """Against plain sampling: a scale a little larger is not safe, for random points and commands."""
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
    with pytest.raises(ValueError, match="three"):
        CollisionMonitor(replace(SETTINGS, body=((0, 0), (1, 1))))


@pytest.mark.parametrize("world", ["generated:3", "generated:299"])
def test_a_planner_gone_mad_touches_nothing_in_simulation(world):
    """Full speed straight ahead through a course: with the monitor the Jackal stands before the first obstacle."""
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
        episode = Episode(sim_bridge.make("kinematic"), Mad(JACKAL.parameters()), period=2.0, limit=5, monitor=monitor)
        outcome = episode.reset(worlds.load(world), 0)
        while not outcome.over:
            outcome = episode.decide(episode.space.theta0)
        touched[monitor] = outcome.collided
    assert touched == {False: True, True: False}


def posts(seed):
    """Places (n, 2) [m] of posts, none of them at the robot."""
    places = np.random.default_rng(seed).uniform(-4.0, 4.0, (40, 2))
    return places[np.hypot(*places.T) > 0.8]


def turned_away_from(behind):
    """A monitor that has seen posts at these places (n, 2) [m] before the robot turned to yaw 0, at time 3.9 s."""
    monitor = CollisionMonitor()
    for step, yaw in enumerate(np.linspace(-math.pi, 0.0, 40)):
        monitor.add_scan(scan_of(behind, (0.0, 0.0, yaw), 0.1 * step))
    assert monitor.filter(3.9, (0, 0, 0), (0, 0), (-0.5, 0.0)).blocked
    return monitor


CLOSE_BEHIND = [(-0.32, y) for y in np.arange(-0.2, 0.21, 0.05)]


@pytest.mark.parametrize("odometry_jumps", [False, True])
def test_another_place_begins_the_memory_afresh(odometry_jumps):
    """The robot is set to another place, or only its odometry is."""
    monitor = turned_away_from(before := [*posts(0), *CLOSE_BEHIND])
    place, after = ((1.9, 0.3, 0.5), before) if odometry_jumps else ((0.0, 0.0, 0.0), posts(1))
    scan = scan_of(after, (0.01, 0.0, 0.0), 4.0, sensor_pose=compose(place, (LASER, 0.0, 0.0)))
    monitor.add_scan(scan)
    only = ObstacleMemory()
    only.update(scan)
    assert len(monitor.memory.points) == len(only.points)
    assert "another place" in monitor.filter(4.0, place, (0, 0), (-0.5, 0.0)).reason
    monitor.add_scan(replace(scan, stamp=4.1))
    assert monitor.filter(4.1, place, (0, 0), (-0.5, 0.0)).command == pytest.approx((-0.1, 0.0))  # nor seen free


def test_scans_of_two_robots_in_turns_are_a_stop():
    monitor, pose = CollisionMonitor(), (0.0, 0.0, 0.0)
    for step in range(10):
        monitor.add_scan(scan_of(posts(step % 2), pose, 0.05 * step))
        verdict = monitor.filter(0.05 * step, pose, (0.0, 0.0), (1.0, 0.0))
        assert (verdict.action == STOP) == (step > 0)


@pytest.mark.parametrize(
    ("twist", "steps", "action"),
    [((1.0, 0.0), 8, STOP), ((0.0, 0.5), 8, STOP), ((0.0, 0.0), 8, PASS), ((0.002, 0.006), 400, PASS)],
)
def test_a_pose_that_stands_while_the_velocity_says_that_the_base_moves_is_a_stop(twist, steps, action):
    """A base at rest whose encoders say nothing new, though its gyroscope drifts, stays free for however long."""
    monitor = seen_all_around([(9.0, 0.0)])
    for step in range(steps):
        monitor.add_scan(scan_of([(9.0, 0.0)], (0, 0, 0), 0.05 * step))
        verdict = monitor.filter(0.05 * step, (0.0, 0.0, 0.0), twist, (0.5, 0.1))
    assert verdict.action == action
    assert ("frozen" in verdict.reason) == (action == STOP)


def test_what_stands_between_beams_that_are_far_apart_was_not_seen():
    """Nothing is measured by nine beams; and more beams than can be remembered are no scan."""
    monitor, pose = CollisionMonitor(), (0.0, 0.0, 0.0)
    few = scan_of([], pose, angle_increment=2 * ANGLE / 8, ranges=np.full(9, np.inf, np.float32))
    assert monitor.add_scan(few) == ""
    assert "creeping" in monitor.filter(0.0, pose, (0, 0), (1.0, 0.0)).reason
    many = scan_of([], pose, 0.1, angle_increment=1e-4, ranges=np.full(20000, 3.0, np.float32))
    assert "20000 beams" in monitor.add_scan(many)


def test_what_is_remembered_holds_the_robot_until_a_scan_shows_that_it_has_gone():
    """However long it waits; a robot that turns and finds the way behind it free may go."""
    monitor, pose = turned_away_from(obstacles := [*posts(0), *CLOSE_BEHIND]), (0.0, 0.0, 0.0)
    for now in np.arange(4.0, 104.0, 1.0):
        monitor.add_scan(scan_of(obstacles, pose, now))
        assert monitor.filter(now, pose, (0, 0), (-0.5, 0.0)).blocked
    for now, yaw in ((104.0, math.pi), (104.1, 0.0)):
        monitor.add_scan(scan_of(posts(0), (0.0, 0.0, yaw), now))
    assert monitor.filter(104.1, pose, (0, 0), (-0.5, 0.0)).action == PASS


@pytest.mark.fault("11d")
def test_what_vanishes_ahead_does_not_make_forget_what_is_behind():
    """A door 1 m ahead, most of what is seen, opens from one scan to the next."""
    monitor = turned_away_from(before := [*wall(1.0, 1.5), (3.0, 3.0), (3.0, -3.0), *CLOSE_BEHIND])
    monitor.add_scan(scan_of([place for place in before if place[0] != 1.0], (0.0, 0.0, 0.0), 4.0))
    assert monitor.filter(4.0, (0, 0, 0), (0, 0), (-0.5, 0.0)).blocked


@pytest.mark.fault("11e")
def test_it_creeps_where_no_scan_has_looked_and_drives_where_it_has_been_or_seen():
    monitor, pose = CollisionMonitor(), (0.0, 0.0, 0.0)
    verdict = None
    for step in range(30):  # 1.45 m ahead
        pose, now = (0.05 * step, 0.0, 0.0), 0.05 * step
        monitor.add_scan(scan_of(posts(0), pose, now))
        verdict = verdict or monitor.filter(now, pose, (0, 0), (-0.5, 0.0))
        assert monitor.filter(now, pose, (1.0, 0.0), (1.0, 0.0)).action == PASS
    assert verdict.command == pytest.approx((-0.1, 0.0))
    assert monitor.filter(now, pose, (0, 0), (-0.5, 0.0)).action == PASS
    assert CollisionMonitor(replace(SETTINGS, creep_speed=0.05)).settings.creep_speed == 0.05


def test_what_lies_behind_an_obstacle_or_the_robot_has_not_been_seen():
    seen = SeenSpace(8.0)
    seen.update(scan_of(wall(1.0), (0.0, 0.0, 0.0)))
    places = np.array([(0.8, 0.0), (1.15, 0.0), (-0.6, 0.0), (0.0, 1.5), (7.0, 0.0)])
    assert [seen.cells[tuple(cell)] for cell in np.floor(places / CELL_M).astype(int) % len(seen.cells)] == [
        1,
        0,
        0,
        1,
        0,
    ]


@pytest.mark.fault("11c")
@pytest.mark.parametrize("value", [math.nan, math.inf])
def test_what_stands_in_a_sector_that_measures_nothing_any_more_is_kept(value):
    """The quarter ahead, where a wall is 1.4 m away: no return there from one scan to the next is not believed."""
    monitor, pose = seen_all_around(wall(1.4, 2.0)), (0.0, 0.0, 0.0)
    for stamp in (0.1, 0.2):
        failed = scan_of(wall(1.4, 2.0), pose, stamp)
        failed.ranges[BEAMS * 3 // 8 : BEAMS * 5 // 8] = value
        monitor.add_scan(failed)
    assert monitor.filter(0.2, pose, (0, 0), (2.0, 0.0)).action == SLOW
    monitor.add_scan(scan_of(wall(5.0, 4.0), pose, 0.3))
    assert monitor.filter(0.3, pose, (0, 0), (1.5, 0.0)).action == PASS


def test_a_sector_in_which_something_stood_in_less_than_half_of_it_is_not_believed_either():
    """A wall of .7 m, 1.4 m ahead, and 28 m to everything else, which is too far to be expected again."""
    monitor, pose = CollisionMonitor(), (0.0, 0.0, 0.0)
    clean = np.minimum(scan_of(wall(1.4, 0.35), pose).ranges, np.float32(28.0))
    failed = clean.copy()
    failed[BEAMS * 3 // 8 : BEAMS * 5 // 8] = math.inf
    for stamp, ranges in ((0.0, clean), (0.1, failed)):
        monitor.add_scan(scan_of([], pose, stamp, ranges=ranges))
    assert monitor.filter(0.1, pose, (0, 0), (2.0, 0.0)).action == SLOW


@pytest.mark.parametrize(("late", "ages"), [(0.3, (0.3, 0.0)), (0.0, (0.0, 0.3)), (0.0, (0.0, 0.0))])
def test_what_is_old_counts_as_far_as_the_robot_may_have_come_since(late, ages):
    """A wall 1.1 m ahead of the body: with the old pose behind or in the body of 300 ms, 2 m/s do not pass as fresh."""
    v, looks = 1.6, [((0.0, 0.0, 0.0), (0.0, 0.0)), ((-1.6 * late, 0.0, 0.0), ages)]
    here, seen = (
        seen_all_around(wall(1.379, 1.0)).filter(0.0, pose, (v, 0.0), (2.0, 0.0), old).command[0] for pose, old in looks
    )
    assert seen < here - 0.2 if any(ages) else seen == here
