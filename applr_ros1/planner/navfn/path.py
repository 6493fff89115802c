"""Path of navfn: traces down the gradient of the potential in half-cell steps.

Called by navfn.Navfn. Follows navfn.cpp:785 and 955 (docs/explanation/planner.md, section 5.3) and is float32 wherever
C++ is. C++ reads cells outside its arrays at the ends of the map; here such cells count as unreached.
"""

import math
from typing import Tuple

import numpy as np

from applr_ros1.common.arrays import Data
from applr_ros1.common.kernels import kernel

F32 = np.float32


@kernel(error_model="numpy")
def trace(potential: Data, nx: int, ny: int, start: int, robot: int, path: Data) -> int:
    """Trace from the cell `start` down to `robot` and write the points [cells] into `path` (4 nx, 2) float32.

    Returns the number of points, or 0 if there is no path or it has more than 4 nx points.
    """
    ns = nx * ny
    far = F32(1e10)
    one = F32(1.0)
    c = start
    dx = F32(0.0)
    dy = F32(0.0)
    g0x = g0y = g1x = g1y = g2x = g2y = g3x = g3y = F32(0.0)
    known = -1
    for n in range(path.shape[0]):
        near = c + _round(dx) + nx * _round(dy)
        near = min(max(near, 0), ns - 1)
        if potential[near] < F32(50.0):
            path[n, 0] = F32(robot % nx)
            path[n, 1] = F32(robot // nx)
            return n + 1
        if c < nx or c > ns - nx:
            return 0
        path[n, 0] = F32(c % nx) + dx
        path[n, 1] = F32(c // nx) + dy
        stuck = n >= 2 and path[n, 0] == path[n - 2, 0] and path[n, 1] == path[n - 2, 1]
        for row in (c - nx, c, c + nx):
            for k in (row - 1, row, row + 1):
                stuck = stuck or k < 0 or k >= ns or potential[k] >= far
        if stuck:
            c = _lowest_around(potential, nx, ns, c)
            dx = F32(0.0)
            dy = F32(0.0)
            if potential[c] >= far:
                return 0
            continue
        if c != known:  # A half step often stays in the same cell.
            known = c
            g0x, g0y = _gradient(potential, nx, ns, c)
            g1x, g1y = _gradient(potential, nx, ns, c + 1)
            g2x, g2y = _gradient(potential, nx, ns, c + nx)
            g3x, g3y = _gradient(potential, nx, ns, c + nx + 1)
        x = _blend(g0x, g1x, g2x, g3x, dx, dy)
        y = _blend(g0y, g1y, g2y, g3y, dx, dy)
        if x == 0 and y == 0:
            return 0
        ss = F32(0.5 / np.float64(_hypot(x, y)))
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


@kernel
def _lowest_around(potential: Data, nx: int, ns: int, c: int) -> int:
    """Return the neighbour of lowest potential, or c if none is lower; C++ compares with truncated potentials."""
    lowest = _truncate(potential[c])
    best = c
    for k in (c - nx - 1, c - nx, c - nx + 1, c - 1, c + 1, c + nx - 1, c + nx, c + nx + 1):
        if 0 <= k < ns and potential[k] < F32(lowest):
            lowest = _truncate(potential[k])
            best = k
    return best


@kernel
def _gradient(potential: Data, nx: int, ns: int, n: int) -> Tuple[F32, F32]:
    """Return the normalised gradient (gx, gy) of a cell, float32. navfn.cpp:955."""
    zero = F32(0.0)
    far = F32(1e10)
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
            gx = F32(-254.0)
        elif right < far:
            gx = F32(254.0)
        if below < far:
            gy = F32(-254.0)
        elif above < far:
            gy = F32(254.0)
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
        norm = F32(1.0 / np.float64(norm))
        gx = gx * norm
        gy = gy * norm
    return gx, gy


@kernel
def _hypot(x: F32, y: F32) -> F32:
    a = np.float64(x)
    b = np.float64(y)
    return F32(math.sqrt(a * a + b * b))


@kernel
def _round(v: F32) -> int:
    """Round to the nearest integer, halves away from zero."""
    return int(math.floor(v + 0.5)) if v >= 0 else -int(math.floor(-v + 0.5))


@kernel
def _truncate(v: F32) -> int:
    """Convert a float32 to a C int; a value that is too large becomes the smallest int."""
    return -2147483648 if v >= F32(2147483648.0) else int(v)


@kernel
def _blend(g0: F32, g1: F32, g2: F32, g3: F32, dx: F32, dy: F32) -> F32:
    """Interpolate the gradients of four cells, with double and float32 operations mixed as in C++."""
    a = 1.0 - np.float64(dx)
    p = F32(a * np.float64(g0) + np.float64(dx * g1))
    q = F32(a * np.float64(g2) + np.float64(dx * g3))
    return F32((1.0 - np.float64(dy)) * np.float64(p) + np.float64(dy * q))
