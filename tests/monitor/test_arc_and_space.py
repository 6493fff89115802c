"""Tests of motions in the collision monitor: arcs, forgotten points, lateral slip, contradictory odometry."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from applr_ros1.common.scan import LaserScan
from applr_ros1.monitor.known_space import CELL_M, ObstacleMemory
from applr_ros1.monitor.monitor import PASS, SLOW, STOP, CollisionMonitor
from applr_ros1.monitor.motion import PoseMotion
from applr_ros1.monitor.settings import MonitorSettings
from applr_ros1.monitor.stopping import EVERYTHING, half_planes, safe_scale
from applr_ros1.robots import JACKAL
from tests.monitor.test_collision_monitor import ANGLE, BEAMS, scan_of, seen_all_around, wall
from tests.support.seeds import examples

SETTINGS = MonitorSettings.of(JACKAL)
HERE = (0.0, 0.0, 0.0)


def test_creeping_and_stopping_follow_the_arc_of_the_command():
    """The values are from a drive in which the robot left a turn straight ahead and hit a wall."""
    monitor, turning = CollisionMonitor(), SETTINGS.turn_gain * -1.457  # turning exactly as commanded
    assert monitor.braked(0.0, 1.67, (1.853, -1.457)) == (1.853, -1.457)
    v, w = monitor.braked(0.05, 1.67, (0.1, -0.078), turning)
    assert (v, w) == pytest.approx((1.575, -0.078 * 15.75))
    stopped = monitor.braked(0.1, 1.6)
    assert stopped == pytest.approx((1.48, w / v * 1.48))


@pytest.mark.parametrize("command", [(0.5, 1.0), (0.5, -1.0), (0.5, 0.2)])
def test_a_braking_base_turns_no_faster_than_commanded_now_or_before(command):
    monitor = CollisionMonitor()
    monitor.braked(0.0, 2.0, (2.0, 0.4))
    v, w = monitor.braked(0.05, 2.0, command, SETTINGS.turn_gain * command[1])
    assert v == pytest.approx(2.0 - 1.9 * 0.05)
    assert abs(w) == pytest.approx(min(abs(command[1]) * v / 0.5, max(abs(command[1]), 0.4)))
    assert w * command[1] > 0.0


def test_a_braking_base_gets_only_reachable_turn_rates():
    """The turn rate changes by at most 3.3 rad/s^2 for a tenth of a second, and never reverses."""
    for turning, asked, turned in ((0.0, 4.0, 0.33), (1.35, 4.0, 1.33), (-1.35, 4.0, 0.0), (2.7, 0.5, 1.67)):
        monitor = CollisionMonitor()
        monitor.braked(0.0, 2.0, (2.0, asked))
        assert monitor.braked(0.05, 2.0, (1.0, asked), turning) == pytest.approx((1.905, turned))
        assert monitor.braked(0.1, 2.0, (2.0, asked)) == (2.0, asked), "the base no longer brakes"


def test_a_rare_command_is_judged_by_the_time_it_stays_in_force():
    """At 5 Hz each command applies longer, so the safe speed is lower. Braking shortens `silence`."""
    reached = {}
    for period in (0.05, 0.2):
        monitor = seen_all_around(wall(1.4))
        for step in range(4):
            monitor.add_scan(scan_of(wall(1.4), HERE, step * period))
            verdict = monitor.filter(step * period, HERE, (0.0, 0.0), (2.0, 0.0))
        assert monitor.silence == pytest.approx(0.1 if period == 0.05 else 0.15)
        reached[period] = verdict.command[0]
    assert reached[0.2] * 0.2 + reached[0.2] ** 2 / 3.8 == pytest.approx(
        reached[0.05] * 0.15 + reached[0.05] ** 2 / 3.8, abs=0.06
    )
    monitor.braked(1.0, 2.0, (2.0, 0.0))
    assert monitor.silence == pytest.approx(0.15)
    monitor.braked(1.05, 2.0, (1.0, 0.0))
    assert monitor.silence == pytest.approx(0.1)


def test_the_swept_area_of_a_turn_about_a_point_far_ahead_counts():
    """The base turns three times as fast as commanded about a point .5 m ahead, so that a rear corner reaches .7 m."""
    changed = replace(SETTINGS, turn_gain=3.0, turn_ahead=0.5)
    assert seen_all_around([(0.17, -0.7)], changed).filter(0.0, HERE, (0.0, 0.0), (0.0, 1.0)).action == SLOW
    assert seen_all_around([(0.17, -2.0)], changed).filter(0.0, HERE, (0.0, 0.0), (0.0, 1.0)).action == PASS


def test_a_braking_base_may_leave_its_turn_outwards():
    """In a steady left turn, a post straight ahead is outside the paths of the commanded turn and of a faster turn."""
    planes, turning, post = half_planes(SETTINGS.body), (1.0, 1.5), np.array([[0.65, -0.2]])
    rest = (planes, 0.03, turning, turning, (0.0, 0.15), (1.9, 3.3), EVERYTHING, (1.5, 1.35, 0.13, 0.0))
    assert 0.0 < safe_scale(post, *rest)[0] < 1.0
    assert safe_scale(post - np.array([[0.0, 0.1]]), *rest)[0] == 1.0


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_the_outline_may_swing_at_the_end_of_a_stop(side):
    """A stop from .3 m/s or more may swing the body by .15 rad, and a rear corner by .05 m. Slower stops swing less."""
    planes, free = half_planes(SETTINGS.body), {}
    for speed in (0.15, 0.3, 0.6):
        for gap in np.arange(0.032, 0.07, 0.002):
            post = np.array([[x, side * (0.208 + gap)] for x in np.arange(-0.3, 0.8, 0.01)])  # rail beside the path
            rest = (planes, 0.03, (speed, 0.0), (speed, 0.0), (0.0, 0.1), (1.9, 3.3), EVERYTHING)
            if safe_scale(post, *rest, (0.0, 1.0, 0.13, 0.0))[0] == 1.0:
                free[speed] = gap
                break
    swung = 0.359 * math.sin(0.15) - 0.208 * (1.0 - math.cos(0.15))
    assert free[0.3] == pytest.approx(free[0.6], abs=0.003) == pytest.approx(swung, abs=0.006)
    assert free[0.15] < 0.04


numbers = st.floats(-2.0, 2.0).map(lambda number: round(number, 4))


def test_a_stop_in_a_turn_follows_its_arc_to_the_end():
    """Neither a command nor odometry arrives, so that the current turn rate is unknown."""
    monitor, speed = CollisionMonitor(), 1.0
    monitor.filter(0.0, HERE, (1.0, 1.35 * 1.5), (1.0, 1.5))
    monitor.braked(0.0, 1.0, (1.0, 1.5))
    for step in range(1, 10):
        v, w = monitor.braked(0.05 * step, speed)
        assert w == pytest.approx(1.5 * v), step
        speed = v
    assert v < 0.2


@examples(60)
@example([(1.0, 0.0, 1.0), *[(0.0, 0.0, 1.0)] * 3, (1.0, 1.0, 1.0), (0.0, 0.0, 1.0)])  # constant odometry
@given(st.lists(st.tuples(numbers, numbers, st.floats(0.3, 3.0)), min_size=2, max_size=6))
def test_every_output_stays_on_the_arc_of_this_or_the_previous_command(commands):
    """A braking base may also turn less, or keep its turn rate."""
    monitor, before = CollisionMonitor(), (0.0, 0.0)
    for step, (v, w, distance) in enumerate(commands):
        now, turning = 0.05 * step, SETTINGS.turn_gain * before[1]
        monitor.add_scan(scan_of(wall(distance), HERE, now))
        verdict = monitor.filter(now, HERE, (before[0], turning), (v, w))
        given_v, given_w = verdict.command
        if verdict.action == STOP:
            arc = before[1] * given_v / before[0] if before[0] else 0.0
            soon = before[1] + min(max(arc - before[1], -0.33), 0.33)
            assert min(abs(given_w - arc), abs(given_w - soon)) < 1e-9, (verdict, before)
        elif (
            verdict.action == SLOW and given_v * v > 0.0 and abs(given_w) < max(abs(before[1]), abs(verdict.scale * w))
        ):
            arc = w * given_v / v
            assert min(arc, before[1], 0.0) - 1e-9 <= given_w <= max(arc, before[1], 0.0) + 1e-9, (verdict, before)
            if abs(arc - before[1]) < 0.33:
                assert given_w == pytest.approx(arc, abs=1e-9), (verdict, before)
        before = verdict.command


@pytest.mark.parametrize("radius", [0.02, 0.1], ids=["4 cm", "20 cm"])
@pytest.mark.parametrize("forgets", ["time", "distance", "capacity"])
def test_forgotten_points_become_unknown_space(radius, forgets, monkeypatch):
    """The robot turns away from an observed post. Once it has forgotten the post, it may creep there."""
    if forgets == "capacity":
        monkeypatch.setattr("applr_ros1.monitor.known_space.CAPACITY_POINTS", 1500)
    monitor, post = CollisionMonitor(), np.array([-0.65, 0.0])
    edge = [post + radius * np.array([math.cos(a), math.sin(a)]) for a in np.arange(-1.4, 1.41, 0.1)]
    for stamp, yaw in ((0.0, math.pi), (0.1, 0.0)):
        ranges = scan_of(edge, (0.0, 0.0, yaw), stamp).ranges
        monitor.add_scan(scan_of([], (0.0, 0.0, yaw), stamp, ranges=np.minimum(ranges, np.float32(9.0 + stamp))))
    back = (-1.0, 0.0)
    kept = monitor.filter(0.1, HERE, (0.0, 0.0), back)
    assert "obstacle" in kept.reason
    cell = tuple(np.floor(edge[len(edge) // 2] / CELL_M).astype(int) % len(monitor.seen.cells))
    assert monitor.seen.cells[cell] == 1
    stamp, noise = 0.1, np.random.default_rng(0)
    # The robot waits, or drives 9 m away and back, or observes too many points. Identical scans would count as frozen.
    places = {"time": [0.0] * 4, "distance": [*np.arange(0.0, 9.1, 0.3), *np.arange(9.0, -0.1, -0.3)]}
    for x in places.get(forgets, [0.0] * 6):
        stamp += 100.0 if forgets == "time" else 0.1
        far = (9.0 - 10.0 * stamp if forgets == "capacity" else 8.0) * np.ones(BEAMS)  # Nearer points occlude old ones.
        ranges = (far + noise.normal(0.0, 0.003, BEAMS)).astype(np.float32)
        monitor.matcher.clear()  # The synthetic ranges fit no room.
        assert monitor.add_scan(scan_of([], (float(x), 0.0, 0.0), stamp, ranges=ranges)) == ""
    assert not len(monitor.memory.around(HERE, 0.6)), "the post is still remembered"
    assert monitor.seen.cells[cell] == 0
    verdict = monitor.filter(stamp, HERE, (0.0, 0.0), back)
    assert verdict.action == SLOW
    assert "creeping" in monitor.filter(stamp, (-0.2, 0.0, 0.0), (0.0, 0.0), back).reason


@pytest.mark.parametrize(("beams", "range_max"), [(BEAMS, 3.5), (181, 30.0)], ids=["too far", "too thin"])
def test_points_are_cleared_only_from_a_distance_at_which_they_are_visible(beams, range_max):
    memory, left = ObstacleMemory(), []
    for stamp, x in enumerate((0.0, -4.0, 0.5)):
        ranges = np.full(beams, np.inf, np.float32)
        ranges[beams // 2 - 1 : beams // 2 + 1] = np.inf if stamp else 0.9
        geometry = dict(angle_increment=2 * ANGLE / (beams - 1), range_max=range_max)
        memory.update(scan_of([], (x, 0.0, 0.0), float(stamp), ranges=ranges, **geometry))
        left.append(len(memory.points))
    assert left[0] == left[1] > 0 == left[2]


@pytest.mark.parametrize(("range_max", "radius"), [(0.2, 8.0), (1.0, 8.0), (30.0, 1.0)])
def test_space_is_observed_within_the_range_of_scanner_and_memory(range_max, radius):
    monitor = CollisionMonitor(replace(SETTINGS, memory_radius=radius))
    monitor.add_scan(scan_of(wall(1.6), HERE, range_max=range_max))
    assert monitor.filter(0.0, HERE, (0.0, 0.0), (1.5, 0.0)).action == SLOW


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_a_post_in_the_path_of_lateral_slip_limits_the_command(side):
    """At 1 m/s forward and .6 m/s of lateral slip the body touches a post that it would pass without slip."""
    points, planes = np.array([[0.5, side * (0.208 + 0.06)]]), half_planes(SETTINGS.body)
    rest = (points, planes, 0.03, (1.0, 0.0), (1.0, 0.0), (0.0, 0.15), (1.9, 3.3), EVERYTHING)
    assert safe_scale(*rest, (0.0, 1.0, 0.0, 0.0))[0] == 1.0
    assert safe_scale(*rest, (0.0, 1.0, 0.0, side * 0.6))[0] < 1.0
    assert safe_scale(*rest, (0.0, 1.0, 0.0, -side * 0.6))[0] == 1.0


def test_turn_ahead_and_turn_gain_change_the_swept_area():
    """In a left turn about a point ahead the body moves right, to a post outside its circumscribed circle."""
    planes, command = half_planes(SETTINGS.body), (0.0, 1.5)
    post = np.array([[-0.2, -0.33]])
    args = (post, planes, 0.03, command, command, (0.0, 0.15), (1.9, 3.3), EVERYTHING)
    assert safe_scale(*args, (0.0, 1.0, 0.0, 0.0))[0] == 1.0
    assert safe_scale(*args, (0.0, 1.0, 0.3, 0.0))[0] < 1.0
    wide = (np.array([[0.29, -0.17]]), planes, 0.03, (0.0, 0.0), (0.0, 1.0), (0.0, 0.1), (1.9, 12.0), EVERYTHING)
    assert safe_scale(*wide, (0.0, 3.0, 0.0, 0.0))[0] <= safe_scale(*wide, (0.0, 1.0, 0.0, 0.0))[0]


def test_the_swept_area_of_a_turn_about_a_point_ahead_is_exact():
    """The base turns at 1.5 rad/s about a point .3 m ahead, and stops after .15 s at 3.3 rad/s^2, beside posts."""
    planes, w, ahead = half_planes(SETTINGS.body), 1.5, 0.3
    turned = np.linspace(0.0, 0.15 * w + w**2 / (2 * 3.3), 200)
    front, side = SETTINGS.body[0][0] + 0.03, SETTINGS.body[0][1] + 0.03

    def meets(x, y):  # whether the turning body meets the post
        dx, c, s = x - ahead, np.cos(turned), np.sin(turned)
        px, py = ahead + c * dx + s * y, c * y - s * dx
        return bool(np.any((abs(px) < front) & (abs(py) < side)))

    for x in (-0.15, 0.0, 0.15):
        for y in np.arange(-0.6, -0.25, 0.04):
            if meets(x, y - 0.012) == meets(x, y + 0.012):  # skips posts exactly on the edge
                arguments = (np.array([[x, y]]), planes, 0.03, (0.0, w), (0.0, w), (0.0, 0.15), (1.9, 3.3), EVERYTHING)
                free = safe_scale(*arguments, (0.0, 1.0, ahead, 0.0))[0] == 1.0
                assert free != meets(x, y), (x, y)


def test_poses_give_forward_lateral_and_turn_velocity():
    motion, yaw = PoseMotion(), 0.0
    for step in range(10):
        stamp, yaw = 0.05 * step, math.pi / 2 + 0.3 * 0.05 * step
        motion.take(stamp, (-0.2 * stamp, 1.5 * stamp, yaw))  # The base heads along +y, so its left is -x.
    v, w, s = motion.velocity
    assert (v, w) == pytest.approx((1.5, 0.3), abs=0.06)
    assert s == pytest.approx(0.2 - 1.5 * 0.3 * 0.325, abs=0.06), "the heading has turned by .1 rad meanwhile"
    assert motion.contradicts((-1.5, 0.3))
    assert motion.contradicts((0.3, 0.3))
    assert not motion.contradicts((1.6, 0.3))
    for step in range(1, 6):  # The base stops at once, and stands for a quarter of a second.
        motion.take(stamp + 0.0501 * step, (-0.2 * stamp, 1.5 * stamp, yaw))
    assert motion.velocity == pytest.approx((0.0, 0.0, 0.0), abs=1e-9)
    motion.take(0.1, HERE)  # The clock was set back.
    assert motion.velocity == (0.0, 0.0, 0.0)


@pytest.mark.parametrize(("reported", "action"), [(-2.0, STOP), (0.3, STOP), (2.0, STOP)])
def test_a_measured_velocity_that_poses_contradict_does_not_hide_the_wall(reported, action):
    """The poses show 2 m/s, .9 m before a wall, while the odometry's twist is -2, .3 or 2 m/s."""
    monitor = CollisionMonitor(replace(SETTINGS, deceleration=1.9))
    for step in range(12):
        now, x = 0.05 * step, 0.1 * step
        monitor.add_scan(scan_of(wall(2.2, 2.0), (x, 0.0, 0.0), now))
        verdict = monitor.filter(now, (x, 0.0, 0.0), (reported, 0.0), (2.0, 0.0))
    assert verdict.action == action
    assert reported < 0.0 or verdict.command[0] > 1.0, "the commanded speed falls from that of the poses"


