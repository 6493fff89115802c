"""Fault detection for a scanner: geometry, blindness, frozen ranges and failed sectors. Used by CollisionMonitor."""

import math
from dataclasses import replace
from typing import Any, Optional, Tuple

import numpy as np

from applr_ros1.common.angles import Pose
from applr_ros1.common.arrays import Array32
from applr_ros1.common.kernels import kernel
from applr_ros1.common.scan import LaserScan
from applr_ros1.monitor.known_space import CAPACITY_POINTS
from applr_ros1.monitor.scan_matching import beam_at

FINEST_RAD = 1e-5  # smallest angle between two beams [rad]
FARTHEST_M = 1e6  # largest coordinate and angle of a sensor's or robot's pose [m, rad]
BLIND_SHARE = 0.95  # share of invalid ranges (NaN, -inf, below range_min) above which the scanner counts as blind
ENOUGH_HITS = 5  # a scan without hits is a fault if at least this number of earlier hits are in range
VISIBLE_SHARE = 0.9  # share of range_max within which an obstacle of an earlier scan must still return a beam
FROZEN_SCANS = 5  # number of identical scans in a row that count as frozen if the robot moves
FROZEN_M, FROZEN_RAD = 0.03, 0.03  # minimum motion of the robot for identical scans to count as frozen [m, rad]
# A wide sector that loses all returns at once is a sensor fault: real obstacles do not vanish that fast.
SECTOR_RAD = math.pi / 4  # smallest width of a sector without returns that can count as failed [rad]
STOOD_SHARE = 0.3  # minimum share of beams in a failed sector that pointed at obstacles of the previous scan
REPEATED_M_RAD = 0.005  # motion of the robot above which a scan with identical ranges counts as old data [m, rad]

# Ranges (n,) of a scan, (range_min, range_max) [m], (first angle, angle increment) [rad] and pose of the laser.
Image = Tuple[Array32, Tuple[float, float], Tuple[float, float], Pose]


class ScannerCheck:
    """Fault detector that compares each scan with the previous scans of its laser.

    Attributes:
        repeats: whether the latest scan has the same ranges as the previous one although the robot moved.
    """

    def __init__(self) -> None:
        self.clear()

    def clear(self) -> None:
        """Forget all scans, for instance after the odometry was reset."""
        self._last: Any = None  # Image of the last scan with hits
        self._doubted = np.zeros(0, bool)  # mask of the beams of failed sectors
        self._doubts = False  # whether there is a failed sector
        self._forget_image()

    def fault(self, scan: LaserScan) -> str:
        """Return the fault of a scan in the odometry frame as one line, or "" if there is none."""
        problem = geometry_fault(scan)
        if problem:
            return problem
        ranges = np.ascontiguousarray(scan.ranges, dtype=np.float32)
        limits = np.float32(scan.range_min), np.float32(scan.range_max)
        beams = float(scan.angle_min), float(scan.angle_increment)
        full_turn = (len(ranges) + 0.5) * abs(beams[1]) >= 2.0 * math.pi
        blind, hits, widest = _count_ranges(ranges, *limits, full_turn)
        if blind >= BLIND_SHARE * len(ranges):
            share = f"{blind} of {len(ranges)} beams"
            return f"the scanner is blind: {share} are NaN or nearer than range_min {scan.range_min:g} m"
        if len(self._doubted) != len(ranges) or not hits:
            self._doubted, self._doubts = np.zeros(len(ranges), bool), False
        if not hits:
            self._forget_image()
            count = self._expected(scan, beams)[1]
            sentence = f"the scanner returns no hit, but {count} obstacle points of the previous scan are in range"
            return sentence if count >= ENOUGH_HITS else ""
        wide = widest * abs(beams[1]) >= SECTOR_RAD
        if wide or self._doubts:
            expected = self._expected(scan, beams)[0] if wide else self._doubted
            self._doubts = _doubt(ranges, limits[1], abs(beams[1]), full_turn, expected, self._doubted)
        problem = self._frozen(ranges, scan.sensor_pose)
        if hits >= ENOUGH_HITS:
            self._last = self._image, limits, beams, tuple(map(float, scan.sensor_pose))
        return problem

    def believed(self, scan: LaserScan) -> LaserScan:
        """Return the latest scan with NaN in place of the ranges of failed sectors, until these return hits again."""
        return replace(scan, ranges=np.where(self._doubted, np.float32(np.nan), scan.ranges)) if self._doubts else scan

    def _forget_image(self) -> None:
        self._image: Optional[np.ndarray] = None
        self._equal, self._since = 0, (0.0, 0.0, 0.0)
        self.repeats = False

    def _expected(self, scan: LaserScan, beams: Tuple[float, float]) -> Tuple[np.ndarray, int]:
        """Return the mask (n,) of the beams that point to hits of the last scan, and the number of these hits."""
        marks = np.zeros(len(scan.ranges), np.bool_)
        pose, reach = tuple(map(float, scan.sensor_pose)), VISIBLE_SHARE * scan.range_max
        return marks, 0 if self._last is None else _mark_expected(self._last, beams, pose, reach, marks)

    def _frozen(self, ranges: Array32, pose: Pose) -> str:
        if self._image is None or not np.array_equal(ranges, self._image, equal_nan=True):
            self._image, self._equal, self._since = ranges.copy(), 0, pose
            self.repeats = False
            return ""
        self._equal += 1
        moved = math.hypot(pose[0] - self._since[0], pose[1] - self._since[1])
        turned = abs(math.remainder(pose[2] - self._since[2], 2.0 * math.pi))
        self.repeats = moved > REPEATED_M_RAD or turned > REPEATED_M_RAD
        if self._equal < FROZEN_SCANS or (moved < FROZEN_M and turned < FROZEN_RAD):
            return ""
        motion = f"{moved:.2f} m and {turned:.2f} rad"
        return f"the scanner is frozen: {self._equal + 1} scans with identical ranges while the robot moved {motion}"


