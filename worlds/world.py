"""World: static and moving obstacles on a plane, and the course through them.

Plain data, except for the positions of moving obstacles, which are interpolated between key frames like a Gazebo
PoseAnimation. All packages read these classes, and `worlds.load` creates them. The frame is BARN's: x to the right, y
forward, in metres and radians.
"""

from __future__ import annotations

import math
from bisect import bisect_left
from dataclasses import dataclass
from functools import cached_property
from typing import List, NamedTuple, Optional, Tuple

import numpy as np

from applr_ros1.common.angles import Pose, outside_box
from applr_ros1.common.arrays import Array

KeyFrame = Tuple[float, float, float]
Point = Tuple[float, float]

SAME_POINT_M = 1e-3  # tolerance within which ignition::math::Vector3 compares equal [m]


@dataclass(frozen=True)
class Mover:
    """A cylinder that moves like a Gazebo model with a PoseAnimation, as DynaBARN's obstacles do.

    The cylinder passes its key frames at their times. In between, its centre follows ignition::math::Spline with
    tension 0: Catmull-Rom tangents, closed if the last point equals the first. Before the first key frame and after the
    last one, the cylinder stands still.

    Attributes:
        radius: Radius [m].
        waypoints: At least two key frames ((t, x, y), ...) [s, m, m], with times >= 0 that never decrease.
        length: Duration of the animation [s]; 0 means the time of the last key frame.
        repeat: Whether the animation starts again after `length` seconds. Otherwise the cylinder stays at its end.
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
        """Return the centre (x, y) [m] at time t >= 0 [s], as gazebo::common::Animation::GetKeyFramesAtTime does."""
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
    """Return the tangents at all points, as ignition::math::Spline::RecalcTangents does with tension 0."""
    last = len(points) - 1
    closed = all(abs(a - b) <= SAME_POINT_M for a, b in zip(points[0], points[last]))
    before = [points[last - 1] if closed else points[0]] + points[:last]
    after = points[1:] + [points[1] if closed else points[last]]
    return [(0.5 * (b[0] - a[0]), 0.5 * (b[1] - a[1])) for a, b in zip(before, after)]


def _hermite(a: float, b: float, tangent_a: float, tangent_b: float, u: float) -> float:
    """Evaluate one coordinate of the cubic from a (u = 0) to b (u = 1) with the given end tangents."""
    return (
        a
        + tangent_a * u
        + (3.0 * (b - a) - 2.0 * tangent_a - tangent_b) * u * u
        + (2.0 * (a - b) + tangent_a + tangent_b) * u * u * u
    )


# Odometry error allowed at the goal: in [m], and as a share of the route. Seen: .55 m on 10 m (Gazebo), 1.3 m on 20 m.
ODOMETRY_OFF_M, ODOMETRY_OFF_SHARE = 0.5, 0.08
MAP_REACH_M = 19.7  # reach of a planner's 20 m global map from the start, without its blocked outermost cells [m]


@dataclass(frozen=True, eq=False)
class Course:
    """Start, goal, reference path and finish of a course through a world.

    Attributes:
        start, goal: Poses (x, y, yaw) [m, m, rad].
        finish_y: Ordinate of the finish line [m], past which the course is completed; None without a line.
        goal_tolerance: Distance from the goal [m] within which the course is completed as well.
        path: Collision-free reference path (k, 2) float64 [m] from start to goal.
        planner_ends: Whether the course is also completed when the planner reports its goal as reached.
    """

    start: Pose
    goal: Pose
    finish_y: Optional[float]
    goal_tolerance: float
    path: Array
    planner_ends: bool = False

    @property
    def length_m(self) -> float:
        """Straight distance [m] from the start to the finish line (5.925 in BARN's worlds) or goal circle."""
        if self.finish_y is not None:
            return self.finish_y - self.start[1]
        return max(0.0, math.hypot(self.goal[0] - self.start[0], self.goal[1] - self.start[1]) - self.goal_tolerance)

    @property
    def route_m(self) -> float:
        """Length of the reference route [m]: start, reference path, then the finish line or the goal.

        BARN's metric derives its optimal time at 2 m/s from this length.
        """
        path, end = self.path, self.goal[:2]
        if self.finish_y is not None:
            path = path[path[:, 1] < self.finish_y]
            end = (path[-1, 0] if len(path) else self.start[0], self.finish_y)
        points = np.vstack([self.start[:2], path, end])
        return float(np.hypot(*np.diff(points, axis=0).T).sum())

    @property
    def sent_goal(self) -> Pose:
        """The goal sent to a planner: `goal`, moved straight towards the start until it lies on the map."""
        dx, dy = self.goal[0] - self.start[0], self.goal[1] - self.start[1]
        beyond = max(abs(dx), abs(dy)) / MAP_REACH_M
        if beyond <= 1.0:
            return self.goal
        return self.start[0] + dx / beyond, self.start[1] + dy / beyond, self.goal[2]

    def arrived(self, x: float, y: float, called_within: Optional[float] = None) -> bool:
        """Return True if a robot at the true position (x, y) has arrived. All decisions about success use this method.

        - Finish line: y = 10 m in BARN's worlds, as in the paper. The paper only writes that the physical course is
          driven from end to end, so the line and the circle of that course are our own.
        - Circle around the goal: 1 m in the BARN Challenge, or the tolerance given in a world file.
        - Planner's report, if the course has no finish of its own: the planner decides by odometry, so the true
          position may be off by the allowed error of the odometry.

        Args:
            x: True position [m].
            y: True position [m].
            called_within: Goal tolerance [m] of the planner if it reports its goal as reached; None if it does not, or
                if this is unknown.
        """
        if self.planner_ends and called_within is not None:
            sent, off = self.sent_goal, max(ODOMETRY_OFF_M, ODOMETRY_OFF_SHARE * self.route_m)
            if math.hypot(sent[0] - x, sent[1] - y) <= called_within + off:
                return True
        past = self.finish_y is not None and y > self.finish_y
        return past or math.hypot(self.goal[0] - x, self.goal[1] - y) <= self.goal_tolerance


class Grid(NamedTuple):
    """Occupancy grid as in nav_msgs: cells (ny, nx) int8, resolution [m], and origin (x, y, yaw) [m, m, rad]."""

    cells: np.ndarray
    resolution: float
    origin: Pose


@dataclass(frozen=True, eq=False)
class World:
    """Obstacles and a course.

    Attributes:
        name: "generated:7", "physical_course", or the stem of a file ("world_7").
        cylinders: (n, 3) float64 x, y, radius [m].
        boxes: (m, 5) float64 x, y, yaw, size_x, size_y [m, rad]; sizes are full side lengths.
        course: Course through the world.
        movers: Moving cylinders.
        map: Map of the building that the course leads through; None if the world has no map of its own.
    """

    name: str
    cylinders: Array
    boxes: Array
    course: Course
    movers: Tuple[Mover, ...] = ()
    map: Optional[Grid] = None


def clearance(world: World, points: Array, time: float = 0.0) -> Array:
    """Return the distance (n,) [m] from each point (n, 2) to the nearest obstacle surface at `time` [s].

    The distance is negative inside a cylinder, 0 inside a box, and inf without obstacles.
    """
    moving = [(*mover.position(time), mover.radius) for mover in world.movers]
    cylinders = np.vstack([world.cylinders, np.array(moving).reshape(-1, 3)])
    x, y = points[:, :1], points[:, 1:]
    nearest: Array = np.min(
        np.hypot(x - cylinders[:, 0], y - cylinders[:, 1]) - cylinders[:, 2], axis=1, initial=np.inf
    )
    for bx, by, yaw, size_x, size_y in world.boxes:
        nearest = np.minimum(nearest, np.hypot(*outside_box(x[:, 0] - bx, y[:, 0] - by, yaw, size_x, size_y)))
    return nearest
