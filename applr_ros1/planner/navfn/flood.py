"""Propagation ("flood") of navfn's potential from the robot's cell until the goal's cell is reached.

Called by navfn.Navfn; the most expensive kernel of a control cycle. The flood visits cells in the order of C++, with
the same rounding (navfn.cpp:419, 440, 615; docs/explanation/planner.md, section 5.2). Only the work per cell differs,
because memory access limits the speed:
- A cell is two adjacent float32: its potential and its push weight (PUSH_WEIGHTS). The weight is infinite for obstacles
  and multiplied by 2^64 while the cell is in a list, so one comparison decides whether to push the cell to a list.
- An iteration runs over the current list twice, first for the new potentials, then for the pushes. Pushes do not change
  potentials, so the result is the same, and neither loop has a branch that the processor could mispredict.
- Lines of 16 potentials are recorded when written, and only these lines are reset for the next flood.
Indices are uint64 so that numba does not add a wrap-around for negative ones.
"""

from __future__ import annotations

from typing import Tuple

import numpy as np

from applr_ros1.common.arrays import Data
from applr_ros1.common.kernels import kernel

OBSTACLE = 254  # cost of a cell that no plan enters
LIST_SIZE = 10000  # capacity of a propagation list [cells]; further cells are lost, as in C++
LINE = 16  # number of potentials in a line
LISTED = np.float32(2.0**64)  # factor of a listed cell's weight, which raises it above any potential
UNLISTED = np.float32(2.0**-64)  # exact inverse of LISTED
COST = np.float32(1.4142135 * 2.0**-64)  # a listed cell's weight times this factor, rounded, is its cost 1..253

# Push weights by cost (256,). A cell is pushed if its potential exceeds a neighbour's new potential plus the weight.
PUSH_WEIGHTS = np.full(256, np.inf, np.float32)
PUSH_WEIGHTS[:OBSTACLE] = [np.float32(0.707106781 * cost) for cost in range(OBSTACLE)]
Work = Tuple[Data, Data, Data, Data]  # field, lines, lists and before of flood()
Starts = Tuple[np.uint64, np.uint64, np.uint64]  # index of the first entry of the lists current, following, over
_int = np.uint64


