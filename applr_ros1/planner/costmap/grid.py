"""A cell grid: world <-> cell conversions, the line of cells between two cells, and how layers write into a grid.

Called by every kernel of the planner. The expressions (a division, then truncation) are those of costmap_2d;
multiplying by 1 / resolution instead would move points on cell borders. Grids are (ny, nx) uint8; a window is
(x0, y0, xn, yn) in cells.
"""

from __future__ import annotations

import math
from typing import Tuple

import numpy as np

from applr_ros1.common.kernels import kernel

FREE = 0
INSCRIBED = 253
LETHAL = 254
UNKNOWN = 255


@kernel
def world_to_map(wx, wy, ox, oy, resolution, nx, ny):
    """Cell (mx, my) of the point (wx, wy) [m]; (-1, -1) if it is off the map. costmap_2d.cpp:208."""
    if wx < ox or wy < oy:
        return -1, -1
    fx = (wx - ox) / resolution
    fy = (wy - oy) / resolution
    if not (fx < nx and fy < ny):  # also refuses NaN and numbers too large for an integer
        return -1, -1
    return int(fx), int(fy)


@kernel
def map_to_world(mx, my, ox, oy, resolution):
    """Centre (x, y) [m] of the cell (mx, my)."""
    return ox + (mx + 0.5) * resolution, oy + (my + 0.5) * resolution


def world_to_map_no_bounds(w: float, o: float, resolution: float) -> int:
    """Cell index of the coordinate w along one axis, truncated towards zero and not clipped."""
    return int((w - o) / resolution)


def world_to_map_enforce_bounds(w: float, o: float, resolution: float, n: int) -> int:
    """Cell index of the coordinate w along one axis, clipped into 0 .. n - 1. costmap_2d.cpp:233."""
    if w < o:
        return 0
    if w >= resolution * n + o:
        return n - 1
    return int((w - o) / resolution)


def cell_distance(distance: float, resolution: float) -> int:
    """A length [m] in whole cells, rounded up and never negative. costmap_2d.cpp:190."""
    return max(0, int(math.ceil(distance / resolution)))


def size_in_meters(n: int, resolution: float) -> float:
    """Length [m] of n cells as costmap_2d counts it: half a cell short."""
    return (n - 1 + 0.5) * resolution


@kernel
def walk_line(x0, y0, x1, y1, xs, ys, start):
    """Write the cells from (x0, y0) to (x1, y1), both included, into xs, ys from index `start`; return the end.

    base_local_planner/line_iterator.h: the way back does not visit the same cells in general.
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
    n = start
    for _ in range(major + 1):
        xs[n] = x
        ys[n] = y
        n += 1
        counter += minor
        step = counter >= major
        if step:
            counter -= major
        if x_major:
            x += sx
            if step:
                y += sy
        else:
            y += sy
            if step:
                x += sx
    return n


def union(a: Tuple, b: Tuple) -> Tuple:
    """The smallest rectangle (x0, y0, x1, y1) around two."""
    return min(a[0], b[0]), min(a[1], b[1]), max(a[2], b[2]), max(a[3], b[3])


def roll(
    cells: np.ndarray, origin: np.ndarray, resolution: float, new_ox: float, new_oy: float, default: int
) -> Tuple[int, int]:
    """Move the window of `cells` (ny, nx) towards the origin (new_ox, new_oy) [m] by whole cells; returns (cx, cy).

    Cells in the overlap keep their values, others get `default`; `origin` (2,) is moved. costmap_2d.cpp:260.
    """
    ox, oy = origin.tolist()
    cx = int((new_ox - ox) / resolution)
    cy = int((new_oy - oy) / resolution)
    if cx != 0 or cy != 0:
        origin[0] = ox + cx * resolution
        origin[1] = oy + cy * resolution
        shift(cells, cx, cy, default)
    return cx, cy


def shift(cells: np.ndarray, cx: int, cy: int, default: int) -> None:
    """cells[y, x] = cells[y + cy, x + cx] where that exists, else `default`, in place."""
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


OVERWRITE = 0  # values of combination_method
MAXIMUM = 1


@kernel
def begin(master, base, default, layer, merging, x0, y0, xn, yn, ax0, ay0, axn, ayn):
    """`base` becomes the default value inside the window, and as the master is in the rest of the rectangle around.

    With `merging` the known cells of the lowest layer are written into the window at once; on default values it makes
    no difference how they are combined.
    """
    empty = np.uint8(default)
    unknown = np.uint8(UNKNOWN)
    for y in range(ay0, ayn):
        if not y0 <= y < yn:
            _copy(master[y, ax0:axn], base[y, ax0:axn])
            continue
        _copy(master[y, ax0:x0], base[y, ax0:x0])
        _copy(master[y, xn:axn], base[y, xn:axn])
        target = base[y, x0:xn]
        if merging:
            values = layer[y, x0:xn]
            for i in range(values.shape[0]):
                target[i] = values[i] if values[i] != unknown else empty
        else:
            for i in range(target.shape[0]):
                target[i] = empty


@kernel
def merge(layer, base, maximum, x0, y0, xn, yn):
    """Known cells of the layer replace those of `base` in the window; with `maximum` only lower or unknown ones."""
    unknown = np.uint8(UNKNOWN)
    for y in range(y0, yn):
        values = layer[y, x0:xn]
        target = base[y, x0:xn]
        if maximum:
            for i in range(values.shape[0]):
                value = values[i]
                old = target[i]
                # 255 of the layer leaves the old value; 255 of the base counts as lower than anything
                target[i] = value if value != unknown and (old == unknown or old < value) else old
        else:
            for i in range(values.shape[0]):
                target[i] = values[i] if values[i] != unknown else target[i]


@kernel
def replace(layer, base, x0, y0, xn, yn):
    """All cells of the layer, unknown ones too, replace those of `base` in the window."""
    for y in range(y0, yn):
        _copy(layer[y, x0:xn], base[y, x0:xn])


@kernel
def _copy(source, target):
    for i in range(source.shape[0]):
        target[i] = source[i]
