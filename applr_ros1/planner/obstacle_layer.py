"""Obstacle layer of a costmap: marks laser hits, clears along the rays, clears under the robot.

Called by costmap.Costmap. Follows costmap_2d/obstacle_layer.cpp step by step; the layer has its own grid.
"""
import math
from dataclasses import dataclass

import numpy as np
from numba import njit

from applr_ros1.planner.footprint import fill_footprint
from applr_ros1.planner.grid import (FREE, LETHAL, UNKNOWN, cell_distance, roll, size_in_meters, world_to_map,
                                     world_to_map_no_bounds)

OVERWRITE = 0
MAXIMUM = 1


@dataclass
class ObstacleParameters:
    """Settings of the layer and of its one laser source, named as the ROS parameters."""
    enabled: bool = True
    footprint_clearing_enabled: bool = True
    max_obstacle_height: float = 2.0    # [m] marking skips higher points
    combination_method: int = MAXIMUM
    obstacle_range: float = 2.5         # [m] hits at or beyond it do not mark
    raytrace_range: float = 3.0         # [m] rays clear up to it
    source_min_height: float = -2.0     # [m] the source keeps points between these two
    source_max_height: float = 2.0
    marking: bool = True
    clearing: bool = True


class ObstacleLayer:
    """Grid `cells` (ny, nx) uint8 of 0, 254 and 255 with its own rolling `origin` (2,) [m]."""

    def __init__(self, nx, ny, resolution, origin, rolling, default, parameters):
        self.parameters = parameters
        self.resolution = float(resolution)
        self.rolling = bool(rolling)
        self.default = int(default)
        self.cells = np.full((ny, nx), default, np.uint8)
        self.origin = np.array(origin, dtype=np.float64)
        self.cloud = None          # the newest scan, applied again in every update
        self._extra = None         # bounds left by a recovery: min x, min y, max x, max y

    def update_bounds(self, pose, footprint, bounds):
        """Roll, clear, mark; widen `bounds` (4,) [m] = min x, min y, max x, max y by what may have changed."""
        p = self.parameters
        ny, nx = self.cells.shape
        if self.rolling:
            roll(self.cells, self.origin, self.resolution, pose[0] - size_in_meters(nx, self.resolution) / 2,
                 pose[1] - size_in_meters(ny, self.resolution) / 2, self.default)
        if self._extra is not None:
            bounds[:2] = np.minimum(bounds[:2], self._extra[:2])
            bounds[2:] = np.maximum(bounds[2:], self._extra[2:])
            self._extra = None
        if self.cloud is not None:
            sx, sy, sz = self.cloud.origin
            _apply_cloud(self.cells, self.origin, self.resolution, self.cloud.points, float(sx), float(sy), float(sz),
                         float(p.raytrace_range), cell_distance(p.raytrace_range, self.resolution),
                         float(p.obstacle_range), float(p.max_obstacle_height), float(p.source_min_height),
                         float(p.source_max_height), bool(p.clearing), bool(p.marking), bounds)
        if p.footprint_clearing_enabled:
            _touch_footprint(footprint, float(pose[0]), float(pose[1]), float(pose[2]), bounds)

    def update_costs(self, master, pose, footprint, x0, y0, xn, yn):
        """Clear under the robot, then merge the window [x0, xn) x [y0, yn) into `master` (ny, nx)."""
        p = self.parameters
        if p.footprint_clearing_enabled:
            fill_footprint(self.cells, FREE, self.origin[0], self.origin[1], self.resolution, footprint,
                           float(pose[0]), float(pose[1]), float(pose[2]), True)
        if p.combination_method in (OVERWRITE, MAXIMUM):
            _combine(self.cells, master, p.combination_method == MAXIMUM, x0, y0, xn, yn)

    def reset(self):
        """Everything back to the default value. The newest scan stays and marks again."""
        self.cells[:] = self.default

    def clear_outside(self, pose, side, inverted=False):
        """Recovery: cells outside (inside, if inverted) the square of `side` [m] about the pose become 255.

        clear_costmap_recovery.cpp:351, costmap_layer.cpp:21; corner rows and columns count as outside.
        """
        ny, nx = self.cells.shape
        ends = []
        for axis in (0, 1):
            start = pose[axis] - side / 2
            ends += [world_to_map_no_bounds(start, self.origin[axis], self.resolution),
                     world_to_map_no_bounds(start + side, self.origin[axis], self.resolution)]
        xs, ys = np.arange(nx), np.arange(ny)
        inside = (((ys > ends[2]) & (ys < ends[3]))[:, None] & ((xs > ends[0]) & (xs < ends[1]))[None, :])
        self.cells[inside == bool(inverted)] = UNKNOWN
        whole = np.array([self.origin[0], self.origin[1],
                          self.origin[0] + size_in_meters(nx, self.resolution),
                          self.origin[1] + size_in_meters(ny, self.resolution)])
        if self._extra is not None:
            whole[:2] = np.minimum(whole[:2], self._extra[:2])
            whole[2:] = np.maximum(whole[2:], self._extra[2:])
        self._extra = whole


