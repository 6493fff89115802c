"""BARN worlds: grid, generator, and the 300 built-in worlds with their splits.

The grid of 30 x 30 cells of .15 m lies behind a corridor. The SDF reader (path files) and the difficulty metrics use
the grid as well. The built-in worlds in data/builtin.npz (23 kB of packed bits) are the output of generate_field for 0
to 299, which a test verifies.
"""

from __future__ import annotations

import functools
import math
import os
from typing import Dict, Optional, Tuple

import numpy as np
import scipy
from numpy.typing import ArrayLike, NDArray

from applr_ros1.common.arrays import Array, Ints

from . import search
from .search import Cells
from .world import Course, World

CELL_M = 0.15  # side of a cell [m]
ROWS = COLS = 30  # size of the field [cells]; rows count across the course (x), columns along it (y)
CORRIDOR_COLUMNS = 34  # columns of the corridor before the field, including the back wall
CYLINDER_RADIUS_M = 0.075  # radius of every cylinder [m]
FIRST_CELL = (-4.425, 5.175)  # centre of cell (0, 0) [m]
CLEARANCE_CELLS = 2  # half width of the blocked 5 x 5 window around a filled cell [cells]

START_Y_M, FINISH_Y_M = 4.075, 10.0  # start and finish line of the paper's course, 5.925 m apart [m]
GOAL_BEYOND_PATH_M = 5.0  # distance of the goal past the path's end, so that no robot brakes on the course [m]
GOAL_TOLERANCE_M = 0.4


def to_xy(cells: ArrayLike) -> Array:
    """Convert cells (k, 2) (row, column) to their centres (k, 2) (x, y) [m]."""
    cells = np.asarray(cells, dtype=np.float64).reshape(-1, 2)
    return cells * CELL_M + FIRST_CELL


def to_cells(xy: ArrayLike) -> Ints:
    """Convert points (k, 2) [m] to int64 cells (k, 2) (row, column), which may lie outside the field."""
    xy = np.asarray(xy, dtype=np.float64).reshape(-1, 2)
    return np.rint((xy - FIRST_CELL) / CELL_M).astype(np.int64)


def fill_of(cylinders: ArrayLike) -> Cells:
    """Return the cells (30, 30) bool of the field that contain the centre of a cylinder (n, 3)."""
    cells = to_cells(np.asarray(cylinders, dtype=np.float64).reshape(-1, 3)[:, :2])
    inside = np.all((cells >= 0) & (cells < (ROWS, COLS)), axis=1)
    filled = np.zeros((ROWS, COLS), dtype=bool)
    filled[cells[inside, 0], cells[inside, 1]] = True
    return filled


def cylinders_of(filled: Cells) -> Array:
    """Return the cylinders (n, 3) x, y, radius [m] of filled cells (30, 30), of the corridor and of its back wall."""
    back = [(r, -CORRIDOR_COLUMNS) for r in range(ROWS)]
    sides = [(r, c) for c in range(-CORRIDOR_COLUMNS + 1, 0) for r in (0, ROWS - 1)]
    xy = to_xy(np.concatenate([np.array(back + sides), np.argwhere(filled)]))
    return np.column_stack([xy, np.full(len(xy), CYLINDER_RADIUS_M)])


def paper_course(path: Array) -> Course:
    """Return the paper's course along a path (k, 2) [m], from 1 m before its first point to the line y = 10."""
    (x0, _), (x1, y1) = path[0], path[-1]
    start, goal = (float(x0), START_Y_M, math.pi / 2), (float(x1), float(y1) + GOAL_BEYOND_PATH_M, math.pi / 2)
    return Course(start, goal, FINISH_Y_M, GOAL_TOLERANCE_M, path)


def challenge_course(path: Array) -> Course:
    """Return the BARN Challenge's course: one start for all worlds, and a goal 10 m ahead with a tolerance of 1 m."""
    return Course((-2.25, 3.0, math.pi / 2), (-2.25, 13.0, math.pi / 2), None, 1.0, path)


def make_world(name: str, filled: Cells, path_cells: Ints) -> World:
    """Return the world of a field (30, 30) bool with a reference path (k, 2) of cells."""
    return World(name, cylinders_of(filled), np.zeros((0, 5)), paper_course(to_xy(path_cells)))


FILL_SHARES = (0.15, 0.20, 0.25, 0.30)  # initial fill probabilities of a cell
SMOOTHING_ROUNDS = (2, 3, 4)  # numbers of smoothing rounds
WORLDS_PER_KIND = 25  # number of worlds of each of the 12 kinds
COUNT = len(FILL_SHARES) * len(SMOOTHING_ROUNDS) * WORLDS_PER_KIND
SEED = 20201103  # seed of the built-in worlds


