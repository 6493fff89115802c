"""Exact planar laser scanner among circles and boxes, called by Simulator.scan.

Only the beams within the angle that an obstacle covers are intersected with the obstacle. A scan of 720 beams among
several hundred cylinders therefore takes some microseconds. Rays of a physics engine are slow and wrong by up to a
centimetre. Tests compare the scans with brute force.
"""

from __future__ import annotations

from functools import lru_cache
from math import pi, sqrt
from typing import Tuple

import numpy as np

from applr_ros1.common.angles import Pose
from applr_ros1.common.arrays import Array, Array32, Ints
from applr_ros1.common.kernels import kernel
from applr_ros1.robots.robot import Laser

_NO_MOVERS = np.empty((0, 3))
Rays = Tuple[Array, Array, Array]  # fan (geometry of the beams, indices below), cosine and sine of each beam
# indices of a fan: first angle, angle between beams [rad], beams in a full turn, smallest and largest range [m]
_FIRST, _STEP, _TURN, _NEAR, _FAR = range(5)


class Lidar:
    """Laser scanner in one static world.

    Args:
        laser: Description of the laser.
        cylinders: (n, 3) x, y, radius [m].
        boxes: (m, 5) x, y, yaw, size_x, size_y [m, rad].
    """

    def __init__(self, laser: Laser, cylinders: Array, boxes: Array) -> None:
        self._rays = _rays(laser)
        self.circles = np.ascontiguousarray(cylinders, dtype=np.float64).reshape(-1, 3)
        self.edges = box_edges(np.asarray(boxes, dtype=np.float64).reshape(-1, 5))
        self._order = np.arange(len(self.circles))  # circles by distance in the last scan
        self._keys = np.empty(len(self.circles))
        self._sorted_at = (np.inf, np.inf)

    def scan(self, x: float, y: float, yaw: float, movers: Array = _NO_MOVERS) -> Array32:
        """Return the exact ranges (beams,) float32 [m] of the laser at (x, y) with heading `yaw`.

        +inf means nothing within range_max, and -inf an obstacle nearer than range_min or around the laser. `movers`
        (k, 3) are additional circles x, y, radius for this scan only.
        """
        # After a jump of the laser, the order of the last scan is useless.
        if abs(x - self._sorted_at[0]) + abs(y - self._sorted_at[1]) > 0.5:
            self._order[:] = np.argsort(np.hypot(self.circles[:, 0] - x, self.circles[:, 1] - y))
        self._sorted_at = (x, y)
        ranges = np.empty(len(self._rays[1]), dtype=np.float32)
        _scan((x, y, yaw), self.circles, movers, self.edges, self._order, self._keys, self._rays, ranges)
        return ranges


@lru_cache(maxsize=16)
def _rays(laser: Laser) -> Rays:
    """Return the rays of a laser for _scan."""
    first, step = laser.first_angle, laser.increment
    angles = first + step * np.arange(laser.beams)
    while first > pi:  # Bearings from -pi to pi must lie at most one turn away from the fan.
        first -= 2 * pi
    fan = np.array([first, step, round(2 * pi / step), laser.range_min, laser.range_max])
    return fan, np.cos(angles), np.sin(angles)


def box_edges(boxes: Array) -> Array:
    """Return the end points (4 m, 4) x0, y0, x1, y1 of the sides of boxes (m, 5), counter-clockwise."""
    edges = np.empty((4 * len(boxes), 4))
    for i, (x, y, yaw, size_x, size_y) in enumerate(boxes):
        c, s = np.cos(yaw), np.sin(yaw)
        corners = np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)]) * (size_x / 2, size_y / 2)
        corners = corners @ np.array([(c, s), (-s, c)]) + (x, y)
        edges[4 * i : 4 * i + 4, :2] = corners
        edges[4 * i : 4 * i + 4, 2:] = np.roll(corners, -1, axis=0)
    return edges


@kernel
def _bearing(y: float, x: float) -> float:
    """Approximate atan2(y, x) with an error below .0003 rad.

    The result only selects the beams to test, and two more beams are tested on either side.
    """
    ax, ay = abs(x), abs(y)
    big = max(ax, ay)
    if big == 0.0:
        return 0.0
    t = min(ax, ay) / big
    t2 = t * t
    a = t * (0.9998660 + t2 * (-0.3302995 + t2 * (0.1801410 + t2 * (-0.0851330 + t2 * 0.0208351))))
    if ay > ax:
        a = 1.5707963267948966 - a
    if x < 0.0:
        a = 3.141592653589793 - a
    return -a if y < 0.0 else a


