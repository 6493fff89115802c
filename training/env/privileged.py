"""Inputs of the critics that the policy cannot know: the course behind obstacles, and randomised physics.

Critics are used only in training, where the simulator knows these values (asymmetric actor-critic,
Pinto et al. 2018). The environment appends the values to the observation; the policy receives only
the entries before them.
"""

from __future__ import annotations

import math
from typing import List, NamedTuple

import numpy as np

from applr_ros1.common.angles import Pose, inverse, transform_point
from applr_ros1.planner.variant import CPP_LIKE
from applr_ros1.robots.check import WIDTH
from training.env.episode import Episode
from worlds.world import clearance

# Ends of the path sections whose clearance is an input [widths].
STATIONS = 0.5, 1.0, 1.5, 2.0, 3.0, 4.0, 6.0, 9.0
STEP = 0.2  # distance between the points of a path at which clearance is measured [widths]
AHEAD = (
    2.0,
    5.0,
)  # distances of two points ahead on the true course, whose directions are inputs [widths]
# Values that map to the end of an input's range.
CLEARANCE_CAP = 2.0  # clearance [widths]
FAR = 8.0  # distance [widths]
LONG = 30.0  # length of a course [widths]
FAST = 2.0  # speed [m/s]
MOVERS = 2  # number of nearest moving obstacles in the inputs
ODD = tuple(range(len(AHEAD) + 2 * MOVERS))  # indices of the entries that change sign when mirrored
SIZE = len(ODD) + 2 * len(STATIONS) + 1 + 2 + len(AHEAD) + 2 * MOVERS + 7 + 1


def privileged(episode: Episode, scale: float) -> np.ndarray:
    """Return the inputs (SIZE,) float32 in [-1, 1] for the current state of an episode.

    The true course is the world's reference path. The first entries change sign if left and right
    are exchanged: sines of the directions of the true course ahead, y and lateral velocity of the
    nearest moving obstacles. The others are the clearance along the global plan and along the true
    course, the free length of the plan, the length of the true course ahead, the robot's distance
    from it, the cosines of the directions, x and forward velocity of the moving obstacles, the
    planner fidelity, the drawn ground, friction, slip, odometry, delay and laser noise, and
    Stall.share.

    Args:
        episode: Episode after its reset() or decide().
        scale: Width of the robot, as a multiple of the Jackal's.
    """
    width = WIDTH * scale
    state = episode.simulator.state
    world = episode.world
    along_plan = _along(_true_plan(episode), width)
    plan_clearance = clearance(world, along_plan, state.time)
    blocked = np.flatnonzero(plan_clearance < 0.5 * episode.robot.body.size[1])
    free = STEP * blocked[0] if len(blocked) else STATIONS[-1]

    # The true course from the point that is nearest to the robot.
    route = np.vstack([world.course.path, world.course.goal[:2]])
    offsets = route - state.pose[:2]
    distances = np.hypot(offsets[:, 0], offsets[:, 1])
    nearest = int(np.argmin(distances))
    steps = np.diff(route[nearest:], axis=0)
    left = np.hypot(steps[:, 0], steps[:, 1]).sum() / width
    along_route = _along(route[nearest:], width)
    rows = [min(len(along_route) - 1, round(far / STEP)) for far in AHEAD]
    ahead = along_route[rows] - state.pose[:2]
    bearings = np.arctan2(ahead[:, 1], ahead[:, 0]) - state.pose[2]

    movers = _movers(episode, state.pose, state.time)
    lateral: List[float] = []
    forward: List[float] = []
    for mover in movers:
        lateral += [mover.y / (FAR * width), mover.vy / FAST]
        forward += [mover.x / (FAR * width), mover.vx / FAST]
    values: List[float] = [
        *np.sin(bearings),
        *lateral,
        *_clearances(plan_clearance, width),
        *_clearances(clearance(world, along_route, state.time), width),
        2.0 * free / STATIONS[-1] - 1.0,
        2.0 * min(1.0, left / LONG) - 1.0,
        2.0 * min(1.0, distances[nearest] / (FAR * width)) - 1.0,
        *np.cos(bearings),
        *forward,
        1.0 if episode.move_base.variant == CPP_LIKE else -1.0,
        *_physics(episode),
        2.0 * episode.stall.share - 1.0,
    ]
    return np.array(np.clip(values, -1.0, 1.0), np.float32)


def _true_plan(episode: Episode) -> np.ndarray:
    """Return the global plan (k, 2) from the robot on, as it lies in the world: odometry errors are taken out."""
    true_pose = episode.simulator.state.pose
    plan = episode.move_base.global_plan
    points = np.zeros((0, 2)) if plan is None else np.asarray(plan, np.float64)[:, :2]
    seen = transform_point(inverse(episode.place), points[:, 0], points[:, 1])
    return np.vstack([true_pose[:2], np.column_stack(transform_point(true_pose, *seen))])


def _physics(episode: Episode) -> List[float]:
    """Return what was drawn for the episode, scaled so that usual ranges lie in [-1, 1]."""
    drawn = episode.simulator.drawn
    return [
        2.0 * min(1.0, drawn.ground) - 1.0,
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
    steps = np.diff(points, axis=0)
    length = np.concatenate([[0.0], np.cumsum(np.hypot(steps[:, 0], steps[:, 1]))])
    at = width * np.arange(0.0, STATIONS[-1] + 0.5 * STEP, STEP)
    x = np.interp(at, length, points[:, 0])
    y = np.interp(at, length, points[:, 1])
    return np.column_stack([x, y])


def _clearances(clear: np.ndarray, width: float) -> List[float]:
    """Return the smallest clearance in each section of a path, on a square-root scale in [-1, 1]."""
    inputs = []
    first = 0
    for station in STATIONS:
        last = round(station / STEP)
        least = max(0.0, clear[first : last + 1].min())
        # The square root resolves narrow places.
        inputs.append(2.0 * math.sqrt(min(1.0, least / (CLEARANCE_CAP * width))) - 1.0)
        first = last
    return inputs


class _Relative(NamedTuple):
    """Moving obstacle in the robot's frame: place [m] and velocity [m/s]."""

    x: float
    y: float
    vx: float
    vy: float


def _movers(episode: Episode, pose: Pose, time: float) -> List[_Relative]:
    """Return the MOVERS nearest moving obstacles. Missing ones are far ahead."""
    back = inverse(pose)
    movers: List[_Relative] = []
    for mover in episode.world.movers:
        x, y = transform_point(back, *mover.position(time))
        later_x, later_y = transform_point(back, *mover.position(time + 0.1))
        movers.append(_Relative(x, y, 10.0 * (later_x - x), 10.0 * (later_y - y)))
    movers.sort(key=lambda mover: math.hypot(mover.x, mover.y))
    nothing = _Relative(math.inf, 0.0, 0.0, 0.0)
    return (movers + [nothing] * MOVERS)[:MOVERS]
