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
    map_limit = diagonal + math.dist(goal[:2], costmap.origin)
    limit = min(tolerance, map_limit)
    # Two steps more than fit: the quotient is cut off, and float32 sums may stay below the product.
    step_count = int(min(limit / step + 2, MOST_STEPS))
    distances = np.cumsum(np.full(step_count, step), dtype=np.float32)
    distances = distances[distances <= limit].astype(np.float64)

    x_candidates = _on_map(goal, distances, costmap, axis=0)
    y_candidates = _on_map(goal, distances, costmap, axis=1)
    is_reached = _reachable(costmap.cells, start_x, start_y, allow_unknown)
    candidate_cells = np.ix_(y_candidates.cells, x_candidates.cells)
    y_indices, x_indices = np.nonzero(is_reached[candidate_cells])
    x_squares = x_candidates.squares[x_indices]
    y_squares = y_candidates.squares[y_indices]
    x_signs = x_candidates.signs[x_indices]
    y_signs = y_candidates.signs[y_indices]

    # C++ tries square by square. Within one, y is the outer loop, and the coordinate below the goal
    # comes before the one above. The primary key of lexsort is its last one.
    squares = np.maximum(y_squares, x_squares)
    order = np.lexsort((x_signs, y_signs, x_squares, y_squares, squares))
    # Square 0 is the goal itself, which has been tried already.
    order = order[squares[order] > 0]
    x = x_candidates.values[x_indices[order]]
    y = y_candidates.values[y_indices[order]]
    return np.stack([x, y], axis=1)


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

    map_start = costmap.origin[axis]
    map_end = map_start + costmap.size[axis] * costmap.resolution
    is_on_map = (values >= map_start) & (values < map_end)
    values = values[is_on_map]
    cells = ((values - map_start) / costmap.resolution).astype(np.int64)
    # Rounding may put a coordinate just below the end into the cell after the last.
    cells = np.minimum(cells, costmap.size[axis] - 1)
    return _Coordinates(values, cells, squares[is_on_map], signs[is_on_map])


@kernel
def _reachable(cells: Data, start_x: int, start_y: int, allow_unknown: bool) -> Data:
    """Return (ny, nx) bool: cells that a 4-connected flood from the start reaches.

    As in navfn, the map's border is closed.
    """
    rows, columns = cells.shape
    is_reached = np.zeros((rows, columns), np.bool_)
    stack = np.empty(columns * rows, np.int64)
    is_reached[start_y, start_x] = True
    stack[0] = start_y * columns + start_x
    stack_size = 1
    while stack_size > 0:
        stack_size -= 1
        cell = stack[stack_size]
        for neighbour in (cell - 1, cell + 1, cell - columns, cell + columns):
            row = neighbour // columns
            column = neighbour % columns
            is_inside = 0 < column < columns - 1 and 0 < row < rows - 1
            if not is_inside or is_reached[row, column]:
                continue
            cost = cells[row, column]
            if cost < INSCRIBED or (allow_unknown and cost == UNKNOWN):
                is_reached[row, column] = True
                stack[stack_size] = neighbour
                stack_size += 1
    return is_reached
