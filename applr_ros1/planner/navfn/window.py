"""Fence: rectangle of obstacle cells that limits navfn's propagation of the potential (flood.py).

Called by navfn.Navfn. A flood inside the fence gives the same plan as a flood of the whole map, in less time: on a map
that only the laser fills, most cells have always been free. The fence surrounds the robot, the goal and every cell that
was ever not free, with a margin. All cells outside have the lowest cost, 50, so a detour outside costs at least as much
as a way along the inner edge. No outside cell can therefore lower the potential of the edge cell beside it. Rounding
may change only the outermost row of cells inside. If a plan comes near this row, the whole map is flooded and the plan
traced again. tests/planner/navfn/test_navfn.py compares plans with and without the fence on many maps.
"""

from __future__ import annotations

from typing import Optional

import numpy as np

from applr_ros1.common.arrays import Data
from applr_ros1.common.kernels import kernel
from applr_ros1.planner.costmap.grid import Window
from applr_ros1.planner.navfn.flood import PUSH_WEIGHTS

MARGIN = 7  # distance from the fence to the cells that it encloses [cells]
INNER = 4  # smallest accepted distance of a plan from the fence [cells]; tracing reads two cells around the plan
LARGEST = 0.7  # largest share of the map inside a fence; a larger fence saves no time


def around(extent: np.ndarray, robot: int, goal: int, nx: int, ny: int) -> Optional[Window]:
    """Return the fence (first column, first row, last column, last row), or None if it would save no time.

    Args:
        extent: (4,) int64, lowest x and y and highest x and y of the cells that were ever not free.
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
def set_fence(field: Data, costs: Data, nx: int, fence: Window, closed: bool) -> None:
    """Make the fence's cells obstacles if `closed`, otherwise restore their weights from `costs`."""
    x0, y0, x1, y1 = fence
    for y in range(y0, y1 + 1):
        step = 1 if y in (y0, y1) else x1 - x0
        for x in range(x0, x1 + 1, step):
            k = y * nx + x
            field[2 * k + 1] = np.float32(np.inf) if closed else PUSH_WEIGHTS[costs[k]]


@kernel
def keeps_inside(path: Data, count: int, nx: int, ny: int, fence: Window) -> bool:
    """Return whether `count` points of `path` [cells] stay INNER cells inside the fence. Map borders do not count."""
    x0, y0, x1, y1 = fence
    left = x0 + INNER if x0 > 0 else -1
    right = x1 - INNER if x1 < nx - 1 else nx
    low = y0 + INNER if y0 > 0 else -1
    high = y1 - INNER if y1 < ny - 1 else ny
    inside = True
    for i in range(count):
        inside = inside and left <= path[i, 0] <= right and low <= path[i, 1] <= high
    return inside
