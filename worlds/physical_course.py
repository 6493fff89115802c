"""The paper's cardboard course, as far as its text tells: boxes in a walled area, relatively open, with tight passages
and turns, unlike any BARN world. `load("physical_course")` gives it; its course is long (about 25 m)."""
from __future__ import annotations

import math
from typing import List, Tuple

import numpy as np

from . import course as courses
from . import search
from .world import Course, World

NAME = "physical_course"

WIDTH, LENGTH = 6.0, 12.0               # of the walled area [m]; x from 0 to 6, y from 0 to 12
START = (0.9, 0.8, math.pi / 2)
GOAL = (5.1, 11.3, math.pi / 2)
GOAL_TOLERANCE = 0.4

# Rows of cardboard boxes that reach across the area but for one gap: y, gap from x, gap to x [m]
BAFFLES = ((2.4, 4.7, 5.6), (4.6, 0.5, 1.3), (6.9, 4.6, 5.5), (9.3, 0.6, 1.5))
# Boxes that stand alone in the rooms between: x, y, yaw, size_x, size_y
LOOSE = ((2.7, 0.9, 0.5, 0.6, 0.45),
         (2.1, 3.6, -0.3, 0.55, 0.4), (4.0, 3.3, 0.9, 0.5, 0.5),
         (3.1, 5.9, 0.2, 0.6, 0.4),
         (1.7, 8.0, 0.7, 0.5, 0.4), (3.6, 7.9, -0.6, 0.6, 0.45),
         (2.6, 10.8, 0.3, 0.6, 0.4), (4.1, 10.2, -0.8, 0.5, 0.4))


def world() -> World:
    """The course, the same every time."""
    boxes = np.array(_walls() + [box for baffle in BAFFLES for box in _baffle(*baffle)] + list(LOOSE))
    return World(name=NAME, cylinders=np.zeros((0, 3)), boxes=boxes, course=_course(boxes))


def _walls() -> List[Tuple[float, ...]]:
    t = 0.3
    return [(-0.5 * t, 0.5 * LENGTH, 0.0, t, LENGTH), (WIDTH + 0.5 * t, 0.5 * LENGTH, 0.0, t, LENGTH),
            (0.5 * WIDTH, -0.5 * t, 0.0, WIDTH + 2 * t, t), (0.5 * WIDTH, LENGTH + 0.5 * t, 0.0, WIDTH + 2 * t, t)]


def _baffle(y: float, gap_from: float, gap_to: float) -> List[Tuple[float, ...]]:
    """Boxes of about .6 x .4 m side by side, each a little askew, as people put cardboard boxes down."""
    boxes = []
    for low, high in ((0.0, gap_from), (gap_to, WIDTH)):
        count = max(1, int(round((high - low) / 0.6)))
        side = (high - low) / count
        for n in range(count):
            askew = 0.06 * math.sin(7.0 * n + 3.0 * y)
            boxes.append((low + (n + 0.5) * side, y + 0.5 * askew, askew, side, 0.4))
    return boxes


def _course(boxes: np.ndarray) -> Course:
    low, high = np.zeros(2), np.array([WIDTH, LENGTH])
    free = courses.free_grid(low, high, np.zeros((0, 3)), boxes)
    cell = [tuple(int(v) for v in (np.array(p[:2]) - low) / courses.SEARCH_CELL) for p in (START, GOAL)]
    cells = search.shortest_path(free, cell[:1], cell[1:])
    path = low + courses.SEARCH_CELL * (cells + 0.5)
    return Course(start=START, goal=GOAL, finish_y=None, goal_tolerance=GOAL_TOLERANCE, path=path)
