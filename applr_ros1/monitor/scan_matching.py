"""Pose of the robot by what the scanner shows, where the wheels have slipped. CollisionMonitor holds one ScanMatcher.

A base that brakes harder than its tyres hold slides on while its wheels stand: its odometry is then wrong by
centimetres, and whatever the monitor remembers behind it by as much. The difference shows in the next scan, because
what stood still seems to have moved. Each scan is laid over an earlier one (point to line; Censi, "An ICP variant using
a point-to-line metric", ICRA 2008), beginning at the odometry's pose, and once more where the base would be had it gone
on as between the last two scans: a base that slides keeps its speed while its wheels stand or turn backwards. The
latter counts where it fits clearly better. What does not fit, such as a walking person, has little weight, and where
scans do not tell a direction, as along a bare corridor, the odometry stands.
"""

import math

import numpy as np

from applr_ros1.common.angles import compose, inverse, normalize_angle
from applr_ros1.common.kernels import kernel

REACH_M = 8.0  # [m]: farther beams are not used
STRIDE_BEAMS = 3  # every third beam is laid over the earlier scan
BASE_M = 0.02  # [m]: a surface's direction is taken from its points so far to both sides
APART_M_RAD = 0.15, 0.3  # [m, rad]: a scan that is farther from every reference becomes one more of them
REFERENCES_KEPT = 256  # references
ITERATIONS, COARSE = 12, 4
WIDE_M, NARROW_M = 0.1, 0.02  # [m]: a point so far from its line counts a quarter, in the coarse and later iterations
NOISE_M = 0.01  # [m]: of a distance between a point and its line
SLIP_M, YAW_ERROR_RAD = 0.05, 0.01  # [m, rad]: errors of the odometry that are expected between two scans
LARGEST_SHIFT_M, LARGEST_TURN_RAD = 0.15, 0.1  # [m, rad]: a larger correction at once is rejected
BETTER_WEIGHT = 0.05  # by so much the mean weight of a match that does not begin at the odometry's pose must be better
LONGEST_S = 0.5  # [s]: over more between two scans nothing goes on as before
ENOUGH_POINTS = 20  # points that must have found a line ...
FITTING_WEIGHT = 0.5  # ... and the mean weight that they must have then
ELSEWHERE_SHARE = 0.15  # share of a scan's points that the other, which does not fit, must see through, both ways


