"""Incremental brushfire of the inflation layer: keeps the costs that obstacles spread, and repairs them after changes.

Called by inflation_layer.InflationLayer. In every update, C++ spreads the costs of all obstacles anew, along
4-neighbours from a queue ordered by distance, first in first out for equal distances. The source of a cell, the
obstacle from which it is reached, depends only on the sources of neighbours nearer to an obstacle. If few obstacles
change, only the cells that depend on them are evaluated again. The result equals that of C++, cell for cell
(tests/planner/costmap/test_inflation.py). The reach is the inflation radius in cells.

Arrays are padded by one cell on all sides and addressed flat, p = (y + 1) (nx + 2) + x + 1:
  level (uint8)  rank of the distance to the source, counted from SEED; WALL on the padding, NONE beyond every reach
  link (uint16)  code (dy + reach) (2 reach + 1) + dx + reach of the offset from the source + last direction << 12
  cost (uint8)   cost of the level, 0 for NONE
Directions 0 .. 3 are x - 1, y - 1, x + 1, y + 1, the order in which C++ enqueues neighbours.
"""

from __future__ import annotations

from functools import lru_cache
from typing import Tuple

import numpy as np

from applr_ros1.common.arrays import Data
from applr_ros1.common.kernels import kernel
from applr_ros1.planner.costmap.grid import Window

WALL = 0  # level of the padding
SEED = 1  # level of a lethal cell, the source of a spread
NONE = 255  # level of a cell that no obstacle reaches
MAX_REACH = 25  # largest reach whose levels fit into uint8 [cells]; for more, InflationLayer recomputes all costs
CODE = 4095  # mask of the offset code in a link
Steps = Tuple[int, int, int, int]  # flat offsets of the four directions
Spread = Tuple[Data, Data, Data, Data, Data, int]  # level, link, cost, step_level, cost by level, reach [cells]


@lru_cache(maxsize=64)
def tables(reach: int) -> Tuple[np.ndarray, Tuple[float, ...]]:
    """Return (step_level, distances) for a reach [cells].

    step_level (codes * 4,) uint8: entry 4 c + k is the level of the cell one step in direction k from offset code c, or
    0 if that cell is beyond `reach` or no further from the source. distances: distance [cells] by level, SEED first.
    """
    side = 2 * reach + 1
    axis = np.arange(-reach - 1, reach + 2, dtype=np.float64)
    distance = np.hypot(axis[:, None], axis[None, :])
    distances = np.unique(distance[distance <= reach])
    level = np.where(distance <= reach, np.searchsorted(distances, distance) + SEED, 0)
    step_level = np.zeros((side, side, 4), np.uint8)
    inner = slice(1, side + 1)
    for k, (dx, dy) in enumerate(((-1, 0), (0, -1), (1, 0), (0, 1))):
        ahead = slice(1 + dy, side + 1 + dy), slice(1 + dx, side + 1 + dx)
        step_level[:, :, k] = np.where(distance[ahead] > distance[inner, inner], level[ahead], 0)
    return step_level.reshape(-1), tuple(distances.tolist())


@kernel
def seed_changes(base: Data, level: Data, rect: Window, around: Window, changed: Data) -> int:
    """Write the flat indices of cells that become or cease to be seeds into `changed`; return their number.

    The seeds are now the lethal cells (254) of `base` (ny, nx) within `rect`. Changes are listed row by row. `around`
    must contain `rect` and all earlier seeds. Return -1 if `changed` is too short.
    """
    (x0, y0, xn, yn), (ax0, ay0, axn, ayn) = rect, around
    count = 0
    for y in range(ay0, ayn):
        inside = y0 <= y < yn
        left = x0 if inside else axn
        right = xn if inside else axn
        differs = np.uint8(0)
        levels = level[y + 1, left + 1 : right + 1]
        values = base[y, left:right]
        for i in range(values.shape[0]):
            differs |= np.uint8((values[i] == 254) != (levels[i] == SEED))
        differs |= _any_seed(level[y + 1, ax0 + 1 : left + 1]) | _any_seed(level[y + 1, right + 1 : axn + 1])
        if differs == 0:
            continue
        for x in range(ax0, axn):
            seed = left <= x < right and base[y, x] == 254
            if seed != (level[y + 1, x + 1] == SEED):
                if count == changed.shape[0]:
                    return -1
                changed[count] = (y + 1) * level.shape[1] + x + 1
                count += 1
    return count


@kernel
def _any_seed(levels: Data) -> np.uint8:
    any_seed = np.uint8(0)
    for i in range(levels.shape[0]):
        any_seed |= np.uint8(levels[i] == SEED)
    return any_seed


@kernel
def _enqueue(queue: Data, used: int, entry: int, level: int) -> int:
    """Append an entry (4 cell + direction) to the queue of a level; return the new number of entries.

    The rows of queue (4, m) int32 are: entry; index of the next entry of the same level; by level, index of the first
    and of the last entry. One array has all four, because numba's counting of references to arrays takes long.
    """
    queue[0, used] = entry
    queue[1, used] = -1
    if queue[2, level] < 0:
        queue[2, level] = used
    else:
        queue[1, queue[3, level]] = used
    queue[3, level] = used
    return used + 1


