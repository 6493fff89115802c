"""The part of the map that navfn's flood has to cover for a plan.

Called by navfn.Navfn. On a map that is filled by the laser most cells have never been anything but free, and a flood in
all directions spends most of its time there. So it is fenced in: by a rectangle around the robot, the goal and every
cell that was ever not free, with a margin. Outside, every cell costs 50, the least that there is. A chain of updates
that leaves the rectangle and comes back could as well go along its edge, for no more: so no cell outside is lower than
the cell of the edge beside it, and an update takes the lower of the two neighbours along each axis. Rounding shows in
the outermost row of cells alone. A plan that comes near it is traced again after a flood of the whole map.
tests/planner/navfn/test_navfn.py compares both on many maps.
"""

from __future__ import annotations

from typing import Optional, Tuple

import numpy as np

from applr_ros1.common.kernels import kernel

MARGIN = 7  # [cells] between the fence and what it is around
INNER = 4  # [cells] that a plan keeps from the fence: it looks two cells around itself
LARGEST = 0.7  # of the map: fencing off less is not worth it

Rectangle = Tuple[int, int, int, int]


def around(extent: np.ndarray, robot: int, goal: int, nx: int, ny: int) -> Optional[Rectangle]:
    """The fence (x0, y0, x1, y1) as first and last columns and rows; None where it is not worth it.

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
    x0, y0 = max(0, left - MARGIN), max(0, low - MARGIN)
    x1, y1 = min(nx - 1, right + MARGIN), min(ny - 1, high + MARGIN)
    return (x0, y0, x1, y1) if (x1 - x0) * (y1 - y0) < LARGEST * nx * ny else None


@kernel
def set_fence(weights, costs, push_weights, nx, x0, y0, x1, y1, closed):
    """Make the fence's cells obstacles (closed), or what the cost array says again."""
    for y in range(y0, y1 + 1):
        step = 1 if y in (y0, y1) else x1 - x0
        for x in range(x0, x1 + 1, step):
            k = y * nx + x
            weights[k] = np.float32(np.inf) if closed else push_weights[costs[k]]


@kernel
def keeps_inside(path, count, nx, ny, x0, y0, x1, y1):
    """Return true if `count` points of `path` (n, 2) [cells] keep INNER cells from the fence, the border aside."""
    left = x0 + INNER if x0 > 0 else -1
    right = x1 - INNER if x1 < nx - 1 else nx
    low = y0 + INNER if y0 > 0 else -1
    high = y1 - INNER if y1 < ny - 1 else ny
    inside = True
    for i in range(count):
        inside = inside and left <= path[i, 0] <= right and low <= path[i, 1] <= high
    return inside