class ScanMatcher:
    """Corrects poses of the odometry frame by a slowly changing transform, found from scans.

    Attributes:
        lost: whether the newest scan contradicts the one before: the robot, or its odometry, was set to another place.
            What has gone, such as a door that opens, does not make it so: the newest scan has to show something in
            space that was seen free, too.
    """

    def __init__(self):
        self._surface = None, np.empty((0, 6))  # ranges of the scan over which one was laid last, and its lines()
        self._places = None, np.empty((0, 3))  # the newest reference, and the poses of all
        self.clear()

    def clear(self):
        """Begins anew: poses are the odometry's until two scans have come."""
        self.correction = (0.0, 0.0, 0.0)
        self._references = []  # (ranges, beams, corrected pose) of scans all along the way
        self.lost = False
        self._last = None  # stamp [s], corrected pose, and (ranges, beams, corrected pose) of the newest scan
        self._measured = None  # the ranges of the newest scan as they came
        self._speed = (0.0, 0.0, 0.0)  # from the last two: forwards, to the left [m/s], turning [rad/s]

    def corrected(self, pose):
        """Return the pose (x, y, yaw) of the odometry frame as the scans have it [m, rad]."""
        return compose(self.correction, pose)

    def add_scan(self, scan):
        """Takes a scan (common.scan.LaserScan in the odometry frame) and corrects the transform.

        It is laid over the nearest of the earlier ones, so that the robot comes back to a place where it left it, and
        where it does not fit there over the one before. A scan that makes it `lost` is the first of new ones.

        Returns:
            Whether the scan fits onto an earlier one; without that the transform stays as it was.
        """
        pose = self.corrected(scan.sensor_pose)
        measured = np.asarray(scan.ranges, dtype=np.float32)
        ranges = np.where(
            (measured >= scan.range_min) & (measured < min(scan.range_max, REACH_M)), measured, np.float32(np.nan)
        )
        beams = float(scan.angle_min), float(scan.angle_increment)
        nearest = self._nearest(pose)
        guesses = self._guesses(pose, scan.stamp)
        found, self.lost = None, False
        if nearest is not None:
            found = self._lay_over(self._references[nearest], ranges, beams, guesses)
            if found is None:
                del self._references[nearest]
                nearest = None
                found = self._lay_over(self._last[2], ranges, beams, guesses)
                self.lost = found is None and self._is_elsewhere(measured, (ranges, beams, pose))
        if self.lost:
            self._references.clear()
        if found is not None:
            pose = found
            self.correction = compose(pose, inverse(scan.sensor_pose))
        newest = ranges, beams, pose
        self._measured = measured
        apart = (math.inf, 0.0) if nearest is None else _difference(self._references[nearest][2], pose)
        if any(value > limit for value, limit in zip(apart, APART_M_RAD)):
            self._references = [*self._references[1 - REFERENCES_KEPT :], newest]
        self._speed = (0.0, 0.0, 0.0)
        if self._last is not None and 0.0 < scan.stamp - self._last[0] <= LONGEST_S:
            since = scan.stamp - self._last[0]
            self._speed = tuple(value / since for value in compose(inverse(self._last[1]), pose))
        self._last = scan.stamp, pose, newest
        return found is not None

    def _is_elsewhere(self, measured, newest):
        """Return whether a scan and the last one see through each other's points, or the last one had next to none."""
        last = self._last[2]
        shown, appeared = _seen_through(*newest, self._measured, *last[1:])
        seen, gone = _seen_through(*last, measured, *newest[1:])
        came = shown >= ENOUGH_POINTS and appeared > ELSEWHERE_SHARE * shown
        return came and (seen < ENOUGH_POINTS or gone > ELSEWHERE_SHARE * seen)

    def _guesses(self, pose, stamp):
        """[pose, and where the base would be had it gone on as between the last two scans, if that is elsewhere]."""
        if self._last is None or not 0.0 < stamp - self._last[0] <= LONGEST_S:
            return [pose]
        gone_on = compose(self._last[1], tuple(speed * (stamp - self._last[0]) for speed in self._speed))
        return [pose, gone_on] if _difference(pose, gone_on)[0] > NARROW_M else [pose]

    def _lay_over(self, earlier, ranges, beams, guesses):
        """Return the pose at which a scan fits onto an earlier one, or None."""
        old, old_beams, old_pose = earlier
        if self._surface[0] is not old:
            self._surface = old, lines(old, old_beams)
        points, tried = _points(ranges, beams), []
        for guess in guesses:
            pose, found, weight = _match(self._surface[1], old_beams, old_pose, points, guess)
            moved, turned = _difference(pose, guess)
            fits = (
                found >= ENOUGH_POINTS
                and weight >= FITTING_WEIGHT * found
                and moved <= LARGEST_SHIFT_M
                and turned <= LARGEST_TURN_RAD
            )
            tried.append((fits, weight / max(found, 1) - BETTER_WEIGHT * bool(tried), pose))
        fits, _, pose = max(tried, key=lambda match: match[:2])
        return pose if fits else None

    def _nearest(self, pose):
        """Return the number of the reference nearest to a pose; None without any."""
        if not self._references:
            return None
        if self._places[0] is not self._references[-1]:  # one that goes makes room for the newest
            self._places = self._references[-1], np.array([place for _, _, place in self._references])
        return _nearest(self._places[1], pose)


