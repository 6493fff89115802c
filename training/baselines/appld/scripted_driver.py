"""Scripted demonstrator, which replaces the person of APPLD's demonstration in a simulator (demonstrate.py).

The demonstrator follows the world's reference path by pure pursuit. The path is moved to the middle of passages, and
the speed depends on the clearance. Unlike a planner, the demonstrator knows the true pose and the map.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Iterator, Tuple

import numpy as np

from applr_ros1.common.angles import Pose, normalize_angle, outside_box, transform_point
from applr_ros1.robots import Robot
from worlds import World

NAME = "scripted: pure pursuit along the reference path, speed by clearance"
PERIOD = 0.05  # interval between two commands [s]
SPACING = 0.05  # distance between points of the route [m]
WANTED = 0.9  # distance below which obstacles push the Jackal's route away [m]


@dataclass(frozen=True)
class Style:
    """Driving style: speeds [m/s, rad/s], accelerations [m/s^2, rad/s^2], distances [m]; defaults for a Jackal."""

    slow: float = 0.30  # speed in the narrowest passages
    fast: float = 1.2  # speed without obstacles nearby
    narrow: float = 0.70  # free distance up to which the speed is `slow`
    wide: float = 2.0  # free distance from which on the speed is `fast`
    turn: float = 1.5  # maximum yaw rate
    sideways: float = 0.8  # maximum lateral acceleration
    gain: float = 0.8  # acceleration
    brake: float = 1.6  # deceleration
    turn_gain: float = 6.0  # yaw acceleration
    lookahead: float = 0.45  # lookahead distance at standstill; grows by .35 s times the speed
    band: float = 0.35  # half the width of the band in which obstacles count as ahead
    beside: float = 0.4  # distance to the front and back within which obstacles count as beside the robot

    @classmethod
    def of(cls, robot: Robot) -> Style:
        """Return the style for a robot: distances scaled like its worlds, the rest limited to what its base can do."""
        own, base, scale = cls(), robot.base, robot.world_scale
        return cls(
            slow=min(own.slow, 0.5 * base.max_speed),
            fast=min(own.fast, 0.9 * base.max_speed),
            narrow=own.narrow * scale,
            wide=own.wide * scale,
            turn=min(own.turn, 0.8 * base.max_yaw_rate),
            gain=min(own.gain, base.max_acceleration),
            brake=min(own.brake, base.max_acceleration),
            turn_gain=min(own.turn_gain, base.max_yaw_acceleration),
            lookahead=own.lookahead * scale,
            band=own.band * scale,
            beside=own.beside * scale,
        )


class Demonstrator:
    """Scripted demonstrator of one course; call command() every PERIOD.

    Args:
        world: World with the course, at the robot's scale.
        robot: Robot that drives.
    """

    def __init__(self, world: World, robot: Robot):
        self.style = Style.of(robot)
        laser = robot.laser
        self._beams = np.linspace(laser.first_angle, laser.last_angle, laser.beams) + laser.pose[2]  # bearings [rad]
        self.route = route(world, WANTED * robot.world_scale)
        self._at = 0
        self._v = self._w = 0.0

    def command(self, pose: Pose, ranges: np.ndarray) -> Tuple[float, float]:
        """Return (v, w) for the true pose (x, y, yaw) in the world's frame and the scan (beams,) [m]."""
        x, y, yaw = pose
        s = self.style
        near = np.hypot(*(self.route[self._at : self._at + 40] - (x, y)).T)
        self._at += int(np.argmin(near))
        ahead = s.lookahead + 0.35 * self._v
        target = self.route[min(len(self.route) - 1, self._at + int(ahead / SPACING))]
        bearing = normalize_angle(math.atan2(target[1] - y, target[0] - x) - yaw)
        if abs(bearing) > 1.0:
            return self._smooth(0.0, math.copysign(s.turn, bearing))
        distance = max(0.2, math.hypot(target[0] - x, target[1] - y))
        curvature = 2.0 * math.sin(bearing) / distance
        room = min(1.0, max(0.0, (self._room(ranges, bearing) - s.narrow) / (s.wide - s.narrow)))
        v = s.slow + (s.fast - s.slow) * room
        if abs(curvature) > 1e-6:
            v = min(v, math.sqrt(s.sideways / abs(curvature)), s.turn / abs(curvature))
        return self._smooth(v, max(-s.turn, min(s.turn, v * curvature)))

    def _room(self, ranges: np.ndarray, bearing: float) -> float:
        """Return the free distance [m] in a scan (beams,): the smaller of two values.

        One is the free distance ahead, in a band slightly wider than the robot. The other is twice the free distance to
        the sides.
        """
        ranges = np.nan_to_num(np.asarray(ranges, np.float64), nan=10.0, posinf=10.0, neginf=0.1)
        along, across = ranges * np.cos(self._beams - bearing), np.abs(ranges * np.sin(self._beams - bearing))
        front = along[(across < self.style.band) & (along > 0.0)]
        beside = across[(np.abs(along) < self.style.beside)]
        return float(min(front.min() if len(front) else 10.0, 2.0 * beside.min() if len(beside) else 10.0))

    def _smooth(self, v: float, w: float) -> Tuple[float, float]:
        s, dt = self.style, PERIOD
        self._v += min(s.gain * dt, max(-s.brake * dt, v - self._v))
        self._w += min(s.turn_gain * dt, max(-s.turn_gain * dt, w - self._w))
        return self._v, self._w


