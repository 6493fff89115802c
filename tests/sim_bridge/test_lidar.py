"""Tests of the exact laser scans, by brute force and in edge cases."""

import numpy as np
import pytest

from applr_ros1 import robots
from sim_bridge.lidar import Lidar
from tests.support.seeds import seeds

NO_CIRCLES = np.empty((0, 3))
NO_BOXES = np.empty((0, 5))
AHEAD = 360  # index of LASER's beam straight ahead
LASER = robots.load("jackal").laser
FULL_TURN = robots.load("turtlebot3_burger").laser  # full turn from 0
# Fan to the right, whose angles exceed pi.
ABOVE_PI = LASER.model_copy(
    update=dict(
        beams=90,
        first_angle=4.0,
        last_angle=6.2,
        range_max=8.0,
    )
)
LASERS = [LASER, FULL_TURN, ABOVE_PI]


def distances_to_circle(directions, offset_x, offset_y, radius):
    """Return the distances (beams,) [m] to a circle at an offset from the laser; inf if missed."""
    along = directions @ (offset_x, offset_y)
    centre_distance = np.hypot(offset_x, offset_y)
    # Square of half the chord; negative if the beam misses the circle.
    half_chord_2 = along**2 - (centre_distance**2 - radius**2)
    is_hit = (half_chord_2 >= 0) & (along > 0)
    half_chord = np.sqrt(np.maximum(half_chord_2, 0))
    return np.where(is_hit, along - half_chord, np.inf)


def distances_to_edge(directions, start, end):
    """Return the distances (beams,) [m] to an edge between two offsets (2,) from the laser."""
    cosine, sine = directions.T
    edge_x, edge_y = end - start
    start_x, start_y = start
    # Intersection of beam and edge by Cramer's rule
    determinant = cosine * edge_y - sine * edge_x
    distance = (start_x * edge_y - start_y * edge_x) / determinant
    share_of_edge = (start_x * sine - start_y * cosine) / determinant
    is_hit = (distance > 0) & (share_of_edge >= 0) & (share_of_edge <= 1)
    return np.where(is_hit, distance, np.inf)


def brute_force(laser, circles, edges, x, y, yaw):
    """Return the ranges (beams,) by intersecting every beam with every obstacle."""
    angles = yaw + laser.first_angle + laser.increment * np.arange(laser.beams)
    directions = np.column_stack([np.cos(angles), np.sin(angles)])
    nearest = np.full(laser.beams, np.inf)
    for centre_x, centre_y, radius in circles:
        offset_x = centre_x - x
        offset_y = centre_y - y
        distances = distances_to_circle(directions, offset_x, offset_y, radius)
        nearest = np.minimum(nearest, distances)
    for edge in edges:
        start, end = np.reshape(edge, (2, 2)) - (x, y)
        nearest = np.minimum(nearest, distances_to_edge(directions, start, end))
    nearest[nearest >= laser.range_max] = np.inf
    nearest[nearest <= laser.range_min] = -np.inf
    return nearest


@seeds(60)
def test_scans_equal_brute_force(seed):
    # Given: up to 60 cylinders and 8 boxes around one of three lasers
    generator = np.random.default_rng(seed)
    circle_count = generator.integers(0, 60)
    box_count = generator.integers(0, 8)
    # From crowded to so wide that most is out of range.
    spread = generator.choice([3.0, 8.0, 25.0])

    circle_centres = generator.uniform(-spread, spread, (circle_count, 2))
    radii = generator.uniform(0.02, 1.5, circle_count)
    circles = np.column_stack([circle_centres, radii])

    box_centres = generator.uniform(-spread, spread, (box_count, 2))
    box_yaws = generator.uniform(-4, 4, box_count)
    box_sizes = generator.uniform(0.02, 5, (box_count, 2))
    boxes = np.column_stack([box_centres, box_yaws, box_sizes])

    laser = LASERS[seed % len(LASERS)]
    lidar = Lidar(laser, circles, boxes)
    for _ in range(4):
        # When: it scans from a random pose
        x, y = generator.uniform(-spread, spread, 2)
        yaw = generator.uniform(-7, 7)
        ranges = lidar.scan(x, y, yaw)
        # Inside an obstacle, all beams are too near.
        if np.isneginf(ranges).all():
            continue

        # Then
        expected = brute_force(laser, circles, lidar.edges, x, y, yaw)
        np.testing.assert_allclose(ranges, expected, rtol=0.0, atol=1e-5)


def test_an_obstacle_behind_reaches_into_both_ends_of_the_fan():
    behind = (-1.0, 0.0, 0.9)
    ranges = Lidar(LASER, [behind], []).scan(0.0, 0.0, 0.0)
    assert np.isfinite(ranges[0])
    assert np.isinf(ranges[AHEAD])
    assert np.isfinite(ranges[-1])
    assert ranges[0] == pytest.approx(ranges[-1], abs=1e-5)


@pytest.mark.parametrize(
    ("circles", "boxes"),
    [
        pytest.param([(0.0, 0.0, 1.0)], NO_BOXES, id="cylinder"),
        pytest.param(NO_CIRCLES, [(0, 0, 0.3, 2, 2)], id="box"),
    ],
)
def test_all_beams_inside_an_obstacle_are_too_near(circles, boxes):
    ranges = Lidar(LASER, circles, boxes).scan(0.3, 0, 0)
    assert np.isneginf(ranges).all()


def test_moving_circles_are_in_the_scan_they_are_given_for():
    lidar = Lidar(LASER, NO_CIRCLES, NO_BOXES)
    mover = np.array([(2.0, 0.0, 0.5)])
    ranges_with_mover = lidar.scan(0, 0, 0, mover)
    assert ranges_with_mover[AHEAD] == pytest.approx(1.5, abs=1e-3)
    ranges_without = lidar.scan(0, 0, 0)
    assert ranges_without[AHEAD] == np.inf
