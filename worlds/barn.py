"""BARN's worlds: their grid, the recipe that generates them, and the 300 built-in ones with their split.

The grid has 30 x 30 cells of .15 m behind a corridor; SDF reader (path files) and difficulty metrics use it, too. The
built-in worlds are data/builtin.npz, 23 kB of packed bits: what generate_field gives for 0 to 299, as a test sees.
"""

from __future__ import annotations

import functools
import math
import os
from typing import Dict, Optional, Tuple

import numpy as np
import scipy
from numpy.typing import ArrayLike

from . import search
from .world import Course, World

CELL_M = 0.15  # side of a cell [m]
ROWS = COLS = 30  # of the field; row r lies across (x), column c along (y) the course
CORRIDOR_COLUMNS = 34  # columns of the corridor before the field, the back wall included
CYLINDER_RADIUS_M = 0.075  # of every cylinder [m]
FIRST_CELL = (-4.425, 5.175)  # centre of cell (0, 0) [m]
CLEARANCE_CELLS = 2  # cells around a filled cell that are not free: a 5 x 5 window

START_Y_M, FINISH_Y_M = 4.075, 10.0  # of the paper's course [m]: 5.925 m
GOAL_BEYOND_PATH_M = 5.0  # the goal lies this far past the path's end: no slowing down before it
GOAL_TOLERANCE_M = 0.4


def to_xy(cells: ArrayLike) -> np.ndarray:
    """(k, 2) cells (row, column) -> (k, 2) centres (x, y) [m]."""
    cells = np.asarray(cells, dtype=np.float64).reshape(-1, 2)
    return cells * CELL_M + FIRST_CELL


def to_cells(xy: ArrayLike) -> np.ndarray:
    """(k, 2) points [m] -> (k, 2) int64 cells (row, column), which may lie outside the field."""
    xy = np.asarray(xy, dtype=np.float64).reshape(-1, 2)
    return np.rint((xy - FIRST_CELL) / CELL_M).astype(np.int64)


def fill_of(cylinders: ArrayLike) -> np.ndarray:
    """(n, 3) cylinders -> (30, 30) bool: the field's cells in which a cylinder's centre lies."""
    cells = to_cells(np.asarray(cylinders, dtype=np.float64).reshape(-1, 3)[:, :2])
    inside = np.all((cells >= 0) & (cells < (ROWS, COLS)), axis=1)
    filled = np.zeros((ROWS, COLS), dtype=bool)
    filled[cells[inside, 0], cells[inside, 1]] = True
    return filled


def cylinders_of(filled: np.ndarray) -> np.ndarray:
    """(30, 30) bool -> (n, 3) cylinders x, y, radius [m], with the corridor's walls and the wall behind the start."""
    back = [(r, -CORRIDOR_COLUMNS) for r in range(ROWS)]
    sides = [(r, c) for c in range(-CORRIDOR_COLUMNS + 1, 0) for r in (0, ROWS - 1)]
    xy = to_xy(np.concatenate([np.array(back + sides), np.argwhere(filled)]))
    return np.column_stack([xy, np.full(len(xy), CYLINDER_RADIUS_M)])


def paper_course(path: np.ndarray) -> Course:
    """The paper's course along a reference path (k, 2) [m]: start 1 m before its first point, done past y = 10."""
    (x0, _), (x1, y1) = path[0], path[-1]
    start, goal = (float(x0), START_Y_M, math.pi / 2), (float(x1), float(y1) + GOAL_BEYOND_PATH_M, math.pi / 2)
    return Course(start, goal, FINISH_Y_M, GOAL_TOLERANCE_M, path)


def challenge_course(path: np.ndarray) -> Course:
    """The BARN Challenge's course: one start for all worlds, goal 10 m ahead, done within 1 m of it."""
    return Course((-2.25, 3.0, math.pi / 2), (-2.25, 13.0, math.pi / 2), None, 1.0, path)


def make_world(name: str, filled: np.ndarray, path_cells: np.ndarray) -> World:
    """World from a field (30, 30) bool and a reference path (k, 2) of cells."""
    return World(name, cylinders_of(filled), np.zeros((0, 5)), paper_course(to_xy(path_cells)))


FILL_SHARES = (0.15, 0.20, 0.25, 0.30)  # probability that a cell is filled at first
SMOOTHING_ROUNDS = (2, 3, 4)  # rounds of smoothing
WORLDS_PER_KIND = 25  # worlds of each of the 12 kinds
COUNT = len(FILL_SHARES) * len(SMOOTHING_ROUNDS) * WORLDS_PER_KIND
SEED = 20201103  # of the built-in set


