"""Tests of scan matching, which recovers the true motion if the wheels slip."""

import math
from dataclasses import replace

import numpy as np
import pytest

from applr_ros1.common.angles import compose, inverse
from applr_ros1.monitor.monitor import PASS, CollisionMonitor
from applr_ros1.monitor.rays import beam_at
from applr_ros1.monitor.scan_matching import SUPPORT_M, ScanMatcher, beam_near, lines, nearest_pose
from applr_ros1.robots import JACKAL
from sim_bridge.lidar import Lidar
from tests.monitor.scenes import BRAKES_WELL
from tests.support.robots import scan_by
from tests.support.seeds import seeds

NO_DISCS = np.zeros((0, 3))
NO_WALLS = np.zeros((0, 5))
ORIGIN = (0.0, 0.0, 0.0)
STEP_S = 0.05  # time between two scans [s]


def scan(true, odometry, stamp, rng=None, discs=NO_DISCS, walls=NO_WALLS, noise=0.003, share=0.0):
    """Return the scan of discs and walls (x, y, yaw, length, thickness) from the pose `true`.

    The scan's sensor_pose is `odometry`. The laser is in the robot's centre. The noise is `noise`
    [m], and `share` of the range; without a generator there is none.
    """
    laser = JACKAL.laser
    ranges = Lidar(laser, discs, walls).scan(*true)
    if rng is not None:
        deviations = noise + share * np.where(np.isfinite(ranges), ranges, 0.0)
        ranges += (deviations * rng.normal(0.0, 1.0, laser.beams)).astype(np.float32)
    return scan_by(laser, stamp, ranges, odometry)


def pillars(rng, count=60):
    """Return discs (n, 3) at random places, none of them at the robot."""
    places = rng.uniform(-4.0, 4.0, (count, 2))
    x, y = places.T
    places = places[np.hypot(x, y) > 0.7]
    radii = np.full(len(places), 0.075)
    return np.column_stack((places, radii))


def error_of(matcher, true, odometry):
    """Return the distance [m] and the angle [rad] between the true and the corrected pose."""
    x, y, yaw = compose(inverse(true), matcher.corrected(odometry))
    return math.hypot(x, y), abs(yaw)


@pytest.mark.parametrize(
    ("pose", "nearest"),
    [
        ((0.0, 0.0, 3.1), 0),
        ((0.0, 0.0, -3.1), 0),  # .08 rad away, to the other side
        ((0.0, 0.0, 1.7), 0),  # a yaw of 1.4 rad, or 1.6
        ((0.0, 0.0, 1.5), 1),
        ((0.9, 0.0, 0.8), 1),  # .9 m and .7 rad, or 1.1 m and .8 rad
        ((1.3, 0.0, 0.8), 2),
        ((1.0, 1.0, 0.2), 1),  # 1.41 m and .1 rad, or 1.41 m and .2 rad
    ],
)
def test_the_nearest_scan_is_that_of_the_least_distance_and_turn(pose, nearest):
    poses = np.array([(0.0, 0.0, 3.1), (0.0, 0.0, 0.1), (2.0, 0.0, 0.0)])
    assert nearest_pose(poses, pose) == nearest


@seeds(5)
def test_slip_and_heading_errors_are_corrected(seed):
    """Every tenth step the wheels slip by up to 8 cm, and headings have an error of .003 rad."""
    rng = np.random.default_rng(seed)
    discs = pillars(rng)
    matcher = ScanMatcher()
    true = ORIGIN
    believed = ORIGIN
    # Four seconds on a winding way
    for step in range(80):
        forward = 0.03 * math.cos(0.05 * step)
        turn = 0.04 * math.sin(0.11 * step)
        slip = 0.0
        if step % 10 == 5:
            slip = float(rng.uniform(-0.08, 0.08))
        true = compose(true, (forward + slip, 0.0, turn))
        believed = compose(believed, (forward, 0.0, turn))
        x, y, yaw = believed
        heading_error = float(rng.normal(0.0, 0.003))
        reported = (x, y, yaw + heading_error)
        matcher.add_scan(scan(true, reported, STEP_S * step, rng, discs))
        distance, angle = error_of(matcher, true, reported)
        # Five times the noise of a range
        assert distance < 0.015
        assert angle < 0.01
    away_x, away_y, _ = compose(inverse(true), believed)
    assert math.hypot(away_x, away_y) > 0.015, "without a correction"