def geometry_fault(scan: LaserScan) -> str:
    """Return the fault of a scan's geometry as one line, or "" if it is valid."""
    count = np.size(scan.ranges)
    # range_max may be infinite.
    numbers = scan.angle_min, scan.angle_increment, scan.range_min, *scan.sensor_pose, scan.stamp
    if not all(map(math.isfinite, numbers)):
        return "the scan's geometry, pose or stamp is not finite"
    if max(map(abs, (scan.angle_min, *scan.sensor_pose))) > FARTHEST_M:
        return f"the scan's first angle or pose exceeds {FARTHEST_M:g} rad or m: check the driver and the odometry"
    if not 3 <= count <= CAPACITY_POINTS:  # Surplus points would be neither remembered nor marked as unknown.
        return f"the scan has {count} beams: use a scanner with 3 to {CAPACITY_POINTS}"
    if abs(scan.angle_increment) < FINEST_RAD or abs(scan.angle_increment) * (count - 1) > 2.0 * math.pi + 0.02:
        return f"the scan has {count} beams {scan.angle_increment:g} rad apart: this is not a planar scan"
    if not 0.0 <= scan.range_min < scan.range_max:
        return f"the scan has range_min {scan.range_min:g} m and range_max {scan.range_max:g} m: give 0 <= min < max"
    return ""


@kernel
def _count_ranges(ranges: Array32, range_min: float, range_max: float, full_turn: bool) -> Tuple[int, int, int]:
    """Return the numbers of invalid ranges and of hits, and the length of the longest run of beams without return."""
    n = ranges.shape[0]
    blind = hits = run = widest = 0
    for i in range(n):
        r = ranges[i]
        blind += math.isnan(r) or r < range_min  # +inf is a valid measurement of free space (REP 117).
        hits += range_min <= r < range_max
        run = run + 1 if r >= range_max else 0
        widest = max(widest, run)
    for i in range(n if full_turn and run < n else 0):  # A run may continue across the ends of a full turn.
        if not ranges[i] >= range_max:
            break
        run += 1
        widest = max(widest, run)
    return blind, hits, widest


@kernel
def _mark_expected(old: Image, beams: Tuple[float, float], pose: Pose, reach: float, marks: np.ndarray) -> int:
    """Mark the beams of a new scan that point to hits of an old scan within `reach`, and return the number of them."""
    ranges, limits, old_beams, old_pose = old
    n = marks.shape[0]
    count = 0
    for i in range(ranges.shape[0]):
        if not limits[0] <= ranges[i] < limits[1]:
            continue
        angle = old_pose[2] + old_beams[0] + i * old_beams[1]
        dx = old_pose[0] + ranges[i] * math.cos(angle) - pose[0]
        dy = old_pose[1] + ranges[i] * math.sin(angle) - pose[1]
        place = beam_at(beams[0], beams[1], math.atan2(dy, dx) - pose[2])
        if place <= n - 1 and math.hypot(dx, dy) < reach:
            marks[int(np.rint(place))] = True
            count += 1
    return count


@kernel
def _doubt(
    ranges: Array32, range_max: float, increment: float, full_turn: bool, expected: np.ndarray, doubted: np.ndarray
) -> bool:
    """Mark the beams of each wide sector without returns if a return was expected for STOOD_SHARE of them.

    The marks are in `doubted` (n,), and are cleared for beams that return again. Returns whether any beam is marked.
    """
    n = ranges.shape[0]
    first = 0
    while full_turn and first < n - 1 and ranges[first] >= range_max:  # A sector may continue across the ends.
        first += 1
    begin = stood = 0
    for j in range(n + 1):
        i = (first + j) % n
        if j < n and ranges[i] >= range_max:
            stood += expected[i]
            continue
        if (j - begin) * increment >= SECTOR_RAD and stood >= STOOD_SHARE * (j - begin):
            for k in range(begin, j):
                doubted[(first + k) % n] = True
        if j < n:
            doubted[i] = False
        begin, stood = j + 1, 0
    return bool(doubted.any())
