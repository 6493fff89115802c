"""A slow, direct costmap after docs/explanation/planner.md, section 3: what test_costmap.py compares the fast one with.

Inflation and filled footprints are the package's own: golden vectors hold them.
"""

import math

import numpy as np

from applr_ros1.planner.costmap import footprint as footprints
from applr_ros1.planner.costmap.grid import walk_line
from applr_ros1.planner.costmap.inflation_layer import InflationLayer

F32_MAX = float(np.finfo(np.float32).max)


def line_cells(x0: int, y0: int, x1: int, y1: int) -> np.ndarray:
    """The cells from (x0, y0) to (x1, y1) as an (n, 2) int64 array, both ends included."""
    xs, ys = np.empty((2, max(abs(x1 - x0), abs(y1 - y0)) + 1), np.int64)
    walk_line(int(x0), int(y0), int(x1), int(y1), xs, ys, 0)
    return np.stack((xs, ys), axis=1)


def hypot(x, y):
    return float(np.hypot(float(x), float(y)))


def inflate(master, window, resolution, inscribed, parameters):
    """Inflate a window of the cells in place, with a layer that has seen nothing before."""
    layer = InflationLayer(*master.shape[::-1], resolution, parameters)
    layer.set_inscribed_radius(inscribed)
    layer.update(master, master.copy(), window)


