"""Tests of the moving-obstacle tracker in small scenes, one test per rule: only moving obstacles
are found.
"""

import math
from dataclasses import replace

import numpy as np
import pytest

from applr_ros1 import robots
from applr_ros1.common.angles import compose, inverse
from applr_ros1.movers.tracker import MoverTracker
from applr_ros1.movers.tracks import CERTAIN_M_S
from applr_ros1.robots import JACKAL
from sim_bridge.lidar import Lidar
from tests.support.robots import scan_by

BURGER = robots.load("turtlebot3_burger").laser
NARROW = JACKAL.laser.model_copy(
    update=dict(beams=121, first_angle=-0.6, last_angle=0.6, rate=15.0)
)
# Walls 6 m to the left, to the right and ahead: x, y, yaw, length, thickness [m, rad]
ROOM = np.array(
    [
        [0.0, 6.0, 0.0, 12.0, 0.2],
        [0.0, -6.0, 0.0, 12.0, 0.2],
        [6.0, 0.0, 0.0, 0.2, 12.0],
    ]
)
# x, y, radius [m]
PILLARS = np.array(
    [
        [2.0, 1.0, 0.1],
        [3.0, -1.5, 0.15],
        [1.5, -2.5, 0.1],
        [-1.5, 2.0, 0.2],
        [-2.0, -1.0, 0.1],
        [4.0, 2.0, 0.1],
    ]
)
NO_CYLINDERS = np.empty((0, 3))
ORIGIN = (0.0, 0.0, 0.0)


class Scene:
    """Robot with a laser among cylinders (n, 3) and boxes (m, 5); moving obstacles and poses are
    functions of time.
    """

    def __init__(self, laser=JACKAL.laser, cylinders=NO_CYLINDERS, boxes=ROOM, noise=0.01):
        self.laser = laser
        self.noise = noise
        self.lidar = Lidar(laser, cylinders, boxes)
        self.random = np.random.default_rng(1)
        self.tracker = MoverTracker(2.0, 4.0, 1.0 / laser.rate)

    def scan(self, time, pose=ORIGIN, movers=(), believed=None):
        """Return a scan at a true pose, as it is seen from the pose of the odometry, `believed`."""
        circles = np.array(movers, dtype=float).reshape(-1, 3)
        ranges = self.lidar.scan(*pose, circles)
        errors = self.random.normal(0.0, self.noise, len(ranges))
        ranges += errors.astype(np.float32)
        return scan_by(self.laser, time, ranges, pose if believed is None else believed)

    def watch(
        self,
        seconds,
        pose=lambda time: ORIGIN,
        movers=lambda time: (),
        believed=None,
        distort=lambda scan: scan,
    ):
        """Return [(time, Movers)] for all scans within `seconds`."""
        watched = []
        # At most 20 Hz: no rule needs more, and the Jackal's laser scans at 50 Hz.
        period = 1.0 / min(self.laser.rate, 20.0)
        for time in np.arange(0.0, seconds, period).tolist():
            odometry_pose = believed(time) if believed else pose(time)
            scan = self.scan(time, pose(time), movers(time), odometry_pose)
            watched.append((time, self.tracker.update(distort(scan))))
        return watched


def ids_of(watched):
    """Return the set of all numbers that moving obstacles had."""
    ids = set()
    for _, movers in watched:
        ids.update(movers.id.tolist())
    return ids


def counts(watched):
    """Return the number of moving obstacles after each scan."""
    return [len(movers.id) for _, movers in watched]


def times_with_movers(watched):
    """Return the times of the scans after which a moving obstacle is known."""
    return [time for time, movers in watched if len(movers.id)]


def place_of(movers):
    """Return the position (x, y) [m] of the first moving obstacle."""
    return movers.x[0], movers.y[0]


def velocity_of(movers):
    """Return the velocity (vx, vy) [m/s] of the first moving obstacle."""
    return movers.vx[0], movers.vy[0]


def as_measured(scan):
    """Return a scan as it is."""
    return scan


def reverse(scan):
    """Return a scan with its beams in reverse order."""
    last_angle = scan.angle_min + scan.angle_increment * (len(scan.ranges) - 1)
    return replace(
        scan,
        angle_min=last_angle,
        angle_increment=-scan.angle_increment,
        ranges=scan.ranges[::-1],
    )


