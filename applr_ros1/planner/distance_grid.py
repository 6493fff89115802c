"""Distance grids: steps from each cell to the plan or to its end, flooded as far as needed.

Used by both local planners. The rules are those of base_local_planner/map_grid.cpp. `settle` floods
until the value of one cell is final, `complete` floods the whole map. Both give the same values.

A border of walls around the map makes bounds tests unnecessary. With N = nx * ny, a cell holds its
distance, N if it is a wall, or N + 1 ("unseen") if the flood has not reached it (yet). The flood
never reaches the extra cell after the last row, so settling this cell completes the flood.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple, Tuple

import numpy as np

from applr_ros1.common.arrays import Data
from applr_ros1.common.kernels import kernel
from applr_ros1.planner.costmap.grid import INSCRIBED, UNKNOWN, world_to_map


class DistanceGrid(NamedTuple):
    """Distance grid of a map."""

    distance: Data  # flat int32, (ny + 2) rows of (nx + 2) cells, plus the extra cell
    queue: Data  # cells in order of distance
    ends: Data  # [next cell to expand, first free slot] of the queue
    nx: int  # size of the map [cells]
    ny: int


def allocate(nx: int, ny: int) -> DistanceGrid:
    """Return a grid for a map of nx by ny cells. A planner reuses it in every cycle."""
    distance = np.full((nx + 2) * (ny + 2) + 1, nx * ny, np.int32)
    distance[-1] = nx * ny + 1
    # The queue has room for every cell of the map and for start cells that are walls.
    queue = np.zeros(nx * ny + 8, np.uint32)
    ends = np.zeros(2, np.int64)
    return DistanceGrid(distance, queue, ends, nx, ny)


@kernel
def reset(grid: DistanceGrid, cells: Data) -> None:
    """Reset the grid: cells (ny, nx) of cost 253 and above become walls, all others unseen.

    The queue is emptied.
    """
    rows, columns = cells.shape
    distance = grid.distance
    wall_value = np.int32(columns * rows)
    unseen_value = np.int32(columns * rows + 1)
    for row in range(rows):
        row_start = (row + 1) * (columns + 2) + 1
        for column in range(columns):
            is_wall = cells[row, column] >= INSCRIBED
            distance[row_start + column] = wall_value if is_wall else unseen_value
    grid.ends[0] = 0
    grid.ends[1] = 0


@kernel
def place(grid: DistanceGrid, x: int, y: int) -> int:
    """Return the index of the map's cell (x, y) in the grid."""
    return (y + 1) * (grid.nx + 2) + x + 1


@kernel
def start_at(grid: DistanceGrid, cell: int) -> None:
    """Start the flood at a cell, which may be a wall."""
    grid.distance[cell] = 0
    grid.queue[grid.ends[1]] = cell
    grid.ends[1] += 1


@kernel
def start_at_plan(grid: DistanceGrid, scene: Any, plan: Data, whole: bool) -> Tuple[int, int]:
    """Start the flood at the plan (n, 2) [m], resampled to the map's resolution.

    The usable plan begins at the first point on a known cell of the map and ends before the next
    point off the map or on an unknown cell. If `whole`, the flood starts at all cells of the usable
    plan, otherwise only at its last cell. map_grid.cpp:106, 141.

    Returns:
        The last cell (x, y) of the usable plan, (-1, -1) without usable points.
    """
    cells = scene.cells
    resolution = scene.resolution
    last_cell_x = last_cell_y = -1
    is_usable = True
    for i in range(plan.shape[0]):
        # Steps of at most one resolution from the previous point; the first point is its own.
        from_x = plan[max(i - 1, 0), 0]
        from_y = plan[max(i - 1, 0), 1]
        dx = plan[i, 0] - from_x
        dy = plan[i, 1] - from_y
        squared_length = dx * dx + dy * dy
        step_count = 1
        if squared_length > resolution * resolution:
            step_count = int(math.ceil(math.sqrt(squared_length) / resolution))
        for step in range(1, step_count + 1):
            # As in C++, the last step is the plan's point itself, without rounding.
            x = plan[i, 0]
            y = plan[i, 1]
            if step < step_count:
                x = from_x + step * (dx / step_count)
                y = from_y + step * (dy / step_count)
            cell_x, cell_y = world_to_map(x, y, scene.ox, scene.oy, resolution, grid.nx, grid.ny)
            if cell_x >= 0 and cells[cell_y, cell_x] != UNKNOWN:
                last_cell_x = cell_x
                last_cell_y = cell_y
                cell = place(grid, cell_x, cell_y)
                if whole and grid.distance[cell] != 0:
                    start_at(grid, cell)
            elif last_cell_x >= 0:
                is_usable = False
                break
        if not is_usable:
            break
    if last_cell_x >= 0 and not whole:
        start_at(grid, place(grid, last_cell_x, last_cell_y))
    return last_cell_x, last_cell_y


