"""Scripted demonstrator, which replaces the person of APPLD's demonstration in a simulator.

The demonstrator follows the world's reference path by pure pursuit. The path is moved to the middle
of passages, and the speed depends on the clearance. Unlike a planner, the demonstrator knows the
true pose and the map. demonstrate.py records its drives.
"""

from __future__ import annotations

import math
from typing import Any, List

import numpy as np

from applr_ros1.common.angles import Pose, Twist, normalize_angle
from applr_ros1.common.paths import distances, points_at, travelled
from applr_ros1.robots import Robot
from applr_ros1.stack.simulated import CONTROL_PERIOD
from worlds import World
from worlds.world import clearance

NAME = "scripted: pure pursuit along the reference path, speed by clearance"
SPACING = 0.05  # distance between points of the route [m]
WANTED = 0.9  # distance below which obstacles push the route away, for the Jackal [m]
LOOKAHEAD_S = 0.35  # increase of the lookahead distance with the speed [s]
SIDEWAYS = 0.8  # maximum lateral acceleration [m/s^2]
SEARCHED = 40  # points of the route, from the current one on, that can be nearest to the robot
TURN_IN_PLACE = 1.0  # bearing of the target beyond which the robot turns on the spot [rad]
NEAREST_M = 0.2  # smallest distance of the target that an arc is made for [m]
OPEN_M = 10.0  # free distance where the scan shows nothing [m]
TOO_NEAR_M = 0.1  # range of a beam that meets something before its smallest range [m]
ITERATIONS = 300  # number of steps of the elastic band
STRAIGHTEN = 0.25  # share by which a step straightens the band
PUSH = 0.04  # share by which a step pushes the band away from obstacles
SLOPE_M = 0.001  # offset at which the slope of the distance from obstacles is measured [m]


class Demonstrator:
    """Scripted demonstrator of one course; call command() every CONTROL_PERIOD.

    Distances are scaled like the robot's worlds. Speeds and accelerations are limited to those of
    the robot's base.

    Args:
        world: World with the course, at the robot's scale.
        robot: Robot that drives.
    """

    def __init__(self, world: World, robot: Robot):
        base = robot.base
        scale = robot.world_scale
        # Speed in the narrowest passages, and without obstacles nearby [m/s]
        self.slow = min(0.3, 0.5 * base.max_speed)
        self.fast = min(1.2, 0.9 * base.max_speed)
        # Largest free distance at which the speed is `slow`, and smallest at which it is `fast` [m]
        self.narrow = 0.7 * scale
        self.wide = 2.0 * scale
        self.turn = min(1.5, 0.8 * base.max_yaw_rate)  # maximum yaw rate [rad/s]
        # Largest changes of the command per control cycle [m/s, rad/s]
        self.speed_up = min(0.8, base.max_acceleration) * CONTROL_PERIOD
        self.slow_down = min(1.6, base.max_acceleration) * CONTROL_PERIOD
        self.turn_change = min(6.0, base.max_yaw_acceleration) * CONTROL_PERIOD
        self.lookahead = 0.45 * scale  # lookahead distance at standstill [m]
        self.band = 0.35 * scale  # half the width of the band in which obstacles count as ahead [m]
        # Distance to front and back within which obstacles count as beside the robot [m]
        self.beside = 0.4 * scale
        laser = robot.laser
        angles = np.linspace(laser.first_angle, laser.last_angle, laser.beams)
        self._beams = angles + laser.pose[2]  # bearings [rad]
        self.route = route(world, WANTED * scale)
        self._nearest = 0  # index of the route's point nearest to the robot
        self._v = 0.0
        self._w = 0.0

    def command(self, pose: Pose, ranges: np.ndarray) -> Twist:
        """Return (v, w) [m/s, rad/s] for a true pose in the world's frame and a scan (beams,) [m].

        Pure pursuit: the robot drives along the arc through the target, a point of the route at the
        lookahead distance.
        """
        # Target. The search goes forwards only: the route may pass the same place twice.
        x, y, yaw = pose
        searched_points = self.route[self._nearest : self._nearest + SEARCHED]
        searched_distances = distances(searched_points, np.array([x, y]))
        self._nearest += int(np.argmin(searched_distances))
        lookahead = self.lookahead + LOOKAHEAD_S * self._v
        target = self._nearest + int(lookahead / SPACING)
        last_point = len(self.route) - 1
        target_x, target_y = self.route[min(last_point, target)]
        dx = target_x - x
        dy = target_y - y

        # Arc. A target behind the robot would make it drive a circle that hits something.
        bearing = normalize_angle(math.atan2(dy, dx) - yaw)
        if abs(bearing) > TURN_IN_PLACE:
            return self._smooth(0.0, math.copysign(self.turn, bearing))
        # A target under the robot would make the arc a turn on the spot.
        distance = max(NEAREST_M, math.hypot(dx, dy))
        curvature = 2.0 * math.sin(bearing) / distance

        # Speed by the free space, and low enough for the arc
        free_distance = self._free_distance(ranges, bearing)
        free_share = (free_distance - self.narrow) / (self.wide - self.narrow)
        v = self.slow + (self.fast - self.slow) * _clamped(free_share, 0.0, 1.0)
        bend = abs(curvature)
        if bend > 1e-6:  # On a straight way, neither limit is reached.
            slowest_of_arc = min(math.sqrt(SIDEWAYS / bend), self.turn / bend)
            v = min(v, slowest_of_arc)
        w = _clamped(v * curvature, -self.turn, self.turn)
        return self._smooth(v, w)

    def _free_distance(self, ranges: np.ndarray, bearing: float) -> float:
        """Return the free distance [m] towards a bearing [rad] in a scan (beams,) [m].

        It is the smaller of the free distance ahead, in a band slightly wider than the robot, and
        twice the free distance to the sides.
        """
        measured_ranges = np.asarray(ranges, np.float64)
        lengths = np.nan_to_num(
            measured_ranges,
            nan=OPEN_M,
            posinf=OPEN_M,
            neginf=TOO_NEAR_M,
        )
        angles = self._beams - bearing
        forward = lengths * np.cos(angles)
        lateral = np.abs(lengths * np.sin(angles))
        is_ahead = (lateral < self.band) & (forward > 0.0)
        is_beside = np.abs(forward) < self.beside
        distance_ahead = forward[is_ahead].min(initial=OPEN_M)
        distance_beside = lateral[is_beside].min(initial=0.5 * OPEN_M)
        return float(min(distance_ahead, 2.0 * distance_beside))

    def _smooth(self, v: float, w: float) -> Twist:
        """Return the command after a control cycle towards (v, w), as fast as the limits allow."""
        self._v += _clamped(v - self._v, -self.slow_down, self.speed_up)
        self._w += _clamped(w - self._w, -self.turn_change, self.turn_change)
        return self._v, self._w


