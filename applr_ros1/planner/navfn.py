"""The global planner navfn: a potential grown from the robot's cell, a path traced down its gradient.

Called by MoveBase. Follows navfn/navfn.cpp and navfn_ros.cpp (planner_details.md section 4) in order, in float32
where C++ is, so that potentials and plans are equal byte for byte.
"""
import math

import numpy as np
from numba import njit

from applr_ros1.planner.grid import world_to_map

LIST_SIZE = 10000          # cells a propagation list holds; more are lost, as in C++
OBSTACLE = 254
UNREACHED = np.float32(1e10)


def cost_table(allow_unknown):
    """navfn's cost (256,) uint8 of every costmap value. navfn.cpp:228."""
    table = np.full(256, OBSTACLE, np.uint8)
    table[:253] = [int(50 + 0.8 * v) for v in range(253)]
    if allow_unknown:
        table[255] = 253
    return table


class Navfn:
    """Plans on a Costmap. Keeps its arrays between calls; one instance serves one map at a time.

    potential (ny, nx) float32 of the last flood, 1e10 where not reached; costs (ny, nx) uint8, navfn's cost array.
    """

    def __init__(self):
        self._shape = None

    def _allocate(self, ny, nx):
        self._shape = (ny, nx)
        self.costs = np.empty((ny, nx), np.uint8)
        self.potential = np.full((ny, nx), UNREACHED, np.float32)
        self._pending = np.zeros(ny * nx, np.uint8)
        self._lists = np.empty((3, LIST_SIZE), np.int32)
        self._touched = np.empty(ny * nx + 1, np.int32)
        self._touched_count = 0
        self._path = np.empty((4 * nx + 1, 2), np.float32)

    def plan(self, costmap, start, goal, tolerance=0.0, allow_unknown=True):
        """Plan (n, 3) of x, y [m], yaw [rad] from `start` (x, y) to `goal` (x, y, yaw); (0, 3) if there is none.

        Yaw is 0 but for the last pose. The robot's cell becomes free in the live costmap, as in C++.
        """
        nothing = np.zeros((0, 3))
        nx, ny = costmap.size
        ox, oy = (float(v) for v in costmap.origin)
        res = costmap.resolution
        sx, sy = costmap.world_to_map(start[0], start[1])
        if sx < 0:
            return nothing
        gx, gy = costmap.world_to_map(goal[0], goal[1])
        if gx < 0:
            if tolerance <= 0:
                return nothing
            gx, gy = 0, 0
        costmap.set_free(sx, sy, sx + 1, sy + 1)
        if self._shape != (ny, nx):
            self._allocate(ny, nx)
        _convert(costmap.cells, self.costs, cost_table(allow_unknown))
        self._touched_count = flood(self.costs.reshape(-1), self.potential.reshape(-1), self._pending, self._lists,
                                    self._touched, self._touched_count, nx, ny, sy * nx + sx, gy * nx + gx)
        found, tx, ty = _target(self.potential, ox, oy, res, float(goal[0]), float(goal[1]), float(tolerance))
        if not found:
            return nothing
        mx, my = costmap.world_to_map(tx, ty)
        n = trace(self.potential.reshape(-1), nx, ny, my * nx + mx, sy * nx + sx, self._path)
        if n == 0:
            return nothing
        plan = np.zeros((n + 1, 3))
        plan[:n, :2] = costmap.origin + self._path[:n][::-1].astype(np.float64) * res
        plan[n] = tx, ty, goal[2]
        return plan


@njit(cache=True)
def _convert(cells, costs, table):
    ny, nx = cells.shape
    for y in range(ny):
        for x in range(nx):
            costs[y, x] = table[cells[y, x]]
    costs[0, :] = OBSTACLE
    costs[ny - 1, :] = OBSTACLE
    costs[:, 0] = OBSTACLE
    costs[:, nx - 1] = OBSTACLE