def test_a_base_that_rolls_back_may_reverse_at_once():
    """The command towards a wall is the same for a base that rolls backwards as for a base at rest."""
    commands = []
    for v in (0.0, -0.33):
        monitor = CollisionMonitor()
        monitor.add_scan(scan_of(wall(0.7), HERE, 0.0))
        monitor.seen.cells[:] = 1
        commands.append(monitor.filter(0.0, HERE, (v, 0.0), (2.0, 0.0)).command)
    assert commands[1] == commands[0]
    assert 0.1 < commands[0][0] < 1.0


FLOATS = st.one_of(st.floats(), st.sampled_from([5e-324, -5e-324, -0.0, 1e308, -1e308, math.nan, math.inf, 1e-300]))


@examples(300)
@given(
    st.tuples(FLOATS, FLOATS, FLOATS), st.tuples(FLOATS, FLOATS), st.tuples(FLOATS, FLOATS), st.tuples(FLOATS, FLOATS)
)
def test_no_input_makes_a_command_invalid(pose, twist, command, ages):
    monitor = seen_all_around(wall(3.0))
    monitor.filter(0.0, HERE, (1.0, 0.1), (1.0, 0.1))
    for where, moving, asked in (
        (pose, (1.0, 0.1), (1.0, 0.1)),
        (HERE, twist, (1.0, 0.1)),
        (HERE, (1.0, 0.1), command),
    ):
        verdict = monitor.filter(0.05, where, moving, asked, ages if asked is command else (0.0, 0.0))
        assert all(math.isfinite(value) for value in verdict.command)
        assert all(abs(value) <= limit + 1e-9 for value, limit in zip(verdict.command, monitor.fastest))


@examples(300)
@given(st.lists(FLOATS, min_size=7, max_size=7), st.lists(FLOATS, min_size=3, max_size=12), st.integers(0, 6))
def test_no_input_makes_a_scan_fail(numbers, ranges, field):
    """One field, all fields, or the ranges have arbitrary values. add_scan then returns a fault as text."""
    good = (0.05, -2.0, 0.5, 0.1, 10.0, 0.1, 0.2)
    one = [*good[:field], numbers[field], *good[field + 1 :]]
    for stamp, first, increment, least, most, x, yaw in (one, numbers, good):
        monitor = seen_all_around(wall(3.0))
        with np.errstate(over="ignore"):
            scan = LaserScan(stamp, first, increment, least, most, np.array(ranges, np.float32), (x, 0.0, yaw))
        assert isinstance(monitor.add_scan(scan), str)
        verdict = monitor.filter(0.05, HERE, (0.0, 0.0), (0.5, 0.5))
        assert all(math.isfinite(value) for value in verdict.command)