@kernel
def rebuild(seeds: Data, count: int, spread: Spread, queue: Data) -> bool:
    """Spread costs from the first `count` cells of `seeds` into empty arrays; return False if `queue` is too short."""
    level2, link, cost, step_level, level_cost, reach = spread
    width = level2.shape[1]
    level = level2.reshape(-1)
    side = 2 * reach + 1
    steps = (-1, -width, 1, width)
    deltas = (-1, -side, 1, side)
    queue[2, :256] = -1
    used = 0
    room = queue.shape[1] - 4
    centre = reach * side + reach
    for i in range(count):
        c = seeds[i]
        level[c] = SEED
        link[c] = centre
        cost[c] = level_cost[SEED]
    for i in range(count):
        if used > room:
            return False
        for k in range(4):
            c = seeds[i] + steps[k]
            b = step_level[4 * centre + k]
            if b != 0 and level[c] == NONE:
                used = _enqueue(queue, used, 4 * c + k, b)
    for b in range(2, NONE):
        e = queue[2, b]
        while e >= 0:
            c = queue[0, e] >> 2
            k = queue[0, e] & 3
            e = queue[1, e]
            if level[c] != NONE:
                continue
            if used > room:
                return False
            code = (link[c - steps[k]] & CODE) + deltas[k]
            level[c] = b
            link[c] = code | (k << 12)
            cost[c] = level_cost[b]
            for j in range(4):
                t = step_level[4 * code + j]
                q = c + steps[j]
                if t != 0 and level[q] == NONE:
                    used = _enqueue(queue, used, 4 * q + j, t)
    return True


@kernel
def _earlier(level: Data, link: Data, steps: Steps, n1: int, k1: int, n2: int, k2: int) -> bool:
    """Return whether C++ enqueued step k1 from cell n1 before step k2 from n2. Both lead to the same level."""
    while True:
        if n1 == n2:
            return k1 < k2
        if level[n1] != level[n2]:
            return bool(level[n1] < level[n2])
        if level[n1] == SEED:
            return n1 < n2
        k1 = link[n1] >> 12
        k2 = link[n2] >> 12
        n1 -= steps[k1]
        n2 -= steps[k2]


@kernel
def _remove_subtree(level: Data, link: Data, cost: Data, steps: Steps, root: int, lost: Data, count: int) -> int:
    """Reset `root` and all cells reached through `root` to NONE, and append them to `lost`; return its new length."""
    lost[count] = root
    level[root] = NONE
    cost[root] = 0
    i = count
    count += 1
    while i < count:
        c = lost[i]
        i += 1
        for k in range(4):
            q = c + steps[k]
            if SEED < level[q] < NONE and link[q] >> 12 == k:
                level[q] = NONE
                cost[q] = 0
                lost[count] = q
                count += 1
    return count


@kernel
def repair(changed: Data, count: int, spread: Spread, queue: Data, lost: Data) -> bool:
    """Add the first `count` cells of `changed` as seeds, or remove those that are seeds. Repair all dependent cells.

    Return False if `queue` or `lost` (m,) int64 is too short. The arrays then have to be rebuilt.
    """
    level2, link, cost, step_level, level_cost, reach = spread
    width = level2.shape[1]
    level = level2.reshape(-1)
    side = 2 * reach + 1
    steps = (-1, -width, 1, width)
    deltas = (-1, -side, 1, side)
    queue[2, :256] = -1
    used = 0
    room = queue.shape[1] - 8
    lost_room = lost.shape[0] - 4 * side * side
    centre = reach * side + reach
    n_lost = 0
    for i in range(count):
        c = changed[i]
        begins = level[c] != SEED
        if level[c] != NONE:
            if n_lost > lost_room:
                return False
            n_lost = _remove_subtree(level, link, cost, steps, c, lost, n_lost)
        if begins:
            level[c] = SEED
            link[c] = centre
            cost[c] = level_cost[SEED]
            if used > room:
                return False
            for k in range(4):
                b = step_level[4 * centre + k]
                q = c + steps[k]
                if b != 0 and level[q] >= b:
                    used = _enqueue(queue, used, 4 * q + k, b)
    done = 0
    b = 2
    while True:
        while done < n_lost:  # Each neighbour that still has a level may reach the lost cell again.
            c = lost[done]
            done += 1
            if level[c] != NONE:
                continue
            if used > room:
                return False
            for k in range(4):
                n = c - steps[k]
                if level[n] != WALL and level[n] != NONE:
                    t = step_level[4 * (link[n] & CODE) + k]
                    if t != 0:
                        if t < b:
                            b = t
                        used = _enqueue(queue, used, 4 * c + k, t)
        while b < NONE and queue[2, b] < 0:
            b += 1
        if b == NONE:
            return True
        e = queue[2, b]
        queue[2, b] = queue[1, e]
        c = queue[0, e] >> 2
        k = queue[0, e] & 3
        n = c - steps[k]
        if level[c] < b or level[n] == WALL or level[n] == NONE:
            continue
        code = link[n] & CODE
        if step_level[4 * code + k] != b:  # The entry is outdated: n has been evaluated again.
            continue
        if level[c] != NONE:
            if level[c] == b:
                other = link[c] >> 12
                if other == k or not _earlier(level, link, steps, n, k, c - steps[other], other):
                    continue
            if n_lost > lost_room:
                return False
            n_lost = _remove_subtree(level, link, cost, steps, c, lost, n_lost)
        if used > room:
            return False
        code += deltas[k]
        level[c] = b
        link[c] = code | (k << 12)
        cost[c] = level_cost[b]
        for j in range(4):
            t = step_level[4 * code + j]
            q = c + steps[j]
            if t != 0 and level[q] >= t:
                used = _enqueue(queue, used, 4 * q + j, t)
