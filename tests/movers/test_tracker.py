"""Tests of the moving-obstacle tracker in small scenes, one test per rule: only moving obstacles
are found.
"""

import math
from dataclasses import replace

import numpy as np
import pytest

from applr_ros1 import robots
from applr_ros1.common.angles import compose
from applr_ros1.common.scan import LaserScan
from applr_ros1.movers.tracker import MoverTracker
from applr_ros1.robots import JACKAL
from sim_bridge.lidar import Lidar

BURGER = robots.load("turtlebot3_burger").laser
NARROW = JACKAL.laser.model_copy(
    update=dict(beams=121, first_angle=-0.6, last_angle=0.6, rate=15.0)
)
ROOM = np.array(
    [[0.0, 6.0, 0.0, 12.0, 0.2], [0.0, -6.0, 0.0, 12.0, 0.2], [6.0, 0.0, 0.0, 0.2, 12.0]]
)
PILLARS = np.array(
    [
        [2.0, 1.0, 0.1],
        [3.0, -1.5, 0.15],
        [1.5, -2.5, 0.1],
        [-1.5, 2, 0.2],
        [-2.0, -1.0, 0.1],
        [4, 2, 0.1],
    ]
)
STANDS = np.empty((0, 3))


class Scene:
    """Robot with a laser among cylinders (n, 3) and boxes (m, 5); moving obstacles and poses are
    functions of time.
    """

    def __init__(self, laser=JACKAL.laser, cylinders=STANDS, boxes=ROOM, noise=0.01):
        self.laser = laser
        self.noise = noise
        self.lidar = Lidar(laser, cylinders, boxes)
        self.random = np.random.default_rng(1)
        self.tracker = MoverTracker(2.0, 4.0, 1.0 / laser.rate)

    def scan(self, time, pose=(0.0, 0.0, 0.0), movers=(), believed=None):
        ranges = self.lidar.scan(*pose, np.array(movers, dtype=float).reshape(-1, 3))
        ranges += self.random.normal(0.0, self.noise, len(ranges)).astype(np.float32)
        laser = self.laser
        limits = laser.first_angle, laser.increment, laser.range_min, laser.range_max
        return LaserScan(time, *limits, ranges, pose if believed is None else believed)

    def watch(
        self,
        seconds,
        pose=lambda t: (0, 0, 0),
        movers=lambda t: (),
        believed=None,
        seen=lambda scan: scan,
    ):
        """Return [(time, Movers)] for all scans within `seconds`."""
        result = []
        for t in np.arange(0.0, seconds, 1.0 / min(self.laser.rate, 20.0)).tolist():
            scan = self.scan(t, pose(t), movers(t), None if believed is None else believed(t))
            result.append((t, self.tracker.update(seen(scan))))
        return result


def counts(result):
    return [len(movers.id) for _, movers in result]


def reverse(scan):
    """Return a scan with its beams in reverse order."""
    last = scan.angle_min + scan.angle_increment * (len(scan.ranges) - 1)
    return replace(
        scan, angle_min=last, angle_increment=-scan.angle_increment, ranges=scan.ranges[::-1]
    )


def vary(scan):
    """Return a scan of a spinning laser whose number of beams varies."""
    less = int(scan.stamp * 5.0) % 3
    return replace(scan, ranges=scan.ranges[: len(scan.ranges) - less])


@pytest.mark.parametrize(("laser", "seen"), [
    (JACKAL.laser, lambda scan: scan), (BURGER, lambda scan: scan), (NARROW, lambda scan: scan),
    (JACKAL.laser, reverse), (BURGER, vary),
])  # fmt: skip
@pytest.mark.parametrize("velocity", [(0.0, 1.0), (1.0, 0.0), (-1.0, 0.0)])
def test_a_moving_obstacle_is_detected_soon_with_its_velocity(laser, seen, velocity):
    """The obstacle crosses, leaves or approaches, for any kind of laser."""
    vx, vy = velocity
    start = 2.4 - vx, -vy
    place = lambda t: (start[0] + vx * t, start[1] + vy * t)  # noqa: E731
    result = Scene(laser).watch(1.9, movers=lambda t: [(*place(t), 0.3)], seen=seen)
    known = [(t, movers) for t, movers in result if len(movers.id)]
    assert known[0][0] <= 0.65
    assert max(counts(result)) == 1
    assert len({int(movers.id[0]) for _, movers in known}) == 1
    t, last = known[-1]
    assert t == result[-1][0]
    assert math.hypot(last.x[0] - place(t)[0], last.y[0] - place(t)[1]) < 0.12
    assert math.hypot(last.vx[0] - vx, last.vy[0] - vy) < 0.25
    assert last.radius[0] == pytest.approx(0.3, abs=0.08)


@pytest.mark.parametrize(("x", "known"), [(7.0, True), (8.5, False)])
def test_obstacles_beyond_eight_metres_are_not_tracked(x, known):
    assert (
        any(counts(Scene(boxes=np.empty((0, 5))).watch(1.5, movers=lambda t: [(x, t - 1.0, 0.3)])))
        == known
    )


