"""Scan matcher that corrects the odometry when the wheels slip. CollisionMonitor holds one ScanMatcher.

A base that brakes beyond its friction limit slides while its wheels stand still. Its odometry is then wrong by
centimetres, and so are the remembered obstacles. The next scan reveals the error, because static obstacles seem to
have moved. Each scan is matched to an earlier scan (point to line; Censi, "An ICP variant using a point-to-line
metric", ICRA 2008) from two initial guesses. The first is the odometry's pose. The second extrapolates the last motion,
because a sliding base keeps its speed while its wheels stand or turn backwards. The second guess is used only if it
leads to a clearly better fit. Points that do not fit, such as a walking person, get a low weight. The initial guess is
also a prior: it determines the directions that the scan does not constrain, such as along a bare corridor.
"""

import math
from typing import Any, List, Optional, Tuple

import numpy as np

from applr_ros1.common.angles import Pose, compose, inverse, normalize_angle
from applr_ros1.common.arrays import Array, Array32
from applr_ros1.common.kernels import kernel
from applr_ros1.common.scan import LaserScan

REACH_M = 8.0  # longest range that is used for matching [m]
STRIDE_BEAMS = 3  # spacing of the beams that are matched to an earlier scan [beams]
BASE_M = 0.02  # distance to each side of a point over which the surface normal is estimated [m]
APART_M_RAD = 0.15, 0.3  # distance and angle to the nearest reference scan above which a scan is kept [m, rad]
REFERENCES_KEPT = 256  # largest number of reference scans
ITERATIONS, COARSE = 12, 4  # maximum number of iterations, and how many of the first iterations are coarse
WIDE_M, NARROW_M = 0.1, 0.02  # point-to-line distance that gets weight 1/4, in coarse and later iterations [m]
NOISE_M = 0.01  # standard deviation of a point-to-line distance [m]
SLIP_M, YAW_ERROR_RAD = 0.05, 0.01  # expected errors of the odometry between two scans [m, rad]
LARGEST_SHIFT_M, LARGEST_TURN_RAD = 0.15, 0.1  # largest accepted correction by one scan [m, rad]
BETTER_WEIGHT = 0.05  # excess of mean weight above which a match from the extrapolated pose is preferred
LONGEST_S = 0.5  # longest time between two scans over which the motion is extrapolated [s]
ENOUGH_POINTS = 20  # smallest number of matched points of a valid match
FITTING_WEIGHT = 0.5  # smallest mean weight of the matched points of a valid match
ELSEWHERE_SHARE = 0.15  # smallest share of a scan's points in free space of a scan of another place

Beams = Tuple[float, float]  # first angle, angle increment [rad]
Reference = Tuple[Array32, Beams, Pose]  # ranges (n,) [m], beams, corrected pose