def route(world: World, wanted: float = WANTED) -> np.ndarray:
    """Return points (k, 2) [m] every SPACING metres from start to goal.

    The points form an elastic band along the reference path of the course, which is alternately straightened and pushed
    away from obstacles nearer than `wanted` [m].
    """
    course = world.course
    finish = [] if course.finish_y is None else [(course.path[-1][0], course.finish_y + 1.0)]
    ends = [course.goal[:2]] if math.dist(course.path[-1], course.goal[:2]) < 3.0 else finish
    parts: list = [course.start[:2], course.path, *ends]
    points = _resampled(np.vstack(parts))
    for _ in range(300):
        points[1:-1] += 0.25 * (points[:-2] + points[2:] - 2.0 * points[1:-1])
        away = _away(world, points, wanted)
        points[1:-1] += 0.04 * away[1:-1]
    return _resampled(points)


def _resampled(points: np.ndarray) -> np.ndarray:
    length = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(points, axis=0).T))])
    at = np.linspace(0.0, length[-1], max(2, int(length[-1] / SPACING)))
    return np.column_stack([np.interp(at, length, points[:, 0]), np.interp(at, length, points[:, 1])])


def _away(world: World, points: np.ndarray, wanted: float) -> np.ndarray:
    """Return (k, 2) directions from the nearest obstacle, times the missing part of the wanted distance."""
    distance, direction = np.full(len(points), np.inf), np.zeros((len(points), 2))
    for offset, gap in _offsets(world, points):
        closer = gap < distance
        distance = np.where(closer, gap, distance)
        norm = np.maximum(np.hypot(*offset.T), 1e-9)[:, None]
        direction = np.where(closer[:, None], offset / norm, direction)
    return direction * np.clip(wanted - distance, 0.0, wanted)[:, None]


def _offsets(world: World, points: np.ndarray) -> Iterator[Tuple[np.ndarray, np.ndarray]]:
    """Yield offsets (k, 2) from the nearest point and gaps (k,) [m], for all cylinders together and for each box."""
    if len(world.cylinders):
        offset = points[:, None, :] - world.cylinders[None, :, :2]
        gap = np.hypot(offset[..., 0], offset[..., 1]) - world.cylinders[:, 2]
        nearest = np.argmin(gap, axis=1)
        rows = np.arange(len(points))
        yield offset[rows, nearest], gap[rows, nearest]
    for x, y, yaw, size_x, size_y in world.boxes:
        outside = outside_box(points[:, 0] - x, points[:, 1] - y, yaw, size_x, size_y)
        yield np.column_stack(transform_point((0.0, 0.0, yaw), *outside)), np.hypot(*outside)
