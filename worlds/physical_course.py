"""Cardboard course of the paper, reconstructed from its text: `load("physical_course")`.

Boxes in a walled lane leave open space and tight passages, unlike any BARN world. The route is
about 22 m long, and default DWA takes about as long as in the paper (72.8 s).
"""

from __future__ import annotations

import math
from typing import List, Tuple

import numpy as np

from applr_ros1.common.arrays import Array

from .world import Course, World

NAME = "physical_course"

LANE_WIDTH_M = 4.0  # width of the lane, x from 0 to 4 [m]
LANE_LENGTH_M = 20.0  # length of the lane, y from 0 to 20 [m]
WALL_WIDTH_M = 0.3  # thickness of the walls of the lane [m]
START = (2.0, 0.8, math.pi / 2)
GOAL = (2.0, 19.4, math.pi / 2)
# finish line, before the goal because odometry drifts by decimetres over 20 m [m]
FINISH_Y_M = 18.8
GOAL_TOLERANCE_M = 0.4
CELL_M = 0.10  # cell size of the grid of the reference path [m]
# Corners of the reference path [cells]: the cheapest path with 0.3 m of clearance
PATH_CORNERS = (
    (20, 8),
    (20, 14),
    (22, 16),
    (22, 22),
    (28, 28),
    (28, 37),
    (22, 43),
    (22, 44),
    (12, 54),
    (12, 70),
    (20, 78),
    (20, 87),
    (19, 88),
    (19, 93),
    (20, 94),
    (20, 116),
    (19, 117),
    (19, 121),
    (30, 132),
    (30, 141),
    (14, 157),
    (14, 160),
    (13, 161),
    (13, 177),
    (17, 181),
    (17, 190),
    (20, 193),
)

BOX_LENGTH_M = 0.6  # approximate length of a box along its row [m]
BOX_WIDTH_M = 0.4  # width of a box across its row [m]
LARGEST_TILT = 0.06  # amplitude of the small rotations of the boxes in a row [rad]
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
    boxes = _walls()
    for y, from_x, to_x in ROWS:
        boxes += _row(y, from_x, to_x)
    boxes += LOOSE
    course = Course(START, GOAL, FINISH_Y_M, GOAL_TOLERANCE_M, _path())
    return World(NAME, np.zeros((0, 3)), np.array(boxes), course)


def _walls() -> List[Tuple[float, ...]]:
    """Return the four walls as boxes; the lane lies between their inner faces."""
    half_wall = 0.5 * WALL_WIDTH_M
    outer_width = LANE_WIDTH_M + 2 * WALL_WIDTH_M
    return [
        (-half_wall, 0.5 * LANE_LENGTH_M, 0.0, WALL_WIDTH_M, LANE_LENGTH_M),
        (LANE_WIDTH_M + half_wall, 0.5 * LANE_LENGTH_M, 0.0, WALL_WIDTH_M, LANE_LENGTH_M),
        (0.5 * LANE_WIDTH_M, -half_wall, 0.0, outer_width, WALL_WIDTH_M),
        (0.5 * LANE_WIDTH_M, LANE_LENGTH_M + half_wall, 0.0, outer_width, WALL_WIDTH_M),
    ]


def _row(y: float, from_x: float, to_x: float) -> List[Tuple[float, ...]]:
    """Return boxes of about .6 x .4 m side by side, each slightly rotated.

    The rotations come from a sine, so that the row looks irregular but is always the same.
    """
    box_count = max(1, int(round((to_x - from_x) / BOX_LENGTH_M)))
    box_length = (to_x - from_x) / box_count
    boxes: List[Tuple[float, ...]] = []
    for number in range(box_count):
        yaw = LARGEST_TILT * math.sin(7.0 * number + 3.0 * y + from_x)
        x = from_x + (number + 0.5) * box_length
        boxes.append((x, y + 0.5 * yaw, yaw, box_length, BOX_WIDTH_M))
    return boxes


def _path() -> Array:
    """Return the reference path (k, 2) [m]: the centres of the cells from corner to corner."""
    corners = np.array(PATH_CORNERS)
    cells = []
    for corner, leg in zip(corners, np.diff(corners, axis=0)):
        # A leg is straight or diagonal. Its last cell is the first of the next leg.
        steps = np.arange(np.abs(leg).max())[:, np.newaxis]
        cells.append(corner + np.sign(leg) * steps)
    cells.append(corners[-1:])
    centres: Array = CELL_M * (np.concatenate(cells) + 0.5)
    return centres
