"""Scripted demonstrator, which replaces the person of APPLD's demonstration in a simulator (demonstrate.py).

The demonstrator follows the world's reference path by pure pursuit. The path is moved to the middle of passages, and
the speed depends on the clearance. Unlike a planner, the demonstrator knows the true pose and the map.
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


class Demonstrator:
    """Scripted demonstrator of one course; call command() every CONTROL_PERIOD.

    Distances are scaled like the robot's worlds. Speeds and accelerations are limited to those of the robot's base.

    Args:
        world: World with the course, at the robot's scale.
        robot: Robot that drives.
    """

    def __init__(self, world: World, robot: Robot):
        base, laser, scale = robot.base, robot.laser, robot.world_scale
        self.slow = min(0.3, 0.5 * base.max_speed)  # speed in the narrowest passages [m/s]
        self.fast = min(1.2, 0.9 * base.max_speed)  # speed without obstacles nearby [m/s]
        self.narrow = 0.7 * scale  # largest free distance at which the speed is `slow` [m]
        self.wide = 2.0 * scale  # smallest free distance at which the speed is `fast` [m]
        self.turn = min(1.5, 0.8 * base.max_yaw_rate)  # maximum yaw rate [rad/s]
        self.gain = min(0.8, base.max_acceleration)  # acceleration [m/s^2]
        self.brake = min(1.6, base.max_acceleration)  # deceleration [m/s^2]
        self.turn_gain = min(6.0, base.max_yaw_acceleration)  # yaw acceleration [rad/s^2]
        self.lookahead = 0.45 * scale  # lookahead distance at standstill [m]
        self.band = 0.35 * scale  # half the width of the band in which obstacles count as ahead [m]
        self.beside = (
            0.4 * scale
        )  # distance to front and back within which obstacles count as beside the robot [m]
        self._beams = (
            np.linspace(laser.first_angle, laser.last_angle, laser.beams) + laser.pose[2]
        )  # bearings [rad]
        self.route = route(world, WANTED * scale)
        self._at = 0
        self._v = self._w = 0.0

    def command(self, pose: Pose, ranges: np.ndarray) -> Tuple[float, float]:
        """Return (v, w) for the true pose (x, y, yaw) in the world's frame and the scan (beams,) [m]."""
        x, y, yaw = pose
        near = np.hypot(*(self.route[self._at : self._at + 40] - (x, y)).T)
        self._at += int(np.argmin(near))
        ahead = self.lookahead + LOOKAHEAD_S * self._v
        target = self.route[min(len(self.route) - 1, self._at + int(ahead / SPACING))]
        bearing = normalize_angle(math.atan2(target[1] - y, target[0] - x) - yaw)
        if abs(bearing) > 1.0:
            return self._smooth(0.0, math.copysign(self.turn, bearing))
        distance = max(0.2, math.hypot(target[0] - x, target[1] - y))
        curvature = 2.0 * math.sin(bearing) / distance
        room = min(
            1.0, max(0.0, (self._room(ranges, bearing) - self.narrow) / (self.wide - self.narrow))
        )
        v = self.slow + (self.fast - self.slow) * room
        if abs(curvature) > 1e-6:
            v = min(v, math.sqrt(SIDEWAYS / abs(curvature)), self.turn / abs(curvature))
        return self._smooth(v, max(-self.turn, min(self.turn, v * curvature)))

    def _room(self, ranges: np.ndarray, bearing: float) -> float:
        """Return the free distance [m] in a scan (beams,).

        It is the smaller of the free distance ahead, in a band slightly wider than the robot, and twice the free
        distance to the sides.
        """
        ranges = np.nan_to_num(np.asarray(ranges, np.float64), nan=10.0, posinf=10.0, neginf=0.1)
        along, across = (
            ranges * np.cos(self._beams - bearing),
            np.abs(ranges * np.sin(self._beams - bearing)),
        )
        front = along[(across < self.band) & (along > 0.0)]
        beside = across[(np.abs(along) < self.beside)]
        return float(
            min(front.min() if len(front) else 10.0, 2.0 * beside.min() if len(beside) else 10.0)
        )

    def _smooth(self, v: float, w: float) -> Tuple[float, float]:
        self._v += min(self.gain * CONTROL_PERIOD, max(-self.brake * CONTROL_PERIOD, v - self._v))
        self._w += min(
            self.turn_gain * CONTROL_PERIOD, max(-self.turn_gain * CONTROL_PERIOD, w - self._w)
        )
        return self._v, self._w


def route(world: World, wanted: float = WANTED) -> np.ndarray:
    """Return points (k, 2) [m] every SPACING metres from start to goal.

    The reference path of the course is treated as an elastic band: alternately straightened, and pushed away from
    obstacles nearer than `wanted` [m].
    """
    course = world.course
    finish = [] if course.finish_y is None else [(course.path[-1][0], course.finish_y + 1.0)]
    ends = [course.goal[:2]] if math.dist(course.path[-1], course.goal[:2]) < 3.0 else finish
    parts: List[Any] = [course.start[:2], course.path, *ends]
    points = _resampled(np.vstack(parts))
    for _ in range(300):
        points[1:-1] += 0.25 * (points[:-2] + points[2:] - 2.0 * points[1:-1])
        away = _away(world, points, wanted)
        points[1:-1] += 0.04 * away[1:-1]
    return _resampled(points)


def _resampled(points: np.ndarray) -> np.ndarray:
    length = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(points, axis=0).T))])
    at = np.linspace(0.0, length[-1], max(2, int(length[-1] / SPACING)))
    return np.column_stack(
        [np.interp(at, length, points[:, 0]), np.interp(at, length, points[:, 1])]
    )


def _away(world: World, points: np.ndarray, wanted: float) -> np.ndarray:
    """Return vectors (k, 2) [m] away from the nearest obstacle, with the length max(0, wanted - distance)."""
    offsets = [points[:, None, :] - world.cylinders[None, :, :2]]
    gaps = [np.hypot(offsets[0][..., 0], offsets[0][..., 1]) - world.cylinders[:, 2]]
    for x, y, yaw, size_x, size_y in world.boxes:
        outside = outside_box(points[:, 0] - x, points[:, 1] - y, yaw, size_x, size_y)
        offsets.append(np.column_stack(transform_point((0.0, 0.0, yaw), *outside))[:, None])
        gaps.append(np.hypot(*outside)[:, None])
    gap = np.hstack(gaps)
    nearest = np.arange(len(points)), np.argmin(gap, axis=1)
    offset = np.hstack(offsets)[nearest]
    norm = np.maximum(np.hypot(*offset.T), 1e-9)[:, None]
    return np.asarray(offset / norm * np.clip(wanted - gap[nearest], 0.0, wanted)[:, None])
