"""What the scanner saw near the robot, kept where it cannot look now. CollisionMonitor holds one ObstacleMemory.

A scanner that covers 270 degrees does not look behind, and one near the front edge does not see what lies beside the
rear wheels. The points that it measured there before are kept in the frame of ScanMatcher's poses until they are
measured anew, seen through, too far away or too old.
"""

import math

import numpy as np

from applr_ros1.common.kernels import kernel
from applr_ros1.monitor.scan_matching import beam_at

CAPACITY = 16384  # points; beyond, the oldest go
SPACING = 0.015  # [m]: of neighbouring beams' points only those at least so far apart are kept
TOLERANCE = 0.08  # [m]: a measured range that differs less from a point's distance is that point
THIN = 0.02  # [m]: where neighbouring beams are farther apart, what they pass by may still stand between them


class ObstacleMemory:
    """Points (x, y) [m] in a fixed frame, with the time at which they were measured.

    Args:
        radius: distance [m] from the scanner beyond which points are forgotten.
        seconds: age [s] at which points that are not measured again are forgotten.
    """

    def __init__(self, radius=8.0, seconds=300.0):
        self.radius, self.seconds = float(radius), float(seconds)
        self._points = np.zeros((CAPACITY, 3))
        self._forgotten = np.empty((CAPACITY, 2))
        self._count = 0

    @property
    def points(self):
        """(n, 2) float64 x, y [m] of all remembered points, in the fixed frame, the oldest first."""
        return self._points[: self._count, :2]

    def clear(self):
        """Forgets everything, for instance after the odometry was reset."""
        self._count = 0

    def update(self, scan):
        """Takes a scan (planner.costmap.scan.LaserScan in the fixed frame).

        Beams outside [range_min, range_max) add nothing; +inf and ranges beyond the radius clear what lies before them;
        NaN, -inf and ranges under range_min neither add nor clear (REP-117: nothing is known there).

        Returns:
            (k, 2) x, y [m] of the points that were forgotten without a scan that shows them gone: for their age, their
            distance, or because there are too many.
        """
        ranges = np.ascontiguousarray(scan.ranges, dtype=np.float32)
        x, y, yaw = (float(v) for v in scan.sensor_pose)
        beams = float(scan.angle_min), float(scan.angle_increment), float(scan.range_min), float(scan.range_max)
        limits = self.radius, float(scan.stamp) - self.seconds, float(scan.stamp)
        self._count, lost = _update(self._points, self._count, self._forgotten, ranges, beams, (x, y, yaw), limits)
        return self._forgotten[:lost]

    def around(self, pose, reach):
        """(k, 2) the points at most `reach` [m] from a robot at pose (x, y, yaw) [m], in its frame [m]."""
        return _around(self._points, self._count, tuple(map(float, pose)), float(reach))


@kernel
def _around(points, count, pose, reach):
    near = np.empty((count, 2))
    c, s = math.cos(pose[2]), math.sin(pose[2])
    n = 0
    for k in range(count):
        dx, dy = points[k, 0] - pose[0], points[k, 1] - pose[1]
        if dx * dx + dy * dy <= reach * reach:
            near[n, 0], near[n, 1] = c * dx + s * dy, c * dy - s * dx
            n += 1
    return near[:n]


@kernel
def _update(points, count, forgotten, ranges, beams, sensor, limits):
    """(number of points, number of rows of `forgotten` that were written)."""
    count, lost = _keep(points, count, forgotten, ranges, beams, sensor, limits)
    angle_min, increment, range_min, range_max = beams
    sx, sy, syaw = sensor
    radius, _, now = limits
    surplus = min(count, max(0, count + ranges.shape[0] - points.shape[0]))
    count -= surplus  # the oldest stand in front
    for k in range(surplus):
        forgotten[lost] = points[k, :2]
        lost += 1
    for k in range(count):
        points[k] = points[k + surplus]
    last_x, last_y = np.inf, np.inf
    for i in range(ranges.shape[0]):
        r = ranges[i]
        if not range_min <= r < range_max:
            continue
        angle = syaw + angle_min + i * increment
        x, y = sx + r * math.cos(angle), sy + r * math.sin(angle)
        if (x - sensor[0]) ** 2 + (y - sensor[1]) ** 2 > radius * radius:
            continue
        if (x - last_x) ** 2 + (y - last_y) ** 2 < SPACING * SPACING:
            continue
        if count < points.shape[0]:
            points[count, 0], points[count, 1], points[count, 2] = x, y, now
            count += 1
        last_x, last_y = x, y
    return count, lost


@kernel
def _keep(points, count, forgotten, ranges, beams, sensor, limits):
    """Move the points that stay to the front of the array; returns how many they are, and how many are forgotten."""
    radius, oldest, _ = limits
    kept = lost = 0
    for k in range(count):
        x, y, stamp = points[k, 0], points[k, 1], points[k, 2]
        if _is_measured(x, y, ranges, beams, sensor):
            continue
        if stamp < oldest or (x - sensor[0]) ** 2 + (y - sensor[1]) ** 2 > radius * radius:
            forgotten[lost] = x, y
            lost += 1
            continue
        points[kept, 0], points[kept, 1], points[kept, 2] = x, y, stamp
        kept += 1
    return kept, lost


@kernel
def _is_measured(x, y, ranges, beams, sensor):
    """Whether a beam ends at the point: it is measured anew; or it and its neighbours reach beyond: it is gone.

    From where the scanner could not have seen it, beyond its range or thinner than its beams are apart, it stays.
    """
    angle_min, increment, range_min, range_max = beams
    dx, dy = x - sensor[0], y - sensor[1]
    distance = math.sqrt(dx * dx + dy * dy)
    if distance < range_min:
        return False
    n = ranges.shape[0]
    i = int(math.floor(beam_at(angle_min - 0.5 * increment, increment, math.atan2(dy, dx) - sensor[2])))
    if i >= n:
        return False
    if abs(ranges[i] - distance) < SPACING:
        return True
    full_turn = (n + 0.5) * abs(increment) >= 2.0 * math.pi
    if (i == 0 or i == n - 1) and not full_turn:
        return False
    met = distance < min(range_max, THIN / abs(increment))
    for j in range(i - 1, i + 2):
        r = ranges[j % n]
        if not r >= range_min or r < distance - TOLERANCE:
            return False
        met |= r < distance + TOLERANCE
    return met
