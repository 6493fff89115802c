"""Check of a scanner that may be broken: geometry, blindness, frozen images, sectors. CollisionMonitor asks it."""

import math
from dataclasses import replace

import numpy as np

from applr_ros1.common.kernels import kernel
from applr_ros1.monitor.known_space import CAPACITY_POINTS
from applr_ros1.monitor.scan_matching import beam_at

FINEST_RAD = 1e-5  # [rad] between beams
FARTHEST_M = 1e6  # [m, rad]: no pose of a sensor or the robot is farther from its frame's origin
BLIND_SHARE = 0.95  # of the beams measuring nothing at all (NaN, -inf, under range_min): the scanner is blind
ENOUGH_HITS = 5  # beams with a hit that a scan needs before its sudden emptiness counts as a fault
VISIBLE_SHARE = 0.9  # share of range_max within which an obstacle of an earlier scan must still return a beam
FROZEN_SCANS = 5  # equal images in a row ...
FROZEN_M, FROZEN_RAD = 0.03, 0.03  # ... while the robot moved by more than this [m, rad]
SECTOR_RAD = math.pi / 4  # [rad]: neighbouring beams of at least so much that all at once return nothing ...
STOOD_SHARE = 0.3  # ... where for this share of them something must stand, are not believed
REPEATED_M_RAD = 0.005  # [m, rad]: an equal image after a motion of more than this is not news


class ScannerCheck:
    """Remembers just enough of the earlier scans to tell a working scanner from a broken one.

    Attributes:
        repeats: whether the newest scan shows what the one before showed, though the robot moved.
    """

    def __init__(self):
        self.clear()

    def clear(self):
        """Forgets earlier scans, for instance after the odometry was reset."""
        self._last = None  # ranges, (range_min, range_max), beams and pose of the last scan that had hits
        self._doubted = np.zeros(0, bool)  # beams that measured nothing where something must stand
        self._doubts = False  # whether there are such
        self._forget_image()

    def fault(self, scan):
        """Return what is wrong with a scan (common.scan.LaserScan in the odometry frame), a line or ""."""
        problem = geometry_fault(scan)
        if problem:
            return problem
        ranges = np.ascontiguousarray(scan.ranges, dtype=np.float32)
        limits = np.float32(scan.range_min), np.float32(scan.range_max)
        beams = float(scan.angle_min), float(scan.angle_increment)
        full_turn = (len(ranges) + 0.5) * abs(beams[1]) >= 2.0 * math.pi
        blind, hits, widest = _look(ranges, *limits, full_turn)
        if blind >= BLIND_SHARE * len(ranges):
            count = f"{blind} of {len(ranges)} beams"
            return f"the scanner is blind: {count} are NaN or nearer than range_min {scan.range_min:g} m"
        if len(self._doubted) != len(ranges) or not hits:
            self._doubted, self._doubts = np.zeros(len(ranges), bool), False
        if not hits:
            self._forget_image()
            count = self._expected(scan, beams)[1]
            sentence = f"the scanner sees nothing where it saw {count} obstacle points before"
            return sentence if count >= ENOUGH_HITS else ""
        wide = widest * abs(beams[1]) >= SECTOR_RAD
        if wide or self._doubts:  # wide sectors that return nothing all at once: nothing that stands there goes so fast
            expected = self._expected(scan, beams)[0] if wide else self._doubted
            self._doubts = _doubt(ranges, limits[1], abs(beams[1]), full_turn, expected, self._doubted)
        problem = self._freezing(ranges, scan.sensor_pose)
        if hits >= ENOUGH_HITS:
            self._last = self._image, limits, beams, tuple(map(float, scan.sensor_pose))
        return problem

    def believed(self, scan):
        """Return the newest scan; NaN are the ranges of a sector that has failed until its beams return again."""
        return replace(scan, ranges=np.where(self._doubted, np.float32(np.nan), scan.ranges)) if self._doubts else scan

    def _forget_image(self):
        self._image = None
        self._equal, self._since = 0, (0.0, 0.0, 0.0)
        self.repeats = False

    def _expected(self, scan, beams):
        """Return the beams (n,) that must meet what the last scan hit unless it has gone; the number of those hits."""
        marks = np.zeros(len(scan.ranges), np.bool_)
        pose, reach = tuple(map(float, scan.sensor_pose)), VISIBLE_SHARE * scan.range_max
        return marks, 0 if self._last is None else _mark_expected(*self._last, beams, pose, reach, marks)

    def _freezing(self, ranges, pose):
        if self._image is None or not _is_same(ranges, self._image):
            self._image, self._equal, self._since = ranges.copy(), 0, tuple(pose)
            self.repeats = False
            return ""
        self._equal += 1
        moved = math.hypot(pose[0] - self._since[0], pose[1] - self._since[1])
        turned = abs(math.remainder(pose[2] - self._since[2], 2.0 * math.pi))
        self.repeats = moved > REPEATED_M_RAD or turned > REPEATED_M_RAD
        if self._equal < FROZEN_SCANS or (moved < FROZEN_M and turned < FROZEN_RAD):
            return ""
        motion = f"{moved:.2f} m and {turned:.2f} rad"
        return f"the scanner is frozen: {self._equal + 1} equal images while the robot moved {motion}"


