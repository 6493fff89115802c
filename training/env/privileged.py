"""Inputs of the critics that the policy cannot know: the course beyond obstacles, drawn physics.

Critics are used only in training, where the simulator knows these values (asymmetric actor-critic,
Pinto et al. 2018). The environment appends the values to the observation; the policy receives only
the entries before them.
"""

from __future__ import annotations

import math
from typing import List

import numpy as np

from applr_ros1.common.angles import Pose, inverse, transform_point
from applr_ros1.common.arrays import Array
from applr_ros1.common.paths import distances, points_at, step_lengths
from applr_ros1.drives.simulate import CourseDrive
from applr_ros1.planner.variant import CPP_LIKE
from applr_ros1.robots.check import WIDTH
from worlds.world import clearance

# Ends of the path sections whose clearance is an input [widths].
STATIONS = 0.5, 1.0, 1.5, 2.0, 3.0, 4.0, 6.0, 9.0
STEP = 0.2  # distance between the points of a path at which clearance is measured [widths]
# Distances of two points ahead on the true course, whose directions are inputs [widths].
AHEAD = (2.0, 5.0)
# Values that map to the end of an input's range.
CLEARANCE_CAP = 2.0  # clearance [widths]
FAR = 8.0  # distance [widths]
LONG = 30.0  # length of a course [widths]
FAST = 2.0  # speed [m/s]
MOVERS = 2  # number of nearest moving obstacles in the inputs
POSITIONS_HZ = 10.0  # rate of the positions of a moving obstacle that give its velocity [1/s]
ODD = tuple(range(len(AHEAD) + 2 * MOVERS))  # indices of the entries that change sign when mirrored
# Sines, clearances along plan and route, free length, length and distance of the route, cosines,
# moving obstacles, fidelity and what was drawn, and Stall.share
SIZE = len(ODD) + 2 * len(STATIONS) + 1 + 2 + len(AHEAD) + 2 * MOVERS + 7 + 1


def privileged(drive: CourseDrive, scale: float) -> np.ndarray:
    """Return the inputs (SIZE,) float32 in [-1, 1] for the present state of a drive.

    The true course is the world's reference path. The first entries change sign if left and right
    are exchanged: sines of the directions of the true course ahead, y and lateral velocity of the
    nearest moving obstacles. The others are the clearance along the global plan and along the true
    course, the free length of the plan, the length of the true course ahead, the robot's distance
    from it, the cosines of the directions, x and forward velocity of the moving obstacles, the
    planner fidelity, the drawn ground, friction, slip, odometry, delay and laser noise, and
    Stall.share.

    Args:
        drive: Drive before a decision, or at its end.
        scale: Width of the robot, as a multiple of the Jackal's.
    """
    width = WIDTH * scale
    state = drive.simulated.state
    world = drive.world

    # The global plan: its clearance, and how far it is wide enough for the robot
    along_plan = _along(_true_plan(drive), width)
    passers_by = drive.simulated.simulator.passers_by
    circles = passers_by.circles(state.time)
    later_circles = passers_by.circles(state.time + 1.0 / POSITIONS_HZ)
    plan_clearance = clearance(world, along_plan, circles)
    blocked_points = np.flatnonzero(plan_clearance < 0.5 * drive.simulated.robot.body.size[1])
    free_length = STATIONS[-1]
    if len(blocked_points):
        free_length = STEP * blocked_points[0]

    # The true course from the point that is nearest to the robot
    route = np.vstack([world.course.path, world.course.goal[:2]])
    position = np.array(state.pose[:2])
    from_robot = distances(route, position)
    nearest = int(np.argmin(from_robot))
    route_left = route[nearest:]
    length_left = step_lengths(route_left).sum() / width
    along_route = _along(route_left, width)
    route_clearance = clearance(world, along_route, circles)
    last_point = len(along_route) - 1
    points_ahead = [min(last_point, round(distance / STEP)) for distance in AHEAD]
    dx, dy = (along_route[points_ahead] - position).T
    bearings = np.arctan2(dy, dx) - state.pose[2]

    farthest = FAR * width
    # Place and velocity of one moving obstacle after the other
    mover_x, mover_y, mover_vx, mover_vy = _movers(state.pose, circles, later_circles).T
    lateral = np.column_stack([mover_y / farthest, mover_vy / FAST])
    forward = np.column_stack([mover_x / farthest, mover_vx / FAST])
    inputs: List[float] = [
        *np.sin(bearings),
        *lateral.flat,
        *_clearances(plan_clearance, width),
        *_clearances(route_clearance, width),
        _centred(free_length / STATIONS[-1]),
        _centred(length_left / LONG),
        _centred(from_robot[nearest] / farthest),
        *np.cos(bearings),
        *forward.flat,
        1.0 if drive.simulated.stack.move_base.variant == CPP_LIKE else -1.0,
        *_physics(drive),
        _centred(drive.stall.share),
    ]
    return np.array(np.clip(inputs, -1.0, 1.0), np.float32)