def kind(number: int) -> Tuple[float, int]:
    """(fill probability, smoothing rounds) of world `number`: number = 25 (3 i_fill + rounds - 2) + k."""
    i_fill, i_rounds = divmod((number % COUNT) // WORLDS_PER_KIND, len(SMOOTHING_ROUNDS))
    return FILL_SHARES[i_fill], SMOOTHING_ROUNDS[i_rounds]


def _neighbours(filled: np.ndarray, rows_outside: bool) -> np.ndarray:
    """Count the filled ones of each cell's 8 neighbours, (30, 30).

    Columns outside the field count as free, rows outside as `rows_outside`.
    """
    around = np.full((ROWS + 2, COLS + 2), rows_outside, np.uint8)
    around[1:-1] = 0
    around[1:-1, 1:-1] = filled
    columns = around[:-2] + around[1:-1] + around[2:]
    return columns[:, :-2] + columns[:, 1:-1] + columns[:, 2:] - filled


def smooth(filled: np.ndarray) -> np.ndarray:
    """One round, all cells at once: 5 or more filled neighbours fill a cell, 1 or fewer clear it.

    Rows outside count as filled, columns outside as free.
    """
    neighbours = _neighbours(filled, rows_outside=True)
    return (filled | (neighbours >= 5)) & (neighbours > 1)


def hollow(filled: np.ndarray) -> np.ndarray:
    """Without the cells that are enclosed on all 8 sides: BARN puts no cylinder where no robot or laser can tell."""
    return filled & (_neighbours(filled, rows_outside=False) < 8)


def draw_field(fill: float, rounds: int, rng: np.random.Generator) -> np.ndarray:
    """(30, 30) bool: a smoothed random field between two walls (rows 0 and 29), not yet hollowed."""
    filled = rng.random((ROWS, COLS)) < fill
    filled[[0, -1]] = True
    for _ in range(rounds):
        filled = smooth(filled)
    return filled


def draw_path(filled: np.ndarray, rng: np.random.Generator) -> Optional[np.ndarray]:
    """(k, 2) cells from a random free row of the first column to one of the last, or None where there is no way.

    The largest region that touches the first column must be the largest that touches the last one.
    """
    free = search.free_space(filled, CLEARANCE_CELLS)
    if not free.any(axis=0).all():
        return None  # most fields end here: a full column has no way through
    regions, _ = scipy.ndimage.label(free)
    sizes = np.bincount(regions.ravel())
    sizes[0] = 0
    start_region, goal_region = (regions[:, c][np.argmax(sizes[regions[:, c]])] for c in (0, -1))
    if start_region == 0 or start_region != goal_region:
        return None
    start = int(rng.choice(np.flatnonzero(regions[:, 0] == start_region)))
    goal = int(rng.choice(np.flatnonzero(regions[:, -1] == start_region)))
    return search.barn_path(free, (start, 0), (goal, COLS - 1))


def generate_field(number: int, seed: int = SEED) -> Tuple[np.ndarray, np.ndarray]:
    """(filled (30, 30) bool, hollowed; path (k, 2) int64 cells) of world `number`. Drawn until there is a path."""
    fill, rounds = kind(number)
    rng = np.random.default_rng([seed, number])
    while True:
        filled = draw_field(fill, rounds, rng)
        path = draw_path(filled, rng)
        if path is not None:
            return hollow(filled), path


def generate(number: int, seed: int = SEED) -> World:
    """World `number` of the set `seed`. Any number >= 0 gives a world; the recipe's kinds repeat every 300."""
    return make_world(f"generated:{number}", *generate_field(number, seed))


FILE = os.path.join(os.path.dirname(os.path.abspath(__file__)), "data", "builtin.npz")

# fmt: off
TEST = (  # the official test numbers of BARN
    0, 8, 17, 19, 27, 32, 41, 47, 48, 57, 64, 69, 76, 78, 88, 93, 100, 104, 112, 118, 123, 129, 133, 138, 144,
    150, 159, 163, 168, 175, 184, 189, 193, 201, 208, 214, 218, 226, 229, 237, 240, 246, 256, 258, 265, 270, 277, 284,
    290, 294,
)
# fmt: on
TRAIN = tuple(n for n in range(COUNT) if n not in TEST)
VALIDATION = TRAIN[4::8]  # training worlds set aside to choose among actors, variants and settings
LEARN = tuple(n for n in TRAIN if n not in VALIDATION)
SPLITS = {"train": TRAIN, "test": TEST, "validation": VALIDATION, "learn": LEARN}


def world(number: int) -> World:
    """World `number` (0 to 299) of the built-in ones."""
    filled, path = fields()[number]
    return make_world(f"generated:{number}", filled, path)


@functools.lru_cache(maxsize=1)
def fields() -> Dict[int, Tuple[np.ndarray, np.ndarray]]:
    """All built-in worlds: {number: (filled (30, 30) bool, path (k, 2) int64 cells)}."""
    with np.load(FILE, allow_pickle=False) as data:
        bits, ends, cells = data["filled"], data["path_ends"], data["path_cells"]
    shape = (COUNT, ROWS, COLS)
    filled = np.unpackbits(bits, count=int(np.prod(shape))).reshape(shape).astype(bool)
    paths = np.split(cells.astype(np.int64).reshape(-1, 2), ends[:-1])
    return {n: (filled[n], paths[n]) for n in range(COUNT)}
