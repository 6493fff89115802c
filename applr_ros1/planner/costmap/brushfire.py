"""Incremental brushfire of the inflation layer: the spread of obstacles, repaired after changes.

Called by inflation_layer.InflationLayer. In every update, C++ spreads the costs of all obstacles
anew, along 4-neighbours from a queue ordered by distance, first in first out for equal distances
(costmap_2d/inflation_layer.cpp). The source of a cell, the obstacle from which it is reached,
depends only on the sources of neighbours nearer to an obstacle. If few obstacles change, only the
cells that depend on them are evaluated again. The result equals that of C++, cell for cell
(tests/planner/costmap/test_inflation.py). The reach is the inflation radius in cells.

Directions 0 .. 3 are x - 1, y - 1, x + 1, y + 1, the order in which C++ enqueues neighbours. The
offset code of a cell is (dy + reach) (2 reach + 1) + dx + reach, with (dx, dy) its offset from its
source [cells].
"""

from __future__ import annotations

from functools import lru_cache
from typing import NamedTuple, Tuple, Type

import numpy as np

from applr_ros1.common.arrays import Data
from applr_ros1.common.kernels import kernel
from applr_ros1.planner.costmap.grid import LETHAL, Window

# Levels of the padding and of a lethal cell (the source of a spread). A cell that no obstacle
# reaches has the highest level of the type, `none`. In this order, one comparison with another
# level skips walls and accepts empty cells.
WALL = 0
SEED = 1

NARROW_REACH = 25  # largest reach [cells] whose levels fit into uint8
DIRECTIONS = ((-1, 0), (0, -1), (1, 0), (0, 1))  # (dx, dy) [cells]

# Rows of a queue (4, m) int32. One array has all four, because numba's counting of references to
# arrays takes long.
ENTRY = 0  # by number of the entry: 4 cell + direction of the step that leads to the cell
NEXT = 1  # by number of the entry: number of the next entry of the same level, -1 for the last one
FIRST = 2  # by level: number of the first entry, -1 if there is none
LAST = 3  # by level: number of the last entry

Steps = Tuple[int, int, int, int]  # flat offsets of the four directions


class Spread(NamedTuple):
    """Spread of all obstacles, with its tables.

    Cells are padded by one on all sides and addressed flat, (y + 1) (columns + 2) + x + 1.
    """

    level: Data  # rank of the distance to the source, from SEED on; WALL on the padding; or none
    link: Data  # offset code; in the highest four bits, direction of the last step
    cost: Data  # uint8 cost of the level, 0 for none
    width: int  # columns + 2
    reach: int  # [cells]
    step_level: Data  # see tables()
    level_cost: Data  # uint8 cost by level


def types_of(reach: int) -> Tuple[Type[np.integer], Type[np.integer]]:
    """Return the types of levels and links for a reach [cells].

    They are as small as possible, because an update takes 4 % longer with int32.
    """
    if reach <= NARROW_REACH:
        return np.uint8, np.uint16
    return np.int32, np.int32


@lru_cache(maxsize=64)
def tables(reach: int) -> Tuple[np.ndarray, Tuple[float, ...]]:
    """Return (step_level, distances) for a reach [cells].

    step_level (codes * 4,), of the type of the levels: entry 4 c + k is the level of the cell one
    step in direction k from offset code c, or 0 if that cell is beyond `reach` or no further from
    the source.
    distances: distance [cells] by level, SEED first.
    """
    side = 2 * reach + 1
    offsets = np.arange(-reach - 1, reach + 2, dtype=np.float64)
    distance = np.hypot(offsets[:, None], offsets[None, :])
    distances = np.unique(distance[distance <= reach])
    level = np.where(distance <= reach, np.searchsorted(distances, distance) + SEED, 0)
    level_type, _ = types_of(reach)
    step_level = np.zeros((side, side, 4), level_type)
    inner_cells = slice(1, side + 1)
    # One more cell on each side lets a step from the edge of the table end in the arrays.
    for direction, (dx, dy) in enumerate(DIRECTIONS):
        rows_ahead = slice(1 + dy, side + 1 + dy)
        columns_ahead = slice(1 + dx, side + 1 + dx)
        cells_ahead = (rows_ahead, columns_ahead)
        is_further = distance[cells_ahead] > distance[inner_cells, inner_cells]
        step_level[:, :, direction] = np.where(is_further, level[cells_ahead], 0)
    return step_level.reshape(-1), tuple(distances.tolist())


