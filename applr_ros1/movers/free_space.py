"""Space that earlier scans saw free: that through which their beams went. MoverTracker holds one FreeSpace.

A mover occupies what was free before, and leaves free what it occupied. The visible part of a wall, which slides along
it as the robot drives, or what comes into view from behind something else, does neither.
"""

import math

import numpy as np

from applr_ros1.common.kernels import kernel

SCANS = 7  # that are kept ...
APART_S = 0.14  # ... at least so far apart [s]
DEEP_M = 0.12  # [m]: a beam has to go on beyond a point for so long ...
BESIDE_M, TURNED_RAD = 0.06, 0.02  # ... as have those beside it: by so much [m, rad] poses and edges may be wrong
# of a scan: stamp [s], pose of the laser (x, y, yaw), first angle, increment [rad], range_min [m], beams, how fast the
# robot turned [rad/s], and how far between its first and its last beam [rad]
STAMP, X, Y, YAW, FIRST, STEP, LEAST, BEAMS, RATE, SWEPT = range(10)


class FreeSpace:
    """The last scans, some tenths of a second apart, of any number of beams.

    Attributes:
        ranges: (SCANS, at least n) float32: how far each beam saw [m]; 0 where that is not known.
        fans: (SCANS, 10) float64, as STAMP to SWEPT say; stamp -inf: none yet.
        newest: the row that was taken last.
    """

    def __init__(self):
        self.ranges = np.zeros((SCANS, 0), np.float32)
        self.fans = np.zeros((SCANS, 10))
        self.clear()

    def clear(self):
        """Forget all scans."""
        self.fans[:, STAMP] = -math.inf
        self.newest = 0

    def due(self, stamp):
        """Return whether a scan of this stamp is to be kept."""
        return stamp - self.fans[self.newest, STAMP] >= APART_S - 1e-3

    def take(self, depth, fan):
        """Keep a scan in place of the oldest: depth (n,) as in `ranges`, fan (10,) as in `fans`."""
        n = len(depth)
        if n > self.ranges.shape[1]:
            self.ranges = np.pad(self.ranges, ((0, 0), (0, n - self.ranges.shape[1])))
        self.newest = (self.newest + 1) % SCANS
        self.ranges[self.newest, :n] = depth
        self.fans[self.newest] = fan


@kernel
def full_turn(n, step):
    """Return whether n beams go all around, or but for a gap of some beams, as where their number varies."""
    return (n + 3.5) * abs(step) >= 2.0 * math.pi


@kernel
def depths(ranges, range_min, range_max, out):
    """Fill out (n,) float32 with how far each beam of a scan saw [m]; 0 where that is not known."""
    for i in range(ranges.shape[0]):
        r = ranges[i]
        out[i] = min(r, range_max) if r >= range_min else 0.0  # NaN and -inf, too


@kernel
def sees_through(depth, fan, x, y, turned):
    """Return whether all beams of a scan that pass near the point (x, y) [m] go on beyond it.

    depth: (at least n,), fan: (10,) as in FreeSpace; turned: possible error of the bearing beyond TURNED_RAD [rad].
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
