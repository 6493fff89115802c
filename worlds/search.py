"""Searches on a grid for reference paths: A* ported from BARN's world generator, and the graph of a map."""

from __future__ import annotations

import heapq
import math
from typing import Any, Dict, List, Optional, Tuple

import numpy as np
import scipy
from numpy.typing import NDArray

from applr_ros1.common.arrays import Array, Ints

Cell = Tuple[int, int]
Cells = NDArray[np.bool_]  # mask (rows, columns) of a grid's cells

MOVES = ((0, 1), (1, 1), (1, 0), (1, -1), (0, -1), (-1, -1), (-1, 0), (-1, 1))  # moves in steps of 45 degrees
LENGTHS = tuple(math.hypot(*m) for m in MOVES)
SHY_CELLS, SHY_COST = 2.0, 5.0  # range [cells] and weight of the penalty SHY_COST / distance to a blocked cell


def free_space(filled: Cells, clearance: int) -> Cells:
    """Return the cells with no filled cell within +-`clearance` cells. Cells outside the grid count as empty."""
    near: Cells = scipy.ndimage.maximum_filter(filled, size=2 * clearance + 1, mode="constant", cval=False)
    return ~near


def obstacle_penalty(free: Cells) -> Array:
    """Return the penalty of each cell: 5 / (distance to the nearest blocked cell) up to 2 cells away, otherwise 0."""
    if free.all():
        return np.zeros(free.shape)
    distance = scipy.ndimage.distance_transform_edt(free)
    return np.where(free & (distance <= SHY_CELLS), SHY_COST / np.maximum(distance, 1.0), 0.0)


def _turns(heading: int) -> Tuple[int, ...]:
    """Return the moves within 45 degrees of the move `heading`, or all if it is -1. Their order decides ties."""
    if heading < 0:
        return tuple(range(8))
    return (heading - 1) % 8, heading, (heading + 1) % 8


def barn_path(free: Cells, start: Cell, goal: Cell) -> Optional[Ints]:
    """Return the path (k, 2) int64 of BARN's generator from start to goal, or None if the search fails.

    The search is A* with three deviations that shape BARN's paths. A cell's penalty affects the order of expansion, but
    not the cost of later cells. Only a cell that is reached again at a lower cost gets a heuristic. Turns are limited
    to 45 degrees, but a cell is closed for all headings, so the search may miss an existing path.
    """
    penalty = obstacle_penalty(free)
    rows, columns = free.shape
    spent: Dict[Cell, float] = {start: 0.0}
    parent: Dict[Cell, Tuple[Cell, int]] = {start: (start, -1)}
    rank: Dict[Cell, float] = {start: 0.0}
    number: Dict[Cell, int] = {start: 0}  # order of discovery, which decides ties
    queue: List[Tuple[float, int, Cell]] = [(0.0, 0, start)]
    closed = set()
    while queue:
        value, _, cell = heapq.heappop(queue)
        if cell in closed or value != rank[cell]:
            continue
        closed.add(cell)
        if cell == goal:
            path = [cell]
            while path[-1] != start:
                path.append(parent[path[-1]][0])
            return np.array(path[::-1], dtype=np.int64)
        for turn in _turns(parent[cell][1]):
            r, c = cell[0] + MOVES[turn][0], cell[1] + MOVES[turn][1]
            if not (0 <= r < rows and 0 <= c < columns and free[r, c]) or (r, c) in closed:
                continue
            if not (free[r, cell[1]] or free[cell[0], c]):
                continue  # A diagonal move must not pass between two blocked corners.
            cost = spent[cell] + LENGTHS[turn]
            if (r, c) not in spent:
                number[r, c] = len(number)
                rank[r, c] = cost + penalty[r, c]
            elif cost < spent[r, c]:
                rank[r, c] = cost + math.hypot(r - goal[0], c - goal[1]) + penalty[r, c]
            else:
                continue
            spent[r, c], parent[r, c] = cost, (cell, turn)
            heapq.heappush(queue, (rank[r, c], number[r, c], (r, c)))
    return None


def grid_graph(free: Cells) -> Any:
    """Return the graph of barn_path's moves between free cells with their lengths [cells], for scipy.sparse.csgraph.

    The cells are numbered row by row. The outermost cells must not be free.
    """
    flat, cells, edges = free.ravel(), np.flatnonzero(free).astype(np.int32), []
    for (row, column), length in zip(MOVES, LENGTHS):
        beside, ahead = cells + row * free.shape[1], cells + column
        passes = flat[beside + column] & (flat[beside] | flat[ahead])
        edges.append((np.full(passes.sum(), length), cells[passes], (beside + column)[passes]))
    lengths, *ends = (np.concatenate(parts) for parts in zip(*edges))
    return scipy.sparse.csr_matrix((lengths, ends), shape=(free.size, free.size))