class ScanMatcher:
    """Corrects odometry poses by a slowly changing transform, which is estimated by scan matching.

    Attributes:
        lost: whether the latest scan contradicts the previous scan, for instance because the robot was carried or its
            odometry was reset. The scan must show new obstacles in space that was observed free. Obstacles that only
            vanish, such as a door that opens, do not count.
    """

    def __init__(self) -> None:
        # Cache: ranges of the earlier scan that was last matched against, and the lines() of that scan.
        self._surface: Tuple[Optional[np.ndarray], np.ndarray] = None, np.empty((0, 6))
        self._places: Tuple[Any, np.ndarray] = None, np.empty((0, 3))  # cache: last reference, poses of all references
        self.clear()

    def clear(self) -> None:
        """Reset the correction and forget all scans. Poses stay uncorrected until two scans have arrived."""
        self.correction: Pose = (0.0, 0.0, 0.0)
        self._references: List[Reference] = []  # reference scans, oldest first
        self.lost = False
        self._last: Optional[Tuple[float, Pose, Reference]] = None  # stamp [s], pose and Reference of the last scan
        self._measured: Any = None  # raw ranges of the last scan
        self._speed: Pose = (0.0, 0.0, 0.0)  # forward and leftward speed [m/s], turn rate [rad/s] of the last motion

    def corrected(self, pose: Pose) -> Pose:
        """Return the corrected pose for a pose (x, y, yaw) of the odometry frame [m, rad]."""
        return compose(self.correction, pose)

    def add_scan(self, scan: LaserScan) -> bool:
        """Match a scan in the odometry frame, and update the correction.

        The scan is matched to the nearest reference scan, so that a robot that comes back to a place gets the same
        coordinates. If the scan does not fit, this reference is discarded, and the scan is matched to the previous
        scan. If the robot is lost, all references are discarded.

        Returns:
            True if the scan fits an earlier scan. Otherwise the correction does not change.
        """
        pose = self.corrected(scan.sensor_pose)
        measured = np.asarray(scan.ranges, dtype=np.float32)
        ranges = np.where(
            (measured >= scan.range_min) & (measured < min(scan.range_max, REACH_M)), measured, np.float32(np.nan)
        )
        beams = float(scan.angle_min), float(scan.angle_increment)
        nearest = self._nearest(pose)
        guesses = self._guesses(pose, scan.stamp)
        matched, self.lost = None, False
        if nearest is not None:
            matched = self._align(self._references[nearest], ranges, beams, guesses)
            if matched is None:
                assert self._last is not None
                del self._references[nearest]
                nearest = None
                matched = self._align(self._last[2], ranges, beams, guesses)
                self.lost = matched is None and self._is_elsewhere(measured, (ranges, beams, pose))
        if self.lost:
            self._references.clear()
        if matched is not None:
            pose = matched
            self.correction = compose(pose, inverse(scan.sensor_pose))
        newest = ranges, beams, pose
        self._measured = measured
        apart = (math.inf, 0.0) if nearest is None else _difference(self._references[nearest][2], pose)
        if any(value > limit for value, limit in zip(apart, APART_M_RAD)):
            self._references = [*self._references[1 - REFERENCES_KEPT :], newest]
        self._speed = (0.0, 0.0, 0.0)
        if self._last is not None and 0.0 < scan.stamp - self._last[0] <= LONGEST_S:
            since = scan.stamp - self._last[0]
            x, y, yaw = compose(inverse(self._last[1]), pose)
            self._speed = x / since, y / since, yaw / since
        self._last = scan.stamp, pose, newest
        return matched is not None

    def _is_elsewhere(self, measured: np.ndarray, newest: Reference) -> bool:
        """Return whether the scans show different places: many points of each lie in free space of the other."""
        assert self._last is not None
        last = self._last[2]
        shown, appeared = _seen_through(newest, (self._measured, *last[1:]))
        seen, gone = _seen_through(last, (measured, *newest[1:]))
        came = shown >= ENOUGH_POINTS and appeared > ELSEWHERE_SHARE * shown
        return bool(came and (seen < ENOUGH_POINTS or gone > ELSEWHERE_SHARE * seen))  # skipped if few are in view

    def _guesses(self, pose: Pose, stamp: float) -> List[Pose]:
        """Return the initial guesses: the odometry's pose, and the extrapolated pose if it differs."""
        if self._last is None or not 0.0 < stamp - self._last[0] <= LONGEST_S:
            return [pose]
        v, s, w = (speed * (stamp - self._last[0]) for speed in self._speed)
        gone_on = compose(self._last[1], (v, s, w))
        return [pose, gone_on] if _difference(pose, gone_on)[0] > NARROW_M else [pose]

    def _align(self, earlier: Reference, ranges: Any, beams: Beams, guesses: List[Pose]) -> Optional[Pose]:
        """Return the pose at which a scan fits an earlier scan, or None if no guess leads to a fit."""
        old, old_beams, old_pose = earlier
        if self._surface[0] is not old:
            self._surface = old, lines(old, old_beams)
        points = _points(ranges, beams)
        tried: List[Tuple[bool, float, Pose]] = []
        for guess in guesses:
            pose, count, weight = _match(self._surface[1], old_beams, old_pose, points, guess)
            moved, turned = _difference(pose, guess)
            fits = (
                count >= ENOUGH_POINTS
                and weight >= FITTING_WEIGHT * count
                and moved <= LARGEST_SHIFT_M
                and turned <= LARGEST_TURN_RAD
            )
            tried.append((fits, weight / max(count, 1) - BETTER_WEIGHT * bool(tried), pose))
        fits, _, pose = max(tried, key=lambda match: match[:2])
        return pose if fits else None

    def _nearest(self, pose: Pose) -> Any:
        """Return the index of the reference nearest to a pose, or None if there is no reference."""
        if not self._references:
            return None
        if self._places[0] is not self._references[-1]:  # Each change of the list ends with a new last reference.
            self._places = self._references[-1], np.array([place for _, _, place in self._references])
        return _nearest(self._places[1], pose)


def _difference(a: Pose, b: Pose) -> Tuple[float, float]:
    """Return the distance [m] and the angle [rad] between two poses."""
    return math.hypot(a[0] - b[0], a[1] - b[1]), abs(normalize_angle(a[2] - b[2]))


