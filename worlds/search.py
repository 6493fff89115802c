"""A* over a grid as BARN's generator has it: 8-connected, gentle turns, shy of blocked cells.
The generator makes its reference paths with it, the SDF reader searches a course where no path file lies beside a world."""
from __future__ import annotations

import heapq
import math
from typing import Optional, Tuple

import numpy as np
from scipy import ndimage

MOVES = ((1, 0), (1, 1), (0, 1), (-1, 1), (-1, 0), (-1, -1), (0, -1), (1, -1))     # neighbours differ by 45 degrees
SHY_CELLS, SHY_COST = 2.0, 5.0      # a cell this near to a blocked one costs 5 / distance more


def free_space(filled: np.ndarray, clearance: int) -> np.ndarray:
    """Cells with no filled cell in the window of +-`clearance` cells. Outside the grid counts as empty."""
    size = 2 * clearance + 1
    return ~ndimage.maximum_filter(filled, size=size, mode="constant", cval=False)


def shyness(free: np.ndarray) -> np.ndarray:
    """Extra cost of entering each cell: 5 / (distance to the nearest blocked cell) within 2 cells, else 0."""
    if free.all():
        return np.zeros(free.shape)
    distance = ndimage.distance_transform_edt(free)
    near = free & (distance <= SHY_CELLS)
    return np.where(near, SHY_COST / np.maximum(distance, 1.0), 0.0)


def shortest_path(free: np.ndarray, start: Tuple[int, int], goal: Tuple[int, int]) -> Optional[np.ndarray]:
    """Cheapest path over free cells, or None.

    free         (rows, columns) bool
    start, goal  cells
    returns      (k, 2) int64 cells from start to goal; consecutive moves differ by at most 45 degrees.

    A state is a cell and the move that led into it, so that the rule on turns keeps A* exact. Ties fall to the state
    that was reached first: the result depends on the arguments only.
    """
    rows, columns = free.shape
    if not (free[start] and free[goal]):
        return None
    extra = shyness(free)
    lengths = [math.hypot(*m) for m in MOVES]

    def to_go(r, c):
        a, b = abs(goal[0] - r), abs(goal[1] - c)
        return max(a, b) + (math.sqrt(2.0) - 1.0) * min(a, b)

    best = np.full((rows, columns, 8), np.inf)
    came_from = {}
    queue = [(to_go(*start), 0, 0.0, start[0], start[1], -1)]
    order = 0
    while queue:
        _, _, cost, r, c, heading = heapq.heappop(queue)
        if (r, c) == goal:
            return _trace(came_from, (r, c, heading), start)
        if heading >= 0 and cost > best[r, c, heading]:
            continue
        for turn in (range(8) if heading < 0 else ((heading - 1) % 8, heading, (heading + 1) % 8)):
            nr, nc = r + MOVES[turn][0], c + MOVES[turn][1]
            if not (0 <= nr < rows and 0 <= nc < columns and free[nr, nc]):
                continue
            reached = cost + lengths[turn] + extra[nr, nc]
            if reached < best[nr, nc, turn]:
                best[nr, nc, turn] = reached
                came_from[(nr, nc, turn)] = (r, c, heading)
                order += 1
                heapq.heappush(queue, (reached + to_go(nr, nc), order, reached, nr, nc, turn))
    return None


def _trace(came_from, state, start) -> np.ndarray:
    cells = [state[:2]]
    while state[2] >= 0:
        state = came_from[state]
        cells.append(state[:2])
    return np.array(cells[::-1], dtype=np.int64)
