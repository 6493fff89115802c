"""Cardboard course of the paper, reconstructed from its text: `load("physical_course")`.

Boxes in a walled lane leave open space and tight passages, unlike any BARN world. The route is about 22 m long, and
default DWA takes about as long as in the paper (72.8 s).
"""

from __future__ import annotations

import math
from typing import List, Tuple

import numpy as np

from .world import Course, World

NAME = "physical_course"

LANE_WIDTH_M, LANE_LENGTH_M = 4.0, 20.0  # size of the lane, x from 0 to 4 and y from 0 to 20 [m]
START = (2.0, 0.8, math.pi / 2)
GOAL = (2.0, 19.4, math.pi / 2)
FINISH_Y_M = 18.8  # finish line, before the goal because odometry drifts by decimetres over 20 m [m]
GOAL_TOLERANCE_M = 0.4
CELL_M = 0.10  # cell size of the grid of the reference path [m]
# Corners of the reference path [cells]: the cheapest path with 0.3 m of clearance
# fmt: off
PATH_CORNERS = (
    (20, 8), (20, 14), (22, 16), (22, 22), (28, 28), (28, 37), (22, 43), (22, 44), (12, 54), (12, 70),
    (20, 78), (20, 87), (19, 88), (19, 93), (20, 94), (20, 116), (19, 117), (19, 121), (30, 132), (30, 141),
    (14, 157), (14, 160), (13, 161), (13, 177), (17, 181), (17, 190), (20, 193),
)
# fmt: on

# Rows of cardboard boxes across the lane: y, from x, to x [m]. The comments give the gaps.
ROWS = (
    (3.2, 0.0, 2.3),  # 1.7 m on the right
    (5.8, 1.8, 4.0),  # 1.8 m on the left
    (8.2, 0.0, 1.6),
    (8.2, 2.5, 4.0),  # the narrow part: .9 m wide,
    (8.8, 0.0, 1.55),
    (8.8, 2.45, 4.0),  # 1.6 m long, and not quite straight
    (9.4, 0.0, 1.55),
    (9.4, 2.45, 4.0),
    (13.6, 0.0, 2.5),  # 1.5 m on the right
    (16.2, 0.0, 0.9),
    (16.2, 1.85, 4.0),  # .95 m on the left
)
# Single boxes in the open parts: x, y, yaw, size_x, size_y [m, rad]
LOOSE = (
    (0.9, 1.9, 0.5, 0.6, 0.45),
    (3.1, 4.6, -0.3, 0.55, 0.4),
    (1.2, 11.4, 0.7, 0.5, 0.4),
    (2.9, 11.8, -0.6, 0.6, 0.45),
    (3.2, 17.9, 0.3, 0.6, 0.4),
    (0.9, 18.3, -0.8, 0.5, 0.4),
)


def world() -> World:
    """Return the world, which is always the same."""
    boxes = np.array(_walls() + [box for row in ROWS for box in _row(*row)] + list(LOOSE))
    course = Course(START, GOAL, FINISH_Y_M, GOAL_TOLERANCE_M, _path())
    return World(name=NAME, cylinders=np.zeros((0, 3)), boxes=boxes, course=course)


def _walls() -> List[Tuple[float, ...]]:
    t = 0.3
    return [
        (-0.5 * t, 0.5 * LANE_LENGTH_M, 0.0, t, LANE_LENGTH_M),
        (LANE_WIDTH_M + 0.5 * t, 0.5 * LANE_LENGTH_M, 0.0, t, LANE_LENGTH_M),
        (0.5 * LANE_WIDTH_M, -0.5 * t, 0.0, LANE_WIDTH_M + 2 * t, t),
        (0.5 * LANE_WIDTH_M, LANE_LENGTH_M + 0.5 * t, 0.0, LANE_WIDTH_M + 2 * t, t),
    ]


def _row(y: float, low: float, high: float) -> List[Tuple[float, ...]]:
    """Return boxes of about .6 x .4 m side by side, each slightly rotated."""
    count = max(1, int(round((high - low) / 0.6)))
    side = (high - low) / count
    askew = [0.06 * math.sin(7.0 * n + 3.0 * y + low) for n in range(count)]
    return [(low + (n + 0.5) * side, y + 0.5 * a, a, side, 0.4) for n, a in enumerate(askew)]


def _path() -> np.ndarray:
    """Return the reference path (k, 2) [m]: the centres of the cells from corner to corner."""
    corners = np.array(PATH_CORNERS)
    legs = [a + np.sign(b - a) * np.arange(np.abs(b - a).max())[:, None] for a, b in zip(corners[:-1], corners[1:])]
    return CELL_M * (np.concatenate([*legs, corners[-1:]]) + 0.5)