@njit(cache=True)
def _touch(bounds, x, y):
    if x < bounds[0]:
        bounds[0] = x
    if y < bounds[1]:
        bounds[1] = y
    if x > bounds[2]:
        bounds[2] = x
    if y > bounds[3]:
        bounds[3] = y


@njit(cache=True)
def _touch_footprint(footprint, x, y, yaw, bounds):
    c = math.cos(yaw)
    s = math.sin(yaw)
    for i in range(footprint.shape[0]):
        fx = footprint[i, 0]
        fy = footprint[i, 1]
        _touch(bounds, x + (fx * c - fy * s), y + (fx * s + fy * c))


@njit(cache=True, error_model="numpy")
def _apply_cloud(cells, origin, res, points, sx, sy, sz, raytrace_range, reach, obstacle_range, max_height,
                 source_min, source_max, clearing, marking, bounds):
    ny, nx = cells.shape
    ox = origin[0]
    oy = origin[1]
    n = points.shape[0]
    if clearing:
        x0, y0 = world_to_map(sx, sy, ox, oy, res, nx, ny)
        if x0 >= 0:
            _clear_rays(cells, ox, oy, res, points, sx, sy, x0, y0, raytrace_range, reach, source_min, source_max,
                        bounds)
    if not marking:
        return
    limit = obstacle_range * obstacle_range
    for i in range(n):
        px = np.float64(points[i, 0])
        py = np.float64(points[i, 1])
        pz = np.float64(points[i, 2])
        if pz < source_min or pz > source_max or pz > max_height:
            continue
        if (px - sx) * (px - sx) + (py - sy) * (py - sy) + (pz - sz) * (pz - sz) >= limit:
            continue
        mx, my = world_to_map(px, py, ox, oy, res, nx, ny)
        if mx < 0:
            continue
        cells[my, mx] = LETHAL
        _touch(bounds, px, py)


@njit(cache=True, error_model="numpy")
def _clear_rays(cells, ox, oy, res, points, sx, sy, x0, y0, raytrace_range, reach, source_min, source_max, bounds):
    ny, nx = cells.shape
    flat = cells.reshape(-1)
    right = ox + nx * res
    top = oy + ny * res
    last_x = -1
    last_y = -1
    near = reach * reach
    safely_near = raytrace_range * raytrace_range * (1.0 - 1e-9)
    _touch(bounds, sx, sy)
    for i in range(points.shape[0]):
        pz = np.float64(points[i, 2])
        if pz < source_min or pz > source_max:
            continue
        wx = np.float64(points[i, 0])
        wy = np.float64(points[i, 1])
        a = wx - sx
        b = wy - sy
        if wx < ox:
            t = (ox - sx) / a
            wx = ox
            wy = sy + b * t
        if wy < oy:
            t = (oy - sy) / b
            wx = sx + a * t
            wy = oy
        if wx > right:
            t = (right - sx) / a
            wx = right - .001
            wy = sy + b * t
        if wy > top:
            t = (top - sy) / b
            wx = sx + a * t
            wy = top - .001
        x1, y1 = world_to_map(wx, wy, ox, oy, res, nx, ny)
        if x1 < 0:
            continue
        dx = wx - sx
        dy = wy - sy
        if dx * dx + dy * dy < safely_near:  # then the factor min(1, range / distance) is 1
            _touch(bounds, sx + dx, sy + dy)
        else:
            f = min(1.0, raytrace_range / math.hypot(dx, dy))
            _touch(bounds, sx + dx * f, sy + dy * f)
        if x1 == last_x and y1 == last_y:  # the same line again
            continue
        last_x = x1
        last_y = y1
        ix = x1 - x0
        iy = y1 - y0
        sign_x = 1 if ix >= 0 else -1
        sign_y = nx if iy >= 0 else -nx
        ix = abs(ix)
        iy = abs(iy)
        if ix >= iy:
            major = ix
            minor = iy
            step_major = sign_x
            step_minor = sign_y
        else:
            major = iy
            minor = ix
            step_major = sign_y
            step_minor = sign_x
        count = major
        if ix * ix + iy * iy > near:
            f = min(1.0, reach / math.hypot(float(ix), float(iy)))
            count = min(int(f * major), major)
        counter = major // 2
        k = y0 * nx + x0
        for _ in range(count + 1):
            flat[k] = FREE
            counter += minor
            if counter >= major:
                counter -= major
                k += step_minor
            k += step_major


@njit(cache=True)
def _combine(layer, master, maximum, x0, y0, xn, yn):
    for y in range(y0, yn):
        for x in range(x0, xn):
            value = layer[y, x]
            if value != UNKNOWN:
                old = master[y, x]
                if not maximum or old == UNKNOWN or old < value:
                    master[y, x] = value
