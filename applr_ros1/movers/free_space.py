"""Free space of the last scans, to distinguish moving from static obstacles. MoverTracker holds one FreeSpace.

A moving obstacle occupies space that was free before, and frees the space that it occupied. Static obstacles do
neither, although the visible part of a wall moves as the robot drives, and obstacles come into view behind others.
"""

import math

import numpy as np

from applr_ros1.common.arrays import Array, Array32
from applr_ros1.common.kernels import kernel

SCANS = 7  # number of scans that FreeSpace keeps
APART_S = 0.14  # smallest interval between two kept scans [s]
DEEP_M = 0.12  # distance that a beam must continue beyond a point to see through it [m]
BESIDE_M, TURNED_RAD = (
    0.06,
    0.02,
)  # tolerance around a point: all beams within it must see through [m, rad]
# Columns of a fan, which is the geometry of one scan: stamp [s], pose of the laser (x, y, yaw), first angle, increment
# [rad], range_min [m], number of beams, turn rate of the robot [rad/s], robot's turn from first to last beam [rad].
STAMP, X, Y, YAW, FIRST, STEP, LEAST, BEAMS, RATE, SWEPT = range(10)


class FreeSpace:
    """Ring buffer of the last scans that are at least APART_S apart. Scans may differ in their number of beams.

    Attributes:
        ranges: (SCANS, at least n) float32, free depth (length of free space) of each beam [m]; 0 if unknown.
        fans: (SCANS, 10) float64, columns STAMP to SWEPT; the stamp of an empty row is -inf.
        newest: index of the latest row.
    """

    def __init__(self) -> None:
        self.ranges = np.zeros((SCANS, 0), np.float32)
        self.fans = np.zeros((SCANS, 10))
        self.clear()

    def clear(self) -> None:
        """Forget all scans."""
        self.fans[:, STAMP] = -math.inf
        self.newest = 0

    def due(self, stamp: float) -> bool:
        """Return whether a scan with this stamp [s] must be kept, because APART_S have passed since the last one."""
        return bool(stamp - self.fans[self.newest, STAMP] >= APART_S - 1e-3)

    def take(self, depth: Array32, fan: Array) -> None:
        """Replace the oldest scan by a new scan: depth (n,) is its row of `ranges`, and fan (10,) its row of `fans`."""
        n = len(depth)
        if n > self.ranges.shape[1]:
            self.ranges = np.pad(self.ranges, ((0, 0), (0, n - self.ranges.shape[1])))
        self.newest = (self.newest + 1) % SCANS
        self.ranges[self.newest, :n] = depth
        self.fans[self.newest] = fan


@kernel
def full_turn(n: int, step: float) -> bool:
    """Return whether n beams cover a full turn. A gap of a few beams is allowed, because some scanners vary n."""
    return (n + 3.5) * abs(step) >= 2.0 * math.pi


def depths(ranges: Array32, range_min: float, range_max: float) -> Array32:
    """Return the free depth of each beam of a scan (n,) float32 [m], 0 if it is unknown: below range_min, or NaN."""
    return np.where(ranges >= np.float64(range_min), np.minimum(ranges, range_max), 0.0).astype(
        np.float32
    )


@kernel
def sees_through(depth: Array32, fan: Array, x: float, y: float, turned: float) -> bool:
    """Return whether all beams of a scan that pass near the point (x, y) [m] continue beyond it.

    depth (at least n,) and fan (10,) are as in FreeSpace. turned is the possible bearing error beyond TURNED_RAD [rad].
    """
    dx, dy = x - fan[X], y - fan[Y]
    distance = math.sqrt(dx * dx + dy * dy)
    if distance < fan[LEAST]:
        return False
    n, step = int(fan[BEAMS]), fan[STEP]
    turn = math.atan2(dy, dx) - fan[YAW] - fan[FIRST]
    turn = turn % (2.0 * math.pi) if step > 0.0 else -((-turn) % (2.0 * math.pi))
    middle = int(turn / step + 0.5)
    around = int(min(BESIDE_M / distance + TURNED_RAD + turned, 1.0) / abs(step)) + 1
    if not full_turn(n, step) and (middle - around < 0 or middle + around >= n):
        return False
    known = 0
    for i in range(middle - around, middle + around + 1):
        r = depth[i % n]
        if r > 0.0:
            known += 1
            if r < distance + DEEP_M:
                return False
    return known > around