def vary(scan):
    """Return a scan of a spinning laser whose number of beams varies."""
    # The laser scans at 5 Hz: by turns, a scan has all beams, one less and two less.
    beam_count = len(scan.ranges) - int(scan.stamp * 5.0) % 3
    return replace(scan, ranges=scan.ranges[:beam_count])


@pytest.mark.parametrize(
    ("laser", "distort"),
    [
        pytest.param(JACKAL.laser, as_measured, id="jackal"),
        pytest.param(BURGER, as_measured, id="burger"),
        pytest.param(NARROW, as_measured, id="narrow"),
        pytest.param(JACKAL.laser, reverse, id="clockwise"),
        pytest.param(BURGER, vary, id="beams vary"),
    ],
)
@pytest.mark.parametrize("velocity", [(0.0, 1.0), (1.0, 0.0), (-1.0, 0.0)])
def test_a_moving_obstacle_is_detected_soon_with_its_velocity(laser, distort, velocity):
    """The obstacle crosses, leaves or approaches, for any kind of laser."""
    vx, vy = velocity

    def place(time):
        """The obstacle is 2.4 m ahead after one second."""
        return 2.4 + vx * (time - 1.0), vy * (time - 1.0)

    def mover(time):
        return [(*place(time), 0.3)]

    watched = Scene(laser).watch(1.9, movers=mover, distort=distort)

    # It is found within .65 s, once, and keeps its number up to the end.
    assert times_with_movers(watched)[0] <= 0.65
    assert max(counts(watched)) == 1
    assert len(ids_of(watched)) == 1
    time, last_movers = watched[-1]
    assert times_with_movers(watched)[-1] == time
    assert math.dist(place_of(last_movers), place(time)) < 0.12
    assert math.dist(velocity_of(last_movers), velocity) < 0.25
    assert last_movers.radius[0] == pytest.approx(0.3, abs=0.08)


@pytest.mark.parametrize(("x", "is_tracked"), [(7.0, True), (8.5, False)])
def test_obstacles_beyond_eight_metres_are_not_tracked(x, is_tracked):
    scene = Scene(boxes=np.empty((0, 5)))
    watched = scene.watch(1.5, movers=lambda time: [(x, time - 1.0, 0.3)])
    assert any(counts(watched)) == is_tracked


@pytest.mark.parametrize("rate", [1.5, -3.0])
@pytest.mark.parametrize("laser", [JACKAL.laser, BURGER], ids=["jackal", "burger"])
def test_turning_causes_no_false_detections(laser, rate):
    """Stamps of scans and poses differ by 30 ms, which matters at the beginning and end of a
    turn.
    """

    def pose(time):
        turning_time = max(0.0, min(time, 2.0) - 0.5)
        return 0.0, 0.0, rate * turning_time

    def late_pose(time):
        return pose(time - 0.03)

    watched = Scene(laser, PILLARS).watch(3.0, pose, believed=late_pose)
    assert sum(counts(watched)) == 0


@pytest.mark.parametrize("rate", [0.6, 1.5])
def test_a_slowly_spinning_laser_causes_no_false_detections(rate):
    """The beams of the TurtleBot3 burger are measured one after the other in 0.2 s, but its driver
    reports 10 ms.
    """
    near_pillars = [
        [0.5, -2.0, 0.2],
        [-0.8, 1.2, 0.1],
        [-2.5, 1.0, 0.15],
    ]
    scene = Scene(BURGER, np.vstack([PILLARS, near_pillars]))
    part_count = 20

    def pose(time):
        turning_time = max(0.0, min(time, 5.0) - 0.5)
        return 0.0, 0.0, rate * turning_time

    for time in np.arange(0.0, 6.0, 0.2).tolist():
        whole = replace(scene.scan(time, pose(time)), sweep=0.01)
        # Each part of the beams comes from the pose at its own time.
        for part in range(part_count):
            first_beam = part * BURGER.beams // part_count
            end_beam = (part + 1) * BURGER.beams // part_count
            part_time = time + 0.2 * part / part_count
            scan = scene.scan(time, pose(part_time))
            whole.ranges[first_beam:end_beam] = scan.ranges[first_beam:end_beam]
        assert len(scene.tracker.update(whole).id) == 0


