"""Helpers of the make_plan service: clearing a square around the robot, and candidate points near a goal.

Called by MoveBase.make_plan. The rules are those of planService and clearCostmapWindows in move_base/move_base.cpp.
"""

from __future__ import annotations

import math
from typing import Any, Sequence, Tuple

import numpy as np

from applr_ros1.common.arrays import Data
from applr_ros1.common.kernels import kernel
from applr_ros1.planner.costmap.grid import INSCRIBED, UNKNOWN

MOST_STEPS = (
    100000  # maximum number of search steps along one axis, reached only by goals far off the map
)


def free_square(costmap: Any, pose: Sequence[float], half_side: float) -> None:
    """Free the square of side 2 * half_side [m] around the pose in the master grid, if it is entirely on the map."""
    low = costmap.world_to_map(pose[0] - half_side, pose[1] - half_side)
    high = costmap.world_to_map(pose[0] + half_side, pose[1] + half_side)
    if min(low + high) >= 0:
        costmap.set_free(low[0], low[1], high[0] + 1, high[1] + 1)


def reachable_near(
    costmap: Any,
    start: Sequence[float],
    goal: Sequence[float],
    tolerance: float,
    allow_unknown: bool,
) -> np.ndarray:
    """Return the points (n, 2) [m] near the goal that navfn can reach, in the order in which C++ tries them.

    C++ plans to one point after another on growing squares around the goal. Points and squares are three cells apart,
    or `tolerance` if it is smaller, summed in float32. Here, one flood first removes the unreachable points.
    """
    sx, sy = costmap.world_to_map(start[0], start[1])
    if sx < 0:
        return np.zeros((0, 2))
    step = np.float32(costmap.resolution * 3.0)
    if tolerance < step:
        step = np.float32(tolerance)
    most = min(
        tolerance,
        math.hypot(*costmap.size) * costmap.resolution + math.dist(goal[:2], costmap.origin),
    )
    steps = np.cumsum(np.full(int(min(most / step + 2, MOST_STEPS)), step), dtype=np.float32)
    offsets = np.concatenate([np.zeros(1), steps[steps <= most].astype(np.float64)])
    x, x_index, x_sign = _on_map(
        goal[0], offsets, costmap.origin[0], costmap.size[0] * costmap.resolution
    )
    y, y_index, y_sign = _on_map(
        goal[1], offsets, costmap.origin[1], costmap.size[1] * costmap.resolution
    )
    mx, my = _cells(x, costmap, 0), _cells(y, costmap, 1)
    rows, columns = np.nonzero(_reachable(costmap.cells, sx, sy, allow_unknown)[np.ix_(my, mx)])
    squares = np.maximum(y_index[rows], x_index[columns])
    order = np.lexsort((x_sign[columns], y_sign[rows], x_index[columns], y_index[rows], squares))
    order = order[squares[order] > 0]  # Square 0 is the goal itself, which has been tried already.
    return np.stack([x[columns[order]], y[rows[order]]], axis=1)


def _on_map(
    centre: float, offsets: np.ndarray, origin: float, length: float
) -> Tuple[np.ndarray, ...]:
    """Return those coordinates centre -+ offsets [m] that are on the map, with indices and signs of their offsets."""
    index = np.arange(len(offsets))
    value = np.concatenate([centre - offsets[1:], centre + offsets])
    index, sign = (
        np.concatenate([index[1:], index]),
        np.concatenate([-np.ones(len(index) - 1), np.ones(len(index))]),
    )
    on = (value >= origin) & (value < origin + length)
    return value[on], index[on], sign[on]


def _cells(values: np.ndarray, costmap: Any, axis: int) -> np.ndarray:
    cells: np.ndarray = np.minimum(
        ((values - costmap.origin[axis]) / costmap.resolution).astype(np.int64),
        costmap.size[axis] - 1,
    )
    return cells


@kernel
def _reachable(cells: Data, sx: int, sy: int, allow_unknown: bool) -> Data:
    """Return (ny, nx) bool: cells that a 4-connected flood from (sx, sy) reaches. The map's border is closed."""
    ny, nx = cells.shape
    reached = np.zeros((ny, nx), np.bool_)
    stack = np.empty(nx * ny, np.int64)
    reached[sy, sx] = True
    stack[0] = sy * nx + sx
    n = 1
    while n > 0:
        n -= 1
        y = stack[n] // nx
        x = stack[n] % nx
        for k in range(4):
            i = x + (k == 0) - (k == 1)
            j = y + (k == 2) - (k == 3)
            if i < 1 or j < 1 or i >= nx - 1 or j >= ny - 1 or reached[j, i]:
                continue
            if cells[j, i] < INSCRIBED or (allow_unknown and cells[j, i] == UNKNOWN):
                reached[j, i] = True
                stack[n] = j * nx + i
                n += 1
    return reached
