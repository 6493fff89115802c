"""Helpers of the make_plan service: a free square around the robot, and points near a goal.

Called by MoveBase.make_plan. The rules are those of planService and clearCostmapWindows in
move_base/move_base.cpp.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple, Sequence

import numpy as np

from applr_ros1.common.arrays import Data
from applr_ros1.common.kernels import kernel
from applr_ros1.planner.costmap.grid import INSCRIBED, UNKNOWN

# Largest number of search steps along one axis, which only goals far off the map reach.
MOST_STEPS = 100000


def free_square(costmap: Any, pose: Sequence[float], half_side: float) -> None:
    """Free the square of side 2 * half_side [m] around the pose, if it is entirely on the map.

    Only the master grid changes.
    """
    x = pose[0]
    y = pose[1]
    first_column, first_row = costmap.world_to_map(x - half_side, y - half_side)
    last_column, last_row = costmap.world_to_map(x + half_side, y + half_side)
    if min(first_column, last_column) >= 0:
        costmap.set_free(first_column, first_row, last_column + 1, last_row + 1)


class _Coordinates(NamedTuple):
    """Coordinates along one axis that the search tries, as far as they are on the map.

    Attributes:
        values: (n,) [m].
        cells: (n,) int64, cell index along the axis.
        squares: (n,) int64, number of the growing square on whose side the coordinate lies.
        signs: (n,), -1 below the goal, 1 above.
    """

    values: np.ndarray
    cells: np.ndarray
    squares: np.ndarray
    signs: np.ndarray


def reachable_near(
    costmap: Any,
    start: Sequence[float],
    goal: Sequence[float],
    tolerance: float,
    allow_unknown: bool,
) -> np.ndarray:
    """Return the points (n, 2) [m] near the goal that navfn can reach, in the order of C++.

    C++ plans to one point after another on growing squares around the goal. Points and squares are
    three cells apart, or `tolerance` if it is smaller, summed in float32. Here, one flood first
    removes the unreachable points.

    Args:
        costmap: map to plan on.
        start: position (x, y) of the robot [m].
        goal: position (x, y) of the goal [m].
        tolerance: largest distance from the goal along each axis [m].
        allow_unknown: whether plans may lead through unknown cells.
    """
    start_x, start_y = costmap.world_to_map(start[0], start[1])
    if start_x < 0:
        return np.zeros((0, 2))

    # Distances of the squares' sides from the goal. Beyond the map there is nothing to reach.
    step = np.float32(costmap.resolution * 3.0)
    if tolerance < step:
        step = np.float32(tolerance)
    diagonal = math.hypot(*costmap.size) * costmap.resolution
    furthest = min(tolerance, diagonal + math.dist(goal[:2], costmap.origin))
    # Two steps more than fit: the quotient is cut off, and float32 sums may stay below the product.
    count = int(min(furthest / step + 2, MOST_STEPS))
    distances = np.cumsum(np.full(count, step), dtype=np.float32)
    distances = distances[distances <= furthest].astype(np.float64)

    x = _on_map(goal, distances, costmap, axis=0)
    y = _on_map(goal, distances, costmap, axis=1)
    reached = _reachable(costmap.cells, start_x, start_y, allow_unknown)
    rows, columns = np.nonzero(reached[np.ix_(y.cells, x.cells)])

    # C++ tries square by square. Within one, y is the outer loop, and the coordinate below the goal
    # comes before the one above. Square 0 is the goal itself, which has been tried already.
    squares = np.maximum(y.squares[rows], x.squares[columns])
    keys = (squares, y.squares[rows], x.squares[columns], y.signs[rows], x.signs[columns])
    order = np.lexsort(keys[::-1])  # The primary key of lexsort is its last one.
    order = order[squares[order] > 0]
    return np.stack([x.values[columns[order]], y.values[rows[order]]], axis=1)


def _on_map(goal: Sequence[float], distances: np.ndarray, costmap: Any, axis: int) -> _Coordinates:
    """Return the coordinates to try along an axis (0: x, 1: y), as far as they are on the map.

    They are the goal's coordinate, and those at the distances (n,) [m] below and above it.
    """
    centre = goal[axis]
    below = centre - distances
    above = centre + distances
    values = np.concatenate([below, [centre], above])
    numbers = np.arange(1, len(distances) + 1)
    squares = np.concatenate([numbers, [0], numbers])
    signs = np.repeat([-1.0, 1.0], [len(below), 1 + len(above)])

    low = costmap.origin[axis]
    high = low + costmap.size[axis] * costmap.resolution
    is_on_map = (values >= low) & (values < high)
    values = values[is_on_map]
    cells = ((values - low) / costmap.resolution).astype(np.int64)
    # Rounding may put a coordinate just below the end into the cell after the last.
    cells = np.minimum(cells, costmap.size[axis] - 1)
    return _Coordinates(values, cells, squares[is_on_map], signs[is_on_map])


@kernel
def _reachable(cells: Data, start_x: int, start_y: int, allow_unknown: bool) -> Data:
    """Return (ny, nx) bool: cells that a 4-connected flood from the start reaches.

    As in navfn, the map's border is closed.
    """
    rows, columns = cells.shape
    reached = np.zeros((rows, columns), np.bool_)
    stack = np.empty(columns * rows, np.int64)
    reached[start_y, start_x] = True
    stack[0] = start_y * columns + start_x
    count = 1
    while count > 0:
        count -= 1
        cell = stack[count]
        for neighbour in (cell - 1, cell + 1, cell - columns, cell + columns):
            row = neighbour // columns
            column = neighbour % columns
            is_inside = 0 < column < columns - 1 and 0 < row < rows - 1
            if not is_inside or reached[row, column]:
                continue
            cost = cells[row, column]
            if cost < INSCRIBED or (allow_unknown and cost == UNKNOWN):
                reached[row, column] = True
                stack[count] = neighbour
                count += 1
    return reached