@pytest.mark.parametrize("yaw", [0.0, 0.8])
def test_a_scan_without_noise_is_matched_to_a_fraction_of_a_millimetre(yaw):
    """The base slips by 10 cm and turns by .05 rad in a room, and its odometry shows none of it."""
    walls = np.vstack((ROOM, (2.0, 1.5, 0.6, 1.0, 0.1)))
    start = (0.0, 0.0, yaw)
    true = compose(start, (0.08, 0.06, 0.05))
    matcher = ScanMatcher()
    matcher.add_scan(scan(start, start, 0.0, walls=walls))
    assert matcher.add_scan(scan(true, start, STEP_S, walls=walls))
    distance, angle = error_of(matcher, true, start)
    assert distance < 5e-4
    assert angle < 2e-4


@pytest.mark.parametrize(
    ("true", "is_corrected"),
    [
        ((0.14, 0.0, 0.0), True),
        ((0.16, 0.0, 0.0), False),
        ((0.11, -0.12, 0.0), False),  # .163 m
        ((0.0, 0.0, 0.09), True),
        ((0.0, 0.0, 0.11), False),
        ((0.0, 0.0, -0.11), False),
    ],
)
def test_a_correction_of_more_than_15_cm_or_a_tenth_of_a_radian_is_refused(true, is_corrected):
    """The base moves in a room of 2 m, and its odometry shows nothing of it."""
    walls = np.array(
        [
            (1.0, 0.0, 0.5 * math.pi, 2.0, 0.01),
            (-1.0, 0.0, 0.5 * math.pi, 2.0, 0.01),
            (0.0, 1.0, 0.0, 2.0, 0.01),
            (0.0, -1.0, 0.0, 2.0, 0.01),
        ]
    )
    matcher = ScanMatcher()
    matcher.add_scan(scan(ORIGIN, ORIGIN, 0.0, walls=walls))
    assert matcher.add_scan(scan(true, ORIGIN, STEP_S, walls=walls)) == is_corrected
    expected = true if is_corrected else ORIGIN
    assert matcher.corrected(ORIGIN) == pytest.approx(expected, abs=0.005)


@seeds(5)
def test_a_sliding_base_is_tracked_while_its_wheels_turn_backwards(seed):
    """The base brakes from 2 m/s at 4.8 m/s^2 between rows of posts that repeat every 15 cm."""
    rng = np.random.default_rng(seed)
    # Two posts ahead, and on each side a row in which a fifth of the posts is missing
    discs = [
        (3.2, 0.3, 0.075),
        (4.0, -0.4, 0.075),
    ]
    for y in (-0.9, 0.9):
        for number in range(-10, 50):
            if rng.random() < 0.8:
                discs.append((0.15 * number, y, 0.075))
    matcher = ScanMatcher()
    true_x = 0.0
    believed_x = 0.0
    step_m = 0.1  # distance that the base moves from scan to scan [m]
    for step in range(22):
        wheels_m = step_m
        if step >= 12:
            # 4.8 m/s^2 take 0.24 m/s, 12 mm of the way from scan to scan.
            step_m = max(0.0, step_m - 0.012)
            wheels_m = -0.025
        true_x += step_m
        believed_x += wheels_m
        true = (true_x, 0.0, 0.0)
        believed = (believed_x, 0.0, 0.0)
        matcher.add_scan(scan(true, believed, STEP_S * step, rng, np.array(discs)))
        distance, _ = error_of(matcher, true, believed)
        assert distance < 0.02
    assert believed_x < true_x - 0.5, "without a correction"


@seeds(3)
def test_an_error_at_normal_incidence_does_not_hold_the_pose_along_a_wall(seed):
    """It moves along with the robot: the wall seems to bend towards it, where it is nearest."""
    rng = np.random.default_rng(seed)
    matcher = ScanMatcher()
    bearings = JACKAL.laser.first_angle + JACKAL.laser.increment * np.arange(JACKAL.laser.beams)
    error = 0.03 * np.exp(-(((bearings - 0.5 * math.pi) / 0.3) ** 2))
    for step in range(40):
        x = 0.08 * step
        seen = scan(
            (x, 0.0, 0.0), (x, 0.0, 0.0), 0.1 * step, rng, walls=[(0.0, 0.8, 0.0, 90.0, 0.01)]
        )
        seen.ranges[:] -= error.astype(np.float32)
        matcher.add_scan(seen)
        assert matcher.corrected((x, 0.0, 0.0))[0] == pytest.approx(x, abs=0.05)


ROOM = np.array(
    [
        (4.0, 0.0, 0.5 * math.pi, 6.0, 0.1),
        (-4.0, 0.0, 0.5 * math.pi, 6.0, 0.1),
        (0.0, 3.0, 0.0, 8.0, 0.1),
        (0.0, -3.0, 0.0, 8.0, 0.1),
    ]
)
HALL = ROOM * (3.0, 3.0, 1.0, 3.0, 1.0)
CORRIDOR = np.array([(0.0, -1.0, 0.0, 80.0, 0.01), (0.0, 1.0, 0.0, 80.0, 0.01)])