@njit(cache=True)
def flood(costs, potential, pending, lists, touched, touched_count, nx, ny, robot, goal):
    """Grow the potential from the cell `robot` until `goal` is reached; flat arrays of nx ny cells.

    touched (n,) holds the cells set by the last flood: they are reset first, the new ones are written there;
    returns their number. navfn.cpp:419, 440, 615.
    """
    far = np.float32(1e10)
    for i in range(touched_count):
        potential[touched[i]] = far
    count = 0
    ns = nx * ny
    potential[robot] = np.float32(0.0)
    touched[count] = robot
    count += 1
    current = lists[0]
    following = lists[1]
    over = lists[2]
    n_current = 0
    n_following = 0
    n_over = 0
    for k in (robot + 1, robot - 1, robot - nx, robot + nx):
        if k >= 0 and k < ns and pending[k] == 0 and costs[k] < OBSTACLE and n_current < LIST_SIZE:
            current[n_current] = k
            n_current += 1
            pending[k] = 1
    threshold = np.float32(OBSTACLE)
    offsets = (-1, 1, -nx, nx)
    for _ in range(max(ns // 20, nx + ny)):
        if n_current == 0 and n_following == 0:
            break
        for i in range(n_current):
            pending[current[i]] = 0
        for i in range(n_current):
            n = current[i]
            if costs[n] >= OBSTACLE:
                continue
            l = potential[n - 1]
            r = potential[n + 1]
            u = potential[n - nx]
            d = potential[n + nx]
            tc = r if r < l else l
            ta = d if d < u else u
            h = np.float32(costs[n])
            dc = tc - ta
            if dc < 0:
                dc = -dc
                ta = tc
            if dc >= h:
                pot = ta + h
            else:
                q = dc / h
                qd = np.float64(q)
                v = np.float32(((-0.2301 * qd) * qd + 0.5307 * qd) + 0.7040)
                pot = ta + h * v
            old = potential[n]
            if pot < old:
                if old == far:
                    touched[count] = n
                    count += 1
                potential[n] = pot
                below = pot < threshold
                neighbours = (l, r, u, d)
                for j in range(4):
                    k = n + offsets[j]
                    w = np.float32(0.707106781 * np.float64(costs[k]))
                    if neighbours[j] > pot + w and pending[k] == 0 and costs[k] < OBSTACLE:
                        if below:
                            if n_following < LIST_SIZE:
                                following[n_following] = k
                                n_following += 1
                                pending[k] = 1
                        elif n_over < LIST_SIZE:
                            over[n_over] = k
                            n_over += 1
                            pending[k] = 1
        current, following = following, current
        n_current = n_following
        n_following = 0
        if n_current == 0:
            threshold = threshold + np.float32(100.0)
            current, over = over, current
            n_current = n_over
            n_over = 0
        if potential[goal] < far:
            break
    for i in range(n_current):
        pending[current[i]] = 0
    for i in range(n_over):
        pending[over[i]] = 0
    return count


@njit(cache=True)
def _target(potential, ox, oy, res, gx, gy, tolerance):
    """The reached point nearest to the goal within the square of `tolerance` [m]. navfn_ros.cpp:262."""
    ny, nx = potential.shape
    found = False
    best = np.inf
    bx = gx
    by = gy
    y = gy - tolerance
    while y <= gy + tolerance:
        x = gx - tolerance
        while x <= gx + tolerance:
            mx, my = world_to_map(x, y, ox, oy, res, nx, ny)
            if mx >= 0 and potential[my, mx] < np.float32(1e10):
                d = (x - gx) * (x - gx) + (y - gy) * (y - gy)
                if d < best:
                    best = d
                    bx = x
                    by = y
                    found = True
            x += res
        y += res
    return found, bx, by


@njit(cache=True)
def _round(v):
    return int(math.floor(v + 0.5)) if v >= 0 else -int(math.floor(-v + 0.5))


@njit(cache=True)
def _gradient(potential, nx, ns, n):
    """Normalised gradient (gx, gy) of a cell, float32. navfn.cpp:955."""
    zero = np.float32(0.0)
    far = np.float32(1e10)
    if n < nx or n > ns - nx:
        return zero, zero
    v = potential[n]
    left = potential[n - 1]
    right = potential[n + 1] if n + 1 < ns else far
    below = potential[n - nx]
    above = potential[n + nx] if n + nx < ns else far
    gx = zero
    gy = zero
    if v >= far:
        if left < far:
            gx = np.float32(-254.0)
        elif right < far:
            gx = np.float32(254.0)
        if below < far:
            gy = np.float32(-254.0)
        elif above < far:
            gy = np.float32(254.0)
    else:
        if left < far:
            gx = gx + (left - v)
        if right < far:
            gx = gx + (v - right)
        if below < far:
            gy = gy + (below - v)
        if above < far:
            gy = gy + (v - above)
    norm = _hypot(gx, gy)
    if norm > 0:
        norm = np.float32(1.0 / np.float64(norm))
        gx = gx * norm
        gy = gy * norm
    return gx, gy


@njit(cache=True)
def _hypot(x, y):
    a = np.float64(x)
    b = np.float64(y)
    return np.float32(math.sqrt(a * a + b * b))


@njit(cache=True, error_model="numpy")
def trace(potential, nx, ny, start, robot, path):
    """Trace from the cell `start` down to `robot`; cells (n, 2) go into `path`; returns n, 0 if there is no way.

    navfn.cpp:785. `path` has room for 4 nx points and more are a failure, as NavfnROS calls it.
    """
    ns = nx * ny
    far = np.float32(1e10)
    one = np.float32(1.0)
    c = start
    dx = np.float32(0.0)
    dy = np.float32(0.0)
    n = 0
    for _ in range(4 * nx):
        near = c + _round(dx) + nx * _round(dy)
        near = min(max(near, 0), ns - 1)
        if potential[near] < np.float32(50.0):
            path[n, 0] = np.float32(robot % nx)
            path[n, 1] = np.float32(robot // nx)
            return n + 1
        if c < nx or c > ns - nx:
            return 0
        path[n, 0] = np.float32(c % nx) + dx
        path[n, 1] = np.float32(c // nx) + dy
        n += 1
        stuck = n > 2 and path[n - 1, 0] == path[n - 3, 0] and path[n - 1, 1] == path[n - 3, 1]
        for row in (c - nx, c, c + nx):
            for k in (row - 1, row, row + 1):
                if k < 0 or k >= ns or potential[k] >= far:
                    stuck = True
        if stuck:
            m = _truncate(potential[c])
            best = c
            for k in (c - nx - 1, c - nx, c - nx + 1, c - 1, c + 1, c + nx - 1, c + nx, c + nx + 1):
                if k >= 0 and k < ns and potential[k] < np.float32(m):
                    m = _truncate(potential[k])
                    best = k
            c = best
            dx = np.float32(0.0)
            dy = np.float32(0.0)
            if potential[c] >= far:
                return 0
            continue
        g0x, g0y = _gradient(potential, nx, ns, c)
        g1x, g1y = _gradient(potential, nx, ns, c + 1)
        g2x, g2y = _gradient(potential, nx, ns, c + nx)
        g3x, g3y = _gradient(potential, nx, ns, c + nx + 1)
        x = _blend(g0x, g1x, g2x, g3x, dx, dy)
        y = _blend(g0y, g1y, g2y, g3y, dx, dy)
        if x == 0 and y == 0:
            return 0
        ss = np.float32(0.5 / np.float64(_hypot(x, y)))
        dx = dx + x * ss
        dy = dy + y * ss
        if dx > one:
            c += 1
            dx = dx - one
        if dx < -one:
            c -= 1
            dx = dx + one
        if dy > one:
            c += nx
            dy = dy - one
        if dy < -one:
            c -= nx
            dy = dy + one
    return 0


@njit(cache=True)
def _truncate(v):
    return -2147483648 if v >= np.float32(2147483648.0) else int(v)


@njit(cache=True)
def _blend(g0, g1, g2, g3, dx, dy):
    a = 1.0 - np.float64(dx)
    p = np.float32(a * np.float64(g0) + np.float64(dx * g1))
    q = np.float32(a * np.float64(g2) + np.float64(dx * g3))
    return np.float32((1.0 - np.float64(dy)) * np.float64(p) + np.float64(dy * q))