def geometry_fault(scan):
    """Return what is impossible about a scan's description, in one line, or ""."""
    count = np.size(scan.ranges)
    numbers = scan.angle_min, scan.angle_increment, scan.range_min, *scan.sensor_pose, scan.stamp  # not range_max
    if not all(map(math.isfinite, numbers)):
        return "the scan's geometry, pose or stamp is not finite"
    if max(map(abs, (scan.angle_min, *scan.sensor_pose))) > FARTHEST_M:
        return f"the scan's first angle or pose is beyond {FARTHEST_M:g}"
    if not 3 <= count <= CAPACITY_POINTS:  # of more some would be neither remembered nor unseen
        return f"a scan of {count} beams: 3 to {CAPACITY_POINTS} are possible"
    if abs(scan.angle_increment) < FINEST_RAD or abs(scan.angle_increment) * (count - 1) > 2.0 * math.pi + 0.02:
        return f"{count} beams {scan.angle_increment:g} rad apart are no planar scan"
    if not 0.0 <= scan.range_min < scan.range_max:
        return f"the scan's ranges are {scan.range_min:g} to {scan.range_max:g} m"
    return ""


@kernel
def _look(ranges, range_min, range_max, full_turn):
    """Return how many beams measure nothing at all, how many hit, and the most neighbours that see nothing there."""
    n = ranges.shape[0]
    blind = hits = run = widest = 0
    for i in range(n):
        r = ranges[i]
        blind += math.isnan(r) or r < range_min  # +inf measured that nothing is there
        hits += range_min <= r < range_max
        run = run + 1 if r >= range_max else 0
        widest = max(widest, run)
    for i in range(n if full_turn and run < n else 0):  # on across the ends of a full turn
        if not ranges[i] >= range_max:
            break
        run += 1
        widest = max(widest, run)
    return blind, hits, widest


def _is_same(a, b):
    """Return whether two images are the same; NaN equals NaN."""
    return len(a) == len(b) and bool(np.all((a == b) | (np.isnan(a) & np.isnan(b))))


@kernel
def _mark_expected(old, limits, old_beams, old_pose, beams, pose, reach, marks):
    """Mark the beams of a new scan that point to the hits of an old one, where those are in reach; returns how many."""
    n = marks.shape[0]
    count = 0
    for i in range(old.shape[0]):
        if not limits[0] <= old[i] < limits[1]:
            continue
        angle = old_pose[2] + old_beams[0] + i * old_beams[1]
        dx = old_pose[0] + old[i] * math.cos(angle) - pose[0]
        dy = old_pose[1] + old[i] * math.sin(angle) - pose[1]
        place = beam_at(beams[0], beams[1], math.atan2(dy, dx) - pose[2])
        if place <= n - 1 and math.hypot(dx, dy) < reach:
            marks[int(np.rint(place))] = True
            count += 1
    return count


@kernel
def _doubt(ranges, range_max, increment, full_turn, expected, doubted):
    """Doubt the beams of each wide sector without a return that has STOOD_SHARE of its beams among the expected ones.

    doubted (n,): beams that return something again are not doubted any more. Returns whether any is.
    """
    n = ranges.shape[0]
    first = 0
    while full_turn and first < n - 1 and ranges[first] >= range_max:  # a sector may go on across the ends
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
    return doubted.any()