def _clamped(value: float, low: float, high: float) -> float:
    return min(high, max(low, value))


def route(world: World, wanted: float = WANTED) -> np.ndarray:
    """Return points (k, 2) [m] every SPACING metres from start to goal.

    The reference path of the course is treated as an elastic band: alternately straightened, and
    pushed away from obstacles nearer than `wanted` [m].
    """
    course = world.course
    path_parts: List[Any] = [course.start[:2], course.path]
    # The paper's goal lies far beyond the finish line: the route then ends a metre past the line.
    last_point = course.path[-1]
    goal_point = course.goal[:2]
    if math.dist(last_point, goal_point) < 3.0:
        path_parts.append(goal_point)
    elif course.finish_y is not None:
        last_x, _ = last_point
        path_parts.append((last_x, course.finish_y + 1.0))

    points = _resampled(np.vstack(path_parts))
    for _ in range(ITERATIONS):
        # Both ends stay where they are: only the view of the points between them changes.
        inner_points = points[1:-1]
        previous_points = points[:-2]
        next_points = points[2:]
        bends = previous_points + next_points - 2.0 * inner_points
        inner_points += STRAIGHTEN * bends
        pushes = _pushes(world, points, wanted)
        inner_points += PUSH * pushes[1:-1]
    return _resampled(points)


def _resampled(points: np.ndarray) -> np.ndarray:
    """Return points (k, 2) every SPACING metres along the path through points (n, 2) [m]."""
    route_length = travelled(points)[-1]
    point_count = max(2, int(route_length / SPACING))
    lengths = np.linspace(0.0, route_length, point_count)
    return points_at(points, lengths)


def _pushes(world: World, points: np.ndarray, wanted: float) -> np.ndarray:
    """Return vectors (k, 2) [m] by which obstacles push points (k, 2) [m] away.

    They point away from the nearest obstacle, along the gradient of the distance, and have the
    length max(0, wanted - distance).
    """

    def room(moved_points: np.ndarray) -> np.ndarray:
        return np.minimum(clearance(world, moved_points), wanted)

    room_there = room(points)
    slopes = [(room(points + offset) - room_there) / SLOPE_M for offset in SLOPE_M * np.eye(2)]
    return np.asarray(np.column_stack(slopes) * (wanted - room_there)[:, None])