def _centred(share: float) -> float:
    """Map a share from [0, 1] to [-1, 1]. Larger shares count as 1."""
    return 2.0 * min(1.0, share) - 1.0


def _true_plan(drive: CourseDrive) -> np.ndarray:
    """Return the global plan (k, 2) [m] from the robot on, as it lies in the world.

    The planner's plan lies where odometry sees it, so its points are taken relative to the robot.
    """
    true_pose = drive.simulated.state.pose
    if drive.simulated.stack.move_base.global_plan is None:
        return np.array([true_pose[:2]])
    plan = np.asarray(drive.simulated.stack.move_base.global_plan, np.float64)
    to_robot = inverse(drive.simulated.place)
    seen_x, seen_y = transform_point(to_robot, plan[:, 0], plan[:, 1])
    x, y = transform_point(true_pose, seen_x, seen_y)
    return np.vstack([true_pose[:2], np.column_stack([x, y])])


def _physics(drive: CourseDrive) -> List[float]:
    """Return what was drawn for the drive, scaled so that usual ranges lie in [-1, 1]."""
    drawn = drive.simulated.simulator.drawn
    return [
        _centred(drawn.ground),
        2.0 * (drawn.friction - 1.0),
        drawn.slip - 1.0,
        0.5 * (drawn.odometry - 1.0),
        20.0 * drawn.latency - 1.0,
        0.25 * (drawn.scan_noise - 1.0),
    ]


def _along(points: np.ndarray, width: float) -> np.ndarray:
    """Return points (k, 2) every STEP widths along a path, up to the last of STATIONS.

    A short path repeats its end.
    """
    # Half a step more, so that rounding does not drop the last point.
    widths_along = np.arange(0.0, STATIONS[-1] + 0.5 * STEP, STEP)
    return points_at(points, width * widths_along)


def _clearances(clearances: np.ndarray, width: float) -> List[float]:
    """Return the smallest clearance in each section of a path, on a scale in [-1, 1].

    clearances: clearance [m] of the points of _along.
    """
    inputs = []
    first_point = 0
    for station in STATIONS:
        last_point = round(station / STEP)
        smallest = max(0.0, clearances[first_point : last_point + 1].min())
        # The square root resolves narrow places.
        share = math.sqrt(smallest / (CLEARANCE_CAP * width))
        inputs.append(_centred(share))
        first_point = last_point
    return inputs


def _movers(pose: Pose, circles: Array, later_circles: Array) -> np.ndarray:
    """Return the MOVERS nearest moving obstacles (MOVERS, 4): x, y [m], vx, vy [m/s].

    They are in the robot's frame. Missing ones are far ahead.

    Args:
        pose: Pose of the robot in the world frame.
        circles: Their circles (k, 3) x, y, radius [m] now.
        later_circles: The same 1 / POSITIONS_HZ later.
    """
    to_robot = inverse(pose)
    x, y = transform_point(to_robot, circles[:, 0], circles[:, 1])
    later_x, later_y = transform_point(to_robot, later_circles[:, 0], later_circles[:, 1])
    vx = POSITIONS_HZ * (later_x - x)
    vy = POSITIONS_HZ * (later_y - y)
    order = np.argsort(np.hypot(x, y))
    nearest = np.column_stack([x, y, vx, vy])[order[:MOVERS]]
    nothing = np.array([(math.inf, 0.0, 0.0, 0.0)] * MOVERS)
    return np.vstack([nearest, nothing])[:MOVERS]