@pytest.mark.parametrize("rate", [1.5, -3.0])
def test_turning_causes_no_false_detections(rate):
    """Stamps of scans and poses differ by 30 ms, which matters at the beginning and end of a turn."""
    turn = lambda t: rate * max(0.0, min(t, 2.0) - 0.5)  # noqa: E731
    for laser in (JACKAL.laser, BURGER):
        scene = Scene(laser, PILLARS)
        result = scene.watch(
            3.0, lambda t: (0, 0, turn(t)), believed=lambda t: (0, 0, turn(t - 0.03))
        )
        assert sum(counts(result)) == 0


@pytest.mark.parametrize("rate", [0.6, 1.5])
def test_a_slowly_spinning_laser_causes_no_false_detections(rate):
    """The beams of the TurtleBot3 burger are measured one after the other in 0.2 s, but its driver
    reports 10 ms.
    """
    scene = Scene(
        BURGER, np.vstack([PILLARS, [[0.5, -2.0, 0.2], [-0.8, 1.2, 0.1], [-2.5, 1.0, 0.15]]])
    )
    parts = 20
    turn = lambda t: rate * max(0.0, min(t, 5.0) - 0.5)  # noqa: E731
    for t in np.arange(0.0, 6.0, 0.2).tolist():
        whole = replace(scene.scan(t, (0.0, 0.0, turn(t))), sweep=0.01)
        for part in range(parts):
            then = t + 0.2 * part / parts
            beams = slice(part * BURGER.beams // parts, (part + 1) * BURGER.beams // parts)
            whole.ranges[beams] = scene.scan(then, (0.0, 0.0, turn(then))).ranges[beams]
        assert len(scene.tracker.update(whole).id) == 0


def test_an_obstacle_without_evidence_for_a_second_is_no_longer_moving():
    """From 2 s on the robot turns so fast that the scans of a spinning laser are distorted."""
    turns = lambda t: (0.0, 0.0, 1.5 * max(0.0, t - 2.0))  # noqa: E731
    spins = lambda scan: replace(scan, sweep=0.01)  # noqa: E731
    numbers = counts(
        Scene(BURGER).watch(4.0, turns, lambda t: [(2.4, 0.8 * t - 1.6, 0.3)], seen=spins)
    )
    assert numbers[10:15] == [1] * 5
    assert sum(numbers[16:]) == 0


def test_a_wall_seen_from_a_new_angle_is_static():
    """As the robot drives, the wall's visible part moves along behind a box, and other obstacles
    come into view.
    """
    boxes = np.array(
        [
            [2.0, 1.0, 0.0, 1.0, 0.4],
            [3, 2.5, 0.3, 0.5, 0.4],
            [4, 2.2, 0, 0.4, 0.3],
            [5, 3, 1, 1, 0.1],
        ]
    )
    posts = np.array([[2.4, 1.8, 0.1], [3.5, 1.7, 0.15], [1.6, 2.2, 0.2]])
    for laser in (JACKAL.laser, BURGER):
        scene = Scene(laser, posts, boxes)
        assert sum(counts(scene.watch(3.0, lambda t: (1.5 * t, 0.0, 0.0)))) == 0


def test_slipping_wheels_cause_no_false_detections():
    """Static obstacles seem to move together, and a moving obstacle is still tracked with its
    velocity in the world.
    """
    for laser, rate in ((JACKAL.laser, 0.6), (JACKAL.laser, 2.0), (BURGER, 0.6)):
        spins = lambda t, rate=rate: (rate * max(0.0, t - 0.5), 0.0, 0.0)  # noqa: E731
        assert sum(counts(Scene(laser, PILLARS).watch(2.0, believed=spins))) == 0
    slips = lambda t: (0.6 * max(0.0, t - 0.5), 0.0, 0.0)  # noqa: E731
    scene = Scene(cylinders=PILLARS)
    result = scene.watch(1.6, believed=slips, movers=lambda t: [(2.8, -0.8 + t, 0.3)])
    assert counts(result)[-1] == 1
    t, last = result[-1]
    assert (last.vx[0], last.vy[0]) == pytest.approx((0.0, 1.0), abs=0.15)
    assert (last.x[0], last.y[0]) == pytest.approx((2.8 + slips(t)[0], -0.8 + t), abs=0.1)
    turns = lambda t: (0.0, 0.0, 0.2 * max(0.0, t - 0.5))  # noqa: E731
    t, last = Scene(cylinders=PILLARS).watch(
        2.4, believed=turns, movers=lambda t: [(2.8, -0.8 + t, 0.3)]
    )[-1]
    assert (last.vx[0], last.vy[0]) == pytest.approx(
        compose(turns(t), (0.0, 1.0, 0.0))[:2], abs=0.15
    )
    assert (last.x[0], last.y[0]) == pytest.approx(
        compose(turns(t), (2.8, -0.8 + t, 0.0))[:2], abs=0.1
    )


@pytest.mark.parametrize("code", [np.inf, np.nan, -np.inf, 0.0])
def test_failing_beams_cause_no_false_detections(code):
    """Random single beams fail, and sometimes a sector. Some posts are so thin that beams sometimes
    miss them.
    """
    random = np.random.default_rng(2)
    thin = np.array([[2.0 + 0.4 * i, -1.5 + 0.6 * i, 0.012] for i in range(6)])

    def fail(scan):
        ranges = np.where(random.random(len(scan.ranges)) < 0.1, np.float32(code), scan.ranges)
        if scan.stamp % 0.5 < 0.2:
            ranges[len(ranges) // 3 : len(ranges) // 2] = code
        return replace(scan, ranges=ranges.astype(np.float32))

    for laser in (JACKAL.laser, BURGER):
        scene = Scene(laser, np.vstack([PILLARS, thin]))
        assert (
            sum(counts(scene.watch(4.0, lambda t: (0.2 * t, 0.0, 0.5 * math.sin(t)), seen=fail)))
            == 0
        )


def test_an_occluded_obstacle_is_extrapolated_and_then_forgotten():
    """The obstacle passes behind a wall. A track whose predicted position is visibly free ends at
    once.
    """
    wall = np.array([[1.5, 2.0, 0.0, 0.2, 3.0]])
    crosses = lambda t: [(2.5, -1.2 + 1.2 * t, 0.25)]  # noqa: E731
    result = Scene(boxes=wall).watch(4.0, movers=crosses)
    times = [t for t, movers in result if len(movers.id)]
    assert 0.8 <= max(times) - 1.5 <= 1.2, "the obstacle is out of sight after about 1.5 s"
    t, movers = next((t, movers) for t, movers in reversed(result) if len(movers.id))
    assert (movers.x[0], movers.y[0]) == pytest.approx((2.5, -1.2 + 1.2 * t), abs=0.3)
    result = Scene(boxes=wall).watch(2.0, movers=lambda t: crosses(t) if t < 1.0 else ())
    assert counts(result)[19] == 1
    assert sum(counts(result)[23:]) == 0


def test_obstacles_that_stop_are_dropped_and_obstacles_that_start_are_detected():
    waits = lambda t: [(2.0, max(0.0, min(t, 3.0) - 1.5), 0.3)]  # noqa: E731
    result = Scene().watch(5.0, movers=waits)
    numbers = counts(result)
    assert sum(numbers[:31]) == 0
    assert all(numbers[42:60])
    assert sum(numbers[72:]) == 0


def test_an_obstacle_that_turns_back_keeps_its_number():
    result = Scene().watch(3.2, movers=lambda t: [(2.4, 0.8 - abs(t - 1.8), 0.3)])
    assert {number for _, movers in result for number in movers.id.tolist()} == {1}


def test_older_scans_are_ignored_and_jumps_restart_the_tracker():
    scene = Scene()
    moving = lambda t: [(2.4, -1.0 + t, 0.3)]  # noqa: E731
    (t, known) = scene.watch(1.0, movers=moving)[-1]
    for stamp in (t, t - 0.1):
        again = scene.tracker.update(scene.scan(stamp, movers=()))
        assert again.id.tolist() == known.id.tolist()
        assert again.x.tolist() == known.x.tolist()
    tilted = replace(scene.scan(t + 0.05, movers=()), rotation=(0.0, 0.2, 0.0, 0.98))
    assert scene.tracker.update(tilted).x.tolist() == known.x.tolist()
    for stamp, pose in (
        (t + 5.0, (0, 0, 0)),
        (t - 5.0, (0, 0, 0)),
        (t + 0.05, (3, 0, 0)),
        (t + 0.05, (0, 0, 2)),
    ):
        scene = Scene()
        scene.watch(1.0, movers=moving)
        assert (
            len(scene.tracker.update(scene.scan(stamp, movers=moving(t), believed=pose)).id) == 0
        ), (stamp, pose)
    scene = Scene()
    scene.watch(1.0, movers=moving)
    scene.tracker.reset()
    assert len(scene.tracker.update(scene.scan(t + 0.05, movers=moving(t))).id) == 0


def test_positions_are_in_the_odometry_frame():
    """The laser drives and turns in a frame far from its origin."""
    frame = (40.0, -30.0, 2.0)
    scene = Scene(cylinders=PILLARS)
    mover = lambda t: (2.5, -1.0 + t, 0.3)  # noqa: E731
    pose = lambda t: (0.5 * t, 0.0, 0.3 * t)  # noqa: E731
    t, last = scene.watch(1.5, pose, lambda t: [mover(t)], lambda t: compose(frame, pose(t)))[-1]
    assert (last.x[0], last.y[0]) == pytest.approx(
        compose(frame, (*mover(t)[:2], 0.0))[:2], abs=0.1
    )
    assert (last.vx[0], last.vy[0]) == pytest.approx((-math.sin(2.0), math.cos(2.0)), abs=0.2)
