"""navfn's flood: the potential grown from the robot's cell until the goal's cell has one.

Called by navfn.Navfn, and the costliest kernel of a control cycle. It visits cells in the C++ order and rounds as
C++ does (navfn.cpp:419, 440, 615; planner_details.md section 4). What differs is the work per cell:
- A cell's cost and its pending flag share one uint16, and one table turns both into the weight of a push: infinite
  for obstacles and for cells already listed, so that a single comparison decides.
- A cycle runs over its list twice, first for the new potentials, then for the pushes. Pushes never enter a potential,
  so the order of results is the same, and neither loop has a branch for the processor to guess wrong.
- Lines of sixteen potentials that were written are noted and alone are reset for the next flood.
Indices are uint64 so that numba adds no wrap-around for negative ones.
"""
import numpy as np
from numba import njit

OBSTACLE = 254
PENDING = 256
LIST_SIZE = 10000          # cells a propagation list holds; more are lost, as in C++
LINE = 16                  # potentials in a noted line

_int = np.uint64


def scratch(list_size=LIST_SIZE):
    """Working arrays of flood(): lists, listed, before."""
    return (np.empty((3, list_size + 4), np.uint32), np.empty(list_size + 4, np.uint32),
            np.empty((list_size + 4, 8), np.float32))


def push_weights():
    """(512,) float32 by code: what a push to such a cell adds to a potential, infinite where there is no push."""
    weights = np.full(512, np.inf, np.float32)
    weights[:OBSTACLE] = [np.float32(0.707106781 * cost) for cost in range(OBSTACLE)]
    return weights


@njit(cache=True)
def reset(potential, lines):
    """Set the potentials of all noted lines back to 1e10 and forget the notes."""
    far = np.float32(1e10)
    groups = lines.view(np.uint64)
    for g in range(groups.shape[0]):
        if groups[g] != 0:
            for i in range(8 * g, 8 * g + 8):
                if lines[i] != 0:
                    for k in range(LINE * i, LINE * i + LINE):
                        potential[k] = far
            groups[g] = 0


@njit(cache=True, error_model="numpy")
def flood(codes, potential, lines, lists, listed, before, weights, nx_, ny_, robot_, goal_):
    """Grow the potential from the cell `robot_` until `goal_` is reached.

    codes (n,) uint16: navfn's cost of each cell, 254 on the border; potential float32: all 1e10, n rounded up to
    lines; lines uint8: zeros; lists (3, m + 4) uint32, listed (m + 4,) uint32 and before (m + 4, 8) float32: scratch,
    whose length sets the m = LIST_SIZE cells that a list holds; weights: push_weights().
    """
    far = np.float32(1e10)
    nx = _int(nx_)
    cells = _int(nx_ * ny_)
    robot = _int(robot_)
    goal = _int(goal_)
    one = _int(1)
    four = _int(4)
    eight = _int(8)
    room = _int(lists.shape[1] - 4)
    current = lists[0]
    following = lists[1]
    over = lists[2]
    n_current = _int(0)
    n_over = _int(0)
    potential[robot] = np.float32(0.0)
    lines[robot >> four] = 1
    for k in (robot + one, robot - one, robot - nx, robot + nx):
        if k < cells and codes[k] < OBSTACLE and n_current < room:
            current[n_current] = k
            n_current += one
            codes[k] |= np.uint16(PENDING)
    threshold = np.float32(OBSTACLE)
    for _ in range(max(nx_ * ny_ // 20, nx_ + ny_)):
        if n_current == _int(0):
            break
        improved = _int(0)
        for i in range(n_current):
            n = _int(current[i])
            left = potential[n - one]
            right = potential[n + one]
            up = potential[n - nx]
            down = potential[n + nx]
            old = potential[n]
            own = codes[n] & np.uint16(255)
            codes[n] = own
            h = np.float32(own)
            across = right if right < left else left
            along = down if down < up else up
            low = across if across < along else along
            high = along if across < along else across
            difference = high - low
            q = np.float64(difference / h)
            v = np.float32(((-0.2301 * q) * q + 0.5307 * q) + 0.7040)
            new = low + (h if difference >= h else h * v)
            potential[n] = min(new, old)
            row = before[improved]
            row[0] = left
            row[1] = right
            row[2] = up
            row[3] = down
            row[4] = new
            listed[improved] = n
            improved += _int(new < old)
        n_following = _int(0)
        if four * n_current + n_over > room:
            n_following, n_over = _push_carefully(codes, listed, before, improved, weights, threshold, nx, lines,
                                                  following, over, n_over, room)
        else:
            for i in range(improved):
                n = _int(listed[i])
                lines[n >> four] = 1
                row = before[i]
                new = row[4]
                below = new < threshold
                target = following if below else over
                end = n_following if below else n_over
                k = n - one
                code = codes[k]
                push = _int(row[0] > new + weights[code])
                target[end] = k
                end += push
                codes[k] = _int(code) | (push << eight)
                k = n + one
                code = codes[k]
                push = _int(row[1] > new + weights[code])
                target[end] = k
                end += push
                codes[k] = _int(code) | (push << eight)
                k = n - nx
                code = codes[k]
                push = _int(row[2] > new + weights[code])
                target[end] = k
                end += push
                codes[k] = _int(code) | (push << eight)
                k = n + nx
                code = codes[k]
                push = _int(row[3] > new + weights[code])
                target[end] = k
                end += push
                codes[k] = _int(code) | (push << eight)
                if below:
                    n_following = end
                else:
                    n_over = end
        current, following = following, current
        n_current = n_following
        if n_current == _int(0):
            threshold = threshold + np.float32(100.0)
            current, over = over, current
            n_current = n_over
            n_over = _int(0)
        if potential[goal] < far:
            break
    for i in range(n_current):
        codes[current[i]] &= np.uint16(255)
    for i in range(n_over):
        codes[over[i]] &= np.uint16(255)


@njit(cache=True)
def _push_carefully(codes, listed, before, improved, weights, threshold, nx, lines, following, over, n_over, room):
    """The pushes of one cycle when a list may run full: pushes to a full list are lost."""
    n_following = _int(0)
    for i in range(improved):
        n = _int(listed[i])
        lines[n >> _int(4)] = 1
        new = before[i, 4]
        for j in range(4):
            k = n - _int(1)
            if j == 1:
                k = n + _int(1)
            elif j == 2:
                k = n - nx
            elif j == 3:
                k = n + nx
            if before[i, j] > new + weights[codes[k]]:
                if new < threshold:
                    if n_following < room:
                        following[n_following] = k
                        n_following += _int(1)
                        codes[k] |= np.uint16(PENDING)
                elif n_over < room:
                    over[n_over] = k
                    n_over += _int(1)
                    codes[k] |= np.uint16(PENDING)
    return n_following, n_over
