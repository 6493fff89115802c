"""Geometry of a cell grid: world <-> cell conversions and the line of cells between two cells.

Called by every kernel of the planner. The expressions (a division, then truncation) are those of costmap_2d;
multiplying by 1 / resolution instead would move points on cell borders.
"""
import math

import numpy as np
from numba import njit

FREE = 0
INSCRIBED = 253
LETHAL = 254
UNKNOWN = 255


@njit(cache=True)
def world_to_map(wx, wy, ox, oy, resolution, nx, ny):
    """Cell (mx, my) of the point (wx, wy) [m]; (-1, -1) if it is off the map. costmap_2d.cpp:208."""
    if wx < ox or wy < oy:
        return -1, -1
    fx = (wx - ox) / resolution
    fy = (wy - oy) / resolution
    if not (fx < nx and fy < ny):  # also refuses NaN and numbers too large for an integer
        return -1, -1
    return int(fx), int(fy)


@njit(cache=True)
def map_to_world(mx, my, ox, oy, resolution):
    """Centre (x, y) [m] of the cell (mx, my)."""
    return ox + (mx + 0.5) * resolution, oy + (my + 0.5) * resolution


@njit(cache=True)
def world_to_map_no_bounds(w, o, resolution):
    """Cell index of the coordinate w along one axis, truncated towards zero and not clipped."""
    return int((w - o) / resolution)


@njit(cache=True)
def world_to_map_enforce_bounds(w, o, resolution, n):
    """Cell index of the coordinate w along one axis, clipped into 0 .. n - 1. costmap_2d.cpp:233."""
    if w < o:
        return 0
    if w >= resolution * n + o:
        return n - 1
    return int((w - o) / resolution)


def cell_distance(distance, resolution):
    """A length [m] in whole cells, rounded up and never negative. costmap_2d.cpp:190."""
    return max(0, int(math.ceil(distance / resolution)))


def size_in_meters(n, resolution):
    """Length [m] of n cells as costmap_2d counts it: half a cell short."""
    return (n - 1 + 0.5) * resolution


@njit(cache=True)
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


def line_cells(x0, y0, x1, y1):
    """The cells from (x0, y0) to (x1, y1) as an (n, 2) int64 array, both ends included."""
    n = max(abs(x1 - x0), abs(y1 - y0)) + 1
    xs = np.empty(n, np.int64)
    ys = np.empty(n, np.int64)
    walk_line(int(x0), int(y0), int(x1), int(y1), xs, ys, 0)
    return np.stack((xs, ys), axis=1)


@njit(cache=True)
def roll(cells, origin, resolution, new_ox, new_oy, default):
    """Move the window of `cells` (ny, nx) towards the origin (new_ox, new_oy) [m] by whole cells; returns (cx, cy).

    Cells in the overlap keep their values, others get `default`; `origin` (2,) is moved. costmap_2d.cpp:260.
    """
    ny, nx = cells.shape
    cx = int((new_ox - origin[0]) / resolution)
    cy = int((new_oy - origin[1]) / resolution)
    if cx == 0 and cy == 0:
        return cx, cy
    origin[0] = origin[0] + cx * resolution
    origin[1] = origin[1] + cy * resolution
    shift(cells, cx, cy, default)
    return cx, cy


@njit(cache=True)
def shift(cells, cx, cy, default):
    """cells[y, x] = cells[y + cy, x + cx] where that exists, else `default`, in place."""
    ny, nx = cells.shape
    low = min(max(0, -cx), nx)     # columns low .. high have a source
    high = max(min(nx, nx - cx), low)
    for i in range(ny):
        y = i if cy >= 0 else ny - 1 - i
        source = y + cy
        if source < 0 or source >= ny:
            for x in range(nx):
                cells[y, x] = default
            continue
        if cx >= 0:
            for x in range(low, high):
                cells[y, x] = cells[source, x + cx]
        else:
            for x in range(high - 1, low - 1, -1):
                cells[y, x] = cells[source, x + cx]
        for x in range(low):
            cells[y, x] = default
        for x in range(high, nx):
            cells[y, x] = default
