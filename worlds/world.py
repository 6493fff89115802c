"""World: static and moving obstacles on a plane, and the course through them.

Plain data, except for the positions of moving obstacles, which are interpolated between key frames
like a Gazebo PoseAnimation. All packages read these classes, and `worlds.load` creates them. The
frame is BARN's: x to the right, y forward, in metres and radians.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple, Optional, Sequence, Tuple, Union

import numpy as np
from numpy.typing import NDArray

from applr_ros1.common.angles import Pose, outside_box
from applr_ros1.common.arrays import Array
from applr_ros1.common.kernels import kernel
from applr_ros1.common.paths import step_lengths

KeyFrame = Tuple[float, float, float]
Point = Tuple[float, float]

_NO_CIRCLES = np.empty((0, 3))
SAME_POINT_M = 1e-3  # tolerance within which ignition::math::Vector3 compares equal [m]


@dataclass(frozen=True)
class Mover:
    """A cylinder that moves like a Gazebo model with a PoseAnimation, as DynaBARN's obstacles do.

    The cylinder passes its key frames at their times. In between, its centre follows
    ignition::math::Spline with tension 0: Catmull-Rom tangents, closed if the last point equals the
    first. Before the first key frame and after the last one, the cylinder stands still.

    Attributes:
        radius: Radius [m].
        waypoints: At least two key frames ((t, x, y), ...) [s, m, m], with times >= 0 that never
            decrease.
        length: Duration of the animation [s]; 0 means the time of the last key frame.
        repeat: Whether the animation starts again after `length` seconds. Otherwise the cylinder
            stays at its end.
        looks: Whether it waits for a robot in its way, or goes round it, as somebody who looks
            where he walks (sim_bridge/passers_by.py).
    """

    radius: float
    waypoints: Tuple[KeyFrame, ...]
    length: float = 0.0
    repeat: bool = True
    looks: bool = False

    def __post_init__(self) -> None:
        if not self.length:
            # The class is frozen, so that a normal assignment would raise.
            object.__setattr__(self, "length", self.waypoints[-1][0])

    def position(self, time: float) -> Point:
        """Return the centre (x, y) [m] at a time >= 0 [s]."""
        x, y, _ = _circles_at(np.array([time]), *_animation((self,)))[0].tolist()
        return x, y


def _animation(movers: Sequence[Mover]) -> Tuple[Array, Array]:
    """Return the key frames of moving cylinders, and what they do with them.

    Returns:
        (frames, cylinders): The frames (n, 5) of one cylinder after the other: time [s], place and
        tangent x, y [m]. For each cylinder (k, 4): radius [m], length of its animation [s], 1 if it
        repeats, and the number of its frames.
    """
    frames = []
    cylinders = []
    for mover in movers:
        waypoints = np.array(mover.waypoints, dtype=np.float64)
        frames.append(np.hstack([waypoints, _tangents(waypoints[:, 1:])]))
        cylinders.append((mover.radius, mover.length, mover.repeat, len(waypoints)))
    return np.concatenate(frames), np.array(cylinders, dtype=np.float64)


def _tangents(points: Array) -> Array:
    """Return the tangents (n, 2) at all points (n, 2) of a curve.

    As in ignition::math::Spline::RecalcTangents with tension 0, a tangent is half the vector from
    the previous point to the next. At the ends of an open curve the point itself replaces the
    missing neighbour.
    """
    before_first = points[0]
    after_last = points[-1]
    if np.abs(before_first - after_last).max() <= SAME_POINT_M:
        before_first = points[-2]
        after_last = points[1]
    extended = np.vstack([before_first, points, after_last])
    tangents: Array = 0.5 * (extended[2:] - extended[:-2])
    return tangents


@kernel
def _circles_at(times: Array, frames: Array, cylinders: Array) -> Array:
    """Return the circles (k, 3) x, y, radius [m] of _animation() at times (k,) >= 0 [s].

    As gazebo::common::Animation::GetKeyFramesAtTime does, a key frame at exactly this time is
    returned without interpolation.
    """
    circles = np.empty((len(cylinders), 3))
    first = 0
    for index in range(len(cylinders)):
        radius, length, repeats, count = cylinders[index]
        moment = min(times[index], length)
        if repeats:
            moment = np.fmod(times[index], length)
        row = first
        last = first + int(count) - 1
        while row < last and frames[row, 0] < moment:
            row += 1
        end = frames[row]
        circles[index] = end[1], end[2], radius
        if row > first and moment < end[0]:
            start = frames[row - 1]
            share = (moment - start[0]) / (end[0] - start[0])
            for axis in range(2):
                circles[index, axis] = _hermite(start[axis + 1 :: 2], end[axis + 1 :: 2], share)
        first = last + 1
    return circles


@kernel
def _hermite(start: Array, end: Array, u: float) -> float:
    """Evaluate one coordinate of the cubic from `start` (u = 0) to `end` (u = 1).

    Both are the coordinate and its tangent.
    """
    a, tangent_a = start
    b, tangent_b = end
    quadratic = 3.0 * (b - a) - 2.0 * tangent_a - tangent_b
    cubic = 2.0 * (a - b) + tangent_a + tangent_b
    value: float = a + tangent_a * u + quadratic * u * u + cubic * u * u * u
    return value


# Odometry error allowed at the goal: in [m], and as a share of the route.
# Seen: .55 m on 10 m (Gazebo), 1.3 m on 20 m.
ODOMETRY_OFF_M = 0.5
ODOMETRY_OFF_SHARE = 0.08
# Half the width of the planner's global map (40 m for the Jackal), which is centred on the start,
# without its blocked outermost cells [m]
MAP_REACH_M = 19.7

# tolerance of a course without a circle around its goal [m]: no distance is within it
NO_CIRCLE_M = -1.0


@dataclass(frozen=True, eq=False)
class Course:
    """Start, goal, reference path and finish of a course through a world.

    Attributes:
        start, goal: Poses (x, y, yaw) [m, m, rad].
        finish_y: Ordinate of the finish line [m], past which the course is completed; None without
            a line.
        goal_tolerance: Distance from the goal [m] within which the course is completed as well.
        path: Collision-free reference path (k, 2) float64 [m] from start to goal.
        planner_ends: Whether the course is also completed when the planner reports its goal as
            reached.
    """

    start: Pose
    goal: Pose
    finish_y: Optional[float]
    goal_tolerance: float
    path: Array
    planner_ends: bool = False

    @property
    def length_m(self) -> float:
        """Straight distance [m] from the start to the finish line or the goal circle.

        It is 5.925 m in BARN's worlds.
        """
        x, y, _ = self.start
        if self.finish_y is not None:
            return self.finish_y - y
        goal_x, goal_y, _ = self.goal
        distance = math.hypot(goal_x - x, goal_y - y)
        return max(0.0, distance - self.goal_tolerance)

    @cached_property
    def route_m(self) -> float:
        """Length of the reference route [m]: start, reference path, finish line or goal.

        BARN's metric derives its optimal time at 2 m/s from this length.
        """
        route_points = np.vstack([self.start[:2], self.path])
        route_end: Sequence[float] = self.goal[:2]
        if self.finish_y is not None:
            # From its last point before the finish line, the route goes straight to the line.
            is_start = np.arange(len(route_points)) == 0
            route_points = route_points[is_start | (route_points[:, 1] < self.finish_y)]
            route_end = route_points[-1, 0], self.finish_y
        route = np.vstack([route_points, route_end])
        return float(step_lengths(route).sum())

    @property
    def sent_goal(self) -> Pose:
        """The goal sent to a planner.

        It is `goal`, moved straight towards the start until it lies on the planner's map.
        """
        x, y, _ = self.start
        goal_x, goal_y, goal_yaw = self.goal
        dx = goal_x - x
        dy = goal_y - y
        maps_away = max(abs(dx), abs(dy)) / MAP_REACH_M
        if maps_away <= 1.0:
            return self.goal
        return x + dx / maps_away, y + dy / maps_away, goal_yaw

    def arrived(self, x: float, y: float, called_within: Optional[float] = None) -> bool:
        """Return True if a robot at the true position (x, y) has arrived.

        All decisions about success use this method.

        - Finish line: y = 10 m in BARN's worlds, as in the paper. The paper only writes that the
          physical course is driven from end to end, so the line and the circle of that course are
          our own.
        - Circle around the goal: 1 m in the BARN Challenge, or the tolerance given in a world file.
        - Planner's report, if the course has no finish of its own: the planner decides by odometry,
          so the true position may be off by the allowed error of the odometry.

        Args:
            x: True position [m].
            y: True position [m].
            called_within: Goal tolerance [m] of the planner if it reports its goal as reached; None
                if it does not, or if this is unknown.
        """
        if self.planner_ends and called_within is not None:
            sent_x, sent_y, _ = self.sent_goal
            odometry_error = max(ODOMETRY_OFF_M, ODOMETRY_OFF_SHARE * self.route_m)
            if math.hypot(sent_x - x, sent_y - y) <= called_within + odometry_error:
                return True
        if self.finish_y is not None and y > self.finish_y:
            return True
        goal_x, goal_y, _ = self.goal
        return math.hypot(goal_x - x, goal_y - y) <= self.goal_tolerance


class Grid(NamedTuple):
    """Occupancy grid as in nav_msgs.

    Attributes:
        cells: Cells (ny, nx) int8; the first row has the lowest y.
        resolution: Edge of a cell [m].
        origin: Pose (x, y, yaw) of the lower left corner [m, m, rad].
    """

    cells: NDArray[np.int8]
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
        map: Map of the building that the course leads through; None if the world has no map of its
            own.
    """

    name: str
    cylinders: Array
    boxes: Array
    course: Course
    movers: Tuple[Mover, ...] = ()
    map: Optional[Grid] = None

    @cached_property
    def _animation(self) -> Tuple[Array, Array]:
        """Animations of all movers, prepared once."""
        return _animation(self.movers)

    def mover_circles(self, times: Union[float, Array]) -> Array:
        """Return the moving cylinders (k, 3) x, y, radius [m] at a time >= 0 [s], or times (k,)."""
        if not self.movers:
            return _NO_CIRCLES
        return _circles_at(np.full(len(self.movers), times, np.float64), *self._animation)


def clearance(world: World, points: Array, movers: Array = _NO_CIRCLES) -> Array:
    """Return the distance (n,) [m] from points (n, 2) to the nearest surface.

    The distance is negative inside a cylinder, 0 inside a box, and inf without obstacles. `movers`
    (k, 3) are further circles x, y, radius [m].
    """
    cylinders = np.vstack([world.cylinders, movers])
    centre_x, centre_y, radius = cylinders.T
    points_x, points_y = points.T
    dx = points_x[:, np.newaxis] - centre_x
    dy = points_y[:, np.newaxis] - centre_y
    distance = np.hypot(dx, dy) - radius
    # `initial` is the distance in a world without cylinders.
    nearest_distance: Array = np.min(distance, axis=1, initial=np.inf)
    for box_x, box_y, yaw, size_x, size_y in world.boxes:
        dx = points_x - box_x
        dy = points_y - box_y
        offset_along, offset_across = outside_box(dx, dy, yaw, size_x, size_y)
        nearest_distance = np.minimum(nearest_distance, np.hypot(offset_along, offset_across))
    return nearest_distance
