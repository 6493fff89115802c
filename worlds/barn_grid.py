"""BARN's grid: 30 x 30 cells of .15 m behind a corridor, and how cells, paths and worlds in metres belong together.

The generator, the built-in worlds, the SDF reader (for path files) and the difficulty metrics use it.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike

from .world import Course, World

CELL = 0.15  # side of a cell [m]
ROWS = COLS = 30  # of the field; row r lies across (x), column c along (y) the course
CORRIDOR = 34  # columns of the corridor before the field, the back wall included
RADIUS = 0.075  # of every cylinder [m]
ORIGIN = (-4.425, 5.175)  # centre of cell (0, 0) [m]
CLEARANCE = 2  # cells around a filled cell that are not free: a 5 x 5 window

START_Y, FINISH_Y = 4.075, 10.0  # of the paper's course [m]: 5.925 m
GOAL_BEYOND = 5.0  # the goal lies this far past the path's end: no slowing down before it
GOAL_TOLERANCE = 0.4


def to_xy(cells: ArrayLike) -> np.ndarray:
    """(k, 2) cells (row, column) -> (k, 2) centres (x, y) [m]."""
    cells = np.asarray(cells, dtype=np.float64).reshape(-1, 2)
    return cells * CELL + ORIGIN


def to_cells(xy: ArrayLike) -> np.ndarray:
    """(k, 2) points [m] -> (k, 2) int64 cells (row, column), which may lie outside the field."""
    xy = np.asarray(xy, dtype=np.float64).reshape(-1, 2)
    return np.rint((xy - ORIGIN) / CELL).astype(np.int64)


def fill_of(cylinders: ArrayLike) -> np.ndarray:
    """(n, 3) cylinders -> (30, 30) bool: the field's cells in which a cylinder's centre lies."""
    cells = to_cells(np.asarray(cylinders, dtype=np.float64).reshape(-1, 3)[:, :2])
    inside = np.all((cells >= 0) & (cells < (ROWS, COLS)), axis=1)
    filled = np.zeros((ROWS, COLS), dtype=bool)
    filled[cells[inside, 0], cells[inside, 1]] = True
    return filled


def cylinders_of(filled: np.ndarray) -> np.ndarray:
    """(30, 30) bool -> (n, 3) cylinders x, y, radius [m], with the corridor's walls and the wall behind the start."""
    back = [(r, -CORRIDOR) for r in range(ROWS)]
    sides = [(r, c) for c in range(-CORRIDOR + 1, 0) for r in (0, ROWS - 1)]
    xy = to_xy(np.concatenate([np.array(back + sides), np.argwhere(filled)]))
    return np.column_stack([xy, np.full(len(xy), RADIUS)])


def paper_course(path: np.ndarray) -> Course:
    """The paper's course along a reference path (k, 2) [m]: start 1 m before its first point, done past y = 10."""
    (x0, _), (x1, y1) = path[0], path[-1]
    return Course(
        start=(float(x0), START_Y, math.pi / 2),
        goal=(float(x1), float(y1) + GOAL_BEYOND, math.pi / 2),
        finish_y=FINISH_Y,
        goal_tolerance=GOAL_TOLERANCE,
        path=path,
    )


def challenge_course(path: np.ndarray) -> Course:
    """The BARN Challenge's course: one start for all worlds, goal 10 m ahead, done within 1 m of it."""
    return Course(
        start=(-2.25, 3.0, math.pi / 2), goal=(-2.25, 13.0, math.pi / 2), finish_y=None, goal_tolerance=1.0, path=path
    )


def make_world(name: str, filled: np.ndarray, path_cells: np.ndarray) -> World:
    """World from a field (30, 30) bool and a reference path (k, 2) of cells."""
    return World(
        name=name, cylinders=cylinders_of(filled), boxes=np.zeros((0, 5)), course=paper_course(to_xy(path_cells))
    )