@pytest.mark.parametrize("noise_at_2_m", [0.001, 0.01, 0.03])
def test_a_noisy_laser_is_matched_and_no_direction_seems_to_be_measured(noise_at_2_m):
    """On a circle in a room, and along a bare corridor. The noise grows with the range."""
    rng = np.random.default_rng(0)
    noise = {"noise": 0.0, "share": 0.5 * noise_at_2_m}
    matcher = ScanMatcher()
    matched = []
    for step in range(60):
        yaw = 0.08 * step
        true = (1.6 * math.sin(yaw), -1.6 * math.cos(yaw), yaw)
        matched.append(matcher.add_scan(scan(true, true, 0.1 * step, rng, walls=ROOM, **noise)))
        distance, angle = error_of(matcher, true, true)
        assert distance < 0.1
        assert angle < 0.03
    assert np.mean(matched[1:]) >= 0.95
    assert matcher.support > 2.0 * SUPPORT_M

    matcher = ScanMatcher()
    for step in range(10):
        pose = (0.1 * step, 0.0, 0.0)
        matcher.add_scan(scan(pose, pose, 0.1 * step, rng, walls=CORRIDOR, **noise))
        assert matcher.support < 0.5 * SUPPORT_M


@pytest.mark.parametrize(
    ("walls", "person", "expected"),
    [
        pytest.param(CORRIDOR, [], (0.0, 0.05, 0.04), id="corridor"),
        pytest.param(ROOM, [(2.0, 0.0)], (0.06, 0.05, 0.04), id="room-with-a-walker"),
    ],
)
def test_the_frame_of_planners_takes_what_is_measured(walls, person, expected):
    """The base slips by 6 cm, 5 cm and .04 rad, in four steps while a person walks by.

    Along a corridor the slip cannot be seen.
    """
    rng = np.random.default_rng(4)
    monitor = CollisionMonitor()
    for step in range(30):
        slipped = min(max(step - 20, 0), 4) / 4.0
        true = (0.06 * slipped, 0.05 * slipped, 0.04 * slipped)
        discs = np.array([(x, -1.5 + 0.05 * step, 0.2) for x, _ in person]).reshape(-1, 3)
        monitor.add_scan(scan(true, ORIGIN, STEP_S * step, rng, discs, walls))
    x, y, yaw = monitor.matcher.correction
    expected_x, expected_y, expected_yaw = expected
    assert x == pytest.approx(expected_x, abs=0.015)
    assert y == pytest.approx(expected_y, abs=0.015)
    assert yaw == pytest.approx(expected_yaw, abs=0.01)


@pytest.mark.parametrize(
    ("people", "walls", "problem"),
    [
        ([(0.9, 0.0, 0.25)], NO_WALLS, "m fit an earlier scan, less than 0.6 m"),
        ([(0.9, 0.0, 0.25), (1.1, 1.2, 0.25)], NO_WALLS, "m fit an earlier scan, less than 0.6 m"),
        # Something large in the middle of a hall, whose walls are too far away to be matched
        ([(1.5, 0.0, 0.5), (1.5, 1.6, 0.5)], HALL, "less than 25% of the returns fit"),
    ],
)
def test_the_pose_follows_no_people_if_the_scan_shows_nothing_else_near(people, walls, problem):
    """They walk away from a robot that stands."""
    matcher = ScanMatcher()
    for step in range(20):
        moved = np.array(people) + (0.02 * step, 0.0, 0.0)
        matcher.add_scan(scan(ORIGIN, ORIGIN, STEP_S * step, None, moved, walls))
    assert problem in matcher.report
    assert matcher.correction == ORIGIN


def test_a_person_alone_shows_no_other_place():
    """One stands where the scan before saw through, and is gone from where it stood."""
    matcher = ScanMatcher()
    for step, y in enumerate((0.5, -0.5)):
        seen = scan(ORIGIN, ORIGIN, STEP_S * step, None, [(0.8, y, 0.25)])
        seen.ranges[:] = np.minimum(seen.ranges, np.float32(9.0))
        matcher.add_scan(seen)
    assert not matcher.lost
    assert "m fit an earlier scan" in matcher.report


