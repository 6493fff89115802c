"""Reference paths on a grid: BARN's own search, move for move, and an exact A* for worlds that come without a path.

The generator uses the first, `worlds.course` the second; both keep a robot's width from what is filled.
"""

from __future__ import annotations

import heapq
import math
from typing import Dict, Iterable, List, Optional, Tuple

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
    parent: Dict[Cell, Tuple[Optional[Cell], int]] = {start: (None, -1)}
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
            return _trace(cell, lambda c: parent[c][0])
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


def shortest_path(free: np.ndarray, starts: Iterable[Cell], goals: Iterable[Cell]) -> Optional[np.ndarray]:
    """The cheapest path from any of the starts to any of the goals, or None: length in cells plus penalties on the way.

    free     (rows, columns) bool
    returns  (k, 2) int64 cells; consecutive moves differ by at most 45 degrees.
    A state is a cell and the move that led into it, so the rule on turns costs no exactness. Every state is opened at
    most once: time and memory are bounded by 8 x the number of cells.
    """
    extra = obstacle_penalty(free)
    rows, columns = free.shape
    ends = {(int(r), int(c)) for r, c in goals if free[r, c]}
    best = np.full((8, rows, columns), np.inf)
    came_from: Dict[Tuple[int, int, int], Tuple[int, int, int]] = {}
    queue = [(0.0, n, int(s[0]), int(s[1]), -1) for n, s in enumerate(starts) if free[tuple(s)]]
    heapq.heapify(queue)
    order = len(queue)
    while queue:
        cost, _, r, c, heading = heapq.heappop(queue)
        if (r, c) in ends:
            return _trace((r, c, heading), came_from.get)
        if heading >= 0 and cost > best[heading, r, c]:
            continue
        for turn in _turns(heading):
            nr, nc = r + MOVES[turn][0], c + MOVES[turn][1]
            if not (0 <= nr < rows and 0 <= nc < columns and free[nr, nc]) or not (free[nr, c] or free[r, nc]):
                continue
            reached = cost + LENGTHS[turn] + extra[nr, nc]
            if reached < best[turn, nr, nc]:
                best[turn, nr, nc] = reached
                came_from[nr, nc, turn] = (r, c, heading)
                order += 1
                heapq.heappush(queue, (reached, order, nr, nc, turn))
    return None


def _trace(state, previous) -> np.ndarray:
    cells = []
    while state is not None:
        cells.append(state[:2])
        state = previous(state)
    return np.array(cells[::-1], dtype=np.int64)
