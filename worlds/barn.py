"""BARN worlds: grid, generator, and the 300 built-in worlds with their splits.

The grid of 30 x 30 cells of .15 m lies behind a corridor. The SDF reader (path files) and the
difficulty metrics use the grid as well. The built-in worlds in data/builtin.npz (23 kB of packed
bits) are the output of generate_field for 0 to 299, which a test verifies.
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
from applr_ros1.common.kernels import kernel

from . import search
from .search import Cells
from .world import Course, World

CELL_M = 0.15  # side of a cell [m]
# size of the field [cells]; rows count across the course (x), columns along it (y)
ROWS = COLS = 30
CORRIDOR_COLUMNS = 34  # columns of the corridor before the field, including the back wall
CYLINDER_RADIUS_M = 0.075  # radius of every cylinder [m]
FIRST_CELL = (-4.425, 5.175)  # centre of cell (0, 0) [m]
CLEARANCE_CELLS = 2  # half width of the blocked 5 x 5 window around a filled cell [cells]

START_Y_M = 4.075  # start line of the paper's course [m]
FINISH_Y_M = 10.0  # finish line of the paper's course, 5.925 m from its start [m]
# distance of the goal past the path's end, so that no robot brakes on the course [m]
GOAL_BEYOND_PATH_M = 5.0
GOAL_TOLERANCE_M = 0.4


def to_xy(cells: ArrayLike) -> Array:
    """Convert cells (k, 2) (row, column) to their centres (k, 2) (x, y) [m]."""
    cells = np.asarray(cells, dtype=np.float64).reshape(-1, 2)
    return cells * CELL_M + FIRST_CELL


def to_cells(xy: ArrayLike) -> Ints:
    """Convert points (k, 2) [m] to int64 cells (k, 2) (row, column).

    The cells may lie outside the field.
    """
    xy = np.asarray(xy, dtype=np.float64).reshape(-1, 2)
    return np.rint((xy - FIRST_CELL) / CELL_M).astype(np.int64)


def fill_of(cylinders: ArrayLike) -> Cells:
    """Return the cells (30, 30) bool of the field that contain the centre of a cylinder (n, 3)."""
    circles = np.asarray(cylinders, dtype=np.float64).reshape(-1, 3)
    cells = to_cells(circles[:, :2])
    # The cylinders of the corridor lie outside the field.
    is_inside = np.all((cells >= 0) & (cells < (ROWS, COLS)), axis=1)
    rows, columns = cells[is_inside].T
    filled = np.zeros((ROWS, COLS), dtype=bool)
    filled[rows, columns] = True
    return filled


def cylinders_of(filled: Cells) -> Array:
    """Return the cylinders (n, 3) x, y, radius [m] of a field (30, 30) and its corridor.

    The order is the corridor's back wall, its sides, and the filled cells.
    """
    corridor = []
    for row in range(ROWS):
        corridor.append((row, -CORRIDOR_COLUMNS))
    for column in range(-CORRIDOR_COLUMNS + 1, 0):
        corridor.append((0, column))
        corridor.append((ROWS - 1, column))
    cells = np.concatenate([np.array(corridor), np.argwhere(filled)])
    radii = np.full(len(cells), CYLINDER_RADIUS_M)
    return np.column_stack([to_xy(cells), radii])


def paper_course(path: Array) -> Course:
    """Return the paper's course along a path (k, 2) [m].

    It leads from 1 m before the path's first point to the line y = 10.
    """
    start_x = float(path[0, 0])
    end_x, end_y = path[-1].tolist()
    goal_y = end_y + GOAL_BEYOND_PATH_M
    return Course(
        start=(start_x, START_Y_M, math.pi / 2),
        goal=(end_x, goal_y, math.pi / 2),
        finish_y=FINISH_Y_M,
        goal_tolerance=GOAL_TOLERANCE_M,
        path=path,
    )


def challenge_course(path: Array) -> Course:
    """Return the BARN Challenge's course.

    All worlds have the same start, and a goal 10 m ahead with a tolerance of 1 m.
    """
    return Course(
        start=(-2.25, 3.0, math.pi / 2),
        goal=(-2.25, 13.0, math.pi / 2),
        finish_y=None,
        goal_tolerance=1.0,
        path=path,
    )


def make_world(name: str, filled: Cells, path_cells: Ints) -> World:
    """Return the world of a field (30, 30) bool with a reference path (k, 2) of cells."""
    return World(
        name=name,
        cylinders=cylinders_of(filled),
        boxes=np.zeros((0, 5)),
        course=paper_course(to_xy(path_cells)),
    )


FILL_SHARES = (0.15, 0.20, 0.25, 0.30)  # initial fill probabilities of a cell
SMOOTHING_ROUNDS = (2, 3, 4)  # numbers of smoothing rounds
WORLDS_PER_KIND = 25  # number of worlds of each of the 12 kinds
COUNT = len(FILL_SHARES) * len(SMOOTHING_ROUNDS) * WORLDS_PER_KIND
SEED = 20201103  # seed of the built-in worlds


def kind(number: int) -> Tuple[float, int]:
    """Return (fill probability, smoothing rounds) of world `number`.

    Each kind has 25 successive numbers.
    """
    kind_index = (number % COUNT) // WORLDS_PER_KIND
    fill_index, rounds_index = divmod(kind_index, len(SMOOTHING_ROUNDS))
    return FILL_SHARES[fill_index], SMOOTHING_ROUNDS[rounds_index]


@kernel
def _neighbours(filled: Cells, rows_outside: bool) -> NDArray[np.uint8]:
    """Count the filled cells (30, 30) among the 8 neighbours of each cell.

    Columns outside the field count as free. Rows outside count as filled if `rows_outside`.
    """
    padded = np.zeros((ROWS + 2, COLS + 2), np.uint8)
    if rows_outside:
        padded[0] = 1
        padded[-1] = 1
    padded[1:-1, 1:-1] = filled
    counts = np.empty((ROWS, COLS), np.uint8)
    for row in range(ROWS):
        for column in range(COLS):
            count = 0
            for padded_row in range(row, row + 3):
                for padded_column in range(column, column + 3):
                    count += padded[padded_row, padded_column]
            counts[row, column] = count - filled[row, column]
    return counts


def smooth(filled: Cells) -> Cells:
    """Apply one smoothing round.

    5 or more filled neighbours fill a cell, 1 or fewer clear it. Rows outside the field count as
    filled, columns outside as free.
    """
    neighbours = _neighbours(filled, True)
    return (filled | (neighbours >= 5)) & (neighbours > 1)


def hollow(filled: Cells) -> Cells:
    """Clear cells enclosed on all 8 sides.

    BARN omits these cylinders, because neither a robot nor a laser can reach them.
    """
    return filled & (_neighbours(filled, False) < 8)


def draw_field(fill: float, rounds: int, rng: np.random.Generator) -> Cells:
    """Draw a smoothed random field (30, 30) bool between two walls (rows 0 and 29).

    The field is not yet hollowed.
    """
    filled = rng.random((ROWS, COLS)) < fill
    # The walls beside the course take part in the smoothing, which grows obstacles out of them.
    filled[[0, -1]] = True
    for _ in range(rounds):
        filled = smooth(filled)
    return filled


def draw_path(filled: Cells, rng: np.random.Generator) -> Optional[Ints]:
    """Draw a path (k, 2) of cells between random free rows of the first and last column.

    The largest region that touches the first column must also be the largest that touches the last
    column. Return None if it is not, or if the search finds no path.
    """
    free_cells = search.free_space(filled, CLEARANCE_CELLS)
    if not free_cells.any(axis=0).all():
        return None  # Most fields are rejected here, because a full column blocks every path.
    regions, _ = scipy.ndimage.label(free_cells)
    region_sizes = np.bincount(regions.ravel())
    region_sizes[0] = 0  # label of all blocked cells
    first_column = regions[:, 0]
    last_column = regions[:, -1]
    region = first_column[np.argmax(region_sizes[first_column])]
    if region == 0 or region != last_column[np.argmax(region_sizes[last_column])]:
        return None
    start_row = int(rng.choice(np.flatnonzero(first_column == region)))
    goal_row = int(rng.choice(np.flatnonzero(last_column == region)))
    return search.barn_path(free_cells, (start_row, 0), (goal_row, COLS - 1))


def generate_field(number: int, seed: int = SEED) -> Tuple[Cells, Ints]:
    """Return (hollowed field (30, 30) bool, path (k, 2) int64) of world `number`.

    Fields are drawn until one has a path.
    """
    fill, rounds = kind(number)
    rng = np.random.default_rng([seed, number])
    while True:
        filled = draw_field(fill, rounds, rng)
        path_cells = draw_path(filled, rng)
        if path_cells is not None:
            return hollow(filled), path_cells


def generate(number: int, seed: int = SEED) -> World:
    """Return world `number` >= 0 of a seed. The kinds of the recipe repeat every 300 worlds."""
    return make_world(f"generated:{number}", *generate_field(number, seed))


FOLDER = os.path.dirname(os.path.abspath(__file__))
FILE = os.path.join(FOLDER, "data", "builtin.npz")

# fmt: off
TEST = (  # official test worlds of BARN
    0, 8, 17, 19, 27, 32, 41, 47, 48, 57, 64, 69, 76, 78, 88, 93,
    100, 104, 112, 118, 123, 129, 133, 138, 144, 150, 159, 163, 168, 175, 184, 189, 193,
    201, 208, 214, 218, 226, 229, 237, 240, 246, 256, 258, 265, 270, 277, 284, 290, 294,
)
# fmt: on
TRAIN = tuple(number for number in range(COUNT) if number not in TEST)
# training worlds reserved for the selection of policies, methods and settings
VALIDATION = TRAIN[4::8]
LEARN = tuple(number for number in TRAIN if number not in VALIDATION)
SPLITS = {"train": TRAIN, "test": TEST, "validation": VALIDATION, "learn": LEARN}


def world(number: int) -> World:
    """Return built-in world `number` (0 to 299)."""
    filled, path_cells = fields()[number]
    return make_world(f"generated:{number}", filled, path_cells)


@functools.lru_cache(maxsize=1)
def fields() -> Dict[int, Tuple[Cells, Ints]]:
    """Return all built-in worlds as {number: (filled (30, 30) bool, path (k, 2) int64 cells)}."""
    with np.load(FILE, allow_pickle=False) as archive:
        packed_fields = archive["filled"]
        path_ends = archive["path_ends"]
        path_cells = archive["path_cells"].astype(np.int64).reshape(-1, 2)
    # The bits of the last byte past the last cell are padding.
    unpacked_cells = np.unpackbits(packed_fields, count=COUNT * ROWS * COLS)
    filled = unpacked_cells.reshape(COUNT, ROWS, COLS).astype(bool)
    cell_paths = np.split(path_cells, path_ends[:-1])
    return dict(enumerate(zip(filled, cell_paths)))
