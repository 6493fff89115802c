"""A world: obstacles on a plane, standing or moving, and the course through them.

Plain data; only where a moving obstacle is at any time is computed, as Gazebo interpolates a PoseAnimation's key
frames. Every part reads these classes; `worlds.load` makes them. Frame: BARN's, x to the right, y forward, metres,
radians.
"""

from __future__ import annotations

import math
from bisect import bisect_left
from dataclasses import dataclass
from functools import cached_property
from typing import List, Optional, Tuple

import numpy as np

from applr_ros1.common.angles import outside_box
from applr_ros1.common.errors import ApplrError

KeyFrame = Tuple[float, float, float]
Point = Tuple[float, float]

SAME_POINT_M = 1e-3  # [m]; ignition::math::Vector3 compares with this tolerance


@dataclass(frozen=True)
class Mover:
    """A cylinder that moves as a Gazebo model with a PoseAnimation does (DynaBARN's obstacles).

    It passes its key frames at their times. Between two of them it follows ignition::math::Spline with tension 0
    (Catmull-Rom tangents, half the neighbours' chord; at the ends half the only chord; where the last point equals the
    first the curve is closed). Before the first key frame and after the last one it stands there.

    radius     [m]
    waypoints  the key frames, ((t, x, y), ...) with times that never fall, from 0 on [s, m, m]; at least two
    length     duration of the animation [s]; 0: the time of the last key frame
    repeat     whether the animation starts again after `length` seconds; otherwise the cylinder stays at its end
    """

    radius: float
    waypoints: Tuple[KeyFrame, ...]
    length: float = 0.0
    repeat: bool = True

    def __post_init__(self) -> None:
        if not self.length:
            object.__setattr__(self, "length", self.waypoints[-1][0])

    @cached_property
    def _curve(self) -> Tuple[List[float], List[Point]]:
        """Times and tangents of the key frames."""
        return [t for t, _, _ in self.waypoints], _tangents([(x, y) for _, x, y in self.waypoints])

    def position(self, t: float) -> Point:
        """Centre at time t >= 0 [s]: (x, y) [m]. Steps as in gazebo::common::Animation::GetKeyFramesAtTime."""
        t = math.fmod(t, self.length) if self.repeat else min(t, self.length)
        (times, tangents), points = self._curve, self.waypoints
        second = bisect_left(times, t)
        if second == len(times):
            return points[-1][1:]
        if second == 0 or times[second] == t:
            return points[second][1:]
        first = second - 1
        u = (t - times[first]) / (times[second] - times[first])
        return (
            _hermite(points[first][1], points[second][1], tangents[first][0], tangents[second][0], u),
            _hermite(points[first][2], points[second][2], tangents[first][1], tangents[second][1], u),
        )


def _tangents(points: List[Point]) -> List[Point]:
    """Tangents at all points, as ignition::math::Spline::RecalcTangents computes them with tension 0."""
    last = len(points) - 1
    closed = all(abs(a - b) <= SAME_POINT_M for a, b in zip(points[0], points[last]))
    before = [points[last - 1] if closed else points[0]] + points[:last]
    after = points[1:] + [points[1] if closed else points[last]]
    return [(0.5 * (b[0] - a[0]), 0.5 * (b[1] - a[1])) for a, b in zip(before, after)]


def _hermite(a: float, b: float, tangent_a: float, tangent_b: float, u: float) -> float:
    """The cubic from a (u = 0) to b (u = 1) with the given end tangents, one coordinate."""
    return (
        a
        + tangent_a * u
        + (3.0 * (b - a) - 2.0 * tangent_a - tangent_b) * u * u
        + (2.0 * (a - b) + tangent_a + tangent_b) * u * u * u
    )


Pose = Tuple[float, float, float]

ODOMETRY_OFF_M, ODOMETRY_OFF_SHARE = 0.5, 0.08  # [m], of the route; in Gazebo .55 m on 10 m, here 1.3 m on 20 m
MAP_REACH_M = 19.7  # [m]; the planners' global maps reach 20 m from the start, and their outermost cells are shut


class WorldError(ApplrError):
    """A world cannot be read or made. One line: what, which value, what to do."""


@dataclass(frozen=True, eq=False)
class Course:
    """A drive through a world: its start, its goal, and its end.

    start, goal      (x, y, yaw) [m, m, rad]
    finish_y         the course is done past this y [m]; None: only near the goal
    goal_tolerance   or within this distance of the goal [m]
    path             (k, 2) float64, a collision-free reference path [m], start's side first
    planner_ends     it has no finish of its own: it is done, too, where the planner calls its goal reached
    """

    start: Pose
    goal: Pose
    finish_y: Optional[float]
    goal_tolerance: float
    path: np.ndarray
    planner_ends: bool = False

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
        beyond = max(abs(dx), abs(dy)) / MAP_REACH_M
        if beyond <= 1.0:
            return self.goal
        return self.start[0] + dx / beyond, self.start[1] + dy / beyond, self.goal[2]

    def arrived(self, x: float, y: float, called_within: Optional[float] = None) -> bool:
        """Return true if a robot whose true place is (x, y) has arrived: wherever success is decided, it is by this.

        - The finish line: the paper's in BARN's worlds (y = 10); on the physical course, of which the paper says no
          more than that it is driven from end to end, the line and the circle are ours.
        - The circle about the goal: the BARN Challenge's of 1 m, and what a file states.
        - The planner's word, where the course has neither of its own: the planner calls the goal reached by odometry,
          and the true place is off by no more than odometry may be.

        Args:
            x: [m].
            y: [m].
            called_within: The planner's tolerance [m] where it calls the goal reached; None where it does not, or where
                nobody knows.
        """
        if self.planner_ends and called_within is not None:
            sent, off = self.sent_goal, max(ODOMETRY_OFF_M, ODOMETRY_OFF_SHARE * self.route_m)
            if math.hypot(sent[0] - x, sent[1] - y) <= called_within + off:
                return True
        past = self.finish_y is not None and y > self.finish_y
        return past or math.hypot(self.goal[0] - x, self.goal[1] - y) <= self.goal_tolerance


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
    movers: Tuple[Mover, ...] = ()


def clearance(world: World, points: np.ndarray, time: float = 0.0) -> np.ndarray:
    """(n,) distance [m] from each point (n, 2) to the nearest obstacle's surface; moving ones at `time` [s].

    Inside a cylinder it is negative, inside a box 0; without obstacles it is inf.
    """
    moving = [(*mover.position(time), mover.radius) for mover in world.movers]
    cylinders = np.vstack([world.cylinders, np.array(moving).reshape(-1, 3)])
    x, y = points[:, :1], points[:, 1:]
    nearest = np.min(np.hypot(x - cylinders[:, 0], y - cylinders[:, 1]) - cylinders[:, 2], axis=1, initial=np.inf)
    for bx, by, yaw, size_x, size_y in world.boxes:
        nearest = np.minimum(nearest, np.hypot(*outside_box(x[:, 0] - bx, y[:, 0] - by, yaw, size_x, size_y)))
    return nearest
