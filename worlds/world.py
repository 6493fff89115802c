"""What a world is: obstacles on a plane, and the course through them.

Plain data, nothing is computed here. Every part reads these classes; `worlds.load` makes them. Frame: BARN's, x to the
right, y forward, metres, radians.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Optional, Tuple

import numpy as np

from applr_ros1.common.errors import ApplrError

from .mover import Mover

Pose = Tuple[float, float, float]

MAP_REACH = 19.7  # [m]; the planners' global maps reach 20 m from the start, and their outermost cells are shut


class WorldError(ApplrError):
    """A world cannot be read or made. One line: what, which value, what to do."""


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

    @property
    def sent_goal(self) -> Pose:
        """The goal that a planner is sent: `goal`, drawn straight back towards the start until it lies on the map."""
        dx, dy = self.goal[0] - self.start[0], self.goal[1] - self.start[1]
        beyond = max(abs(dx), abs(dy)) / MAP_REACH
        if beyond <= 1.0:
            return self.goal
        return self.start[0] + dx / beyond, self.start[1] + dy / beyond, self.goal[2]

    def done(self, x: float, y: float) -> bool:
        """Whether a robot at (x, y) has finished."""
        if self.finish_y is not None and y > self.finish_y:
            return True
        return math.hypot(self.goal[0] - x, self.goal[1] - y) <= self.goal_tolerance


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
