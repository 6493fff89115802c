"""Propagation ("flood") of navfn's potential from the robot's cell until the goal's is reached.

Called by navfn.Navfn; the most expensive kernel of a control cycle. The flood visits cells in the
order of C++, with the same rounding (navfn.cpp:419, 440, 615; docs/explanation/planner.md, section
5.2). Only the work per cell differs, because memory access limits the speed:
- A cell is two adjacent float32: its potential and its push weight (PUSH_WEIGHTS). The weight is
  infinite for obstacles and multiplied by 2^64 while the cell is in a list, so one comparison
  decides whether to push the cell to a list.
- An iteration runs over the current list twice, for the new potentials and for the pushes.
  Pushes do not change potentials, so the result is the same, and neither loop has a branch that the
  processor could mispredict.
- Lines of 16 potentials are recorded when written, and only these lines are reset for the next
  flood.

In the kernels, a cell is the index of its potential in the field, twice its number. Indices are
uint64 so that numba does not add a wrap-around for negative ones.
"""

from __future__ import annotations

from typing import Tuple

import numpy as np

from applr_ros1.common.arrays import Data
from applr_ros1.common.kernels import kernel

_int = np.uint64
OBSTACLE = 254  # cost of a cell that no plan enters
LIST_SIZE = 10000  # capacity of a list of cells; further cells are lost, as in C++
FAR = np.float32(1e10)  # potential of a cell that is not reached
THRESHOLD_STEP = np.float32(100.0)  # growth of the potential above which cells wait

# A listed cell's weight is raised above any potential. UNLISTED is the exact inverse of LISTED. A
# listed cell's weight times COST, rounded, is its cost 1 .. 253.
LISTED = np.float32(2.0**64)
UNLISTED = np.float32(2.0**-64)
COST = np.float32(1.4142135 * 2.0**-64)

# Push weights by cost (256,). A cell is pushed if its potential exceeds a neighbour's new potential
# plus the weight.
PUSH_WEIGHTS = np.full(256, np.inf, np.float32)
PUSH_WEIGHTS[:OBSTACLE] = [np.float32(0.707106781 * cost) for cost in range(OBSTACLE)]

# Layout of the field: distance of a cell's weight from its potential, and of the next cell.
WEIGHT = _int(1)
NEXT = _int(2)
LINE = 16  # number of potentials in a line
LINE_BITS = _int(5)  # binary digits of the index of a potential within its line
# Layout of `changes`: eight float32 for each improved cell, the old potentials of its neighbours
# left, right, below and above, and its new potential.
CHANGE_BITS = _int(3)
RIGHT = _int(1)
BELOW = _int(2)
ABOVE = _int(3)
NEW = _int(4)
ROOM = 4  # entries of a list beyond its capacity, which the fast pushes may overwrite

Work = Tuple[Data, Data, Data, Data]  # field, lines, lists (flat) and changes of flood()
# Index of the first entry of the lists current, following and waiting.
Starts = Tuple[np.uint64, np.uint64, np.uint64]