def test_an_obstacle_without_evidence_for_a_second_is_no_longer_moving():
    """From 2 s on the robot turns so fast that the scans of a spinning laser are distorted."""

    def pose(time):
        return 0.0, 0.0, 1.5 * max(0.0, time - 2.0)

    def crosses(time):
        return [(2.4, 0.8 * time - 1.6, 0.3)]

    def spins(scan):
        return replace(scan, sweep=0.01)

    # Scans come at 5 Hz: the turn begins at row 10.
    mover_counts = counts(Scene(BURGER).watch(4.0, pose, crosses, distort=spins))
    assert mover_counts[10:15] == [1] * 5
    assert sum(mover_counts[16:]) == 0


def test_a_wall_seen_from_a_new_angle_is_static():
    """As the robot drives, the wall's visible part moves along behind a box, and other obstacles
    come into view.
    """
    boxes = np.array(
        [
            [2.0, 1.0, 0.0, 1.0, 0.4],
            [3.0, 2.5, 0.3, 0.5, 0.4],
            [4.0, 2.2, 0.0, 0.4, 0.3],
            [5.0, 3.0, 1.0, 1.0, 0.1],
        ]
    )
    posts = np.array(
        [
            [2.4, 1.8, 0.1],
            [3.5, 1.7, 0.15],
            [1.6, 2.2, 0.2],
        ]
    )

    def drives_ahead(time):
        return 1.5 * time, 0.0, 0.0

    for laser in (JACKAL.laser, BURGER):
        watched = Scene(laser, posts, boxes).watch(3.0, drives_ahead)
        assert sum(counts(watched)) == 0


@pytest.mark.parametrize(
    ("laser", "speed"),
    [
        pytest.param(JACKAL.laser, 0.6, id="jackal"),
        pytest.param(JACKAL.laser, 2.0, id="jackal, fast"),
        pytest.param(BURGER, 0.6, id="burger"),
    ],
)
def test_slipping_wheels_cause_no_false_detections(laser, speed):
    """Static obstacles seem to move together."""

    def slips(time):
        return speed * max(0.0, time - 0.5), 0.0, 0.0

    watched = Scene(laser, PILLARS).watch(2.0, believed=slips)
    assert sum(counts(watched)) == 0


@pytest.mark.parametrize(
    ("speed", "turn_rate", "seconds"),
    [
        pytest.param(0.6, 0.0, 1.6, id="ahead"),
        pytest.param(0.0, 0.2, 2.4, id="turning"),
    ],
)
@pytest.mark.parametrize("is_known", [False, True])
def test_slipping_wheels_leave_a_moving_obstacle_its_velocity(speed, turn_rate, seconds, is_known):
    """Pillars show the slip, or it is known beforehand up to the last scan."""

    def slips(time):
        slipping_time = max(0.0, time - 0.5)
        return speed * slipping_time, 0.0, turn_rate * slipping_time

    def crosses(time):
        return [(2.8, -0.8 + time, 0.3)]

    scene = Scene(cylinders=NO_CYLINDERS if is_known else PILLARS)

    def corrects(scan):
        if is_known:
            scene.tracker.frame = inverse(slips(scan.stamp - 0.05))
        return scan

    watched = scene.watch(seconds, believed=slips, movers=crosses, distort=corrects)
    assert counts(watched)[-1] == 1

    # Place and velocity are those in the world, in the frame of the slipping odometry.
    time, last_movers = watched[-1]
    _, _, yaw = slips(time)
    velocity = compose((0.0, 0.0, yaw), (0.0, 1.0, 0.0))[:2]
    place = compose(slips(time), (2.8, -0.8 + time, 0.0))[:2]
    assert velocity_of(last_movers) == pytest.approx(velocity, abs=0.15)
    assert place_of(last_movers) == pytest.approx(place, abs=0.1)