@kernel
def seed_changes(base: Data, level: Data, rect: Window, around: Window, changed: Data) -> int:
    """Write the flat indices of cells that become or cease to be seeds into `changed`.

    The seeds are now the lethal cells (254) of `base` (rows, columns) within `rect`. Changes are
    listed row by row. `level` is the padded (rows + 2, columns + 2) array. `around` must contain
    `rect` and all earlier seeds.

    Returns:
        The number of changes, or -1 if `changed` is too short.
    """
    rect_left, rect_bottom, rect_right, rect_top = rect
    left, bottom, right, top = around
    count = 0
    for row in range(bottom, top):
        # Columns in which this row may have seeds: none above and below `rect`.
        first_column = right
        end_column = right
        if rect_bottom <= row < rect_top:
            first_column = rect_left
            end_column = rect_right

        # Most rows are unchanged. This test has no branches and compiles to vector instructions.
        row_differs = np.uint8(0)
        levels = level[row + 1, first_column + 1 : end_column + 1]
        base_row = base[row, first_column:end_column]
        for index in range(base_row.shape[0]):
            row_differs |= np.uint8((base_row[index] == LETHAL) != (levels[index] == SEED))
        row_differs |= _any_seed(level[row + 1, left + 1 : first_column + 1])
        row_differs |= _any_seed(level[row + 1, end_column + 1 : right + 1])
        if row_differs == 0:
            continue

        for column in range(left, right):
            is_seed = first_column <= column < end_column and base[row, column] == LETHAL
            if is_seed != (level[row + 1, column + 1] == SEED):
                if count == changed.shape[0]:
                    return -1
                changed[count] = (row + 1) * level.shape[1] + column + 1
                count += 1
    return count


@kernel
def _any_seed(levels: Data) -> np.uint8:
    any_seed = np.uint8(0)
    for index in range(levels.shape[0]):
        any_seed |= np.uint8(levels[index] == SEED)
    return any_seed


@kernel
def _enqueue(queue: Data, queued: int, entry: int, level: int) -> int:
    """Append an entry (4 cell + direction) to the queue of a level; return the new entry count."""
    queue[ENTRY, queued] = entry
    queue[NEXT, queued] = -1
    if queue[FIRST, level] < 0:
        queue[FIRST, level] = queued
    else:
        queue[NEXT, queue[LAST, level]] = queued
    queue[LAST, level] = queued
    return queued + 1


@kernel(inline="always")
def _enqueue_around(
    queue: Data, queued: int, level: Data, step_level: Data, steps: Steps, cell: int, code: int
) -> int:
    """Enqueue the neighbours that a cell with this offset code may reach; return the entry count.

    These are the neighbours further from the source that are not nearer to another source.
    """
    for direction in range(4):
        next_level = step_level[4 * code + direction]
        neighbour = cell + steps[direction]
        if next_level != 0 and level[neighbour] >= next_level:
            queued = _enqueue(queue, queued, 4 * neighbour + direction, next_level)
    return queued


@kernel
def rebuild(seeds: Data, count: int, spread: Spread, queue: Data) -> bool:
    """Spread costs from the first `count` cells of `seeds` into empty arrays.

    Return False if `queue` is too short. The arrays then have to be emptied again.
    """
    # A namedtuple's fields are read once, because each access would count references.
    level, link, cost, width, reach, step_level, level_cost = spread
    none = np.iinfo(level.dtype).max
    direction_bit = 8 * link.itemsize - 4
    code_mask = (1 << direction_bit) - 1
    side = 2 * reach + 1
    steps = (-1, -width, 1, width)
    code_steps = (-1, -side, 1, side)
    centre = reach * side + reach
    level_count = level_cost.shape[0]
    queue[FIRST, :level_count] = -1
    queued = 0
    queue_room = queue.shape[1] - 4  # A cell has at most four entries to append.

    # All seeds are set before the first neighbour is enqueued, so that no seed enters the queue.
    for index in range(count):
        cell = seeds[index]
        level[cell] = SEED
        link[cell] = centre
        cost[cell] = level_cost[SEED]
    for index in range(count):
        if queued > queue_room:
            return False
        queued = _enqueue_around(queue, queued, level, step_level, steps, seeds[index], centre)

    # The first entry that leads to a cell decides its source, later ones are skipped.
    for next_level in range(SEED + 1, level_count):
        entry_number = queue[FIRST, next_level]
        while entry_number >= 0:
            cell = queue[ENTRY, entry_number] >> 2
            direction = queue[ENTRY, entry_number] & 3
            entry_number = queue[NEXT, entry_number]
            if level[cell] != none:
                continue
            if queued > queue_room:
                return False
            code = (link[cell - steps[direction]] & code_mask) + code_steps[direction]
            level[cell] = next_level
            link[cell] = code | (direction << direction_bit)
            cost[cell] = level_cost[next_level]
            queued = _enqueue_around(queue, queued, level, step_level, steps, cell, code)
    return True


@kernel
def _is_earlier(
    level: Data,
    link: Data,
    steps: Steps,
    cell: int,
    direction: int,
    other_cell: int,
    other_direction: int,
) -> bool:
    """Return whether C++ enqueued a step from `cell` before one from `other_cell` to its level.

    The order of two steps is that of the steps which led to their cells, and finally of the seeds.
    """
    direction_bit = 8 * link.itemsize - 4
    while True:
        if cell == other_cell:
            return direction < other_direction
        if level[cell] != level[other_cell]:
            return bool(level[cell] < level[other_cell])
        if level[cell] == SEED:
            return cell < other_cell
        direction = link[cell] >> direction_bit
        other_direction = link[other_cell] >> direction_bit
        cell -= steps[direction]
        other_cell -= steps[other_direction]


