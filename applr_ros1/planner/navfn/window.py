"""The part of the map that navfn's flood has to cover for a plan, and the check that the rest could not matter.

Called by navfn.Navfn. On a map that is filled by the laser most cells have never been anything but free, and a flood in
all directions spends most of its time there. So it is fenced in: by a rectangle around the robot, the goal and every
cell that was ever not free, with a margin. Nothing outside such a fence changes a potential inside if the wave leaves
it everywhere:

- Outside, every cell costs the same 50, the least that there is. A chain of updates that goes out at one cell of the
  rectangle's inner edge and along it for k cells is at least the edge's own potential there plus 50 k: a cell of the
  edge is at most 50 more than its neighbour. So a cell outside is never below the cell of the edge beside it.
- An update takes the lower of the two neighbours along each axis. Where the neighbour further in is lower than the
  edge, the one outside is never taken; and it is always reached later, so it never lists the edge's cell first.

Whether the wave leaves everywhere is looked up after each flood (`leaves`), with some slack for potentials that are not
settled; if it does not, the flood is repeated with a wider fence, and then without one.
tests/planner/navfn/test_navfn.py compares both on many maps.
"""

from __future__ import annotations

from typing import List, Tuple

import numpy as np

from applr_ros1.common.kernels import kernel

MARGINS = (20, 60)  # [cells] between the fence and what it is around: first and second try
INNER = 6  # [cells] that a plan keeps from the fence: it looks two cells around itself
ROWS = 3  # [cells] inside the fence in which the potential has to rise outwards,
SLACK = 10.0  # by at least this much a cell; a free cell costs 50
LARGEST = 0.7  # of the map: fencing off less is not worth it

Rectangle = Tuple[int, int, int, int]


def around(extent: np.ndarray, robot: int, goal: int, nx: int, ny: int) -> List[Rectangle]:
    """The fences to try, (x0, y0, x1, y1) as first and last columns and rows; none where it is not worth it.

    Args:
        extent: (4,) int64, least x and y and greatest x and y of the cells that were ever not free.
        robot: flat index of the robot's cell.
        goal: flat index of the goal's cell.
        nx: columns of the map.
        ny: rows of the map.
    """
    left, low, right, high = extent.tolist()
    for cell in (robot, goal):
        y, x = divmod(cell, nx)
        left, low, right, high = min(left, x), min(low, y), max(right, x), max(high, y)
    fences = [(max(0, left - m), max(0, low - m), min(nx - 1, right + m), min(ny - 1, high + m)) for m in MARGINS]
    return [(x0, y0, x1, y1) for x0, y0, x1, y1 in fences if (x1 - x0) * (y1 - y0) < LARGEST * nx * ny]


@kernel
def set_fence(weights, costs, push_weights, nx, x0, y0, x1, y1, closed):
    """Make the fence's cells obstacles (closed), or what the cost array says again."""
    for y in range(y0, y1 + 1):
        step = 1 if y in (y0, y1) else x1 - x0
        for x in range(x0, x1 + 1, step):
            k = y * nx + x
            weights[k] = np.float32(np.inf) if closed else push_weights[costs[k]]


@kernel
def leaves(potential, nx, ny, x0, y0, x1, y1):
    """Whether the wave rises outwards at every reached cell inside the fence; the map's own border needs no check."""
    return (
        (x0 == 0 or _rises(potential, (y0 + 1) * nx + x0 + 1, nx, y1 - y0 - 1, 1))
        and (x1 == nx - 1 or _rises(potential, (y0 + 1) * nx + x1 - 1, nx, y1 - y0 - 1, -1))
        and (y0 == 0 or _rises(potential, (y0 + 1) * nx + x0 + 1, 1, x1 - x0 - 1, nx))
        and (y1 == ny - 1 or _rises(potential, (y1 - 1) * nx + x0 + 1, 1, x1 - x0 - 1, -nx))
    )


@kernel
def _rises(potential, first, step, count, inwards):
    """Whether `count` cells from `first` on, and those behind them `inwards`, rise by SLACK, where they are reached."""
    for i in range(count):
        for row in range(ROWS):
            k = first + i * step + row * inwards
            if potential[k] < np.float32(1e10) and not potential[k] > potential[k + inwards] + np.float32(SLACK):
                return False
    return True


@kernel
def keeps_inside(path, count, nx, ny, x0, y0, x1, y1):
    """Whether the `count` points of `path` (n, 2) [cells] keep INNER cells from the fence, but for the map's border."""
    left = x0 + INNER if x0 > 0 else -1
    right = x1 - INNER if x1 < nx - 1 else nx
    low = y0 + INNER if y0 > 0 else -1
    high = y1 - INNER if y1 < ny - 1 else ny
    inside = True
    for i in range(count):
        inside = inside and left <= path[i, 0] <= right and low <= path[i, 1] <= high
    return inside
