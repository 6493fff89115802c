"""Rays of a scan, as numba kernels take them, and the beam that points in a given direction.

ObstacleMemory, SeenSpace, ScanMatcher and ScannerCheck all compare the beams of one scan with
points of another.
"""

import math
from typing import NamedTuple, Tuple

from applr_ros1.common.arrays import Array32
from applr_ros1.common.kernels import kernel
from applr_ros1.common.scan import LaserScan


class ScanRays(NamedTuple):
    """Ranges of a scan, geometry of its beams, and pose of its laser.

    ranges, free: (n,) LaserScan.distances and LaserScan.free [m]. angle_min, increment: bearing of
    the first beam in the laser's frame, and angle from beam to beam [rad]. range_min, range_max:
    limits of a hit [m]. x, y, yaw: pose of the laser [m, m, rad].
    """

    ranges: Array32
    free: Array32
    angle_min: float
    increment: float
    range_min: float
    range_max: float
    x: float
    y: float
    yaw: float


def rays_of(scan: LaserScan) -> ScanRays:
    """Return the ScanRays of a scan."""
    # A kernel is compiled for each combination of argument types, so all numbers become floats.
    return ScanRays(
        scan.distances,
        scan.free,
        float(scan.angle_min),
        float(scan.angle_increment),
        float(scan.range_min),
        float(scan.range_max),
        *map(float, scan.sensor_pose),
    )


@kernel
def end_point(rays: ScanRays, beam: int) -> Tuple[float, float]:
    """Return the end point x, y [m] of a beam, in the frame of the laser's pose."""
    bearing = rays.yaw + rays.angle_min + beam * rays.increment
    distance = rays.ranges[beam]
    return rays.x + distance * math.cos(bearing), rays.y + distance * math.sin(bearing)


@kernel
def beam_at(angle_min: float, increment: float, bearing: float) -> float:
    """Return the fractional index of the beam towards a bearing [rad] in the laser's frame.

    The result is beyond the last index if no beam has this bearing.
    """
    turn = bearing - angle_min if increment > 0.0 else angle_min - bearing
    if -2.0 * math.pi < turn < 0.0:
        turn += 2.0 * math.pi  # The result equals that of the modulo, which is far slower.
    elif not 0.0 <= turn < 2.0 * math.pi:
        turn %= 2.0 * math.pi
    return turn / abs(increment)
