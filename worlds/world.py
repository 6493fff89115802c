"""What a world is: obstacles on a plane, and the course through them. Plain data, nothing is computed here.
Every part reads these classes; `worlds.load` makes them. Frame: BARN's, x to the right, y forward, metres, radians."""
from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Optional, Tuple

import numpy as np

Pose = Tuple[float, float, float]


class WorldError(ValueError):
    """A world cannot be had. One line: what, which value, what to do."""


@dataclass(frozen=True)
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
        """Straight distance to be driven [m]: start to finish line (5.925 in BARN's worlds), else to the goal's circle."""
        if self.finish_y is not None:
            return self.finish_y - self.start[1]
        return max(0.0, math.hypot(self.goal[0] - self.start[0], self.goal[1] - self.start[1]) - self.goal_tolerance)

    def done(self, x: float, y: float) -> bool:
        """Whether a robot at (x, y) has finished."""
        if self.finish_y is not None and y > self.finish_y:
            return True
        return math.hypot(self.goal[0] - x, self.goal[1] - y) <= self.goal_tolerance


@dataclass(frozen=True)
class Mover:
    """A moving cylinder (DynaBARN): at time t its centre is (P(t), Q(t)) with polynomials P and Q.

    radius    [m]
    x, y      coefficients of P and Q, constant term first [m, m/s, m/s^2, ...]
    duration  length of one sweep [s]; after it the cylinder turns round and comes back the same way, and so on.
              0: the polynomial runs on for ever.
    """
    radius: float
    x: Tuple[float, ...]
    y: Tuple[float, ...]
    duration: float = 0.0

    def position(self, t: float) -> Tuple[float, float]:
        """Centre at time t >= 0 [s]: (x, y) [m]."""
        if self.duration > 0.0:
            t = math.fmod(t, 2.0 * self.duration)
            t = 2.0 * self.duration - t if t > self.duration else t
        return _polynomial(self.x, t), _polynomial(self.y, t)


def _polynomial(coefficients: Tuple[float, ...], t: float) -> float:
    value = 0.0
    for c in reversed(coefficients):
        value = value * t + c
    return value


@dataclass(frozen=True)
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
