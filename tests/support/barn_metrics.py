"""How hard a world is: BARN's five difficulty metrics, averaged over the reference path.

The generator's worlds are compared with BARN's by them. They equal BARN's published values to the last printed digit.
"""

import math

import numpy as np
from scipy import ndimage

from worlds import barn, search

NAMES = ("closest_obstacle", "visibility", "dispersion", "dimension", "tortuosity")

_DISPERSION_RADIUS = 3
# fmt: off
_SIXTEEN = ((0, 1), (1, 2), (1, 1), (2, 1), (1, 0), (2, -1), (1, -1), (1, -2),
            (0, -1), (-2, -1), (-1, -1), (-1, -2), (-1, 0), (-2, 1), (-1, 1), (-1, 2))
# fmt: on


def difficulty(world):
    """The five metrics of a world on BARN's grid (generated, or a BARN file), by the names in NAMES."""
    return grid_difficulty(barn.fill_of(world.cylinders), barn.to_cells(world.course.path))


def grid_difficulty(filled, path):
    """The five metrics from a field and its reference path.

    filled   (30, 30) bool
    path     (k, 2) cells
    closest_obstacle  distance to the nearest cell where the robot's centre cannot be [cells]
    visibility        mean free length along 8 rays [cells]
    dispersion        changes between wall and free around 16 rays of 3 cells
    dimension         least free length over the 4 axes [cells]
    tortuosity        arc / chord

    As in BARN's files, the path's first cell counts twice in every mean (its path files repeat it).
    """
    free = search.free_space(filled, barn.CLEARANCE_CELLS)
    distance = ndimage.distance_transform_edt(free)
    cells = [(int(r), int(c)) for r, c in path]
    cells.insert(0, cells[0])
    runs = [[_free_run(free, cell, move) for move in search.MOVES] for cell in cells]
    visibility = [sum((n + 1) * length for n, length in zip(run, search.LENGTHS)) / 8.0 for run in runs]
    dimension = [min((run[i] + run[i + 4]) * search.LENGTHS[i] for i in range(4)) for run in runs]
    steps = np.diff(np.asarray(path, dtype=np.float64), axis=0)
    chord = math.hypot(*(float(a - b) for a, b in zip(path[-1], path[0])))
    arc = float(np.hypot(steps[:, 0], steps[:, 1]).sum())
    return {
        "closest_obstacle": float(np.mean([distance[c] for c in cells])),
        "visibility": float(np.mean(visibility)),
        "dispersion": float(np.mean([_dispersion(free, c) for c in cells])),
        "dimension": float(np.mean(dimension)),
        "tortuosity": arc / chord if chord else 1.0,
    }


def _free_run(free, cell, move):
    """Free cells in a row from `cell`, itself not counted, in the direction of `move`."""
    rows, columns = free.shape
    r, c, n = cell[0] + move[0], cell[1] + move[1], 0
    while 0 <= r < rows and 0 <= c < columns and free[r, c]:
        r, c, n = r + move[0], c + move[1], n + 1
    return n


def _dispersion(free, cell):
    seen = [_meets_wall(free, cell, move) for move in _SIXTEEN]
    return sum(seen[i] != seen[i - 1] for i in range(len(seen)))


def _meets_wall(free, cell, move):
    """Whether a ray of 3 cells meets a cell that is not free. A step of +2 counts 2, one of -2, as in BARN, 1."""
    (r, c), gone = cell, 0
    while gone < _DISPERSION_RADIUS:
        r, c = r + move[0], c + move[1]
        if not (0 <= r < free.shape[0] and 0 <= c < free.shape[1]):
            return False
        if not free[r, c]:
            return True
        gone += 2 if 2 in move else 1
    return False