@kernel
def settle(grid: DistanceGrid, cell: int, limit: int) -> int:
    """Flood until `cell` is final and return its value.

    The flood is 4-connected, one step per cell, and never enters walls. map_grid.cpp:222.

    Returns:
        A distance, N for a wall, or N + 1 if the cell is unseen. It is unseen if its distance
        exceeds `limit` (then ends[0] < ends[1]) or if the complete flood does not reach it.
    """
    distance, queue, ends, columns, rows = grid
    unseen_value = columns * rows + 1
    # Unsigned indices spare numba the wrap-around of negative ones.
    one = np.uintp(1)
    row_step = np.uintp(columns + 2)
    target_cell = np.uintp(cell)
    queue_head = np.uintp(ends[0])
    queue_tail = np.uintp(ends[1])
    while queue_head < queue_tail and distance[target_cell] == unseen_value:
        nearest_cell = np.uintp(queue[queue_head])
        step_count = distance[nearest_cell]
        if step_count >= limit:
            break
        queue_head += one
        step_count += np.int32(1)
        # Unrolled, because a loop over the four neighbours takes longer.
        if distance[nearest_cell - one] == unseen_value:
            distance[nearest_cell - one] = step_count
            queue[queue_tail] = nearest_cell - one
            queue_tail += one
        if distance[nearest_cell + one] == unseen_value:
            distance[nearest_cell + one] = step_count
            queue[queue_tail] = nearest_cell + one
            queue_tail += one
        if distance[nearest_cell - row_step] == unseen_value:
            distance[nearest_cell - row_step] = step_count
            queue[queue_tail] = nearest_cell - row_step
            queue_tail += one
        if distance[nearest_cell + row_step] == unseen_value:
            distance[nearest_cell + row_step] = step_count
            queue[queue_tail] = nearest_cell + row_step
            queue_tail += one
    ends[0] = queue_head
    ends[1] = queue_tail
    return int(distance[target_cell])


@kernel
def at_least(grid: DistanceGrid, cell: int, limit: int) -> int:
    """Return the value of `cell` (N for a wall), or limit + 1 if it is further than `limit`."""
    cell_value = settle(grid, cell, limit)
    # An unseen cell of a complete flood keeps its N + 1.
    if cell_value > grid.nx * grid.ny and grid.ends[0] < grid.ends[1]:
        return limit + 1
    return cell_value


@kernel
def final_distance(grid: DistanceGrid, cell: int) -> int:
    """Return the value of `cell` in C++.

    It is the distance, N for a wall touched by the flood, or N + 1 if the flood never reaches it.
    """
    wall_value = grid.nx * grid.ny
    row_step = grid.nx + 2
    cell_value = settle(grid, cell, wall_value + 1)
    if cell_value == wall_value:
        # The flood touches a wall only if it reaches a neighbour of the wall.
        for neighbour in (cell - 1, cell + 1, cell - row_step, cell + row_step):
            if settle(grid, neighbour, wall_value + 1) < wall_value:
                break
        cell_value = _final_value(grid.distance, cell, row_step, wall_value)
    return cell_value


@kernel
def complete(grid: DistanceGrid) -> Data:
    """Flood the whole map and return the grid (ny, nx) int32 as C++ stores it.

    Walls that the flood touched are N. Cells and walls that it never reached are N + 1.
    """
    distance, _, _, columns, rows = grid
    wall_value = columns * rows
    # The extra cell is never reached.
    settle(grid, distance.shape[0] - 1, wall_value + 1)
    values = np.empty((rows, columns), np.int32)
    for row in range(rows):
        for column in range(columns):
            cell = place(grid, column, row)
            values[row, column] = _final_value(distance, cell, columns + 2, wall_value)
    return values


@kernel
def _final_value(distance: Data, cell: int, row_step: int, wall_value: int) -> int:
    """Return the C++ value of a cell after the cell and its four neighbours are settled."""
    cell_value = int(distance[cell])
    if cell_value != wall_value:
        return cell_value
    for neighbour in (cell - 1, cell + 1, cell - row_step, cell + row_step):
        if distance[neighbour] < wall_value:
            return cell_value
    return wall_value + 1