@kernel
def _nearest(places: Array, pose: Pose) -> int:
    best, nearest = np.inf, 0
    for i in range(places.shape[0]):
        turned = abs(places[i, 2] - pose[2]) % (2.0 * math.pi)
        apart = math.hypot(places[i, 0] - pose[0], places[i, 1] - pose[1]) + min(turned, 2.0 * math.pi - turned)
        if apart < best:
            best, nearest = apart, i
    return nearest


@kernel
def _points(ranges: Array32, beams: Beams) -> Array:
    """Return (k, 3) x, y [m] in the scanner's frame and index of every STRIDE_BEAMS-th beam that has a return."""
    points = np.empty((ranges.shape[0] // STRIDE_BEAMS + 1, 3))
    k = 0
    for i in range(0, ranges.shape[0], STRIDE_BEAMS):
        if not math.isnan(ranges[i]):
            angle = beams[0] + i * beams[1]
            points[k] = ranges[i] * math.cos(angle), ranges[i] * math.sin(angle), float(i)
            k += 1
    return points[:k]


@kernel
def _match(surface: Array, old_beams: Beams, old_pose: Pose, points: Array, guess: Pose) -> Tuple[Pose, int, float]:
    """Return the pose at which points best fit an earlier scan's lines(), the number of matches, and their weight sum.

    Works in the scanner frame of the earlier scan, so that the lines() of that scan can be reused. Overwrites the third
    column of points (k, 3) with the index of the earlier scan's beam towards each point, where the next search starts.
    """
    c, s = math.cos(old_pose[2]), math.sin(old_pose[2])
    dx, dy = guess[0] - old_pose[0], guess[1] - old_pose[1]
    guess_x, guess_y, guess_yaw = c * dx + s * dy, c * dy - s * dx, guess[2] - old_pose[2]
    x, y, yaw = guess_x, guess_y, guess_yaw
    count, weights = 0, 0.0
    for iteration in range(ITERATIONS):
        scale = WIDE_M if iteration < COARSE else NARROW_M
        count, weights = 0, 0.0
        # The initial guess is the prior in the normal equations of the correction (dx, dy, dyaw).
        a00 = a11 = (NOISE_M / SLIP_M) ** 2
        a22 = (NOISE_M / YAW_ERROR_RAD) ** 2
        a01 = a02 = a12 = 0.0
        b0, b1, b2 = a00 * (guess_x - x), a11 * (guess_y - y), a22 * (guess_yaw - yaw)
        turn_c, turn_s = math.cos(yaw), math.sin(yaw)
        for i in range(points.shape[0]):
            ox, oy = turn_c * points[i, 0] - turn_s * points[i, 1], turn_s * points[i, 0] + turn_c * points[i, 1]
            points[i, 2] = _beam_near(surface, old_beams, x + ox, y + oy, points[i, 2])
            k = int(math.floor(points[i, 2]))
            if k < 0 or k + 1 >= surface.shape[0] or math.isnan(surface[k, 2]):
                continue
            share, qx, qy, nx, ny = points[i, 2] - k, surface[k, 0], surface[k, 1], surface[k, 2], surface[k, 3]
            qx, qy = qx + share * (surface[k + 1, 0] - qx), qy + share * (surface[k + 1, 1] - qy)
            distance = nx * (x + ox - qx) + ny * (y + oy - qy)
            weight = 1.0 / (1.0 + (distance / scale) ** 2) ** 2
            lever = ny * ox - nx * oy
            count += 1
            weights += weight
            a00 += weight * nx * nx
            a01 += weight * nx * ny
            a02 += weight * nx * lever
            a11 += weight * ny * ny
            a12 += weight * ny * lever
            a22 += weight * lever * lever
            b0 -= weight * nx * distance
            b1 -= weight * ny * distance
            b2 -= weight * lever * distance
        dx, dy, dyaw = _solve(a00, a01, a02, a11, a12, a22, b0, b1, b2)
        x, y, yaw = x + dx, y + dy, yaw + dyaw
        if iteration >= COARSE and abs(c * dx - s * dy) + abs(s * dx + c * dy) + abs(dyaw) < 1e-5:
            break
    pose = old_pose[0] + c * x - s * y, old_pose[1] + s * x + c * y, old_pose[2] + yaw
    return pose, count, weights


@kernel
def _seen_through(old: Reference, new: Reference) -> Tuple[int, int]:
    """Return the number of points of scan `old` in view of scan `new`, and how many of these are free in `new`."""
    (old_ranges, old_beams, old_pose), (ranges, beams, pose) = old, new
    seen = gone = 0
    for i in range(old_ranges.shape[0]):
        if math.isnan(old_ranges[i]):
            continue
        angle = old_pose[2] + old_beams[0] + i * old_beams[1]
        dx = old_pose[0] + old_ranges[i] * math.cos(angle) - pose[0]
        dy = old_pose[1] + old_ranges[i] * math.sin(angle) - pose[1]
        place = beam_at(beams[0], beams[1], math.atan2(dy, dx) - pose[2])
        j = int(place + 0.5)
        if 0 < j < ranges.shape[0] - 1:
            seen += 1
            gone += min(ranges[j - 1], ranges[j], ranges[j + 1]) > math.sqrt(dx * dx + dy * dy) + WIDE_M
    return seen, gone


@kernel
def lines(ranges: Array32, beams: Beams) -> Array:
    """Return (n, 6), a row per beam: point [m], unit normal of the surface up to the next point, direction of the beam.

    All are in the scanner's frame. The normal is NaN at the edge of a surface, and for a beam without return.
    """
    n = ranges.shape[0]
    surface = np.empty((n, 6))
    for i in range(n):
        angle = beams[0] + i * beams[1]
        c, s = math.cos(angle), math.sin(angle)
        surface[i] = ranges[i] * c, ranges[i] * s, np.nan, np.nan, c, s
    for i in range(n - 1):
        near = abs(ranges[i] * beams[1])  # spacing of neighbouring points of a surface at a right angle to the beam [m]
        if not abs(ranges[i + 1] - ranges[i]) < 4.0 * near:
            continue
        span = min(int(math.ceil(BASE_M / max(near, 1e-6))), 20)
        low, high = i, i + 1
        while low > 0 and i - low < span and abs(ranges[low - 1] - ranges[low]) < 4.0 * near:
            low -= 1
        while high < n - 1 and high - i - 1 < span and abs(ranges[high + 1] - ranges[high]) < 4.0 * near:
            high += 1
        dx, dy = surface[high, 0] - surface[low, 0], surface[high, 1] - surface[low, 1]
        length = math.sqrt(dx * dx + dy * dy)
        if length >= 1e-6:
            surface[i, 2], surface[i, 3] = -dy / length, dx / length
    return surface


@kernel
def _beam_near(surface: Array, beams: Beams, x: float, y: float, last: float) -> float:
    """Return the fractional index of the beam towards the point x, y [m] in the scanner's frame, starting at `last`.

    Agrees with beam_at(), which is slower. Each step advances by the angle between the current beam and the point,
    in angle increments. A short series replaces the arc tangent.
    """
    i = int(last)
    for _ in range(3):
        if not 0 <= i < surface.shape[0]:
            break
        c, s = surface[i, 4], surface[i, 5]
        along, across = c * x + s * y, c * y - s * x
        if not abs(across) < 0.1 * along:
            break
        t = across / along
        beyond = t * (1.0 - t * t * (1.0 / 3.0 - t * t * (0.2 - t * t / 7.0))) / beams[1]
        if 0.0 <= beyond < 1.0:
            return float(i + beyond)
        i += int(math.floor(beyond))
    return float(beam_at(beams[0], beams[1], math.atan2(y, x)))


@kernel
def beam_at(angle_min: float, increment: float, bearing: float) -> float:
    """Return the fractional index of the beam towards a bearing [rad]; beyond the last index if there is none."""
    turn = bearing - angle_min if increment > 0.0 else angle_min - bearing
    if -2.0 * math.pi < turn < 0.0:
        turn += 2.0 * math.pi  # The result equals that of the modulo, which is far slower.
    elif not 0.0 <= turn < 2.0 * math.pi:
        turn %= 2.0 * math.pi
    return turn / abs(increment)


@kernel
def _solve(
    a00: float, a01: float, a02: float, a11: float, a12: float, a22: float, b0: float, b1: float, b2: float
) -> Pose:
    """Solve the symmetric, positive definite system a x = b of three unknowns (Cramer's rule)."""
    c00, c01, c02 = a11 * a22 - a12 * a12, a02 * a12 - a01 * a22, a01 * a12 - a02 * a11
    c11, c12, c22 = a00 * a22 - a02 * a02, a01 * a02 - a00 * a12, a00 * a11 - a01 * a01
    determinant = a00 * c00 + a01 * c01 + a02 * c02
    return (
        (c00 * b0 + c01 * b1 + c02 * b2) / determinant,
        (c01 * b0 + c11 * b1 + c12 * b2) / determinant,
        (c02 * b0 + c12 * b1 + c22 * b2) / determinant,
    )