@pytest.mark.parametrize("code", [np.inf, np.nan, -np.inf, 0.0])
def test_failing_beams_cause_no_false_detections(code):
    """Random single beams fail, and sometimes a sector. Some posts are so thin that beams sometimes
    miss them.
    """
    rng = np.random.default_rng(2)
    number = np.arange(6)
    thin_posts = np.column_stack(
        [
            2.0 + 0.4 * number,
            -1.5 + 0.6 * number,
            np.full(6, 0.012),
        ]
    )

    def fail(scan):
        beam_count = len(scan.ranges)
        fails = rng.random(beam_count) < 0.1
        ranges = np.where(fails, np.float32(code), scan.ranges)
        # A sector fails in 0.2 s of every 0.5 s.
        if scan.stamp % 0.5 < 0.2:
            ranges[beam_count // 3 : beam_count // 2] = code
        return replace(scan, ranges=ranges.astype(np.float32))

    def pose(time):
        return 0.2 * time, 0.0, 0.5 * math.sin(time)

    posts = np.vstack([PILLARS, thin_posts])
    for laser in (JACKAL.laser, BURGER):
        watched = Scene(laser, posts).watch(4.0, pose, distort=fail)
        assert sum(counts(watched)) == 0


def test_an_occluded_obstacle_is_extrapolated_and_then_forgotten():
    """The obstacle passes behind a wall with a gap. A track whose predicted position is visibly
    free ends at once.
    """
    # As seen from the origin, it hides the way from y = 0.5 to 1.7 m, and from 2.1 m on.
    wall = np.array([[1.5, 0.65, 0.0, 0.2, 0.7], [1.5, 2.4, 0.0, 0.2, 2.3]])

    def crosses(time):
        return [(2.5, -1.2 + 1.2 * time, 0.25)]

    watched = Scene(boxes=wall).watch(4.0, movers=crosses)
    known = [movers for _, movers in watched if len(movers.id)]
    deviations = [math.sqrt(movers.covariance[0, 2]) for movers in known]
    assert deviations[0] <= CERTAIN_M_S < deviations[-1], "no longer measured"
    assert [len(movers.certain().id) for movers in known] == [1] * len(known), "once is enough"
    last_time = times_with_movers(watched)[-1]
    assert 0.8 <= last_time - 2.6 <= 1.2, "the obstacle is out of sight after about 2.6 s"
    last_movers = dict(watched)[last_time]
    true_place = (2.5, -1.2 + 1.2 * last_time)
    assert place_of(last_movers) == pytest.approx(true_place, abs=0.3)

    def vanishes(time):
        """Return the obstacle until it vanishes in full view after a second."""
        return crosses(time) if time < 1.0 else ()

    # Scans come at 20 Hz: it is dropped within 0.15 s if the room behind it returns.
    mover_counts = counts(Scene().watch(2.0, movers=vanishes))
    assert mover_counts[19] == 1
    assert sum(mover_counts[23:]) == 0
    # Otherwise it may be dark, and is extrapolated.
    open_watched = Scene(boxes=wall).watch(3.0, movers=vanishes)
    assert 1.7 <= times_with_movers(open_watched)[-1] <= 1.8


@pytest.mark.parametrize("range_max", [30.0, 5.6, math.inf])
def test_an_obstacle_that_returns_nothing_in_half_of_the_scans_stays_tracked(range_max):
    """No float32 is 5.6: the range_max of a message is, but not that of a file."""
    random = np.random.default_rng(0)

    def darken(scan):
        farthest = 4.0 if random.random() < 0.5 else 0.0
        ranges = np.where(scan.ranges < farthest, np.inf, scan.ranges)
        return replace(scan, ranges=ranges, range_max=range_max)

    def crosses(time):
        return [(2.5, -1.5 + time, 0.25)]

    watched = Scene().watch(3.0, movers=crosses, distort=darken)
    assert min(counts(watched)[20:]) == 1
    assert len(ids_of(watched)) == 1


def test_obstacles_that_stop_are_dropped_and_obstacles_that_start_are_detected():
    def moves_from_one_and_a_half_to_three_seconds(time):
        moving_time = max(0.0, min(time, 3.0) - 1.5)
        return [(2.0, moving_time, 0.3)]

    # Scans come at 20 Hz: rows 30 and 60 are the beginning and the end of the motion.
    watched = Scene().watch(5.0, movers=moves_from_one_and_a_half_to_three_seconds)
    mover_counts = counts(watched)
    assert sum(mover_counts[:31]) == 0
    assert all(mover_counts[42:60])
    # One leg stands while a person walks: a second without evidence ends the motion.
    assert sum(mover_counts[85:]) == 0


def legs(time):
    """Return the legs of a person who walks at 1 m/s, and stands on one leg at any time."""
    feet = []
    for x, phase in ((2.3, 0.0), (2.5, 0.5)):
        # A leg stands for half of each stride of 1.1 m, and then swings forward.
        strides = time / 1.1 + phase
        swing = max(0.0, 2.0 * (strides % 1.0) - 1.0)
        feet.append((x, 1.1 * (math.floor(strides) + swing - phase) - 2.0, 0.06))
    return feet


POST = np.array([[2.9, 0.0, 0.06]])  # as thick as a leg, beside the way of the legs


@pytest.mark.parametrize(
    ("laser", "cylinders"),
    [
        pytest.param(JACKAL.laser, POST, id="jackal, beside a post"),
        pytest.param(BURGER, NO_CYLINDERS, id="burger"),
    ],
)
def test_two_legs_are_one_person_who_moves_at_their_mean_velocity(laser, cylinders):
    watched = Scene(laser, cylinders).watch(4.0, movers=legs)
    last_seconds = [movers for time, movers in watched if time >= 1.8]
    errors = [math.dist(velocity_of(movers), (0.0, 1.0)) for movers in last_seconds]
    assert np.median(errors) < 0.35
    assert np.mean([len(movers.id) for movers in last_seconds]) < 1.2


def test_an_obstacle_that_turns_back_keeps_its_number():
    def turns_back(time):
        """Return an obstacle that comes from the right, and goes back there after 1.8 s."""
        return [(2.4, 0.8 - abs(time - 1.8), 0.3)]

    watched = Scene().watch(3.2, movers=turns_back)
    assert ids_of(watched) == {1}


def crossing(time):
    """Return an obstacle that crosses the robot's way after a second."""
    return [(2.4, -1.0 + time, 0.3)]


def test_without_moving_obstacles_all_columns_are_empty():
    scene = Scene()
    movers = scene.tracker.update(scene.scan(0.0))
    assert [len(column) for column in movers] == [0] * len(movers)
    assert movers.covariance.shape == (0, 3)


def test_older_and_tilted_scans_are_ignored():
    scene = Scene()
    time, known = scene.watch(1.0, movers=crossing)[-1]
    unusable = [
        scene.scan(time),
        scene.scan(time - 0.1),
        replace(scene.scan(time + 0.05), rotation=(0.0, 0.2, 0.0, 0.98)),
    ]
    for scan in unusable:
        movers = scene.tracker.update(scan)
        assert movers.id.tolist() == known.id.tolist()
        assert movers.x.tolist() == known.x.tolist()


@pytest.mark.parametrize(
    ("delay", "pose"),
    [
        pytest.param(1.1, ORIGIN, id="later"),
        pytest.param(-1.1, ORIGIN, id="earlier"),
        # Within 0.05 s the base drives 0.15 m, and its odometry is corrected by 0.3 m.
        pytest.param(0.05, (0.5, 0.0, 0.0), id="elsewhere"),
        pytest.param(0.05, (0.0, 0.0, 0.7), id="turned"),
        pytest.param(0.05, None, id="reset"),
    ],
)
def test_a_jump_or_a_reset_restarts_the_tracker(delay, pose):
    scene = Scene()
    time, _ = scene.watch(1.0, movers=crossing)[-1]
    if pose is None:
        scene.tracker.reset()
    scan = scene.scan(time + delay, movers=crossing(time), believed=pose)
    assert len(scene.tracker.update(scan).id) == 0


def test_a_fast_robot_with_a_slow_laser_has_not_jumped():
    """It moves by 36 cm from scan to scan, more than a correction of the odometry may."""

    def drives_ahead(time):
        return 1.8 * time - 2.5, 0.0, 0.0

    def crosses(time):
        return [(1.5, time - 0.8, 0.3)]

    # Scans come at 5 Hz.
    watched = Scene(BURGER).watch(1.4, drives_ahead, crosses)
    assert counts(watched)[-1] == 1


def test_positions_are_in_the_odometry_frame():
    """The laser drives and turns in a frame far from its origin."""
    odometry_frame = (40.0, -30.0, 2.0)

    def pose(time):
        return 0.5 * time, 0.0, 0.3 * time

    def crosses(time):
        return [(2.5, -1.0 + time, 0.3)]

    def odometry_pose(time):
        return compose(odometry_frame, pose(time))

    scene = Scene(cylinders=PILLARS)
    watched = scene.watch(1.5, pose, crosses, believed=odometry_pose)
    time, last_movers = watched[-1]
    place = compose(odometry_frame, (2.5, -1.0 + time, 0.0))[:2]
    assert place_of(last_movers) == pytest.approx(place, abs=0.1)
    # It moves along y at 1 m/s, and the frame is turned by 2 rad.
    velocity = (-math.sin(2.0), math.cos(2.0))
    assert velocity_of(last_movers) == pytest.approx(velocity, abs=0.2)
