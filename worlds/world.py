"""What a world is: obstacles on a plane, and the course through them.

Plain data, nothing is computed here. Every part reads these classes; `worlds.load` makes them. Frame: BARN's, x to the
right, y forward, metres, radians.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Optional, Tuple

import numpy as np

Pose = Tuple[float, float, float]


class WorldError(ValueError):
    """A world cannot be had. One line: what, which value, what to do."""


@dataclass(frozen=True, eq=False)
class Course:
    """Where a robot starts, where it is sent, and when it is done.

    start, goal      (x, y, yaw) [m, m, rad]
    finish_y         the course is done past this y [m]; None: only near the goal
    goal_tolerance   or within this distance of the goal [m]
    path             (k, 2) float64, a collision-free reference path [m], start's side first
    """

    start: Pose
    goal: Pose
    finish_y: Optional[float]
    goal_tolerance: float
    path: np.ndarray

    @property
    def length_m(self) -> float:
        """Straight distance to drive [m]: start to finish line (5.925 in BARN's worlds), else to the goal's circle."""
        if self.finish_y is not None:
            return self.finish_y - self.start[1]
        return max(0.0, math.hypot(self.goal[0] - self.start[0], self.goal[1] - self.start[1]) - self.goal_tolerance)

    @property
    def route_m(self) -> float:
        """Length of the reference route [m]: start, reference path, then the finish line or the goal.

        BARN's metric takes its optimal time, at 2 m/s, from it.
        """
        path, end = self.path, self.goal[:2]
        if self.finish_y is not None:
            path = path[path[:, 1] < self.finish_y]
            end = (path[-1, 0] if len(path) else self.start[0], self.finish_y)
        points = np.vstack([self.start[:2], path, end])
        return float(np.hypot(*np.diff(points, axis=0).T).sum())

    def done(self, x: float, y: float) -> bool:
        """Whether a robot at (x, y) has finished."""
        if self.finish_y is not None and y > self.finish_y:
            return True
        return math.hypot(self.goal[0] - x, self.goal[1] - y) <= self.goal_tolerance


@dataclass(frozen=True)
class Mover:
    """A moving cylinder (DynaBARN).

    It passes its waypoints at their times, on cubic polynomials between them, and begins anew after the last one, as
    Gazebo's repeated animation does.

    radius     [m]
    waypoints  ((t, x, y), ...) with t rising from 0 [s, m, m]; at least two
    """

    radius: float
    waypoints: Tuple[Tuple[float, float, float], ...]

    def position(self, t: float) -> Tuple[float, float]:
        """Centre at time t >= 0 [s]: (x, y) [m]."""
        points = self.waypoints
        t = math.fmod(t, points[-1][0])
        i = 0
        while i < len(points) - 2 and t >= points[i + 1][0]:
            i += 1
        u = (t - points[i][0]) / (points[i + 1][0] - points[i][0])
        return self._between(i, u, 1), self._between(i, u, 2)

    def _between(self, i: int, u: float, axis: int) -> float:
        """Hermite cubic from waypoint i (u = 0) to i + 1 (u = 1); tangents are half the chord of the neighbours."""
        points, last = self.waypoints, len(self.waypoints) - 1
        a, b = points[i][axis], points[i + 1][axis]
        tangent_a = 0.5 * (b - points[max(i - 1, 0)][axis])
        tangent_b = 0.5 * (points[min(i + 2, last)][axis] - a)
        return (
            a
            + tangent_a * u
            + (3.0 * (b - a) - 2.0 * tangent_a - tangent_b) * u * u
            + (2.0 * (a - b) + tangent_a + tangent_b) * u * u * u
        )


@dataclass(frozen=True, eq=False)
class World:
    """Obstacles and a course.

    name       "generated:7", "physical_course", or a file's stem ("world_7")
    cylinders  (n, 3) float64: x, y, radius [m]
    boxes      (m, 5) float64: x, y, yaw, size_x, size_y [m, rad]; sizes are full side lengths
    movers     moving cylinders
    """

    name: str
    cylinders: np.ndarray
    boxes: np.ndarray
    course: Course
    movers: Tuple[Mover, ...] = field(default=())