@kernel
def _remove_subtree(
    level: Data, link: Data, cost: Data, steps: Steps, root: int, lost: Data, count: int
) -> int:
    """Reset `root` and all cells reached through `root` to none, and append them to `lost`.

    Return the new length of `lost`.
    """
    none = np.iinfo(level.dtype).max
    direction_bit = 8 * link.itemsize - 4
    # `lost` is also the list of cells whose neighbours are still to visit.
    lost[count] = root
    level[root] = none
    cost[root] = 0
    visited = count
    count += 1
    while visited < count:
        cell = lost[visited]
        visited += 1
        for direction in range(4):
            neighbour = cell + steps[direction]
            if SEED < level[neighbour] < none and link[neighbour] >> direction_bit == direction:
                level[neighbour] = none
                cost[neighbour] = 0
                lost[count] = neighbour
                count += 1
    return count


@kernel
def repair(changed: Data, count: int, spread: Spread, queue: Data, lost: Data) -> bool:
    """Add the first `count` cells of `changed` as seeds, or remove those that are seeds.

    All cells that depend on them are evaluated again. Return False if `queue` or `lost` (m,) int64
    is too short. The arrays then have to be rebuilt.
    """
    level, link, cost, width, reach, step_level, level_cost = spread
    none = np.iinfo(level.dtype).max
    direction_bit = 8 * link.itemsize - 4
    code_mask = (1 << direction_bit) - 1
    side = 2 * reach + 1
    steps = (-1, -width, 1, width)
    code_steps = (-1, -side, 1, side)
    centre = reach * side + reach
    level_count = level_cost.shape[0]
    queue[FIRST, :level_count] = -1
    queued = 0
    # Each step below appends at most as many entries as these margins leave. A subtree lies within
    # the reach of its seed.
    queue_room = queue.shape[1] - 8
    lost_count = 0
    lost_room = lost.shape[0] - 4 * side * side

    # A cell that becomes or ceases to be a seed loses its source, and so do all cells behind it.
    for index in range(count):
        cell = changed[index]
        becomes_seed = level[cell] != SEED
        if level[cell] != none:
            if lost_count > lost_room:
                return False
            lost_count = _remove_subtree(level, link, cost, steps, cell, lost, lost_count)
        if becomes_seed:
            if queued > queue_room:
                return False
            level[cell] = SEED
            link[cell] = centre
            cost[cell] = level_cost[SEED]
            queued = _enqueue_around(queue, queued, level, step_level, steps, cell, centre)

    next_lost = 0
    next_level = SEED + 1
    while True:
        # Each neighbour that still has a source may reach the lost cell again.
        while next_lost < lost_count:
            cell = lost[next_lost]
            next_lost += 1
            if level[cell] != none:
                continue
            if queued > queue_room:
                return False
            for direction in range(4):
                previous_cell = cell - steps[direction]
                if level[previous_cell] == WALL or level[previous_cell] == none:
                    continue
                reached_level = step_level[4 * (link[previous_cell] & code_mask) + direction]
                if reached_level != 0:
                    next_level = min(next_level, reached_level)
                    queued = _enqueue(queue, queued, 4 * cell + direction, reached_level)

        # Take the first entry of the lowest level.
        while next_level < level_count and queue[FIRST, next_level] < 0:
            next_level += 1
        if next_level == level_count:
            return True
        entry_number = queue[FIRST, next_level]
        queue[FIRST, next_level] = queue[NEXT, entry_number]
        cell = queue[ENTRY, entry_number] >> 2
        direction = queue[ENTRY, entry_number] & 3

        # Skip the entry if the cell has a nearer source, or if the entry is outdated because the
        # cell from which it leads has lost its source or has been evaluated again.
        previous_cell = cell - steps[direction]
        if level[cell] < next_level or level[previous_cell] == WALL or level[previous_cell] == none:
            continue
        code = link[previous_cell] & code_mask
        if step_level[4 * code + direction] != next_level:
            continue

        # A later source of the same distance and all more distant ones give way.
        if level[cell] != none:
            if level[cell] == next_level:
                other_direction = link[cell] >> direction_bit
                other_cell = cell - steps[other_direction]
                if other_direction == direction or not _is_earlier(
                    level, link, steps, previous_cell, direction, other_cell, other_direction
                ):
                    continue
            if lost_count > lost_room:
                return False
            lost_count = _remove_subtree(level, link, cost, steps, cell, lost, lost_count)
        if queued > queue_room:
            return False
        code += code_steps[direction]
        level[cell] = next_level
        link[cell] = code | (direction << direction_bit)
        cost[cell] = level_cost[next_level]
        queued = _enqueue_around(queue, queued, level, step_level, steps, cell, code)
