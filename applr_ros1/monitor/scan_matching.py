"""Scan matcher that corrects the odometry when the wheels slip.

CollisionMonitor holds one ScanMatcher. A base that brakes beyond its friction limit slides while
its wheels stand still. Its odometry is then wrong by centimetres, and so are the remembered
obstacles. The next scan reveals the error, because static obstacles seem to have moved. Each scan
is matched to an earlier scan (point to line; Censi, "An ICP variant using a point-to-line metric",
ICRA 2008) from two initial guesses. The first is the odometry's pose. The second extrapolates the
last motion, because a sliding base keeps its speed while its wheels stand or turn backwards. The
second guess is used only if it leads to a clearly better fit. Points that do not fit, such as a
walking person, get a low weight, by a width that follows the scatter of the others. The initial
guess is also a prior. Along a direction that little measures, such as along a bare corridor, the
odometry alone decides, but the walls measure the heading best of all. People are little, too: if
the pose followed them, nobody would seem to move. So a planner may drive in the frame of these
poses. What measures counts by its width in metres, as people are narrow at any distance and for any
laser. A share of the beams would be small for a laser that gets few returns.
"""

import math
from typing import List, NamedTuple, Optional, Tuple

import numpy as np

from applr_ros1.common.angles import Pose, compose, inverse
from applr_ros1.common.arrays import Array, Array32
from applr_ros1.common.kernels import kernel
from applr_ros1.common.scan import LaserScan
from applr_ros1.monitor.rays import ScanRays, beam_at, end_point, rays_of

REACH_M = 8.0  # longest range that is used for matching [m]
# Largest spacing of the beams that are matched to an earlier scan [beams]. It is less for a scanner
# with fewer beams than so many points.
STRIDE_BEAMS = 3
MATCHED_POINTS = 90
# Distance to each side of a point over which the surface normal is estimated [m], and the largest
# number of beams.
BASE_M = 0.02
BASE_BEAMS = 20
# Noise of the ranges makes normals of a short base point anywhere: least base by noise.
BASE_NOISES = 5.0
# Points of neighbouring beams lie on one surface if their ranges differ by less than this
# multiple of their spacing, or of the noise.
STEEPEST = 4.0
# Distance and angle to the nearest reference scan above which a scan is kept.
APART_M = 0.3
APART_RAD = 0.3
REFERENCES_KEPT = 256  # largest number of reference scans
ITERATIONS = 12  # maximum number of iterations of one match
COARSE = 4  # number of first iterations that are coarse
SETTLED = 1e-5  # step below which later iterations end [m, rad]
# Point-to-line distance that gets weight 1/4 [m]: in coarse iterations, and the smallest in later
# ones, where it is a multiple of the standard deviation of the distances.
WIDE_M = 0.1
NARROW_M = 0.02
WIDTH_DEVIATIONS = 2.5
NOISE_M = 0.01  # standard deviation of a point-to-line distance [m]
# Expected errors of the odometry between two scans.
SLIP_M = 0.05
YAW_ERROR_RAD = 0.01
# Largest accepted correction by one scan.
LARGEST_SHIFT_M = 0.15
LARGEST_TURN_RAD = 0.1
# Excess of mean weight above which a match from the extrapolated pose is preferred.
BETTER_WEIGHT = 0.05
LONGEST_S = 0.5  # longest time between two scans over which the motion is extrapolated [s]
# Smallest width of surfaces that measures along an axis (ScanMatch.support) [m]. Two people give
# 0.56 m, alone and beside a wall. Noise of 3 cm at 2 m gives 0.49 m at most along a corridor 4 m
# wide. All scans between the obstacles of worlds of the BARN dataset have more than 0.6 m.
SUPPORT_M = 0.6
# Smallest share of the returns, whatever their distance, that fit in a valid match. A large moving
# obstacle may be all that is near in a hall.
ENOUGH_SHARE = 0.25
FITTING_WEIGHT = 0.5  # smallest mean weight of the matched points of a valid match
ELSEWHERE_SHARE = 0.15  # smallest share of a scan in free space of a scan of another place
SEARCH_STEPS = 3  # number of steps of the search for a beam, before its bearing is computed