def make_field(cells: int) -> np.ndarray:
    """Return the initial field (2 n,) float32: for each cell its potential 1e10 (not reached) and an obstacle's weight.

    n is the number of cells, rounded up to the groups of eight lines that reset() handles.
    """
    lines = -(-cells // (8 * LINE)) * 8
    return np.tile(np.array([1e10, np.inf], dtype=np.float32), lines * LINE)


def scratch(list_size: int = LIST_SIZE) -> Tuple[np.ndarray, np.ndarray]:
    """Return the working arrays `lists_` and `before` of flood()."""
    return np.empty((3, list_size + 4), np.uint32), np.empty((list_size + 4) * 8, np.float32)


@kernel
def reset(field: Data, lines: Data) -> None:
    """Reset the potentials of all recorded lines to 1e10 and clear the records."""
    far = np.float32(1e10)
    groups = lines.view(np.uint64)
    for g in range(groups.shape[0]):
        if groups[g] != 0:
            for i in range(8 * g, 8 * g + 8):
                if lines[i] != 0:
                    for k in range(_int(2 * LINE * i), _int(2 * LINE * (i + 1)), _int(2)):
                        field[k] = far
            groups[g] = 0


@kernel
def _push(field: Data, lists: Data, end: _int, k: _int, old: np.float32, new: np.float32) -> _int:
    """Push cell k to a list if its neighbour's `new` potential may lower its `old` potential; return the list's end."""
    weight = field[k + _int(1)]
    push = old > new + weight
    lists[end] = k
    field[k + _int(1)] = weight * LISTED if push else weight
    return end + _int(push)


@kernel(error_model="numpy")
def flood(field: Data, lines: Data, lists_: Data, before: Data, nx_: int, ny_: int, robot_: int, goal_: int) -> None:
    """Grow the potential from the cell `robot_` until `goal_` is reached.

    field is the float32 array of make_field(), with all potentials at 1e10 and infinite weights on the border. lines
    are uint8 zeros, one per LINE cells. lists_ (3, m + 4) uint32 and before (8 m + 32,) float32 are scratch memory for
    lists of m cells. Inside this function a cell is addressed by the index of its potential, twice its number.
    """
    far = np.float32(1e10)
    one = _int(1)
    two = _int(2)
    three = _int(3)
    four = _int(4)
    five = _int(5)
    row = _int(2 * nx_)
    robot = _int(2 * robot_)
    goal = _int(2 * goal_)
    places = _int(2 * nx_ * ny_)
    lists = lists_.reshape(lists_.size)
    room = _int(lists_.shape[1] - 4)
    current = _int(0)  # index of the first entry of each list
    following = room + four
    over = two * (room + four)
    n_current = _int(0)
    n_over = _int(0)
    field[robot] = np.float32(0.0)
    lines[robot >> five] = 1
    for k in (robot + two, robot - two, robot - row, robot + row):
        if k < places and field[k + one] < far and n_current < room:
            lists[n_current] = k
            n_current += one
            field[k + one] *= LISTED
    threshold = np.float32(OBSTACLE)
    for _ in range(max(nx_ * ny_ // 20, nx_ + ny_)):
        if n_current == _int(0):
            break
        improved = _int(0)
        for i in range(n_current):
            n = _int(lists[current + i])
            left = field[n - two]
            right = field[n + two]
            up = field[n - row]
            down = field[n + row]
            old = field[n]
            weight = field[n + one]
            field[n + one] = weight * UNLISTED
            h = np.rint(weight * COST)
            across = right if right < left else left
            along = down if down < up else up
            low = across if across < along else along
            high = along if across < along else across
            difference = high - low
            q = np.float64(difference / h)
            v = np.float32(((-0.2301 * q) * q + 0.5307 * q) + 0.7040)
            new = low + (h if difference >= h else h * v)
            field[n] = min(new, old)
            b = improved << three
            before[b] = left
            before[b + one] = right
            before[b + two] = up
            before[b + three] = down
            before[b + four] = new
            lists[current + improved] = n
            improved += _int(new < old)
        if four * n_current + n_over > room:
            work, starts = (field, lines, lists, before), (current, following, over)
            n_following, n_over = _push_carefully(work, starts, improved, threshold, row, n_over, room)
        else:
            end_following = following
            end_over = over + n_over
            for i in range(improved):
                n = _int(lists[current + i])
                lines[n >> five] = 1
                b = _int(i) << three
                new = before[b + four]
                below = new < threshold
                end = end_following if below else end_over
                end = _push(field, lists, end, n - two, before[b], new)
                end = _push(field, lists, end, n + two, before[b + one], new)
                end = _push(field, lists, end, n - row, before[b + two], new)
                end = _push(field, lists, end, n + row, before[b + three], new)
                end_following = end if below else end_following
                end_over = end_over if below else end
            n_following = end_following - following
            n_over = end_over - over
        current, following = following, current
        n_current = n_following
        if n_current == _int(0):
            threshold = threshold + np.float32(100.0)
            current, over = over, current
            n_current = n_over
            n_over = _int(0)
        if field[goal] < far:
            break
    for i in range(n_current):
        field[_int(lists[current + i]) + one] *= UNLISTED
    for i in range(n_over):
        field[_int(lists[over + i]) + one] *= UNLISTED


@kernel
def _push_carefully(
    work: Work, starts: Starts, improved: _int, threshold: np.float32, row: _int, n_over: _int, room: _int
) -> Tuple[_int, _int]:
    """Push the cells of one round when a list may become full; pushes to a full list are lost, as in C++."""
    (field, lines, lists, before), (current, following, over) = work, starts
    n_following = _int(0)
    for i in range(improved):
        n = _int(lists[current + i])
        lines[n >> _int(5)] = 1
        b = _int(8) * _int(i)
        new = before[b + _int(4)]
        for j, k in enumerate((n - _int(2), n + _int(2), n - row, n + row)):
            if before[b + _int(j)] > new + field[k + _int(1)]:
                if new < threshold:
                    if n_following < room:
                        lists[following + n_following] = k
                        n_following += _int(1)
                        field[k + _int(1)] *= LISTED
                elif n_over < room:
                    lists[over + n_over] = k
                    n_over += _int(1)
                    field[k + _int(1)] *= LISTED
    return n_following, n_over