def kind(number: int) -> Tuple[float, int]:
    """Return (fill probability, smoothing rounds) of world `number`. Each kind has 25 successive numbers."""
    i_fill, i_rounds = divmod((number % COUNT) // WORLDS_PER_KIND, len(SMOOTHING_ROUNDS))
    return FILL_SHARES[i_fill], SMOOTHING_ROUNDS[i_rounds]


def _neighbours(filled: Cells, rows_outside: bool) -> NDArray[np.uint8]:
    """Count the filled cells (30, 30) among the 8 neighbours of each cell.

    Columns outside the field count as free. Rows outside count as filled if `rows_outside`.
    """
    around = np.full((ROWS + 2, COLS + 2), rows_outside, np.uint8)
    around[1:-1] = 0
    around[1:-1, 1:-1] = filled
    columns = around[:-2] + around[1:-1] + around[2:]
    counts: NDArray[np.uint8] = columns[:, :-2] + columns[:, 1:-1] + columns[:, 2:] - filled
    return counts


def smooth(filled: Cells) -> Cells:
    """Apply one smoothing round: 5 or more filled neighbours fill a cell, 1 or fewer clear the cell.

    Rows outside the field count as filled, columns outside as free.
    """
    neighbours = _neighbours(filled, rows_outside=True)
    return (filled | (neighbours >= 5)) & (neighbours > 1)


def hollow(filled: Cells) -> Cells:
    """Clear cells enclosed on all 8 sides: BARN omits cylinders that neither a robot nor a laser can reach."""
    return filled & (_neighbours(filled, rows_outside=False) < 8)


def draw_field(fill: float, rounds: int, rng: np.random.Generator) -> Cells:
    """Draw a smoothed random field (30, 30) bool between two walls (rows 0 and 29), not yet hollowed."""
    filled = rng.random((ROWS, COLS)) < fill
    filled[[0, -1]] = True
    for _ in range(rounds):
        filled = smooth(filled)
    return filled


def draw_path(filled: Cells, rng: np.random.Generator) -> Optional[Ints]:
    """Draw a path (k, 2) of cells between random free rows of the first and last column, or None if there is none.

    The largest region that touches the first column must also be the largest that touches the last column.
    """
    free = search.free_space(filled, CLEARANCE_CELLS)
    if not free.any(axis=0).all():
        return None  # Most fields are rejected here, because a full column blocks every path.
    regions, _ = scipy.ndimage.label(free)
    sizes = np.bincount(regions.ravel())
    sizes[0] = 0
    start_region, goal_region = (regions[:, c][np.argmax(sizes[regions[:, c]])] for c in (0, -1))
    if start_region == 0 or start_region != goal_region:
        return None
    start = int(rng.choice(np.flatnonzero(regions[:, 0] == start_region)))
    goal = int(rng.choice(np.flatnonzero(regions[:, -1] == start_region)))
    return search.barn_path(free, (start, 0), (goal, COLS - 1))


def generate_field(number: int, seed: int = SEED) -> Tuple[Cells, Ints]:
    """Return (hollowed field (30, 30) bool, path (k, 2) int64) of world `number`. Redraw until there is a path."""
    fill, rounds = kind(number)
    rng = np.random.default_rng([seed, number])
    while True:
        filled = draw_field(fill, rounds, rng)
        path = draw_path(filled, rng)
        if path is not None:
            return hollow(filled), path


def generate(number: int, seed: int = SEED) -> World:
    """Return world `number` >= 0 of a seed. The kinds of the recipe repeat every 300 worlds."""
    return make_world(f"generated:{number}", *generate_field(number, seed))


FILE = os.path.join(os.path.dirname(os.path.abspath(__file__)), "data", "builtin.npz")

# fmt: off
TEST = (  # official test worlds of BARN
    0, 8, 17, 19, 27, 32, 41, 47, 48, 57, 64, 69, 76, 78, 88, 93, 100, 104, 112, 118, 123, 129, 133, 138, 144,
    150, 159, 163, 168, 175, 184, 189, 193, 201, 208, 214, 218, 226, 229, 237, 240, 246, 256, 258, 265, 270, 277, 284,
    290, 294,
)
# fmt: on
TRAIN = tuple(n for n in range(COUNT) if n not in TEST)
VALIDATION = TRAIN[4::8]  # training worlds reserved for the selection of policies, methods and settings
LEARN = tuple(n for n in TRAIN if n not in VALIDATION)
SPLITS = {"train": TRAIN, "test": TEST, "validation": VALIDATION, "learn": LEARN}


def world(number: int) -> World:
    """Return built-in world `number` (0 to 299)."""
    filled, path = fields()[number]
    return make_world(f"generated:{number}", filled, path)


@functools.lru_cache(maxsize=1)
def fields() -> Dict[int, Tuple[Cells, Ints]]:
    """Return all built-in worlds as {number: (filled (30, 30) bool, path (k, 2) int64 cells)}."""
    with np.load(FILE, allow_pickle=False) as data:
        bits, ends, cells = data["filled"], data["path_ends"], data["path_cells"]
    shape = (COUNT, ROWS, COLS)
    filled = np.unpackbits(bits, count=int(np.prod(shape))).reshape(shape).astype(bool)
    paths = np.split(cells.astype(np.int64).reshape(-1, 2), ends[:-1])
    return {n: (filled[n], paths[n]) for n in range(COUNT)}
