"""Helpers of the make_plan service: the freed square about the robot, and where else to try near a goal.

Called by MoveBase.make_plan. Rules: move_base/move_base.cpp, planService and clearCostmapWindows.
"""
from __future__ import annotations

import math

import numpy as np
from numba import njit

from .grid import INSCRIBED, UNKNOWN


def free_square(costmap, pose, half_side: float) -> None:
    """Make the square of 2 * half_side [m] about the pose free in the master map, if it lies wholly on it."""
    low = costmap.world_to_map(pose[0] - half_side, pose[1] - half_side)
    high = costmap.world_to_map(pose[0] + half_side, pose[1] + half_side)
    if min(low + high) >= 0:
        costmap.set_free(low[0], low[1], high[0] + 1, high[1] + 1)


def reachable_near(costmap, start, goal, tolerance: float, allow_unknown: bool):
    """Yield the points (x, y) [m] that make_plan tries, in its order, leaving out those navfn cannot reach.

    C++ plans to each of them in turn; one flood here tells the hopeless ones apart.
    """
    sx, sy = costmap.world_to_map(start[0], start[1])
    if sx < 0:
        return
    reached = _reachable(costmap.cells, sx, sy, allow_unknown)
    across = math.hypot(*costmap.size) * costmap.resolution
    away = math.hypot(goal[0] - start[0], goal[1] - start[1])
    for dx, dy in offsets(costmap.resolution, min(tolerance, away + across)):
        x, y = goal[0] + dx, goal[1] + dy
        mx, my = costmap.world_to_map(x, y)
        if mx >= 0 and reached[my, mx]:
            yield x, y


def offsets(resolution: float, tolerance: float):
    """Yield (dx, dy) on growing squares, in steps of three cells (less if tolerance is), added in float32."""
    f = np.float32
    step = f(resolution * 3.0)
    if 0.0 < tolerance < step:
        step = f(tolerance)
    largest = step
    while largest <= tolerance:
        y = f(0.0)
        while y <= largest:
            x = f(0.0)
            while x <= largest:
                if x >= largest - 1e-9 or y >= largest - 1e-9:
                    for sign_y in (-1.0, 1.0) if y > 0.0 else (1.0,):
                        for sign_x in (-1.0, 1.0) if x > 0.0 else (1.0,):
                            yield sign_x * float(x), sign_y * float(y)
                x = f(x + step)
            y = f(y + step)
        largest = f(largest + step)


@njit(cache=True)
def _reachable(cells, sx, sy, allow_unknown):
    """(ny, nx) bool: the cells a flood can come to from (sx, sy): 4-connected, the map's border shut."""
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