class ScanMatch(NamedTuple):
    """Best match of points to an earlier scan.

    pose: of the laser. matches: number of matched points. weight: sum of their weights. support:
    width of the surfaces that measures along the axis along which least does, seen from the laser
    and by weight [m]: 0 before a bare wall. largest_support: width along the axis across [m].
    """

    pose: Pose
    matches: int
    weight: float
    support: float
    largest_support: float

    @property
    def mean_weight(self) -> float:
        """Mean weight of the matched points, 0 without any."""
        return self.weight / max(self.matches, 1)

    @property
    def fits(self) -> bool:
        """Whether most of the matched points lie near the earlier scan's surfaces."""
        return self.mean_weight >= FITTING_WEIGHT


class View(NamedTuple):
    """Evidence of one scan about the surfaces of another, in widths across the beams [m].

    in_view: those in its view. seen_through: of these, those in its free space.
    """

    in_view: float
    seen_through: float

    @property
    def contradicts(self) -> bool:
        """Whether more of the surfaces is seen through than people who come or go."""
        return self.seen_through > max(SUPPORT_M, ELSEWHERE_SHARE * self.in_view)


class ScanMatcher:
    """Corrects odometry poses by a slowly changing transform, which is estimated by scan matching.

    Attributes:
        correction: pose of the odometry's frame in that of the corrected poses.
        support: ScanMatch.support of the latest scan.
        problem: why the latest scan was not matched, "" if it was.
        matched_stamp: stamp of the latest scan that was matched [s], None without one.
        lost: whether the latest scan contradicts the previous scan, for instance because the robot
            was carried or its odometry was reset. The scan must show new obstacles in space that
            was observed free. Obstacles that only vanish, such as a door that opens, do not count.
    """

    def __init__(self) -> None:
        # Caches, each with the object that it was made of: lines() of the scan that was last
        # matched against, and poses of all references.
        self._lines_of: Optional[np.ndarray] = None
        self._lines = np.empty((0, 6))
        self._poses_up_to: Optional[ScanRays] = None
        self._poses = np.empty((0, 3))
        self.clear()

    def clear(self) -> None:
        """Reset the correction and forget all scans.

        Poses stay uncorrected until two scans have arrived.
        """
        self.correction: Pose = (0.0, 0.0, 0.0)
        self.forget_scans()

    def forget_scans(self) -> None:
        """Forget all scans. The correction stays, so that the frame of a planner does not jump."""
        self.lost = False
        self.support = 0.0
        self.problem = "no earlier scan"
        self.matched_stamp: Optional[float] = None
        # Scans have corrected poses, and NaN for the ranges that are not used for matching.
        self._references: List[ScanRays] = []  # reference scans, oldest first
        self._last: Optional[ScanRays] = None  # last scan
        self._last_stamp = 0.0  # its stamp [s]
        self._last_ranges = np.empty(0, np.float32)  # its ranges as measured
        # Forward and leftward speed [m/s] and turn rate [rad/s] of the last motion.
        self._speed: Pose = (0.0, 0.0, 0.0)

    @property
    def report(self) -> str:
        """Whether scans are matched; if not, since when and why."""
        if not self.problem:
            return "on"
        since = ""
        if self.matched_stamp is not None:
            since = f" since the scan of {self.matched_stamp:.2f} s"
        return f"off{since}: {self.problem}"

    def corrected(self, pose: Pose) -> Pose:
        """Return the corrected pose for a pose (x, y, yaw) of the odometry frame [m, rad]."""
        return compose(self.correction, pose)

    def add_scan(self, scan: LaserScan) -> bool:
        """Match a scan in the odometry frame, and update the correction.

        The scan is matched to the nearest reference scan, so that a robot that comes back to a
        place gets the same coordinates. If the scan does not fit, this reference is discarded, and
        the scan is matched to the previous scan. If the robot is lost, all references are
        discarded.

        Returns:
            True if the scan fits an earlier scan. Otherwise the correction does not change.
        """
        measured_ranges = scan.distances
        is_return = np.isfinite(measured_ranges)
        is_used = is_return & (measured_ranges < REACH_M)
        used_ranges = np.where(is_used, measured_ranges, np.float32(np.nan))
        stride = min(max(len(is_used) // MATCHED_POINTS, 1), STRIDE_BEAMS)
        pose = self.corrected(scan.sensor_pose)
        newest_rays = _at(rays_of(scan), pose)._replace(ranges=used_ranges)
        fewest_fitting = ENOUGH_SHARE * is_return.sum() / stride
        guesses = self._guesses(pose, scan.stamp)
        nearest_index = self._nearest(pose)

        self.lost = False
        self.problem = "no earlier scan"
        match: Optional[ScanMatch] = None
        if nearest_index is not None:
            reference = self._references[nearest_index]
            match = self._align(reference, newest_rays, guesses, stride, fewest_fitting)
            if self.problem:
                assert self._last is not None
                del self._references[nearest_index]
                nearest_index = None
                match = self._align(self._last, newest_rays, guesses, stride, fewest_fitting)
            # A scan that fits is no other place, even if it is too small or its pose too far away.
            if not match.fits:
                self.lost = self._is_elsewhere(measured_ranges, newest_rays)
        if self.lost:
            self._references.clear()
        is_matched = not self.problem
        if match is not None and is_matched:
            newest_rays = _at(newest_rays, match.pose)
            self.correction = compose(match.pose, inverse(scan.sensor_pose))
            self.matched_stamp = scan.stamp

        if nearest_index is None or self._is_apart(self._references[nearest_index], newest_rays):
            self._references = [*self._references[1 - REFERENCES_KEPT :], newest_rays]
        self._speed = self._speed_to(newest_rays, scan.stamp)
        self._last = newest_rays
        self._last_stamp = scan.stamp
        self._last_ranges = measured_ranges
        return is_matched

    def _is_apart(self, reference: ScanRays, newest: ScanRays) -> bool:
        """Return whether a scan is far enough from the nearest reference to become one."""
        distance, angle = _difference(_pose_of(reference), _pose_of(newest))
        return distance > APART_M or angle > APART_RAD

    def _speed_to(self, newest: ScanRays, stamp: float) -> Pose:
        """Return the mean speed since the last scan; zeros if it is unknown.

        Components are forward and leftward [m/s], and the turn rate [rad/s].
        """
        if self._last is None or not 0.0 < stamp - self._last_stamp <= LONGEST_S:
            return 0.0, 0.0, 0.0
        interval = stamp - self._last_stamp
        forward, leftward, turn = compose(inverse(_pose_of(self._last)), _pose_of(newest))
        return forward / interval, leftward / interval, turn / interval

    def _is_elsewhere(self, measured: np.ndarray, newest: ScanRays) -> bool:
        """Return whether the scans show different places.

        Much of each then lies in free space of the other.
        """
        assert self._last is not None
        if not _seen_through(newest, self._last._replace(ranges=self._last_ranges)).contradicts:
            return False
        # If little of the last scan is in view, the scan cannot show that it is gone.
        last_view = _seen_through(self._last, newest._replace(ranges=measured))
        return last_view.in_view < SUPPORT_M or last_view.contradicts

    def _guesses(self, pose: Pose, stamp: float) -> List[Pose]:
        """Return the odometry's pose, and the extrapolated pose if it differs."""
        if self._last is None or not 0.0 < stamp - self._last_stamp <= LONGEST_S:
            return [pose]
        interval = stamp - self._last_stamp
        forward, leftward, turn = [speed * interval for speed in self._speed]
        extrapolated_pose = compose(_pose_of(self._last), (forward, leftward, turn))
        distance, _ = _difference(pose, extrapolated_pose)
        if distance > NARROW_M:
            return [pose, extrapolated_pose]
        return [pose]

    def _align(
        self,
        earlier: ScanRays,
        newest: ScanRays,
        guesses: List[Pose],
        stride: int,
        fewest_fitting: float,
    ) -> ScanMatch:
        """Return the best match of a scan to an earlier one, and set `problem`.

        stride: spacing of the beams that are matched [beams]. fewest_fitting: smallest weight of a
        valid match.
        """
        if self._lines_of is not earlier.ranges:
            self._lines_of = earlier.ranges
            self._lines = lines(earlier.ranges, earlier.angle_min, earlier.increment)
        points = _points(newest.ranges, newest.angle_min, newest.increment, stride)
        candidates = []
        for number, guess in enumerate(guesses):
            match = _match(
                self._lines,
                earlier.angle_min,
                earlier.increment,
                _pose_of(earlier),
                points,
                guess,
            )
            # A valid match comes before any other. The odometry's pose, the first guess, wins
            # unless another fits clearly better, and fits nowhere else.
            handicap = 0.0
            if number > 0:
                if match.support < SUPPORT_M:
                    continue
                handicap = BETTER_WEIGHT
            problem = _problem(match, guess, fewest_fitting)
            rank = (not problem, match.mean_weight - handicap)
            candidates.append((rank, problem, match))
        _, self.problem, best_match = max(candidates, key=lambda candidate: candidate[0])
        self.support = best_match.support
        return best_match

    def _nearest(self, pose: Pose) -> Optional[int]:
        """Return the index of the reference nearest to a pose, or None if there is no reference."""
        if not self._references:
            return None
        # Each change of the list ends with a new last reference.
        if self._poses_up_to is not self._references[-1]:
            self._poses_up_to = self._references[-1]
            self._poses = np.array(list(map(_pose_of, self._references)))
        index: int = nearest_pose(self._poses, pose)
        return index


@kernel
def weakest_axis(xx: float, xy: float, yy: float) -> Tuple[float, float, float]:
    """Return the smaller eigenvalue of the matrix (xx, xy; xy, yy), and its unit vector x, y."""
    smallest = 0.5 * (xx + yy) - math.hypot(0.5 * (xx - yy), xy)
    angle = 0.5 * math.atan2(2.0 * xy, xx - yy)
    return smallest, -math.sin(angle), math.cos(angle)


def _pose_of(rays: ScanRays) -> Pose:
    return rays.x, rays.y, rays.yaw


def _at(rays: ScanRays, pose: Pose) -> ScanRays:
    """Return the rays at another pose of the laser."""
    x, y, yaw = pose
    return rays._replace(x=x, y=y, yaw=yaw)


def _difference(first: Pose, second: Pose) -> Tuple[float, float]:
    """Return the distance [m] and the angle [rad] between two poses."""
    x, y, angle = compose(inverse(first), second)
    return math.hypot(x, y), abs(angle)


def _problem(match: ScanMatch, guess: Pose, fewest_fitting: float) -> str:
    """Return why a match is not valid, "" if it is."""
    if match.largest_support < SUPPORT_M:
        return (
            f"surfaces of {match.largest_support:.2f} m fit an earlier scan, "
            f"less than {SUPPORT_M:g} m"
        )
    if match.weight < fewest_fitting:
        return f"less than {ENOUGH_SHARE:.0%} of the returns fit an earlier scan"
    if not match.fits:
        return f"points are farther than {WIDE_M:g} m from the surfaces of an earlier scan"
    distance, angle = _difference(match.pose, guess)
    if distance > LARGEST_SHIFT_M or angle > LARGEST_TURN_RAD:
        return f"it fits an earlier scan {distance:.2f} m and {angle:.2f} rad from the odometry"
    return ""


@kernel
def nearest_pose(poses: Array, pose: Pose) -> int:
    """Return the row of poses (n, 3) that is nearest to a pose, by distance [m] plus angle."""
    x, y, yaw = pose
    smallest = np.inf
    nearest_index = 0
    for index in range(poses.shape[0]):
        distance = math.hypot(poses[index, 0] - x, poses[index, 1] - y)
        # A turn beyond half a turn is a smaller one to the other side.
        angle = abs(poses[index, 2] - yaw) % (2.0 * math.pi)
        angle = min(angle, 2.0 * math.pi - angle)
        difference = distance + angle
        if difference < smallest:
            smallest = difference
            nearest_index = index
    return nearest_index


@kernel
def _points(ranges: Array32, angle_min: float, increment: float, stride: int) -> Array:
    """Return every stride-th beam that has a return, as (k, 4).

    Columns are x, y [m] in the scanner's frame, the index of the beam, and the width across the
    beams for which the point stands [m].
    """
    beam_count = ranges.shape[0]
    points = np.empty((beam_count // stride + 1, 4))
    count = 0
    for beam in range(0, beam_count, stride):
        distance = ranges[beam]
        if not math.isnan(distance):
            angle = angle_min + beam * increment
            points[count, 0] = distance * math.cos(angle)
            points[count, 1] = distance * math.sin(angle)
            points[count, 2] = beam
            points[count, 3] = distance * abs(increment) * stride
            count += 1
    return points[:count]


@kernel
def _match(
    surface: Array,
    angle_min: float,
    increment: float,
    earlier_pose: Pose,
    points: Array,
    guess: Pose,
) -> ScanMatch:
    """Return the pose at which points best fit an earlier scan.

    Each iteration solves the normal equations A (dx, dy, dyaw) = b of the weighted point-to-line
    distances (Gauss and Newton). All are computed in the scanner frame of the earlier scan, so that
    its lines() can be reused.

    Args:
        surface: (n, 6) lines() of the earlier scan.
        angle_min: bearing of the earlier scan's first beam in its laser's frame [rad].
        increment: angle between its beams [rad].
        earlier_pose: pose of the laser at the earlier scan.
        points: (k, 4) points of the new scan. The third column is overwritten with the index of the
            earlier scan's beam towards each point, where the next search starts.
        guess: initial guess of the new scan's pose, which is also a prior.
    """
    # Guess and pose in the frame of the earlier scan.
    frame_x, frame_y, frame_yaw = earlier_pose
    cos_frame = math.cos(frame_yaw)
    sin_frame = math.sin(frame_yaw)
    offset_x = guess[0] - frame_x
    offset_y = guess[1] - frame_y
    guess_x = cos_frame * offset_x + sin_frame * offset_y
    guess_y = cos_frame * offset_y - sin_frame * offset_x
    guess_yaw = guess[2] - frame_yaw
    x = guess_x
    y = guess_y
    yaw = guess_yaw

    # Precision of the prior, which is that of the odometry, in units of that of a distance.
    prior = (NOISE_M / SLIP_M) ** 2
    yaw_prior = (NOISE_M / YAW_ERROR_RAD) ** 2
    scale = WIDE_M
    matches = 0
    weight_sum = 0.0
    support = 0.0
    largest_support = 0.0
    for iteration in range(ITERATIONS):
        matches = 0
        weight_sum = 0.0
        square_sum = 0.0
        width_x = 0.0
        width_xy = 0.0
        width_y = 0.0
        a00 = 0.0
        a01 = 0.0
        a02 = 0.0
        a11 = 0.0
        a12 = 0.0
        a22 = yaw_prior
        b0 = prior * (guess_x - x)
        b1 = prior * (guess_y - y)
        b2 = yaw_prior * (guess_yaw - yaw)
        cos_yaw = math.cos(yaw)
        sin_yaw = math.sin(yaw)
        for i in range(points.shape[0]):
            # The point relative to the laser, and the beam of the earlier scan that points towards
            # it.
            forward = points[i, 0]
            leftward = points[i, 1]
            lever_x = cos_yaw * forward - sin_yaw * leftward
            lever_y = sin_yaw * forward + cos_yaw * leftward
            point_x = x + lever_x
            point_y = y + lever_y
            beam = beam_near(surface, angle_min, increment, point_x, point_y, points[i, 2])
            points[i, 2] = beam
            line_index = int(math.floor(beam))
            is_outside = line_index < 0 or line_index + 1 >= surface.shape[0]
            if is_outside or math.isnan(surface[line_index, 2]):
                continue

            # Signed distance from the line, at the place where the beam meets it.
            line_share = beam - line_index
            normal_x = surface[line_index, 2]
            normal_y = surface[line_index, 3]
            start_x = surface[line_index, 0]
            start_y = surface[line_index, 1]
            line_x = start_x + line_share * (surface[line_index + 1, 0] - start_x)
            line_y = start_y + line_share * (surface[line_index + 1, 1] - start_y)
            distance = normal_x * (point_x - line_x) + normal_y * (point_y - line_y)

            # Weight of Geman and McClure: points far from any line, such as those of a person,
            # hardly count.
            weight = 1.0 / (1.0 + (distance / scale) ** 2) ** 2
            moment = normal_y * lever_x - normal_x * lever_y
            matches += 1
            weight_sum += weight
            square_sum += weight * distance * distance
            weighted_width = weight * points[i, 3]
            width_x += weighted_width * normal_x * normal_x
            width_xy += weighted_width * normal_x * normal_y
            width_y += weighted_width * normal_y * normal_y
            weighted_x = weight * normal_x
            weighted_y = weight * normal_y
            weighted_moment = weight * moment
            a00 += weighted_x * normal_x
            a01 += weighted_x * normal_y
            a02 += weighted_x * moment
            a11 += weighted_y * normal_y
            a12 += weighted_y * moment
            a22 += weighted_moment * moment
            b0 -= weighted_x * distance
            b1 -= weighted_y * distance
            b2 -= weighted_moment * distance

        support, axis_x, axis_y = weakest_axis(width_x, width_xy, width_y)
        largest_support = width_x + width_y - support
        a00 += prior
        a11 += prior
        dx, dy, dyaw = _solve(a00, a01, a02, a11, a12, a22, b0, b1, b2)
        # Along an axis along which little measures, errors of range that move along with the
        # robot would hold the pose, as at normal incidence: there the odometry decides.
        if iteration >= COARSE and support < SUPPORT_M:
            shift = axis_x * (x + dx - guess_x) + axis_y * (y + dy - guess_y)
            dx -= shift * axis_x
            dy -= shift * axis_y
        x += dx
        y += dy
        yaw += dyaw
        if iteration >= COARSE and abs(dx) + abs(dy) + abs(dyaw) < SETTLED:
            break
        if iteration + 1 >= COARSE:
            deviation = math.sqrt(square_sum / max(weight_sum, 1e-9))
            scale = min(max(WIDTH_DEVIATIONS * deviation, NARROW_M), WIDE_M)
    pose_x = frame_x + cos_frame * x - sin_frame * y
    pose_y = frame_y + sin_frame * x + cos_frame * y
    pose = pose_x, pose_y, frame_yaw + yaw
    return ScanMatch(pose, matches, weight_sum, support, largest_support)


@kernel
def _seen_through(old: ScanRays, new: ScanRays) -> View:
    """Return how much of `old` is in view of `new`, and how much is free there."""
    in_view = 0.0
    seen_through = 0.0
    last_beam = new.ranges.shape[0] - 1
    for old_beam in range(old.ranges.shape[0]):
        if math.isnan(old.ranges[old_beam]):
            continue
        x, y = end_point(old, old_beam)
        offset_x = x - new.x
        offset_y = y - new.y
        bearing = math.atan2(offset_y, offset_x) - new.yaw
        fractional_beam = beam_at(new.angle_min, new.increment, bearing)
        beam = int(fractional_beam + 0.5)
        if 0 < beam < last_beam:
            width = old.ranges[old_beam] * abs(old.increment)
            in_view += width
            # The point is free if the beams around it reach clearly beyond it.
            shortest = min(new.ranges[beam - 1], new.ranges[beam], new.ranges[beam + 1])
            distance = math.sqrt(offset_x * offset_x + offset_y * offset_y)
            if shortest > distance + WIDE_M:
                seen_through += width
    return View(in_view, seen_through)


@kernel
def lines(ranges: Array32, angle_min: float, increment: float) -> Array:
    """Return the surfaces that a scan shows, in the scanner's frame.

    Returns:
        (n, 6), a row per beam: point x, y [m], unit normal x, y of the surface up to the next
        point, direction x, y of the beam. The normal is NaN at the edge of a surface, and for a
        beam without return.
    """
    beam_count = ranges.shape[0]
    noise = noise_of(ranges)
    base = max(BASE_M, BASE_NOISES * noise)
    surface = np.empty((beam_count, 6))
    for beam in range(beam_count):
        angle = angle_min + beam * increment
        cos_angle = math.cos(angle)
        sin_angle = math.sin(angle)
        distance = ranges[beam]
        x = distance * cos_angle
        y = distance * sin_angle
        surface[beam] = x, y, np.nan, np.nan, cos_angle, sin_angle

    for beam in range(beam_count - 1):
        # Spacing of neighbouring points of a surface at a right angle to the beam [m].
        spacing = abs(ranges[beam] * increment)
        largest_step = STEEPEST * max(spacing, noise)
        # The comparison is false for NaN.
        if not abs(ranges[beam + 1] - ranges[beam]) < largest_step:
            continue

        # The normal is that of a line over neighbours to both sides, because one spacing is shorter
        # than the noise.
        beam_span = min(int(math.ceil(base / max(spacing, 1e-6))), BASE_BEAMS)
        first_beam = beam
        last_beam = beam + 1
        while (
            first_beam > 0
            and beam - first_beam < beam_span
            and abs(ranges[first_beam - 1] - ranges[first_beam]) < largest_step
        ):
            first_beam -= 1
        while (
            last_beam < beam_count - 1
            and last_beam - beam - 1 < beam_span
            and abs(ranges[last_beam + 1] - ranges[last_beam]) < largest_step
        ):
            last_beam += 1
        offset_x = surface[last_beam, 0] - surface[first_beam, 0]
        offset_y = surface[last_beam, 1] - surface[first_beam, 1]
        base_length = math.sqrt(offset_x * offset_x + offset_y * offset_y)
        if base_length >= 1e-6:
            surface[beam, 2] = -offset_y / base_length
            surface[beam, 3] = offset_x / base_length
    return surface


@kernel
def noise_of(ranges: Array32) -> float:
    """Return the standard deviation of a scan's ranges about a smooth surface [m].

    Second differences of neighbouring ranges show it; edges and curved surfaces hardly count in
    their median. It is 0 if no three neighbours have returns.
    """
    bends = np.abs(ranges[2:] - 2.0 * ranges[1:-1] + ranges[:-2])
    bends = bends[np.isfinite(bends)]
    if not len(bends):
        return 0.0
    # A second difference has the variance 1 + 4 + 1, and the median of a normal distribution's
    # absolute values is .67 of its standard deviation.
    return float(np.median(bends) / (0.67 * math.sqrt(6.0)))


@kernel
def beam_near(
    surface: Array, angle_min: float, increment: float, x: float, y: float, start: float
) -> float:
    """Return the fractional index of the beam towards the point x, y [m] in the scanner's frame.

    Agrees with beam_at(), which is slower. The search begins at the beam `start`. Each step
    advances by the angle between the current beam and the point, in angle increments. A short
    series replaces the arc tangent.
    """
    beam = int(start)
    for _ in range(SEARCH_STEPS):
        if not 0 <= beam < surface.shape[0]:
            break
        cos_beam = surface[beam, 4]
        sin_beam = surface[beam, 5]
        x_along_beam = cos_beam * x + sin_beam * y
        y_across_beam = cos_beam * y - sin_beam * x
        # Below .1 rad the error of the series is at most .1^9 / 9 = 1e-10 rad.
        if not abs(y_across_beam) < 0.1 * x_along_beam:
            break
        ratio = y_across_beam / x_along_beam
        square = ratio * ratio
        angle = ratio * (1.0 - square * (1.0 / 3.0 - square * (0.2 - square / 7.0)))
        beams_beyond = angle / increment
        if 0.0 <= beams_beyond < 1.0:
            return float(beam + beams_beyond)
        beam += int(math.floor(beams_beyond))
    return float(beam_at(angle_min, increment, math.atan2(y, x)))


@kernel
def _solve(
    a00: float,
    a01: float,
    a02: float,
    a11: float,
    a12: float,
    a22: float,
    b0: float,
    b1: float,
    b2: float,
) -> Tuple[float, float, float]:
    """Solve the symmetric, positive definite system a x = b of three unknowns (Cramer's rule)."""
    cofactor00 = a11 * a22 - a12 * a12
    cofactor01 = a02 * a12 - a01 * a22
    cofactor02 = a01 * a12 - a02 * a11
    cofactor11 = a00 * a22 - a02 * a02
    cofactor12 = a01 * a02 - a00 * a12
    cofactor22 = a00 * a11 - a01 * a01
    determinant = a00 * cofactor00 + a01 * cofactor01 + a02 * cofactor02
    x0 = (cofactor00 * b0 + cofactor01 * b1 + cofactor02 * b2) / determinant
    x1 = (cofactor01 * b0 + cofactor11 * b1 + cofactor12 * b2) / determinant
    x2 = (cofactor02 * b0 + cofactor12 * b1 + cofactor22 * b2) / determinant
    return x0, x1, x2
