"""A laser scan and its projection into a costmap's frame, rounded as laser_geometry and tf2 round it.

Called by MoveBase and the costmap tests: one projection serves both costmaps.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Dict, Tuple

import numpy as np

from applr_ros1.common.kernels import kernel


@dataclass
class LaserScan:
    """One scan.

    Angles [rad], ranges (n,) float32 [m], +inf = no return; `sensor_pose` (x, y, yaw) is the laser's pose in the
    costmap's frame at `stamp` [s], `sensor_height` its z [m].
    """

    stamp: float
    angle_min: float
    angle_increment: float
    range_min: float
    range_max: float
    ranges: np.ndarray
    sensor_pose: Tuple[float, float, float]
    sensor_height: float = 0.0


@dataclass
class PointCloud:
    """Hits in the costmap's frame: `points` (n, 3) float32 [m], seen from `origin` (x, y, z) [m]."""

    origin: Tuple[float, float, float]
    points: np.ndarray


_beams: Dict[Tuple[float, float, int], np.ndarray] = {}


def _beam_directions(angle_min, angle_increment, count):
    """Cosine and sine (count, 2) of every beam, kept for the last few scan geometries."""
    key = (angle_min, angle_increment, count)
    table = _beams.get(key)
    if table is None:
        if len(_beams) >= 8:
            _beams.clear()
        first, step = float(np.float32(angle_min)), float(np.float32(angle_increment))
        angles = [first + i * step for i in range(count)]
        table = np.array([[math.cos(a), math.sin(a)] for a in angles], dtype=np.float64).reshape(count, 2)
        _beams[key] = table
    return table


def project(scan: LaserScan, inf_is_valid: bool = False) -> PointCloud:
    """PointCloud of a LaserScan: docs/planner.md, section 3.1.

    Kept are beams with range_min <= range < range_max. With `inf_is_valid` a +inf counts as a hit just short of
    range_max, so that it clears; NaN and -inf never count.
    """
    ranges = np.ascontiguousarray(scan.ranges, dtype=np.float32)
    table = _beam_directions(float(scan.angle_min), float(scan.angle_increment), len(ranges))
    points = np.empty((len(ranges), 3), np.float32)
    x, y, yaw = scan.sensor_pose
    x, y, z = float(x), float(y), float(scan.sensor_height)
    count = _project(
        ranges,
        table,
        np.float32(scan.range_min),
        np.float32(scan.range_max),
        bool(inf_is_valid),
        x,
        y,
        z,
        float(yaw),
        points,
    )
    return PointCloud((x, y, z), points[:count])


@kernel
def _project(ranges, table, range_min, range_max, inf_is_valid, x, y, z, yaw, points):
    one = np.float32(1.0)
    two = np.float32(2.0)
    qz = np.float32(math.sin(0.5 * yaw))
    qw = np.float32(math.cos(0.5 * yaw))
    twz = (two * qz) * qw
    tzz = (two * qz) * qz
    m00 = one - tzz
    m01 = -twz
    m10 = twz
    tx = np.float32(x)
    ty = np.float32(y)
    tz = np.float32(z)
    almost_max = range_max - np.float32(0.0001)
    count = 0
    for i in range(ranges.shape[0]):
        r = ranges[i]
        if inf_is_valid and r == np.inf:
            r = almost_max
        if r >= range_min and r < range_max:
            px = np.float32(np.float64(r) * table[i, 0])
            py = np.float32(np.float64(r) * table[i, 1])
            points[count, 0] = (m00 * px + m01 * py) + tx
            points[count, 1] = (m10 * px + m00 * py) + ty
            points[count, 2] = tz
            count += 1
    return count
