"""Tests of the collision monitor's scan matching, which recovers the true motion if the wheels slip."""

import math
from dataclasses import replace

import numpy as np
import pytest

from applr_ros1.common.angles import compose, inverse
from applr_ros1.common.scan import LaserScan
from applr_ros1.monitor.monitor import PASS, CollisionMonitor
from applr_ros1.monitor.scan_matching import ScanMatcher, _beam_near, beam_at, lines
from applr_ros1.monitor.settings import MonitorSettings
from applr_ros1.robots import JACKAL
from sim_bridge.lidar import Lidar
from tests.support.seeds import seeds

NOTHING = np.zeros((0, 3)), np.zeros((0, 5))


def scan(true, odometry, stamp, rng, discs=NOTHING[0], walls=NOTHING[1]):
    """Return the scan of discs and walls (x, y, yaw, length, thickness) from the pose `true`. The scan's
    sensor_pose is `odometry`. The laser is in the robot's centre.
    """
    laser = JACKAL.laser
    ranges = Lidar(laser, discs, walls).scan(*true) + rng.normal(0.0, 0.003, laser.beams).astype(np.float32)
    return LaserScan(stamp, laser.first_angle, laser.increment, 0.1, 30.0, ranges, odometry)


def pillars(rng, count=60):
    places = rng.uniform(-4.0, 4.0, (count, 2))
    places = places[np.hypot(*places.T) > 0.7]
    return np.column_stack((places, np.full(len(places), 0.075)))


@seeds(5)
def test_slip_and_heading_errors_are_corrected(seed):
    """Every tenth step the wheels slip by up to 8 cm, and headings have an error of .003 rad."""
    rng = np.random.default_rng(seed)
    discs, matcher = pillars(rng), ScanMatcher()
    true, slipped = (0.0, 0.0, 0.0), 0.0
    believed = true
    for step in range(80):
        move = (0.03 * math.cos(0.05 * step), 0.0, 0.04 * math.sin(0.11 * step))
        slip = float(rng.uniform(-0.08, 0.08)) if step % 10 == 5 else 0.0
        slipped += slip
        true = compose(true, (move[0] + slip, move[1], move[2]))
        believed = compose(believed, move)
        reported = (*believed[:2], believed[2] + float(rng.normal(0.0, 0.003)))
        matcher.add_scan(scan(true, reported, 0.05 * step, rng, discs))
        x, y, yaw = compose(inverse(true), matcher.corrected(reported))
        assert math.hypot(x, y) < 0.015
        assert abs(yaw) < 0.01
    assert math.hypot(believed[0] - true[0], believed[1] - true[1]) > 0.015


@seeds(5)
def test_a_sliding_base_is_tracked_while_its_wheels_turn_backwards(seed):
    """The base brakes from 2 m/s at 4.8 m/s^2 between rows of posts that repeat every 15 cm."""
    rng = np.random.default_rng(seed)
    rows = [(0.15 * i, side, 0.075) for side in (-0.9, 0.9) for i in range(-10, 50) if rng.random() < 0.8]
    discs, matcher = np.array([*rows, (3.2, 0.3, 0.075), (4.0, -0.4, 0.075)]), ScanMatcher()
    true = believed = (0.0, 0.0, 0.0)
    ahead, errors = 0.1, []
    for step in range(22):
        sliding = step >= 12
        ahead = max(0.0, ahead - 0.012) if sliding else ahead
        true = compose(true, (ahead, 0.0, 0.0))
        believed = compose(believed, (-0.025 if sliding else ahead, 0.0, 0.0))
        matcher.add_scan(scan(true, believed, 0.05 * step, rng, discs))
        x, y, _ = compose(inverse(true), matcher.corrected(believed))
        errors.append(math.hypot(x, y))
    assert max(errors) < 0.02
    assert believed[0] < true[0] - 0.5