class PlainCostmap:
    """Section 3: obstacle layer, inflation layer and master, in the order of the steps there."""

    def __init__(self, nx, ny, resolution, origin, rolling, footprint, default, obstacles, source, inflation):
        self.res, self.n, self.rolling = resolution, (nx, ny), rolling
        self.default = default
        self.master, self.layer = (np.full((ny, nx), default, np.uint8) for _ in range(2))
        self.origin, self.layer_origin = list(origin), list(origin)
        self.footprint = footprint
        self.inscribed = footprints.radii(footprint)[0]
        self.obstacles, self.source, self.inflation = obstacles, source, inflation
        self.due = True
        self.last = (-F32_MAX, -F32_MAX, F32_MAX, F32_MAX)
        self.cloud = None
        self.extra = None

    def set_inflation(self, new):
        old, self.inflation = self.inflation, new
        self.due = self.due or old != new

    def cell(self, wx, wy, origin):
        if wx < origin[0] or wy < origin[1]:
            return None
        mx, my = int((wx - origin[0]) / self.res), int((wy - origin[1]) / self.res)
        return (mx, my) if mx < self.n[0] and my < self.n[1] else None

    def roll(self, grid, origin, pose):
        shift = [int((pose[i] - (self.n[i] - 1 + 0.5) * self.res / 2 - origin[i]) / self.res) for i in (0, 1)]
        if shift == [0, 0]:
            return grid
        for i in (0, 1):
            origin[i] = origin[i] + shift[i] * self.res
        out = np.full_like(grid, self.default)
        for y, x in np.ndindex(*grid.shape):
            if 0 <= x + shift[0] < self.n[0] and 0 <= y + shift[1] < self.n[1]:
                out[y, x] = grid[y + shift[1], x + shift[0]]
        return out

    def update(self, pose, cloud=None):
        self.cloud = cloud if cloud is not None else self.cloud
        if self.rolling:
            self.master = self.roll(self.master, self.origin, pose)
        bounds = [1e30, 1e30, -1e30, -1e30]
        if self.obstacles.enabled:
            self.obstacle_bounds(pose, bounds)
        if self.inflation.enabled:
            self.inflation_bounds(bounds)
        window = []
        for i in range(4):
            axis, w = i % 2, bounds[i]
            if w < self.origin[axis]:
                c = 0
            elif w >= self.res * self.n[axis] + self.origin[axis]:
                c = self.n[axis] - 1
            else:
                c = int((w - self.origin[axis]) / self.res)
            window.append(max(0, c) if i < 2 else min(self.n[axis], c + 1))
        x0, y0, xn, yn = window
        if xn < x0 or yn < y0:
            return
        self.master[y0:yn, x0:xn] = self.default
        if self.obstacles.enabled:
            self.obstacle_costs(pose, x0, y0, xn, yn)
        if self.inflation.enabled:
            inflate(self.master, window, self.res, self.inscribed, self.inflation)

    def obstacle_bounds(self, pose, bounds):
        p, source, grid = self.obstacles, self.source, self.layer

        def widen(x, y):
            bounds[:] = min(bounds[0], x), min(bounds[1], y), max(bounds[2], x), max(bounds[3], y)

        if self.rolling:
            grid = self.layer = self.roll(self.layer, self.layer_origin, pose)
        origin = self.layer_origin
        if self.extra is not None:
            widen(*self.extra[:2])
            widen(*self.extra[2:])
            self.extra = None
        points, sensor = [], None
        if self.cloud is not None:
            sensor = self.cloud.origin
            low, high = source.min_obstacle_height, source.max_obstacle_height
            points = [q for q in self.cloud.points.astype(np.float64).tolist() if low <= q[2] <= high]
        if self.cloud is not None and source.clearing and self.cell(sensor[0], sensor[1], origin) is not None:
            self.clear_rays(points, sensor, widen)
        for x, y, z in points if source.marking else ():
            if z > p.max_obstacle_height:
                continue
            dx, dy, dz = x - sensor[0], y - sensor[1], z - sensor[2]
            far = dx * dx + dy * dy + dz * dz
            cell = self.cell(x, y, origin)
            if far >= source.obstacle_range * source.obstacle_range or cell is None:
                continue
            grid[cell[1], cell[0]] = 254
            widen(x, y)
        if p.footprint_clearing_enabled:
            for x, y in footprints.transform(self.footprint, *pose).tolist():
                widen(x, y)

    def clear_rays(self, points, sensor, widen):
        ox, oy = self.layer_origin
        sx, sy = sensor[:2]
        ex, ey = ox + self.n[0] * self.res, oy + self.n[1] * self.res
        start = self.cell(sx, sy, (ox, oy))
        widen(sx, sy)
        reach = math.ceil(self.source.raytrace_range / self.res)
        for wx, wy, _ in points:
            a, b = wx - sx, wy - sy
            if wx < ox:
                wx, wy = ox, sy + b * ((ox - sx) / a)
            if wy < oy:
                wx, wy = sx + a * ((oy - sy) / b), oy
            if wx > ex:
                wx, wy = ex - 0.001, sy + b * ((ex - sx) / a)
            if wy > ey:
                wx, wy = sx + a * ((ey - sy) / b), ey - 0.001
            end = self.cell(wx, wy, (ox, oy))
            if end is None:
                continue
            line = line_cells(*start, *end)
            distance = hypot(end[0] - start[0], end[1] - start[1])
            scale = 1.0 if distance == 0 else min(1.0, reach / distance)
            for x, y in line[: min(int(scale * (len(line) - 1)), len(line) - 1) + 1]:
                self.layer[y, x] = 0
            dx, dy = wx - sx, wy - sy
            full = hypot(dx, dy)
            f = 1.0 if full == 0 else min(1.0, self.source.raytrace_range / full)
            widen(sx + dx * f, sy + dy * f)

    def obstacle_costs(self, pose, x0, y0, xn, yn):
        p = self.obstacles
        if p.footprint_clearing_enabled:
            footprints.fill_footprint(self.layer, 0, *self.layer_origin, self.res, self.footprint, *pose, True)
        for y in range(y0, yn):
            for x in range(x0, xn):
                value, old = self.layer[y, x], self.master[y, x]
                if value == 255:
                    continue
                if p.combination_method == 0 or (p.combination_method == 1 and (old == 255 or old < value)):
                    self.master[y, x] = value

    def inflation_bounds(self, bounds):
        incoming, r = tuple(bounds), self.inflation.inflation_radius
        if self.due:
            self.due = False
            bounds[:] = -F32_MAX, -F32_MAX, F32_MAX, F32_MAX
        else:
            bounds[:] = (
                min(self.last[0], incoming[0]) - r,
                min(self.last[1], incoming[1]) - r,
                max(self.last[2], incoming[2]) + r,
                max(self.last[3], incoming[3]) + r,
            )
        self.last = incoming

    def clear_outside(self, pose, side):
        start = [pose[i] - side / 2 for i in (0, 1)]
        low, high = ([int((start[i] + more - self.layer_origin[i]) / self.res) for i in (0, 1)] for more in (0.0, side))
        for y, x in np.ndindex(*self.layer.shape):
            if not (low[0] < x < high[0] and low[1] < y < high[1]):
                self.layer[y, x] = 255
        ox, oy = self.layer_origin
        self.extra = (ox, oy, ox + (self.n[0] - 1 + 0.5) * self.res, oy + (self.n[1] - 1 + 0.5) * self.res)

    def clear(self):
        self.master[:] = self.default
        self.layer[:] = self.default
        self.due = False
