"""Distance grids: number of steps from each cell to the plan or to its end, flooded only as far as needed.

Used by both local planners. The rules are those of base_local_planner/map_grid.cpp. `settle` floods until the value
of one cell is final, `complete` floods the whole map. Both give the same values.

A grid consists of three arrays. distance: flat int32, (ny + 2) rows of (nx + 2) cells, plus one extra cell. The border
of walls around the map makes bounds tests unnecessary. With N = nx * ny, a cell holds its distance, N if it is a wall,
or N + 1 ("unseen") if the flood has not reached it (yet). The flood never reaches the extra cell, so that settling it
completes the flood. queue: cells in order of distance. ends: [next cell to expand, first free slot] of the queue.
"""

from __future__ import annotations

import math
from typing import Tuple

import numpy as np

from applr_ros1.common.kernels import kernel
from applr_ros1.planner.costmap.grid import INSCRIBED, UNKNOWN, world_to_map


def allocate(nx: int, ny: int) -> Tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return (distance, queue, ends) for a map of nx by ny cells. A planner reuses these arrays in every cycle."""
    distance = np.full((nx + 2) * (ny + 2) + 1, nx * ny, np.int32)
    distance[-1] = nx * ny + 1
    return distance, np.zeros(nx * ny + 8, np.uint32), np.zeros(2, np.int64)


@kernel
def reset(distance, ends, cells):
    """Make costmap cells (ny, nx) of 253 and above walls and all others unseen, and empty the queue."""
    ny, nx = cells.shape
    wall = np.int32(nx * ny)
    unseen = np.int32(nx * ny + 1)
    for row in range(ny):
        base = (row + 1) * (nx + 2) + 1
        for column in range(nx):
            distance[base + column] = wall if cells[row, column] >= INSCRIBED else unseen
    ends[0] = ends[1] = 0


@kernel
def start_at(distance, queue, ends, k):
    """Start the flood at cell k, which may be a wall."""
    distance[k] = 0
    queue[ends[1]] = k
    ends[1] += 1


@kernel
def start_at_plan(distance, queue, ends, cells, ox, oy, resolution, plan, whole):
    """Start the flood at the plan (n, 2) [m], resampled to the map's resolution, and return its last cell (x, y).

    The usable plan begins at the first point that is on the map and known, and ends before the next one that is not.
    Without usable points, the result is (-1, -1). If `whole` is set, the flood starts at all of its cells, otherwise
    only at the last one. map_grid.cpp:106, 141.
    """
    ny, nx = cells.shape
    goal_x = goal_y = -1
    over = False
    for i in range(plan.shape[0]):
        last_x = plan[max(i - 1, 0), 0]
        last_y = plan[max(i - 1, 0), 1]
        dx = plan[i, 0] - last_x
        dy = plan[i, 1] - last_y
        squared = dx * dx + dy * dy
        steps = 1
        if squared > resolution * resolution:
            steps = int(math.ceil(math.sqrt(squared) / resolution))
        for j in range(1, steps + 1):
            px, py = plan[i, 0], plan[i, 1]
            if j < steps:
                px, py = last_x + j * (dx / steps), last_y + j * (dy / steps)
            mx, my = world_to_map(px, py, ox, oy, resolution, nx, ny)
            if mx >= 0 and cells[my, mx] != UNKNOWN:
                goal_x, goal_y = mx, my
                k = (my + 1) * (nx + 2) + mx + 1
                if whole and distance[k] != 0:
                    start_at(distance, queue, ends, k)
            elif goal_x >= 0:
                over = True
                break
        if over:
            break
    if goal_x >= 0 and not whole:
        start_at(distance, queue, ends, (goal_y + 1) * (nx + 2) + goal_x + 1)
    return goal_x, goal_y


@kernel
def settle(distance, queue, ends, stride, unseen, cell, limit):
    """Flood until `cell` is final and return its value: a distance, the value of a wall, or `unseen`.

    `unseen` means that the flood is complete without reaching the cell, or, if ends[0] < ends[1], that its distance
    exceeds `limit`. The flood is 4-connected, one step per cell, and never enters walls. map_grid.cpp:222.
    """
    one = np.uintp(1)
    side = np.uintp(stride)
    wanted = np.uintp(cell)
    head = np.uintp(ends[0])
    tail = np.uintp(ends[1])
    while head < tail and distance[wanted] == unseen:
        k = np.uintp(queue[head])
        value = distance[k]
        if value >= limit:
            break
        head += one
        value += np.int32(1)
        if distance[k - one] == unseen:
            distance[k - one] = value
            queue[tail] = k - one
            tail += one
        if distance[k + one] == unseen:
            distance[k + one] = value
            queue[tail] = k + one
            tail += one
        if distance[k - side] == unseen:
            distance[k - side] = value
            queue[tail] = k - side
            tail += one
        if distance[k + side] == unseen:
            distance[k + side] = value
            queue[tail] = k + side
            tail += one
    ends[0] = head
    ends[1] = tail
    return int(distance[wanted])


@kernel
def at_least(distance, queue, ends, nx, ny, cell, limit):
    """Return the value of `cell` (N for a wall), or limit + 1 if the flood would exceed the limit to reach it."""
    value = settle(distance, queue, ends, nx + 2, nx * ny + 1, cell, limit)
    if value > nx * ny and ends[0] < ends[1]:
        return limit + 1
    return value


@kernel
def final_distance(distance, queue, ends, stride, n, cell):
    """Return the value of `cell` in C++: distance, N for a wall touched by the flood, N + 1 if never reached."""
    value = settle(distance, queue, ends, stride, n + 1, cell, n + 1)
    if value == n:  # The flood touches a wall only if it reaches one of its neighbours.
        for neighbour in (cell - 1, cell + 1, cell - stride, cell + stride):
            if settle(distance, queue, ends, stride, n + 1, neighbour, n + 1) < n:
                break
        value = _final_value(distance, cell, stride, n)
    return value


@kernel
def complete(distance, queue, ends, nx, ny, out):
    """Flood the whole map and write the grid to `out` (ny, nx) int32 as C++ stores it.

    Walls that the flood touched are N, cells that it never reached are N + 1.
    """
    stride = nx + 2
    unseen = nx * ny + 1
    settle(distance, queue, ends, stride, unseen, distance.shape[0] - 1, unseen)
    for row in range(ny):
        for column in range(nx):
            out[row, column] = _final_value(distance, (row + 1) * stride + column + 1, stride, nx * ny)


@kernel
def _final_value(distance, k, stride, n):
    """Return the C++ value of cell k after the cell and its four neighbours are settled."""
    value = int(distance[k])
    if value == n and not (
        distance[k - 1] < n or distance[k + 1] < n or distance[k - stride] < n or distance[k + stride] < n
    ):
        return n + 1
    return value
