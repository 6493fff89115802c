"""Distance grids: number of steps from each cell to the plan or to its end, flooded only as far as needed.

Used by both local planners. The rules are those of base_local_planner/map_grid.cpp. `settle` floods until the value
of one cell is final, `complete` floods the whole map. Both give the same values.

A border of walls around the map makes bounds tests unnecessary. With N = nx * ny, a cell holds its distance, N if it is
a wall, or N + 1 ("unseen") if the flood has not reached it (yet). The flood never reaches the extra cell after the last
row, so settling this cell completes the flood.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple, Tuple

import numpy as np

from applr_ros1.common.arrays import Data
from applr_ros1.common.kernels import kernel
from applr_ros1.planner.costmap.grid import INSCRIBED, UNKNOWN, world_to_map


class Grid(NamedTuple):
    """Distance grid of a map."""

    distance: Data  # flat int32, (ny + 2) rows of (nx + 2) cells, plus the extra cell
    queue: Data  # cells in order of distance
    ends: Data  # [next cell to expand, first free slot] of the queue
    nx: int  # size of the map [cells]
    ny: int


def allocate(nx: int, ny: int) -> Grid:
    """Return a grid for a map of nx by ny cells. A planner reuses it in every cycle."""
    distance = np.full((nx + 2) * (ny + 2) + 1, nx * ny, np.int32)
    distance[-1] = nx * ny + 1
    return Grid(distance, np.zeros(nx * ny + 8, np.uint32), np.zeros(2, np.int64), nx, ny)


@kernel
def reset(grid: Grid, cells: Data) -> None:
    """Reset the grid: cells (ny, nx) of cost 253 and above become walls, all others unseen. Empty the queue."""
    ny, nx = cells.shape
    distance = grid.distance
    wall = np.int32(nx * ny)
    unseen = np.int32(nx * ny + 1)
    for row in range(ny):
        base = (row + 1) * (nx + 2) + 1
        for column in range(nx):
            distance[base + column] = wall if cells[row, column] >= INSCRIBED else unseen
    grid.ends[0] = grid.ends[1] = 0


@kernel
def place(grid: Grid, x: int, y: int) -> int:
    """Return the index of the map's cell (x, y) in the grid."""
    return (y + 1) * (grid.nx + 2) + x + 1


@kernel
def start_at(grid: Grid, k: int) -> None:
    """Start the flood at cell k, which may be a wall."""
    grid.distance[k] = 0
    grid.queue[grid.ends[1]] = k
    grid.ends[1] += 1


@kernel
def start_at_plan(grid: Grid, scene: Any, plan: Data, whole: bool) -> Tuple[int, int]:
    """Start the flood at the plan (n, 2) [m], resampled to the map's resolution, and return its last cell (x, y).

    The usable plan begins at the first point on a known cell of the map and ends before the next point off the map or
    on an unknown cell. Without usable points, the result is (-1, -1). If `whole`, the flood starts at all cells of the
    usable plan, otherwise only at its last cell. map_grid.cpp:106, 141.
    """
    cells, resolution = scene.cells, scene.resolution
    goal_x = goal_y = -1
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
            mx, my = world_to_map(px, py, scene.ox, scene.oy, resolution, grid.nx, grid.ny)
            if mx >= 0 and cells[my, mx] != UNKNOWN:
                goal_x, goal_y = mx, my
                if whole and grid.distance[place(grid, mx, my)] != 0:
                    start_at(grid, place(grid, mx, my))
            elif goal_x >= 0:
                return _started(grid, goal_x, goal_y, whole)
    return _started(grid, goal_x, goal_y, whole)


@kernel
def _started(grid: Grid, x: int, y: int, whole: bool) -> Tuple[int, int]:
    """Start the flood at the plan's last cell (x, y), unless it has started at the whole plan. Return the cell."""
    if x >= 0 and not whole:
        start_at(grid, place(grid, x, y))
    return x, y


@kernel
def settle(grid: Grid, cell: int, limit: int) -> int:
    """Flood until `cell` is final and return its value: a distance, N for a wall, or N + 1 if it is unseen.

    A cell is unseen if its distance exceeds `limit` (then ends[0] < ends[1]) or if the complete flood does not reach
    it. The flood is 4-connected, one step per cell, and never enters walls. map_grid.cpp:222.
    """
    distance, queue, ends, nx, ny = grid
    unseen = nx * ny + 1
    one = np.uintp(1)
    side = np.uintp(nx + 2)
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
def at_least(grid: Grid, cell: int, limit: int) -> int:
    """Return the value of `cell` (N for a wall), or limit + 1 if its distance exceeds `limit` [cells]."""
    value = settle(grid, cell, limit)
    return limit + 1 if value > grid.nx * grid.ny and grid.ends[0] < grid.ends[1] else value


@kernel
def final_distance(grid: Grid, cell: int) -> int:
    """Return the value of `cell` in C++: distance, N for a wall touched by the flood, N + 1 if never reached."""
    n = grid.nx * grid.ny
    stride = grid.nx + 2
    value = settle(grid, cell, n + 1)
    if value == n:  # The flood touches a wall only if it reaches a neighbour of the wall.
        for neighbour in (cell - 1, cell + 1, cell - stride, cell + stride):
            if settle(grid, neighbour, n + 1) < n:
                break
        value = _final_value(grid.distance, cell, stride, n)
    return value


@kernel
def complete(grid: Grid) -> Data:
    """Flood the whole map and return the grid (ny, nx) int32 as C++ stores it.

    Walls that the flood touched are N. Cells and walls that it never reached are N + 1.
    """
    distance, _, _, nx, ny = grid
    settle(grid, distance.shape[0] - 1, nx * ny + 1)
    out = np.empty((ny, nx), np.int32)
    for row in range(ny):
        for column in range(nx):
            out[row, column] = _final_value(distance, place(grid, column, row), nx + 2, nx * ny)
    return out


@kernel
def _final_value(distance: Data, k: int, stride: int, n: int) -> int:
    """Return the C++ value of cell k after the cell and its four neighbours are settled."""
    value = int(distance[k])
    if value == n and not (
        distance[k - 1] < n
        or distance[k + 1] < n
        or distance[k - stride] < n
        or distance[k + stride] < n
    ):
        return n + 1
    return value
