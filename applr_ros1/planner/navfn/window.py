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
# States of a fence, for `set_fence`
CLOSED = True
OPEN = False


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
    first_column, first_row, last_column, last_row = extent.tolist()
    for cell in (robot, goal):
        row, column = divmod(cell, columns)
        first_column = min(first_column, column)
        last_column = max(last_column, column)
        first_row = min(first_row, row)
        last_row = max(last_row, row)
    first_column = max(0, first_column - MARGIN)
    first_row = max(0, first_row - MARGIN)
    last_column = min(columns - 1, last_column + MARGIN)
    last_row = min(rows - 1, last_row + MARGIN)
    if (last_column - first_column) * (last_row - first_row) >= LARGEST * columns * rows:
        return None
    return first_column, first_row, last_column, last_row


@kernel
def set_fence(field: Data, costs: Data, columns: int, fence: Window, closed: bool) -> None:
    """Make the fence's cells obstacles if `closed`, otherwise restore their weights from costs."""
    first_column, first_row, last_column, last_row = fence
    for row in range(first_row, last_row + 1):
        # All cells of the first and last row, only both ends of the others.
        column_step = 1 if row in (first_row, last_row) else last_column - first_column
        for column in range(first_column, last_column + 1, column_step):
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
    first_column, first_row, last_column, last_row = fence
    for point in range(count):
        x = path[point, 0]
        y = path[point, 1]
        if first_column > 0 and x < first_column + INNER:
            return False
        if first_row > 0 and y < first_row + INNER:
            return False
        if last_column < columns - 1 and x > last_column - INNER:
            return False
        if last_row < rows - 1 and y > last_row - INNER:
            return False
    return True