def make_field(cells: int) -> np.ndarray:
    """Return the initial field (2 n,) float32: for each cell FAR and an obstacle's weight.

    n is the number of cells, rounded up to the groups of eight lines that reset() handles.
    """
    lines = -(-cells // (8 * LINE)) * 8
    return np.tile(np.array([FAR, np.inf], dtype=np.float32), lines * LINE)


def scratch(list_size: int = LIST_SIZE) -> Tuple[np.ndarray, np.ndarray]:
    """Return the working arrays `lists` and `changes` of flood()."""
    entries = list_size + ROOM
    return np.empty((3, entries), np.uint32), np.empty(entries * 8, np.float32)


@kernel
def reset(field: Data, lines: Data) -> None:
    """Reset the potentials of all recorded lines to FAR and clear the records."""
    # Eight records are tested at once.
    groups = lines.view(np.uint64)
    for group in range(groups.shape[0]):
        if groups[group] == 0:
            continue
        for line in range(8 * group, 8 * group + 8):
            if lines[line] != 0:
                for cell in range(_int(2 * LINE * line), _int(2 * LINE * (line + 1)), NEXT):
                    field[cell] = FAR
        groups[group] = 0


@kernel
def _push(
    field: Data,
    lists: Data,
    end: _int,
    cell: _int,
    old_potential: np.float32,
    new_potential: np.float32,
) -> _int:
    """Push a cell to a list if its neighbour's new potential may lower its old potential.

    The cell is written in any case, and the list's end, which is returned, moves past it only if
    it is pushed: this spares a branch.
    """
    weight = field[cell + WEIGHT]
    is_pushed = old_potential > new_potential + weight
    lists[end] = cell
    field[cell + WEIGHT] = weight * LISTED if is_pushed else weight
    return end + _int(is_pushed)


@kernel(error_model="numpy")
def flood(
    field: Data,
    lines: Data,
    lists_: Data,
    changes: Data,
    columns: int,
    rows: int,
    robot_: int,
    goal_: int,
) -> None:
    """Grow the potential from the cell number `robot_` until the cell `goal_` is reached.

    Args:
        field: float32 array of make_field(), with all potentials FAR and infinite weights on the
            map's border.
        lines: uint8 zeros, one per LINE cells.
        lists_: (3, m + 4) uint32, scratch memory for lists of m cells.
        changes: (8 m + 32,) float32, scratch memory.
        columns: columns of the map.
        rows: rows of the map.
        robot_: number of the robot's cell.
        goal_: number of the goal's cell.
    """
    row = _int(2 * columns)
    robot = _int(2 * robot_)
    goal = _int(2 * goal_)
    field_end = _int(2 * columns * rows)
    lists = lists_.reshape(lists_.size)
    capacity = _int(lists_.shape[1] - ROOM)

    # First entry and number of entries of the three lists: the cells of this iteration, those of
    # the next one, and those that wait until the threshold has grown.
    current = _int(0)
    following = _int(lists_.shape[1])
    waiting = _int(2 * lists_.shape[1])
    current_count = _int(0)
    waiting_count = _int(0)
    threshold = np.float32(OBSTACLE)

    # Start at the neighbours of the robot, in the order of C++.
    field[robot] = np.float32(0.0)
    lines[robot >> LINE_BITS] = 1
    for cell in (robot + NEXT, robot - NEXT, robot - row, robot + row):
        if cell < field_end and field[cell + WEIGHT] < FAR and current_count < capacity:
            lists[current_count] = cell
            current_count += _int(1)
            field[cell + WEIGHT] *= LISTED

    for _ in range(max(columns * rows // 20, columns + rows)):
        if current_count == _int(0):
            break
        improved_count = _lower(field, lists, changes, current, current_count, row)
        work = (field, lines, lists, changes)
        starts = (current, following, waiting)
        # Each improved cell pushes up to four neighbours, to either list.
        if _int(4) * current_count + waiting_count > capacity:
            current_count, waiting_count = _push_carefully(
                work, starts, improved_count, threshold, row, waiting_count, capacity
            )
        else:
            current_count, waiting_count = _push_all(
                work, starts, improved_count, threshold, row, waiting_count
            )
        current, following = following, current

        # Only when no cell is left below the threshold, the threshold grows.
        if current_count == _int(0):
            threshold = threshold + THRESHOLD_STEP
            current, waiting = waiting, current
            current_count = waiting_count
            waiting_count = _int(0)
        if field[goal] < FAR:
            break

    # Cells that are still listed get their weights back.
    for index in range(current_count):
        field[_int(lists[current + index]) + WEIGHT] *= UNLISTED
    for index in range(waiting_count):
        field[_int(lists[waiting + index]) + WEIGHT] *= UNLISTED


@kernel(error_model="numpy")
def _lower(field: Data, lists: Data, changes: Data, current: _int, count: _int, row: _int) -> _int:
    """Lower the potentials of the listed cells, where possible, and take the cells off the list.

    Improved cells are moved to the front of the list and described in `changes`. Returns their
    number. navfn.cpp:440.
    """
    improved_count = _int(0)
    for index in range(count):
        cell = _int(lists[current + index])
        left = field[cell - NEXT]
        right = field[cell + NEXT]
        below = field[cell - row]
        above = field[cell + row]
        old_potential = field[cell]
        weight = field[cell + WEIGHT]
        field[cell + WEIGHT] = weight * UNLISTED

        # Potential of a plane wave that passes the lower neighbours of both axes.
        cost = np.rint(weight * COST)
        lower_x = min(left, right)
        lower_y = min(below, above)
        lowest = min(lower_x, lower_y)
        difference = max(lower_x, lower_y) - lowest
        ratio = np.float64(difference / cost)
        share = np.float32(((-0.2301 * ratio) * ratio + 0.5307 * ratio) + 0.7040)
        new_potential = lowest + (cost if difference >= cost else cost * share)

        # The next cell overwrites the description unless this one has improved.
        field[cell] = min(new_potential, old_potential)
        slot = improved_count << CHANGE_BITS
        changes[slot] = left
        changes[slot + RIGHT] = right
        changes[slot + BELOW] = below
        changes[slot + ABOVE] = above
        changes[slot + NEW] = new_potential
        lists[current + improved_count] = cell
        improved_count += _int(new_potential < old_potential)
    return improved_count


@kernel
def _push_all(
    work: Work,
    starts: Starts,
    improved_count: _int,
    threshold: np.float32,
    row: _int,
    waiting_count: _int,
) -> Tuple[_int, _int]:
    """Push the neighbours of the improved cells; return the lengths of the lists.

    Cells below the threshold go to the list `following`, the others to the list that waits.
    """
    field, lines, lists, changes = work
    current, following, waiting = starts
    following_end = following
    waiting_end = waiting + waiting_count
    for index in range(improved_count):
        cell = _int(lists[current + index])
        lines[cell >> LINE_BITS] = 1
        slot = _int(index) << CHANGE_BITS
        new_potential = changes[slot + NEW]
        is_below = new_potential < threshold
        list_end = following_end if is_below else waiting_end
        list_end = _push(field, lists, list_end, cell - NEXT, changes[slot], new_potential)
        list_end = _push(field, lists, list_end, cell + NEXT, changes[slot + RIGHT], new_potential)
        list_end = _push(field, lists, list_end, cell - row, changes[slot + BELOW], new_potential)
        list_end = _push(field, lists, list_end, cell + row, changes[slot + ABOVE], new_potential)
        following_end = list_end if is_below else following_end
        waiting_end = waiting_end if is_below else list_end
    return following_end - following, waiting_end - waiting


@kernel
def _push_carefully(
    work: Work,
    starts: Starts,
    improved_count: _int,
    threshold: np.float32,
    row: _int,
    waiting_count: _int,
    capacity: _int,
) -> Tuple[_int, _int]:
    """Do the same as _push_all when a list may become full; pushes to a full list are lost."""
    field, lines, lists, changes = work
    current, following, waiting = starts
    following_count = _int(0)
    for index in range(improved_count):
        cell = _int(lists[current + index])
        lines[cell >> LINE_BITS] = 1
        slot = _int(index) << CHANGE_BITS
        new_potential = changes[slot + NEW]
        for side, neighbour in enumerate((cell - NEXT, cell + NEXT, cell - row, cell + row)):
            if changes[slot + _int(side)] <= new_potential + field[neighbour + WEIGHT]:
                continue
            if new_potential < threshold:
                if following_count < capacity:
                    lists[following + following_count] = neighbour
                    following_count += _int(1)
                    field[neighbour + WEIGHT] *= LISTED
            elif waiting_count < capacity:
                lists[waiting + waiting_count] = neighbour
                waiting_count += _int(1)
                field[neighbour + WEIGHT] *= LISTED
    return following_count, waiting_count
