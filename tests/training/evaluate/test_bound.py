"""Tests of the bound of a drive's time: shortest free way, and limits of the base, from rest."""

import dataclasses
import math

import numpy as np
import pytest

from applr_ros1.robots import JACKAL
from training.evaluate import bound
from worlds import Course, World


def world_of(cylinders=(), boxes=()):
    """Return a world in which the robot drives 10 m ahead, along a path of 12 m."""
    course = Course(
        start=(0.0, 0.0, math.pi / 2),
        goal=(0.0, 11.0, math.pi / 2),
        finish_y=10.0,
        goal_tolerance=0.0,
        path=np.array([(3.0, 4.0), (3.0, 8.0), (3.0, 12.0)]),
    )
    return World(
        "made-up",
        np.array(cylinders, np.float64).reshape(-1, 3),
        np.array(boxes, np.float64).reshape(-1, 5),
        course,
    )


def around(x, y, radius):
    """Return the length of the way that passes a circle at (x, y) on its right, up to the line."""
    distance = math.hypot(x, y)
    turned = math.atan2(x, y) + math.asin(radius / distance)
    return math.sqrt(distance**2 - radius**2) + radius * turned + 10.0 - y


# Two walls of 4 m with a gap of 0.5 m between them, straight ahead
WALLS = [(-2.25, 5.0, 0.0, 4.0, 0.2), (2.25, 5.0, 0.0, 4.0, 0.2)]


@pytest.mark.parametrize(
    ("cylinders", "boxes", "radius", "length"),
    [
        ([], [], 0.2, 10.0),
        ([], WALLS, 0.2, 10.0),
        ([], WALLS, 0.35, around(4.25, 4.9, 0.35)),
        ([(0.0, 5.0, 3.0)], [], 0.2, around(0.0, 5.0, 3.2)),
    ],
)
def test_the_length_is_at_most_that_of_the_shortest_way_of_a_disc(cylinders, boxes, radius, length):
    shortest_m = bound.shortest_m(world_of(cylinders, boxes), radius)
    # The moves of the grid cost up to 8 %, but never where the way is straight.
    assert 0.92 * length < shortest_m <= length
    if length == 10.0:
        assert shortest_m > 9.9


@pytest.mark.parametrize(
    ("max_speed", "max_acceleration", "seconds"),
    [
        # 10 m with a ramp of 1 m in 1 s
        (2.0, 2.0, 1.0 + 9.0 / 2.0),
        # It is still accelerating at the end.
        (20.0, 5.0, 2.0),
    ],
)
def test_the_bound_is_the_time_from_rest_at_the_limits_of_the_base(
    max_speed, max_acceleration, seconds
):
    limits = {"max_speed": max_speed, "max_acceleration": max_acceleration}
    base = JACKAL.base.model_copy(update=limits)
    robot = dataclasses.replace(JACKAL, base=base)
    assert bound.bound_s(world_of(), robot) == pytest.approx(seconds, rel=0.01)


def test_the_robot_passes_with_its_inscribed_circle():
    # The Jackal is 0.42 m wide, and 0.62 m from corner to corner.
    passing = bound.bound_s(world_of(boxes=WALLS), JACKAL)
    assert passing == pytest.approx(bound.bound_s(world_of(), JACKAL))
