"""Searches on a grid for reference paths: A* of BARN's world generator, and the graph of a map."""

from __future__ import annotations

import heapq
import math
from typing import Any, Dict, Optional, Tuple

import numpy as np
import scipy
from numpy.typing import NDArray

from applr_ros1.common.arrays import Array, Ints

Cell = Tuple[int, int]
Cells = NDArray[np.bool_]  # mask (rows, columns) of a grid's cells

# moves (rows, columns) to a neighbouring cell, in steps of 45 degrees
MOVES = (
    (0, 1),
    (1, 1),
    (1, 0),
    (1, -1),
    (0, -1),
    (-1, -1),
    (-1, 0),
    (-1, 1),
)
ANY_MOVE = -1  # heading at the start of a path
SHY_CELLS = 2.0  # largest distance to a blocked cell with a penalty [cells]
SHY_COST = 5.0  # penalty of a cell beside a blocked one; it decreases with 1 / distance


def free_space(filled: Cells, clearance: int) -> Cells:
    """Return the cells with no filled cell within +-`clearance` cells along both axes.

    Cells outside the grid count as empty.
    """
    width = 2 * clearance + 1
    is_near: Cells = scipy.ndimage.maximum_filter(filled, size=width, mode="constant", cval=False)
    return ~is_near


def obstacle_penalty(free: Cells) -> Array:
    """Return the penalty of each cell.

    It is 5 / (distance to the nearest blocked cell) up to 2 cells away, otherwise 0.
    """
    if free.all():
        return np.zeros(free.shape)  # The distance to a blocked cell is undefined.
    distance = scipy.ndimage.distance_transform_edt(free)
    is_near = free & (distance <= SHY_CELLS)
    cell_penalty = SHY_COST / np.maximum(distance, 1.0)
    return np.where(is_near, cell_penalty, 0.0)


def _turns(heading: int) -> Tuple[int, ...]:
    """Return the moves within 45 degrees of a heading. Their order decides ties."""
    if heading == ANY_MOVE:
        return tuple(range(len(MOVES)))
    right_turn = (heading - 1) % len(MOVES)
    left_turn = (heading + 1) % len(MOVES)
    return right_turn, heading, left_turn


def barn_path(free: Cells, start: Cell, goal: Cell) -> Optional[Ints]:
    """Return the path (k, 2) int64 of BARN's generator from start to goal, or None.

    The search is A* with three deviations that shape BARN's paths. A cell's penalty affects the
    order of expansion, but not the cost of later cells. Only a cell that is reached again at a
    lower cost gets a heuristic. Turns are limited to 45 degrees, but a cell is closed for all
    headings, so the search may miss an existing path and return None.
    """
    penalty = obstacle_penalty(free)
    row_count, column_count = free.shape
    cost_to = {start: 0.0}
    parent: Dict[Cell, Cell] = {}
    heading = {start: ANY_MOVE}  # move by which the path enters a cell
    rank = {start: 0.0}
    discovery = {start: 0}  # order of discovery, which decides ties
    queue = [(0.0, 0, start)]
    closed = set()
    while queue:
        queued_rank, _, cell = heapq.heappop(queue)
        if cell in closed or queued_rank != rank[cell]:
            continue  # The entry is outdated: the cell has been reached at a lower cost since.
        closed.add(cell)
        # The goal ends the search when it is expanded, not when it is discovered, because a path
        # at a lower cost may still be found in between.
        if cell == goal:
            path = [cell]
            while path[-1] != start:
                path.append(parent[path[-1]])
            return np.array(path[::-1], dtype=np.int64)
        cell_row, cell_column = cell
        for move in _turns(heading[cell]):
            row_step, column_step = MOVES[move]
            next_row = cell_row + row_step
            next_column = cell_column + column_step
            next_cell = next_row, next_column
            is_inside = 0 <= next_row < row_count and 0 <= next_column < column_count
            if not is_inside or not free[next_cell] or next_cell in closed:
                continue
            beside_in_row = cell_row, next_column
            beside_in_column = next_row, cell_column
            if not free[beside_in_row] and not free[beside_in_column]:
                continue  # A diagonal move must not pass between two blocked corners.
            cost = cost_to[cell] + math.hypot(row_step, column_step)
            # A cell that is discovered has no heuristic yet (second deviation from A*).
            if next_cell not in cost_to:
                discovery[next_cell] = len(discovery)
                rank[next_cell] = cost + penalty[next_cell]
            elif cost < cost_to[next_cell]:
                heuristic = math.hypot(next_row - goal[0], next_column - goal[1])
                rank[next_cell] = cost + heuristic + penalty[next_cell]
            else:
                continue
            cost_to[next_cell] = cost
            parent[next_cell] = cell
            heading[next_cell] = move
            heapq.heappush(queue, (rank[next_cell], discovery[next_cell], next_cell))
    return None


def grid_graph(free: Cells) -> Any:
    """Return the graph of barn_path's moves between free cells, for scipy.sparse.csgraph.

    The weights are the lengths of the moves [cells], and the cells are numbered row by row. The
    outermost cells must not be free, because a move from one of them would enter another row.
    """
    is_free = free.ravel()
    cell_indices = np.flatnonzero(free).astype(np.int32)
    lengths = []
    origins = []
    targets = []
    for row_step, column_step in MOVES:
        # A diagonal move passes one of the two cells beside it, as in barn_path.
        beside_in_row = cell_indices + column_step
        beside_in_column = cell_indices + row_step * free.shape[1]
        target_cells = beside_in_column + column_step
        is_passable = is_free[target_cells] & (is_free[beside_in_column] | is_free[beside_in_row])
        lengths.append(np.full(is_passable.sum(), math.hypot(row_step, column_step)))
        origins.append(cell_indices[is_passable])
        targets.append(target_cells[is_passable])
    edge_ends = (np.concatenate(origins), np.concatenate(targets))
    return scipy.sparse.csr_matrix(
        (np.concatenate(lengths), edge_ends),
        shape=(free.size, free.size),
    )
