"""Cell grid: conversions between world and cells, lines of cells, and the ways in which layers write into a grid.

Called by every kernel of the planner. Cells are computed as in costmap_2d, by a division and truncation. Multiplying by
1 / resolution instead would move points on cell borders to another cell. Grids are (ny, nx) uint8.
"""

from __future__ import annotations

import math
from typing import Tuple, TypeVar

import numpy as np

from applr_ros1.common.arrays import Data
from applr_ros1.common.kernels import kernel

FREE = 0
INSCRIBED = 253  # cost of a cell within the inscribed radius of an obstacle
LETHAL = 254
UNKNOWN = 255
OVERWRITE = 0  # combination_method: known cells of the layer replace those of the costmap
MAXIMUM = 1  # combination_method: the larger value counts

Window = Tuple[int, int, int, int]  # cells [x0, xn) x [y0, yn) as (x0, y0, xn, yn)
Bounds = Tuple[float, float, float, float]  # (min x, min y, max x, max y) [m]
Rectangle = TypeVar("Rectangle", Window, Bounds)


@kernel
def world_to_map(wx: float, wy: float, ox: float, oy: float, resolution: float, nx: int, ny: int) -> Tuple[int, int]:
    """Return the cell (mx, my) of the point (wx, wy) [m]; (-1, -1) if the point is off the map. costmap_2d.cpp:208."""
    if wx < ox or wy < oy:
        return -1, -1
    fx = (wx - ox) / resolution
    fy = (wy - oy) / resolution
    if not (fx < nx and fy < ny):  # The negation also rejects NaN and numbers too large for an integer.
        return -1, -1
    return int(fx), int(fy)


@kernel
def map_to_world(mx: int, my: int, ox: float, oy: float, resolution: float) -> Tuple[float, float]:
    """Return the centre (x, y) [m] of the cell (mx, my)."""
    return ox + (mx + 0.5) * resolution, oy + (my + 0.5) * resolution


def truncated_cell(w: float, o: float, resolution: float) -> int:
    """Return the cell index of the coordinate w [m] along one axis, truncated towards zero and not clipped."""
    return int((w - o) / resolution)


def clipped_cell(w: float, o: float, resolution: float, n: int) -> int:
    """Return the cell index of the coordinate w [m] along one axis, clipped to 0 .. n - 1. costmap_2d.cpp:233."""
    if w < o:
        return 0
    if w >= resolution * n + o:
        return n - 1
    return int((w - o) / resolution)


def cell_distance(distance: float, resolution: float) -> int:
    """Convert a length [m] to whole cells, rounded up and never negative. costmap_2d.cpp:190."""
    return max(0, int(math.ceil(distance / resolution)))


def size_in_meters(n: int, resolution: float) -> float:
    """Return the length [m] of n cells as costmap_2d computes it: half a cell short."""
    return (n - 1 + 0.5) * resolution


@kernel
def walk_line(x0: int, y0: int, x1: int, y1: int, xs: Data, ys: Data) -> int:
    """Write the cells from (x0, y0) to (x1, y1), both included, into xs, ys, and return their number.

    The line in the opposite direction may visit other cells. base_local_planner/line_iterator.h.
    """
    adx = abs(x1 - x0)
    ady = abs(y1 - y0)
    sx = 1 if x1 >= x0 else -1
    sy = 1 if y1 >= y0 else -1
    x_major = adx >= ady
    major = adx if x_major else ady
    minor = ady if x_major else adx
    counter = major // 2
    x = x0
    y = y0
    for n in range(major + 1):
        xs[n] = x
        ys[n] = y
        counter += minor
        both = counter >= major
        counter -= major if both else 0
        x += sx if both or x_major else 0
        y += sy if both or not x_major else 0
    return major + 1


def union(a: Rectangle, b: Rectangle) -> Rectangle:
    """Return the smallest rectangle (x0, y0, x1, y1) around two rectangles."""
    return min(a[0], b[0]), min(a[1], b[1]), max(a[2], b[2]), max(a[3], b[3])


def roll(cells: Data, origin: Data, resolution: float, x: float, y: float, default: int) -> Tuple[int, int]:
    """Move `cells` (ny, nx) and `origin` (2,) to centre (x, y) [m], and return the shift (cx, cy) [cells].

    Cells in the overlap keep their values, the others get `default`. costmap_2d.cpp:260.
    """
    ny, nx = cells.shape
    ox, oy = origin.tolist()
    cx = int((x - size_in_meters(nx, resolution) / 2 - ox) / resolution)
    cy = int((y - size_in_meters(ny, resolution) / 2 - oy) / resolution)
    if cx != 0 or cy != 0:
        origin[0] = ox + cx * resolution
        origin[1] = oy + cy * resolution
        shift(cells, cx, cy, default)
    return cx, cy


def shift(cells: np.ndarray, cx: int, cy: int, default: int) -> None:
    """Set cells[y, x] = cells[y + cy, x + cx] in place, or `default` if that cell does not exist."""
    ny, nx = cells.shape
    if abs(cx) >= nx or abs(cy) >= ny:
        cells[:] = default
        return
    flat = cells.reshape(-1)
    k = cy * nx + cx
    if k > 0:
        flat[:-k] = flat[k:]
    elif k < 0:
        flat[-k:] = flat[:k].copy()
    if cy > 0:
        cells[ny - cy :] = default
    elif cy < 0:
        cells[:-cy] = default
    if cx > 0:
        cells[:, nx - cx :] = default
    elif cx < 0:
        cells[:, :-cx] = default


@kernel
def merge(layer: Data, base: Data, maximum: bool, x0: int, y0: int, xn: int, yn: int) -> None:
    """Copy the layer's known cells in the window into `base`; if `maximum`, only over lower or unknown values."""
    unknown = np.uint8(UNKNOWN)
    for y in range(y0, yn):
        values = layer[y, x0:xn]
        target = base[y, x0:xn]
        if maximum:
            for i in range(values.shape[0]):
                value = values[i]
                old = target[i]
                # An unknown cell of the layer changes nothing; an unknown cell of the base is lower than any value.
                target[i] = value if value != unknown and (old == unknown or old < value) else old
        else:
            for i in range(values.shape[0]):
                target[i] = values[i] if values[i] != unknown else target[i]