@pytest.mark.parametrize("is_mounted_upside_down", [False, True])
def test_few_returns_are_matched_if_they_show_more_than_people(is_mounted_upside_down):
    """Of a room only a corner returns: 17 % of the beams. The base slips, and turns by .02 rad."""
    matcher = ScanMatcher()
    for step, true in enumerate((ORIGIN, (0.04, 0.03, 0.02))):
        seen = scan(true, ORIGIN, STEP_S * step, walls=ROOM)
        bearings = seen.angle_min + seen.angle_increment * np.arange(len(seen.ranges))
        seen.ranges[(bearings < math.radians(20.0)) | (bearings > math.radians(65.0))] = np.inf
        if is_mounted_upside_down:
            seen = replace(
                seen,
                angle_min=bearings[-1],
                angle_increment=-seen.angle_increment,
                ranges=seen.ranges[::-1],
            )
        is_matched = matcher.add_scan(seen)
    assert is_matched
    assert matcher.correction == pytest.approx(true, abs=0.005)


def test_a_completely_changed_scene_does_not_change_the_pose():
    """The pose is then taken from the odometry, and the next scan fits again."""
    rng = np.random.default_rng(2)
    matcher = ScanMatcher()
    discs = pillars(rng)
    walls = np.array(
        [
            [0.0, -0.7, -0.1, 4.0, 0.01],
            [1.35, 0.5, 1.63, 5.0, 0.01],
        ]
    )
    # A scan is matched (True) if it fits the one before.
    assert not matcher.add_scan(scan(ORIGIN, ORIGIN, 0.0, rng, discs))
    assert matcher.add_scan(scan(ORIGIN, ORIGIN, 0.1, rng, discs))
    assert not matcher.add_scan(scan(ORIGIN, ORIGIN, 0.2, rng, walls=walls))
    assert matcher.report.startswith("off since the scan of 0.10 s: ")
    assert np.allclose(matcher.corrected(ORIGIN), ORIGIN, atol=0.002)
    assert matcher.add_scan(scan(ORIGIN, ORIGIN, 0.3, rng, walls=walls))
    assert matcher.report == "on"


def verdict_after_slide(slide):
    """Return the Verdict on backing up, after a slide backwards that the odometry misses [m]."""
    rng = np.random.default_rng(3)
    posts = [
        (1.0, 0.7, 0.2),
        (0.9, -0.8, 0.2),
        (2.0, 0.0, 0.5),
        (0.3, 1.5, 0.4),
        (0.2, -1.6, 0.4),
    ]
    row_behind = [(-0.72, y, 0.05) for y in np.arange(-0.3, 0.31, 0.05)]
    discs = np.array(posts + row_behind)
    monitor = CollisionMonitor(BRAKES_WELL)
    turned_round = (0.0, 0.0, math.pi)
    backed_up = (-0.20, 0.0, 0.0)
    slid = (-0.20 - slide, 0.0, 0.0)
    # The robot first looks back, then ahead, and backs up by 0.2 m. From its rear, 0.229 m behind
    # its centre, to the row of discs 0.24 m are left, less the slide.
    monitor.add_scan(scan(turned_round, turned_round, 0.0, rng, discs))
    monitor.add_scan(scan(ORIGIN, ORIGIN, 0.1, rng, discs))
    monitor.add_scan(scan(backed_up, backed_up, 0.2, rng, discs))
    monitor.add_scan(scan(slid, backed_up, 0.3, rng, discs))
    return monitor.filter(0.3, backed_up, twist=(0.0, 0.0), command=(-0.5, 0.0))


def test_backing_up_uses_the_corrected_pose():
    """The obstacles behind leave room to back up, until the wheels lock and the base slides."""
    assert verdict_after_slide(0.0).action == PASS
    v, _ = verdict_after_slide(0.09).command
    assert -0.4 < v < 0.0


@pytest.mark.parametrize(
    ("first", "increment", "count"),
    [
        (-2.356, 0.00654, 721),
        (2.0, -0.05, 60),
        (0.0, 0.0175, 359),
    ],
)
def test_the_beam_search_does_not_depend_on_its_start(first, increment, count):
    rng = np.random.default_rng(count)
    surface = lines(np.full(count, 2.0, np.float32), first, increment)
    for _ in range(300):
        bearing = rng.uniform(-np.pi, np.pi)
        distance = rng.uniform(0.2, 8.0)
        expected = beam_at(first, increment, bearing)
        anywhere = rng.integers(-1, count + 1)
        nearby = int(expected) + rng.integers(-9, 10)
        x = distance * np.cos(bearing)
        y = distance * np.sin(bearing)
        for first_beam in (anywhere, nearby):
            beam = beam_near(surface, first, increment, x, y, float(first_beam))
            assert beam == pytest.approx(expected, abs=1e-9)
