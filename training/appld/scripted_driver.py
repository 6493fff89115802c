"""Scripted demonstrator, which replaces the person of APPLD's demonstration in a simulator.

The demonstrator follows the world's reference path by pure pursuit. The path is moved to the middle
of passages, and the speed depends on the clearance. Unlike a planner, the demonstrator knows the
true pose and the map. demonstrate.py records its drives.
"""

from __future__ import annotations

import math
from typing import Any, List, Tuple

import numpy as np

from applr_ros1.common.angles import Pose, normalize_angle, outside_box, transform_point
from applr_ros1.robots import Robot
from training.env.episode import CONTROL_PERIOD
from worlds import World

NAME = "scripted: pure pursuit along the reference path, speed by clearance"
SPACING = 0.05  # distance between points of the route [m]
WANTED = 0.9  # distance below which obstacles push the route away, for the Jackal [m]
LOOKAHEAD_S = 0.35  # increase of the lookahead distance with the speed [s]
SIDEWAYS = 0.8  # maximum lateral acceleration [m/s^2]
SEARCHED = 40  # points of the route, from the current one on, that can be nearest to the robot
TURN_IN_PLACE = 1.0  # bearing of the target beyond which the robot turns on the spot [rad]
OPEN_M = 10.0  # free distance where the scan shows nothing [m]
ITERATIONS = 300  # number of steps of the elastic band
STRAIGHTEN = 0.25  # share by which a step straightens the band
PUSH = 0.04  # share by which a step pushes the band away from obstacles


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

    def command(self, pose: Pose, ranges: np.ndarray) -> Tuple[float, float]:
        """Return (v, w) [m/s, rad/s] for a true pose in the world's frame and a scan (beams,) [m].

        Pure pursuit: the robot drives along the arc through the target, a point of the route at the
        lookahead distance.
        """
        # Target. The search goes forwards only: the route may pass the same place twice.
        x, y, yaw = pose
        candidates = self.route[self._nearest : self._nearest + SEARCHED] - (x, y)
        distances = np.hypot(candidates[:, 0], candidates[:, 1])
        self._nearest += int(np.argmin(distances))
        lookahead = self.lookahead + LOOKAHEAD_S * self._v
        index = self._nearest + int(lookahead / SPACING)
        target = self.route[min(len(self.route) - 1, index)]
        dx = target[0] - x
        dy = target[1] - y

        # Arc. A target behind the robot would make it drive a circle that hits something.
        bearing = normalize_angle(math.atan2(dy, dx) - yaw)
        if abs(bearing) > TURN_IN_PLACE:
            return self._smooth(0.0, math.copysign(self.turn, bearing))
        distance = max(0.2, math.hypot(dx, dy))
        curvature = 2.0 * math.sin(bearing) / distance

        # Speed by the free space, and low enough for the arc
        beyond_narrow = self._free_distance(ranges, bearing) - self.narrow
        free_share = _clamped(beyond_narrow / (self.wide - self.narrow), 0.0, 1.0)
        v = self.slow + (self.fast - self.slow) * free_share
        bend = abs(curvature)
        if bend > 1e-6:
            v = min(
                v,
                math.sqrt(SIDEWAYS / bend),
                self.turn / bend,
            )
        w = _clamped(v * curvature, -self.turn, self.turn)
        return self._smooth(v, w)

    def _free_distance(self, ranges: np.ndarray, bearing: float) -> float:
        """Return the free distance [m] towards a bearing [rad] in a scan (beams,) [m].

        It is the smaller of the free distance ahead, in a band slightly wider than the robot, and
        twice the free distance to the sides.
        """
        seen = np.nan_to_num(np.asarray(ranges, np.float64), nan=OPEN_M, posinf=OPEN_M, neginf=0.1)
        angles = self._beams - bearing
        along = seen * np.cos(angles)
        across = np.abs(seen * np.sin(angles))
        is_ahead = (across < self.band) & (along > 0.0)
        is_beside = np.abs(along) < self.beside
        ahead = along[is_ahead].min(initial=OPEN_M)
        beside = across[is_beside].min(initial=0.5 * OPEN_M)
        return float(min(ahead, 2.0 * beside))

    def _smooth(self, v: float, w: float) -> Tuple[float, float]:
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
    parts: List[Any] = [course.start[:2], course.path]
    # The paper's goal lies far beyond the finish line: the route then ends a metre past the line.
    last_point = course.path[-1]
    if math.dist(last_point, course.goal[:2]) < 3.0:
        parts.append(course.goal[:2])
    elif course.finish_y is not None:
        parts.append((last_point[0], course.finish_y + 1.0))

    points = _resampled(np.vstack(parts))
    for _ in range(ITERATIONS):
        # Both ends stay where they are.
        inner = points[1:-1]
        inner += STRAIGHTEN * (points[:-2] + points[2:] - 2.0 * inner)
        inner += PUSH * _away(world, points, wanted)[1:-1]
    return _resampled(points)


def _resampled(points: np.ndarray) -> np.ndarray:
    """Return points (k, 2) every SPACING metres along the path through points (n, 2) [m]."""
    steps = np.diff(points, axis=0)
    lengths = np.hypot(steps[:, 0], steps[:, 1])
    travelled = np.concatenate([[0.0], np.cumsum(lengths)])
    places = np.linspace(0.0, travelled[-1], max(2, int(travelled[-1] / SPACING)))
    x = np.interp(places, travelled, points[:, 0])
    y = np.interp(places, travelled, points[:, 1])
    return np.column_stack([x, y])


def _away(world: World, points: np.ndarray, wanted: float) -> np.ndarray:
    """Return vectors (k, 2) [m] by which obstacles push points (k, 2) [m] away.

    They point away from the nearest obstacle and have the length max(0, wanted - distance).
    """
    # From each point's nearest spot on each obstacle: offsets (k, obstacles, 2) and distances
    x, y = points.T
    from_centres = points[:, None, :] - world.cylinders[None, :, :2]
    centre_distances = np.hypot(from_centres[..., 0], from_centres[..., 1])
    offsets = [from_centres]
    distances = [centre_distances - world.cylinders[:, 2]]
    for box_x, box_y, yaw, size_x, size_y in world.boxes:
        along, across = outside_box(x - box_x, y - box_y, yaw, size_x, size_y)
        offset = np.column_stack(transform_point((0.0, 0.0, yaw), along, across))
        offsets.append(offset[:, None])
        distances.append(np.hypot(along, across)[:, None])

    distance = np.hstack(distances)
    nearest = np.arange(len(points)), np.argmin(distance, axis=1)
    offset = np.hstack(offsets)[nearest]
    length = np.hypot(offset[:, 0], offset[:, 1])
    length = np.maximum(length, 1e-9)  # 0 inside a box
    push = np.clip(wanted - distance[nearest], 0.0, wanted)
    return np.asarray(offset / length[:, None] * push[:, None])
