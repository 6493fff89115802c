"""Fence: rectangle of obstacle cells that limits navfn's propagation of the potential (flood.py).

Called by navfn.Navfn. A flood inside the fence gives the same plan as a flood of the whole map, in
less time: on a map that only the laser fills, most cells have always been free. The fence surrounds
the robot, the goal and every cell that was ever not free, with a margin. All cells outside have the
lowest cost, 50, so a detour outside costs at least as much as a way along the inner edge. No
outside cell can therefore lower the potential of the edge cell beside it. Rounding may change only
the outermost row of cells inside. If a plan comes near this row, the whole map is flooded and the
plan traced again. tests/planner/navfn/test_navfn.py compares plans with and without the fence on
many maps.
"""

from __future__ import annotations

from typing import Optional

import numpy as np

from applr_ros1.common.arrays import Data
from applr_ros1.common.kernels import kernel
from applr_ros1.planner.costmap.grid import Window
from applr_ros1.planner.navfn.flood import PUSH_WEIGHTS

MARGIN = 7  # distance from the fence to the cells that it encloses [cells]
# Smallest accepted distance of a plan from the fence [cells]. Tracing reads two cells around.
INNER = 4
LARGEST = 0.7  # largest share of the map inside a fence; a larger fence saves no time


def around(extent: np.ndarray, robot: int, goal: int, columns: int, rows: int) -> Optional[Window]:
    """Return the fence (first column, first row, last column, last row).

    Return None if a fence would save no time.

    Args:
        extent: (4,) int64, lowest x and y and highest x and y of the cells that were ever not free.
        robot: flat index of the robot's cell.
        goal: flat index of the goal's cell.
        columns: columns of the map.
        rows: rows of the map.
    """
    left, bottom, right, top = extent.tolist()
    for cell in (robot, goal):
        row, column = divmod(cell, columns)
        left = min(left, column)
        right = max(right, column)
        bottom = min(bottom, row)
        top = max(top, row)
    left = max(0, left - MARGIN)
    bottom = max(0, bottom - MARGIN)
    right = min(columns - 1, right + MARGIN)
    top = min(rows - 1, top + MARGIN)
    if (right - left) * (top - bottom) >= LARGEST * columns * rows:
        return None
    return left, bottom, right, top


@kernel
def set_fence(field: Data, costs: Data, columns: int, fence: Window, closed: bool) -> None:
    """Make the fence's cells obstacles if `closed`, otherwise restore their weights from costs."""
    left, bottom, right, top = fence
    for row in range(bottom, top + 1):
        # All cells of the first and last row, only both ends of the others.
        step = 1 if row in (bottom, top) else right - left
        for column in range(left, right + 1, step):
            cell = row * columns + column
            weight = np.float32(np.inf)
            if not closed:
                weight = PUSH_WEIGHTS[costs[cell]]
            field[2 * cell + 1] = weight


@kernel
def keeps_inside(path: Data, count: int, columns: int, rows: int, fence: Window) -> bool:
    """Return whether `count` points of `path` (n, 2) [cells] stay INNER cells inside the fence.

    Sides of the fence on the map's border do not count, because nothing lies beyond them.
    """
    left, bottom, right, top = fence
    for point in range(count):
        x = path[point, 0]
        y = path[point, 1]
        if left > 0 and x < left + INNER:
            return False
        if bottom > 0 and y < bottom + INNER:
            return False
        if right < columns - 1 and x > right - INNER:
            return False
        if top < rows - 1 and y > top - INNER:
            return False
    return True