@kernel
def _cut_circle(cx: float, cy: float, r: float, d2: float, rays: Rays, best: Array) -> bool:
    """Shorten the ranges `best` of beams that hit the circle at (cx, cy) in the laser frame. d2 is cx^2 + cy^2.

    Returns:
        True if the laser is inside the circle.
    """
    fan, cos_t, sin_t = rays
    if d2 <= r * r:
        return True
    d = sqrt(d2)
    near = d - r
    if near > fan[_FAR]:
        return False
    q = r / d
    half = q * (1.0 + q * q * (0.1666667 + q * q * 0.4041297)) + 0.0005  # upper bound of asin(q), the half angle
    middle = _bearing(cy, cx)
    n = best.shape[0]
    lo = int((middle - half - fan[_FIRST]) / fan[_STEP])
    hi = int((middle + half - fan[_FIRST]) / fan[_STEP]) + 1
    full = int(fan[_TURN])
    excess = d2 - r * r
    for turn in range(-1, 2):  # An obstacle behind the laser may reach into either end of the fan.
        first = lo + turn * full
        last = hi + turn * full + 1
        if last < 0 or first >= n:
            continue
        for i in range(max(first - 1, 0), min(last + 1, n - 1) + 1):
            if near < best[i]:
                along = cx * cos_t[i] + cy * sin_t[i]
                inside = along * along - excess
                if inside >= 0.0 and along > 0.0:
                    reach = along - sqrt(inside)
                    if reach < best[i]:
                        best[i] = reach
    return False


@kernel
def _cut_edge(x0: float, y0: float, x1: float, y1: float, rays: Rays, best: Array) -> None:
    """Shorten the ranges `best` of beams that hit the segment from (x0, y0) to (x1, y1) in the laser frame."""
    fan, cos_t, sin_t = rays
    a0 = _bearing(y0, x0)
    span = _bearing(x0 * y1 - y0 * x1, x0 * x1 + y0 * y1)  # signed angle from the first end to the second
    n = best.shape[0]
    lo = int((min(a0, a0 + span) - 0.001 - fan[_FIRST]) / fan[_STEP])
    hi = int((max(a0, a0 + span) + 0.001 - fan[_FIRST]) / fan[_STEP]) + 1
    full = int(fan[_TURN])
    ex, ey = x1 - x0, y1 - y0
    cross = x0 * ey - y0 * ex
    for turn in range(-1, 2):
        for i in range(max(lo + turn * full - 1, 0), min(hi + turn * full + 2, n - 1) + 1):
            c, s = cos_t[i], sin_t[i]
            across = c * ey - s * ex
            if across != 0.0:
                reach = cross / across
                where = (x0 * s - y0 * c) / across
                if 0.0 < reach < best[i] and -1e-12 <= where <= 1.0 + 1e-12:
                    best[i] = reach


@kernel
def _scan(
    pose: Pose, circles: Array, movers: Array, edges: Array, order: Ints, keys: Array, rays: Rays, ranges: Array32
) -> None:
    (x, y, yaw), fan = pose, rays[0]
    best = np.full(ranges.shape[0], fan[_FAR])
    c, s = np.cos(yaw), np.sin(yaw)
    covered = False
    for k in range(circles.shape[0]):
        dx, dy = circles[k, 0] - x, circles[k, 1] - y
        keys[k] = dx * dx + dy * dy
    for a in range(1, order.shape[0]):  # Insertion sort is fast, because the order of the last scan is nearly right.
        k = order[a]
        b = a - 1
        while b >= 0 and keys[order[b]] > keys[k]:
            order[b + 1] = order[b]
            b -= 1
        order[b + 1] = k
    for a in range(order.shape[0]):
        k = order[a]
        dx, dy = circles[k, 0] - x, circles[k, 1] - y
        covered |= _cut_circle(c * dx + s * dy, c * dy - s * dx, circles[k, 2], keys[k], rays, best)
    for k in range(movers.shape[0]):
        dx, dy = movers[k, 0] - x, movers[k, 1] - y
        d2 = dx * dx + dy * dy
        covered |= _cut_circle(c * dx + s * dy, c * dy - s * dx, movers[k, 2], d2, rays, best)
    for k in range(0, edges.shape[0], 4):
        inside = True
        for e in range(k, k + 4):
            x0, y0 = edges[e, 0] - x, edges[e, 1] - y
            x1, y1 = edges[e, 2] - x, edges[e, 3] - y
            if x0 * y1 - y0 * x1 > 0.0:  # The laser is on the inner side of this edge.
                continue
            inside = False  # Only sides that face the laser are visible.
            _cut_edge(c * x0 + s * y0, c * y0 - s * x0, c * x1 + s * y1, c * y1 - s * x1, rays, best)
        covered |= inside
    for i in range(ranges.shape[0]):
        if covered or best[i] <= fan[_NEAR]:
            ranges[i] = -np.inf
        elif best[i] >= fan[_FAR]:
            ranges[i] = np.inf
        else:
            ranges[i] = best[i]
