"""Fault detection for a scanner: geometry, blindness, frozen ranges, failed sectors.

CollisionMonitor holds one ScannerCheck per laser.
"""

import math
from dataclasses import replace
from typing import NamedTuple, Optional, Tuple

import numpy as np

from applr_ros1.common.angles import Pose
from applr_ros1.common.arrays import Array32
from applr_ros1.common.kernels import kernel
from applr_ros1.common.scan import LaserScan, covers_full_turn
from applr_ros1.monitor.known_space import CAPACITY_POINTS
from applr_ros1.monitor.rays import ScanRays, beam_at, end_point, rays_of

FINEST_RAD = 1e-5  # smallest angle between two beams [rad]
# Largest coordinate [m] and angle [rad] of a sensor's or robot's pose, far beyond any drive's.
FARTHEST_M = 1e6
FEWEST_BEAMS = 3  # smallest number of beams of a scan
# Tolerance of the angle that a planar scan covers, beyond a full turn, because drivers round it
# [rad].
OVERLAP_RAD = 0.02
# Share of invalid ranges (NaN, -inf, below range_min) above which the scanner counts as blind.
BLIND_SHARE = 0.95
# A scan without hits is a fault if at least this number of earlier hits are in range.
ENOUGH_HITS = 5
# Share of range_max within which an obstacle of an earlier scan must still return a beam.
VISIBLE_SHARE = 0.9
FROZEN_SCANS = 5  # number of identical scans in a row that count as frozen if the robot moves
# Minimum motion of the robot for identical scans to count as frozen.
FROZEN_M = 0.03
FROZEN_RAD = 0.03
# A wide sector that loses all returns at once is a sensor fault: real obstacles do not vanish that
# fast. Smallest width of a sector without returns that can count as failed [rad].
SECTOR_RAD = math.pi / 4
# Minimum share of beams in a failed sector that pointed at obstacles of the previous scan.
STOOD_SHARE = 0.3
# Motion of the robot above which a scan with identical ranges counts as old data [m, rad].
REPEATED_M_RAD = 0.005


class RangeCounts(NamedTuple):
    """Numbers of beams of a scan.

    invalid: beams that measure nothing. hits: beams with a return. widest_gap: longest run of beams
    without return.
    """

    invalid: int
    hits: int
    widest_gap: int


class ScannerCheck:
    """Fault detector that compares each scan with the previous scans of its laser.

    Attributes:
        repeats: whether the latest scan has the same ranges as the previous one although the robot
            moved.
    """

    def __init__(self) -> None:
        self.clear()

    def clear(self) -> None:
        """Forget all scans, for instance after the odometry was reset."""
        self._last: Optional[ScanRays] = None  # last scan with hits
        self._doubted = np.zeros(0, bool)  # mask of the beams of failed sectors
        self._forget_image()

    def fault(self, scan: LaserScan) -> str:
        """Return the fault of a scan in the odometry frame as one line, or "" if there is none."""
        problem = geometry_fault(scan)
        if problem:
            return problem
        rays = rays_of(scan)
        beam_count = len(rays.ranges)
        counts = _count_ranges(rays)
        if counts.invalid >= BLIND_SHARE * beam_count:
            share = f"{counts.invalid} of {beam_count} beams"
            limit = f"range_min {scan.range_min:g} m"
            return f"the scanner is blind: {share} are NaN or nearer than {limit}"

        if len(self._doubted) != beam_count or not counts.hits:
            self._doubted = np.zeros(beam_count, bool)
        if not counts.hits:
            self._forget_image()
            _, expected_hits = self._expected(rays)
            if expected_hits < ENOUGH_HITS:
                return ""
            points = f"{expected_hits} obstacle points of the previous scan"
            return f"the scanner returns no hit, but {points} are in range"

        has_wide_gap = counts.widest_gap * abs(rays.increment) >= SECTOR_RAD
        if has_wide_gap or self._doubted.any():
            expected = self._doubted
            if has_wide_gap:
                expected, _ = self._expected(rays)
            _doubt(rays.ranges, rays.increment, expected, self._doubted)

        problem = self._frozen(rays.ranges, scan.sensor_pose)
        if counts.hits >= ENOUGH_HITS:
            # The copy of the ranges in _image stays as it is, even if the caller reuses the scan's
            # array.
            self._last = rays._replace(ranges=self._image)
        return problem

    def believed(self, scan: LaserScan) -> LaserScan:
        """Return the latest scan with NaN for failed sectors, until these return hits again."""
        if not self._doubted.any():
            return scan
        return replace(scan, ranges=np.where(self._doubted, np.float32(np.nan), scan.ranges))

    def _forget_image(self) -> None:
        # Ranges of the last scan that differed from the scan before it.
        self._image = np.empty(0, np.float32)
        self._equal_scans = 0  # number of scans with these ranges, without the first
        self._image_pose = (0.0, 0.0, 0.0)  # pose of the laser in the first of them
        self.repeats = False

    def _expected(self, rays: ScanRays) -> Tuple[np.ndarray, int]:
        """Return which beams (n,) point to hits of the last scan, and the number of the hits."""
        mask = np.zeros(len(rays.ranges), np.bool_)
        if self._last is None:
            return mask, 0
        return mask, _mark_expected(self._last, rays, mask)

    def _frozen(self, ranges: Array32, pose: Pose) -> str:
        """Return a fault if the ranges stay identical while the robot moves.

        Updates `repeats`.
        """
        # Bytes, because NaN does not equal itself.
        if ranges.tobytes() != self._image.tobytes():
            self._image = ranges.copy()
            self._equal_scans = 0
            self._image_pose = pose
            self.repeats = False
            return ""
        self._equal_scans += 1
        first_x, first_y, first_yaw = self._image_pose
        x, y, yaw = pose
        distance = math.hypot(x - first_x, y - first_y)
        angle = abs(math.remainder(yaw - first_yaw, 2.0 * math.pi))
        self.repeats = distance > REPEATED_M_RAD or angle > REPEATED_M_RAD
        if self._equal_scans < FROZEN_SCANS or (distance < FROZEN_M and angle < FROZEN_RAD):
            return ""
        scans = f"{self._equal_scans + 1} scans with identical ranges"
        motion = f"{distance:.2f} m and {angle:.2f} rad"
        return f"the scanner is frozen: {scans} while the robot moved {motion}"