def test_along_a_bare_corridor_the_odometry_decides():
    rng, matcher = np.random.default_rng(0), ScanMatcher()
    walls = np.array([[0.0, side, 0.0, 80.0, 0.01] for side in (-1.0, 1.0)])
    for step in range(40):
        true = (0.05 * step, 0.02 * math.sin(step), 0.0)
        matcher.add_scan(scan(true, (true[0], 0.0, 0.0), 0.05 * step, rng, walls=walls))
        x, y, _ = matcher.corrected((true[0], 0.0, 0.0))
        assert abs(y - true[1]) < 0.01
        assert abs(x - true[0]) < 0.05


def test_a_passing_person_does_not_shift_the_pose():
    rng, matcher = np.random.default_rng(1), ScanMatcher()
    discs, pose = pillars(rng, 20), (0.0, 0.0, 0.0)
    for step in range(60):
        person = np.array([[1.0, -1.5 + 0.05 * step, 0.25]])
        matcher.add_scan(scan(pose, pose, 0.05 * step, rng, np.vstack((discs, person))))
        assert np.hypot(*matcher.corrected(pose)[:2]) < 0.01


def test_a_completely_changed_scene_does_not_change_the_pose():
    """If the scene changes completely, the pose is taken from the odometry, and the next scan fits again."""
    rng, matcher = np.random.default_rng(2), ScanMatcher()
    pose, first = (0.0, 0.0, 0.0), pillars(rng)
    second = np.array([[0.0, -0.7, -0.1, 4.0, 0.01], [1.35, 0.5, 1.63, 5.0, 0.01]])
    assert not matcher.add_scan(scan(pose, pose, 0.0, rng, first))
    assert matcher.add_scan(scan(pose, pose, 0.1, rng, first))
    assert not matcher.add_scan(scan(pose, pose, 0.2, rng, walls=second))
    assert np.allclose(matcher.corrected(pose), pose, atol=0.002)
    assert matcher.add_scan(scan(pose, pose, 0.3, rng, walls=second))


def test_backing_up_uses_the_corrected_pose():
    """The obstacles behind leave room to back up, until the wheels lock and the base slides back by 9 cm."""
    rng = np.random.default_rng(3)
    discs = np.array([(-0.72, y, 0.05) for y in np.arange(-0.3, 0.31, 0.05)] + [(1.0, 0.7, 0.2), (0.9, -0.8, 0.2)])
    verdicts = []
    brakes_well = replace(MonitorSettings.of(JACKAL), deceleration=4.0, yaw_deceleration=12.0)
    for slide in (0.0, 0.09):
        monitor, pose = CollisionMonitor(brakes_well), (0.0, 0.0, 0.0)
        monitor.add_scan(scan((0, 0, math.pi), (0, 0, math.pi), 0.0, rng, discs))
        monitor.add_scan(scan(pose, pose, 0.1, rng, discs))
        monitor.add_scan(scan((-0.20, 0, 0), (-0.20, 0, 0), 0.2, rng, discs))
        monitor.add_scan(scan((-0.20 - slide, 0, 0), (-0.20, 0, 0), 0.3, rng, discs))
        verdicts.append(monitor.filter(0.3, (-0.20, 0, 0), (0, 0), (-0.5, 0.0)))
    assert verdicts[0].action == PASS
    assert -0.4 < verdicts[1].command[0] < 0.0


@pytest.mark.parametrize(
    ("first", "increment", "count"), [(-2.356, 0.00654, 721), (2.0, -0.05, 60), (0.0, 0.0175, 359)]
)
def test_the_beam_search_does_not_depend_on_its_start(first, increment, count):
    random = np.random.default_rng(count)
    beams, surface = (first, increment), lines(np.full(count, 2.0, np.float32), (first, increment))
    for _ in range(300):
        bearing, r = random.uniform(-np.pi, np.pi), random.uniform(0.2, 8.0)
        expected = beam_at(*beams, bearing)
        last = (random.integers(-1, count + 1), int(expected) + random.integers(-9, 10))[random.integers(2)]
        beam = _beam_near(surface, beams, r * np.cos(bearing), r * np.sin(bearing), float(last))
        assert beam == pytest.approx(expected, abs=1e-9)