def _difference(a, b):
    """Return distance [m] and angle [rad] between two poses."""
    return math.hypot(a[0] - b[0], a[1] - b[1]), abs(normalize_angle(a[2] - b[2]))


@kernel
def _nearest(places, pose):
    best, nearest = np.inf, 0
    for i in range(places.shape[0]):
        turned = abs(places[i, 2] - pose[2]) % (2.0 * math.pi)
        apart = math.hypot(places[i, 0] - pose[0], places[i, 1] - pose[1]) + min(turned, 2.0 * math.pi - turned)
        if apart < best:
            best, nearest = apart, i
    return nearest


@kernel
def _points(ranges, beams):
    """Return (k, 3) x, y [m] in the scanner's frame of every STRIDE_BEAMS-th beam that has a return, and its number."""
    points = np.empty((ranges.shape[0] // STRIDE_BEAMS + 1, 3))
    k = 0
    for i in range(0, ranges.shape[0], STRIDE_BEAMS):
        if not math.isnan(ranges[i]):
            angle = beams[0] + i * beams[1]
            points[k] = ranges[i] * math.cos(angle), ranges[i] * math.sin(angle), float(i)
            k += 1
    return points[:k]


@kernel
def _match(surface, old_beams, old_pose, points, guess):
    """Return the pose (x, y, yaw) at which points lie best on an earlier scan's lines(), their number, sum of weights.

    All is reckoned in the frame of that scan's scanner, where its lines were found once and for all. points (k, 3):
    see _points(); of each the earlier scan's beam that points to it is noted for the next time.
    """
    c, s = math.cos(old_pose[2]), math.sin(old_pose[2])
    dx, dy = guess[0] - old_pose[0], guess[1] - old_pose[1]
    guess_x, guess_y, guess_yaw = c * dx + s * dy, c * dy - s * dx, guess[2] - old_pose[2]
    x, y, yaw = guess_x, guess_y, guess_yaw
    found, weights = 0, 0.0
    for iteration in range(ITERATIONS):
        scale = WIDE_M if iteration < COARSE else NARROW_M
        found, weights = 0, 0.0
        # normal equations of the correction (dx, dy, dyaw), with the odometry's pose as prior
        a00 = a11 = (NOISE_M / SLIP_M) ** 2
        a22 = (NOISE_M / YAW_ERROR_RAD) ** 2
        a01 = a02 = a12 = 0.0
        b0, b1, b2 = a00 * (guess_x - x), a11 * (guess_y - y), a22 * (guess_yaw - yaw)
        turn_c, turn_s = math.cos(yaw), math.sin(yaw)
        for i in range(points.shape[0]):
            ox, oy = turn_c * points[i, 0] - turn_s * points[i, 1], turn_s * points[i, 0] + turn_c * points[i, 1]
            points[i, 2] = _beam_near(surface, old_beams, x + ox, y + oy, points[i, 2])
            hit, qx, qy, nx, ny = _line(surface, points[i, 2])
            if not hit:
                continue
            distance = nx * (x + ox - qx) + ny * (y + oy - qy)
            weight = 1.0 / (1.0 + (distance / scale) ** 2) ** 2
            lever = ny * ox - nx * oy
            found += 1
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
    return pose, found, weights


@kernel
def _seen_through(old, old_beams, old_pose, new, beams, pose):
    """Return how many points of one scan (old) lie in another's field of view, and how many of them it sees through."""
    seen = gone = 0
    for i in range(old.shape[0]):
        if math.isnan(old[i]):
            continue
        angle = old_pose[2] + old_beams[0] + i * old_beams[1]
        dx = old_pose[0] + old[i] * math.cos(angle) - pose[0]
        dy = old_pose[1] + old[i] * math.sin(angle) - pose[1]
        place = beam_at(beams[0], beams[1], math.atan2(dy, dx) - pose[2])
        j = int(place + 0.5)
        if 0 < j < new.shape[0] - 1:
            seen += 1
            gone += min(new[j - 1], new[j], new[j + 1]) > math.sqrt(dx * dx + dy * dy) + WIDE_M
    return seen, gone


@kernel
def lines(ranges, beams):
    """Return (n, 6) of a scan: each beam's point [m], unit normal of the surface to the next one's, and direction.

    In the scanner's frame. The normal is NaN where there is no surface: at an edge, and where a beam has no return.
    """
    n = ranges.shape[0]
    surface = np.empty((n, 6))
    for i in range(n):
        angle = beams[0] + i * beams[1]
        c, s = math.cos(angle), math.sin(angle)
        surface[i] = ranges[i] * c, ranges[i] * s, np.nan, np.nan, c, s
    for i in range(n - 1):
        near = abs(ranges[i] * beams[1])  # between neighbouring points of a surface that is seen squarely
        if not abs(ranges[i + 1] - ranges[i]) < 4.0 * near:
            continue
        span = min(int(math.ceil(BASE_M / max(near, 1e-6))), 20)
        low, high = i, i + 1
        while low > 0 and i - low < span and abs(ranges[low - 1] - ranges[low]) < 4.0 * near:  # not across an edge
            low -= 1
        while high < n - 1 and high - i - 1 < span and abs(ranges[high + 1] - ranges[high]) < 4.0 * near:
            high += 1
        dx, dy = surface[high, 0] - surface[low, 0], surface[high, 1] - surface[low, 1]
        length = math.sqrt(dx * dx + dy * dy)
        if length >= 1e-6:
            surface[i, 2], surface[i, 3] = -dy / length, dx / length
    return surface


@kernel
def _line(surface, place):
    """Return the surface in the direction of a beam with a fraction: (hit, point on it, unit normal)."""
    i = int(math.floor(place))
    if i < 0 or i + 1 >= surface.shape[0] or math.isnan(surface[i, 2]):
        return False, 0.0, 0.0, 0.0, 0.0
    share = place - i
    qx, qy, px, py = surface[i, 0], surface[i, 1], surface[i + 1, 0], surface[i + 1, 1]
    return True, qx + share * (px - qx), qy + share * (py - qy), surface[i, 2], surface[i, 3]


@kernel
def _beam_near(surface, beams, x, y, last):
    """Return beam_at of the point x, y [m] in the scanner's frame, faster where it was near the beam `last`.

    From beam to beam by the angle between a beam and the point, whose arc tangent is a short series.
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
            return i + beyond
        i += int(math.floor(beyond))
    return beam_at(beams[0], beams[1], math.atan2(y, x))


@kernel
def beam_at(angle_min, increment, bearing):
    """Return the index, with a fraction, of the beam that points to a bearing [rad]; past the scan's end for none."""
    turn = bearing - angle_min if increment > 0.0 else angle_min - bearing
    if -2.0 * math.pi < turn < 0.0:
        turn += 2.0 * math.pi  # what % gives there, which takes far longer
    elif not 0.0 <= turn < 2.0 * math.pi:
        turn %= 2.0 * math.pi
    return turn / abs(increment)


@kernel
def _solve(a00, a01, a02, a11, a12, a22, b0, b1, b2):
    """Solve the symmetric, positive definite system a x = b of three unknowns (Cramer's rule)."""
    c00, c01, c02 = a11 * a22 - a12 * a12, a02 * a12 - a01 * a22, a01 * a12 - a02 * a11
    c11, c12, c22 = a00 * a22 - a02 * a02, a01 * a02 - a00 * a12, a00 * a11 - a01 * a01
    determinant = a00 * c00 + a01 * c01 + a02 * c02
    return (
        (c00 * b0 + c01 * b1 + c02 * b2) / determinant,
        (c01 * b0 + c11 * b1 + c12 * b2) / determinant,
        (c02 * b0 + c12 * b1 + c22 * b2) / determinant,
    )
