"""Free space of the last scans, to distinguish moving from static obstacles.

MoverTracker holds one FreeSpace. A moving obstacle occupies space that was free before, and frees
the space that it occupied. Static obstacles do neither, although the visible part of a wall moves
as the robot drives, and obstacles come into view behind others.
"""

import math
from typing import Any, Tuple

import numpy as np

from applr_ros1.common.arrays import Array32
from applr_ros1.common.kernels import kernel
from applr_ros1.common.scan import covers_full_turn

SCANS = 7  # number of scans that FreeSpace keeps
APART_S = 0.14  # smallest interval between two kept scans [s]
ROUNDING_S = 1e-3  # tolerance of this interval, because stamps are rounded [s]
DEEP_M = 0.12  # distance that a beam must continue beyond a point to see through it [m]
# Tolerance around a point: all beams within it must see through.
BESIDE_M = 0.06
TURNED_RAD = 0.02
LARGEST_RAD = 1.0  # largest tolerance, for points close to the laser [rad]
GAP_BEAMS = 3  # number of beams that may be missing from a full turn
LARGEST_FLOAT32 = float(np.finfo(np.float32).max)

# Geometry of one scan: stamp [s], pose of the laser (x, y, yaw), first angle and increment [rad],
# limits of a hit [m], number of beams, turn rate of the robot [rad/s], its turn from first to last
# beam [rad].
FAN = np.dtype(
    [
        ("stamp", np.float64),
        ("x", np.float64),
        ("y", np.float64),
        ("yaw", np.float64),
        ("angle_min", np.float64),
        ("increment", np.float64),
        ("range_min", np.float64),
        ("range_max", np.float64),
        ("beams", np.int64),
        ("turn_rate", np.float64),
        ("swept", np.float64),
    ]
)
Fan = Any  # a record of FAN, which numba knows by its dtype


class FreeSpace:
    """Ring buffer of the last scans that are at least APART_S apart.

    Scans may differ in their number of beams.

    Attributes:
        ranges: (SCANS, at least n) float32, free depth (length of free space) of each beam [m]; 0
            if unknown.
        fans: (SCANS,) FAN of each scan; the stamp of an empty row is -inf.
        newest: index of the latest row.
    """

    def __init__(self) -> None:
        self.ranges = np.zeros((SCANS, 0), np.float32)
        self.fans = np.zeros(SCANS, FAN)
        self.clear()

    def clear(self) -> None:
        """Forget all scans."""
        self.fans["stamp"] = -math.inf
        self.newest = 0

    def due(self, stamp: float) -> bool:
        """Return whether a scan with this stamp [s] must be kept, because APART_S have passed."""
        interval = stamp - self.fans["stamp"][self.newest]
        return bool(interval >= APART_S - ROUNDING_S)

    def take(self, depth: Array32, fan: Fan) -> None:
        """Replace the oldest scan by a new scan, given by free depths (n,) and its FAN."""
        beam_count = len(depth)
        missing = beam_count - self.ranges.shape[1]
        if missing > 0:
            self.ranges = np.pad(self.ranges, ((0, 0), (0, missing)))
        self.newest = (self.newest + 1) % SCANS
        self.ranges[self.newest, :beam_count] = depth
        self.fans[self.newest] = fan


@kernel
def full_turn(beam_count: int, increment: float) -> bool:
    """Return whether beams cover a full turn. Some scanners vary their number by a few beams."""
    return covers_full_turn(beam_count + GAP_BEAMS, increment)


def depths(distances: Array32, range_max: float) -> Array32:
    """Return the free depth (n,) float32 [m] of each beam from LaserScan.distances.

    It is 0 if it is unknown.
    """
    # Some drivers report a range_max that no float32 holds.
    longest = min(range_max, LARGEST_FLOAT32)
    is_known = distances > -np.inf
    return np.where(is_known, np.minimum(distances, longest), 0.0).astype(np.float32)


@kernel
def sees_through(
    depth: Array32, fan: Fan, x: float, y: float, bearing_error: float, longest: float = math.inf
) -> bool:
    """Return whether all beams of a scan that pass near the point (x, y) [m] continue beyond it.

    Args:
        depth: (at least n,) free depth of each beam [m].
        fan: FAN of the scan.
        x: x of the point [m].
        y: y of the point [m].
        bearing_error: possible bearing error beyond TURNED_RAD [rad].
        longest: free depth from which on a beam counts as unknown [m].
    """
    nearest_beam, distance = _towards(fan, x, y)
    if distance < fan.range_min:
        return False

    # Beams within the tolerance of the point.
    tolerance = min(BESIDE_M / distance + TURNED_RAD + bearing_error, LARGEST_RAD)
    around = int(tolerance / abs(fan.increment)) + 1
    first_beam = nearest_beam - around
    last_beam = nearest_beam + around
    if not full_turn(fan.beams, fan.increment) and (first_beam < 0 or last_beam >= fan.beams):
        return False

    # Most of the beams must be known, and none of the known ones may end before or at the point.
    known_beams = 0
    for beam in range(first_beam, last_beam + 1):
        free_depth = depth[beam % fan.beams]
        if 0.0 < free_depth < longest:
            known_beams += 1
            if free_depth < distance + DEEP_M:
                return False
    return known_beams > around


@kernel
def ends_at(depth: Array32, fan: Fan, x: float, y: float) -> bool:
    """Return whether one of the three beams nearest to the point (x, y) [m] ends there."""
    beam, distance = _towards(fan, x, y)
    # A beam without return has the depth range_max.
    is_in_reach = distance + DEEP_M < fan.range_max
    near_depths = depth[max(beam - 1, 0) : beam + 2]
    return is_in_reach and bool(np.any(np.abs(near_depths - distance) < DEEP_M))


@kernel
def _towards(fan: Fan, x: float, y: float) -> Tuple[int, float]:
    """Return the beam towards a point (x, y), beyond the last one too, and its distance [m]."""
    offset_x = x - fan.x
    offset_y = y - fan.y
    # The number of beams up to its bearing is never negative.
    turn = math.atan2(offset_y, offset_x) - fan.yaw - fan.angle_min
    if fan.increment > 0.0:
        turn = turn % (2.0 * math.pi)
    else:
        turn = -((-turn) % (2.0 * math.pi))
    return int(turn / fan.increment + 0.5), math.sqrt(offset_x * offset_x + offset_y * offset_y)
