"""Reference paths on a grid by BARN's own search, move for move. The generator uses it."""

from __future__ import annotations

import heapq
import math
from typing import Dict, List, Optional, Tuple

import numpy as np
import scipy

Cell = Tuple[int, int]

MOVES = ((0, 1), (1, 1), (1, 0), (1, -1), (0, -1), (-1, -1), (-1, 0), (-1, 1))  # neighbours differ by 45 degrees
LENGTHS = tuple(math.hypot(*m) for m in MOVES)
SHY_CELLS, SHY_COST = 2.0, 5.0  # a cell this near to a blocked one costs 5 / distance more


def free_space(filled: np.ndarray, clearance: int) -> np.ndarray:
    """Cells with no filled cell in the window of +-`clearance` cells. What lies outside the grid counts as empty."""
    return ~scipy.ndimage.maximum_filter(filled, size=2 * clearance + 1, mode="constant", cval=False)


def obstacle_penalty(free: np.ndarray) -> np.ndarray:
    """Penalty of each cell: 5 / (distance to the nearest blocked cell) within 2 cells of one, else 0."""
    if free.all():
        return np.zeros(free.shape)
    distance = scipy.ndimage.distance_transform_edt(free)
    return np.where(free & (distance <= SHY_CELLS), SHY_COST / np.maximum(distance, 1.0), 0.0)


def _turns(heading: int) -> Tuple[int, ...]:
    """Moves at most 45 degrees off; every move from the start (heading -1). Order settles ties."""
    if heading < 0:
        return tuple(range(8))
    return (heading - 1) % 8, heading, (heading + 1) % 8


def barn_path(free: np.ndarray, start: Cell, goal: Cell) -> Optional[np.ndarray]:
    """The path that BARN's generator draws: (k, 2) int64 cells from start to goal, or None where it finds none.

    It resembles A*, with three peculiarities that shape BARN's paths and are kept: a cell's penalty counts for the
    order of expansion but is not passed on to later cells; a cell first met has no estimate of what is left, only one
    met again and cheaper has; and a cell is closed for all headings, so that the rule on turns can hide a path.
    """
    penalty = obstacle_penalty(free)
    rows, columns = free.shape
    spent: Dict[Cell, float] = {start: 0.0}
    parent: Dict[Cell, Tuple[Cell, int]] = {start: (start, -1)}
    rank: Dict[Cell, float] = {start: 0.0}
    number: Dict[Cell, int] = {start: 0}  # ties: the cell met first
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
                continue  # no squeezing between two blocked corners
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
