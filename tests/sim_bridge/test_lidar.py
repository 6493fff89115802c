"""Tests of the exact laser scans, by brute force and in edge cases."""

import numpy as np
import pytest

from applr_ros1 import robots
from sim_bridge.lidar import Lidar
from tests.support.seeds import seeds

NOTHING = np.empty((0, 3)), np.empty((0, 5))
LASER = robots.load("jackal").laser
FULL_TURN = robots.load("turtlebot3_burger").laser  # full turn from 0
# Fan to the right.
ABOVE_PI = LASER.model_copy(update=dict(beams=90, first_angle=4.0, last_angle=6.2, range_max=8.0))
LASERS = [LASER, FULL_TURN, ABOVE_PI]


def brute_force(laser, circles, edges, x, y, yaw):
    """Return the ranges (beams,) by intersecting every beam with every obstacle."""
    angles = yaw + laser.first_angle + laser.increment * np.arange(laser.beams)
    beams = np.column_stack([np.cos(angles), np.sin(angles)])
    best = np.full(laser.beams, np.inf)
    for cx, cy, r in circles:
        along = beams @ (cx - x, cy - y)
        inside = along**2 - ((cx - x) ** 2 + (cy - y) ** 2 - r * r)
        hit = (inside >= 0) & (along > 0)
        best = np.minimum(best, np.where(hit, along - np.sqrt(np.maximum(inside, 0)), np.inf))
    for x0, y0, x1, y1 in edges:
        edge = np.array([x1 - x0, y1 - y0])
        to = np.array([x0 - x, y0 - y])
        across = beams[:, 0] * edge[1] - beams[:, 1] * edge[0]
        reach = (to[0] * edge[1] - to[1] * edge[0]) / across
        where = (to[0] * beams[:, 1] - to[1] * beams[:, 0]) / across
        best = np.minimum(best, np.where((reach > 0) & (where >= 0) & (where <= 1), reach, np.inf))
    best[best >= laser.range_max] = np.inf
    best[best <= laser.range_min] = -np.inf
    return best


def grazing(laser, circles, edges, x, y, yaw, beam):
    """Return whether a beam passes the rim of an obstacle so closely that rounding decides whether
    it hits.
    """
    angle = yaw + laser.first_angle + laser.increment * beam
    across = np.array([-np.sin(angle), np.cos(angle)])
    rims = [abs(abs(across @ (cx - x, cy - y)) - r) for cx, cy, r in circles]
    rims += [
        abs(across @ (ex - x, ey - y))
        for x0, y0, x1, y1 in edges
        for ex, ey in ((x0, y0), (x1, y1))
    ]
    return min(rims, default=1.0) < 1e-9


@seeds(60)
def test_scans_equal_brute_force(seed):
    rng = np.random.default_rng(seed)
    n = rng.integers(0, 60)
    m = rng.integers(0, 8)
    spread = rng.choice([3.0, 8.0, 25.0])
    circles = np.column_stack([rng.uniform(-spread, spread, (n, 2)), rng.uniform(0.02, 1.5, n)])
    boxes = np.column_stack(
        [rng.uniform(-spread, spread, (m, 2)), rng.uniform(-4, 4, m), rng.uniform(0.02, 5, (m, 2))]
    )
    laser = LASERS[seed % len(LASERS)]
    lidar = Lidar(laser, circles, boxes)
    for _ in range(4):
        x, y, yaw = rng.uniform(-spread, spread), rng.uniform(-spread, spread), rng.uniform(-7, 7)
        got = lidar.scan(x, y, yaw)
        want = brute_force(laser, circles, lidar.edges, x, y, yaw)
        if np.isneginf(got).all():  # inside an obstacle
            continue
        for beam in np.flatnonzero(~np.isclose(got, want, rtol=0.0, atol=1e-5)):
            assert grazing(laser, circles, lidar.edges, x, y, yaw, beam), (
                beam,
                got[beam],
                want[beam],
            )


def test_an_obstacle_behind_reaches_into_both_ends_of_the_fan():
    ranges = Lidar(LASER, [(-1.0, 0.0, 0.9)], []).scan(0.0, 0.0, 0.0)
    assert np.isfinite(ranges[[0, 360, -1]]).tolist() == [True, False, True]
    assert ranges[0] == pytest.approx(ranges[-1], abs=1e-5)


def test_beams_without_obstacles_beyond_range_and_too_near():
    assert (Lidar(LASER, *NOTHING).scan(0, 0, 0) == np.inf).all()
    assert (Lidar(LASER, [(40.0, 0.0, 1.0)], []).scan(0, 0, 0) == np.inf).all()
    assert Lidar(LASER, [(0.15, 0.0, 0.1)], []).scan(0, 0, 0)[360] == -np.inf
    assert (Lidar(LASER, [(0.0, 0.0, 1.0)], []).scan(0.3, 0, 0) == -np.inf).all()
    assert (Lidar(LASER, NOTHING[0], [(0, 0, 0.3, 2, 2)]).scan(0.3, 0, 0) == -np.inf).all()


def test_moving_circles_are_in_the_scan_they_are_given_for():
    lidar = Lidar(LASER, *NOTHING)
    assert lidar.scan(0, 0, 0, np.array([(2.0, 0.0, 0.5)]))[360] == pytest.approx(1.5, abs=1e-3)
    assert lidar.scan(0, 0, 0)[360] == np.inf