def geometry_fault(scan: LaserScan) -> str:
    """Return the fault of a scan's geometry as one line, or "" if it is valid."""
    count = np.size(scan.ranges)
    increment = abs(scan.angle_increment)
    # range_max may be infinite.
    numbers = scan.angle_min, scan.angle_increment, scan.range_min, *scan.sensor_pose, scan.stamp
    if not all(map(math.isfinite, numbers)):
        return "the scan's geometry, pose or stamp is not finite"
    if max(map(abs, (scan.angle_min, *scan.sensor_pose))) > FARTHEST_M:
        limit = f"{FARTHEST_M:g} rad or m"
        return f"the scan's first angle or pose exceeds {limit}: check the driver and the odometry"
    # Surplus points would be neither remembered nor marked as unknown.
    if not FEWEST_BEAMS <= count <= CAPACITY_POINTS:
        return f"the scan has {count} beams: use a scanner with {FEWEST_BEAMS} to {CAPACITY_POINTS}"
    if increment < FINEST_RAD or increment * (count - 1) > 2.0 * math.pi + OVERLAP_RAD:
        spacing = f"{scan.angle_increment:g} rad apart"
        return f"the scan has {count} beams {spacing}: this is not a planar scan"
    if not 0.0 <= scan.range_min < scan.range_max:
        limits = f"range_min {scan.range_min:g} m and range_max {scan.range_max:g} m"
        return f"the scan has {limits}: give 0 <= min < max"
    return ""


@kernel
def _count_ranges(rays: ScanRays) -> RangeCounts:
    """Count the invalid ranges, the hits, and the beams of the widest gap without a return."""
    ranges = rays.ranges
    beam_count = ranges.shape[0]
    invalid = 0
    hits = 0
    gap = 0
    widest_gap = 0
    for beam in range(beam_count):
        distance = ranges[beam]
        # +inf is a valid measurement of free space (REP 117).
        invalid += not rays.free[beam] > -np.inf
        hits += np.isfinite(distance)
        gap = gap + 1 if distance == np.inf else 0
        widest_gap = max(widest_gap, gap)

    # A gap may continue across the ends of a full turn.
    if covers_full_turn(beam_count, rays.increment) and gap < beam_count:
        for beam in range(beam_count):
            if ranges[beam] != np.inf:
                break
            gap += 1
            widest_gap = max(widest_gap, gap)
    return RangeCounts(invalid, hits, widest_gap)


@kernel
def _mark_expected(old: ScanRays, new: ScanRays, mask: np.ndarray) -> int:
    """Mark the beams of a new scan that point to hits of an old scan within its range.

    Args:
        old: earlier scan.
        new: scan of the same laser, whose ranges do not matter.
        mask: (n,) bool, a row per beam of the new scan; set to True for the marked beams.

    Returns:
        Number of the hits.
    """
    reach = VISIBLE_SHARE * new.range_max
    last_beam = mask.shape[0] - 1
    count = 0
    for old_beam in range(old.ranges.shape[0]):
        if not np.isfinite(old.ranges[old_beam]):
            continue
        x, y = end_point(old, old_beam)
        offset_x = x - new.x
        offset_y = y - new.y
        beam = beam_at(new.angle_min, new.increment, math.atan2(offset_y, offset_x) - new.yaw)
        if beam <= last_beam and math.hypot(offset_x, offset_y) < reach:
            mask[int(np.rint(beam))] = True
            count += 1
    return count


@kernel
def _doubt(
    ranges: Array32,
    increment: float,
    expected: np.ndarray,
    doubted: np.ndarray,
) -> None:
    """Mark the beams of each wide sector that has failed.

    A sector without returns has failed if STOOD_SHARE of its beams were expected to return.

    Args:
        ranges: (n,) ranges of the scan [m].
        increment: angle from beam to beam [rad].
        expected: (n,) bool, whether a beam pointed to a hit of the previous scan.
        doubted: (n,) bool, updated: set for the beams of failed sectors, cleared for beams that
            return again.
    """
    beam_count = ranges.shape[0]
    # In a full turn a sector may continue across the ends: start at a beam with a return.
    start_beam = 0
    if covers_full_turn(beam_count, increment):
        while start_beam < beam_count - 1 and ranges[start_beam] == np.inf:
            start_beam += 1

    # Steps count the beams from there. A sector ends at a beam with a return, or after the last
    # step.
    sector_start = 0
    expected_beams = 0
    for step in range(beam_count + 1):
        beam = (start_beam + step) % beam_count
        if step < beam_count and ranges[beam] == np.inf:
            expected_beams += expected[beam]
            continue
        sector_beams = step - sector_start
        is_wide = sector_beams * abs(increment) >= SECTOR_RAD
        if is_wide and expected_beams >= STOOD_SHARE * sector_beams:
            for sector_step in range(sector_start, step):
                doubted[(start_beam + sector_step) % beam_count] = True
        if step < beam_count:
            doubted[beam] = False
        sector_start = step + 1
        expected_beams = 0
