"""Inputs of the critics that the policy cannot know: the course behind obstacles, and randomised physics.

Critics are used only in training, where the simulator knows these values (asymmetric actor-critic, Pinto et al. 2018).
The environment appends the values to the observation; the policy receives only the entries before them.
"""

from __future__ import annotations

import math
from typing import List, Tuple

import numpy as np

from applr_ros1.common.angles import Pose, inverse, transform_point
from applr_ros1.planner.variant import CPP_LIKE
from applr_ros1.robots.check import WIDTH
from training.env.episode import Episode
from worlds.world import clearance

STATIONS = (
    0.5,
    1.0,
    1.5,
    2.0,
    3.0,
    4.0,
    6.0,
    9.0,
)  # ends of the path sections whose clearance is an input [widths]
STEP = 0.2  # distance between the points of a path at which clearance is measured [widths]
AHEAD = (
    2.0,
    5.0,
)  # distances of two points ahead on the true course, whose directions are inputs [widths]
CAP, FAR, LONG, FAST = (
    2.0,
    8.0,
    30.0,
    2.0,
)  # scales of clearance, distance, length [widths] and speed [m/s]
MOVERS = 2  # number of nearest moving obstacles in the inputs
ODD = tuple(range(len(AHEAD) + 2 * MOVERS))  # indices of the entries that change sign when mirrored
SIZE = len(ODD) + 2 * len(STATIONS) + 1 + 2 + len(AHEAD) + 2 * MOVERS + 7 + 1


def privileged(episode: Episode, scale: float) -> np.ndarray:
    """Return the inputs (SIZE,) float32 in [-1, 1] for the current state of an episode.

    The true course is the world's reference path. The first entries change sign if left and right are exchanged: sines
    of the directions of the true course ahead, y and lateral velocity of the nearest moving obstacles. The others are
    the clearance along the global plan and along the true course, the free length of the plan, the length of the true
    course ahead, the robot's distance from it, the cosines of the directions, x and forward velocity of the moving
    obstacles, the planner fidelity, the drawn ground, friction, slip, odometry, delay and laser noise, and Stall.share.

    Args:
        episode: Episode after its reset() or decide().
        scale: Width of the robot, as a multiple of the Jackal's.
    """
    width, state, world = WIDTH * scale, episode.simulator.state, episode.world
    course, drawn = world.course, episode.simulator.drawn
    plan = episode.move_base.global_plan
    plan = (
        np.asarray(plan, dtype=np.float64)[:, :2]
        if plan is not None and len(plan)
        else np.zeros((0, 2))
    )
    believed = inverse(episode.place)
    plan = np.column_stack(
        transform_point(state.pose, *transform_point(believed, plan[:, 0], plan[:, 1]))
    )
    along_plan = _along(np.vstack([state.pose[:2], plan]), width)
    clear_plan = clearance(world, along_plan, state.time)
    blocked = np.flatnonzero(clear_plan < 0.5 * episode.robot.body.size[1])
    free = STEP * (blocked[0] if len(blocked) else STATIONS[-1] / STEP)
    route = np.vstack([course.path, course.goal[:2]])
    distances = np.hypot(*(route - state.pose[:2]).T)
    nearest = int(np.argmin(distances))
    left = np.hypot(*np.diff(route[nearest:], axis=0).T).sum() / width
    along_route = _along(route[nearest:], width)
    ahead = (
        along_route[[min(len(along_route) - 1, round(far / STEP)) for far in AHEAD]]
        - state.pose[:2]
    )
    bearings = np.arctan2(ahead[:, 1], ahead[:, 0]) - state.pose[2]
    movers = _movers(episode, state.pose, state.time)
    values: List[float] = [
        *np.sin(bearings),
        *(part for x, y, vx, vy in movers for part in (y / (FAR * width), vy / FAST)),
        *_clearances(clear_plan, width),
        *_clearances(clearance(world, along_route, state.time), width),
        2.0 * free / STATIONS[-1] - 1.0,
        2.0 * min(1.0, left / LONG) - 1.0,
        2.0 * min(1.0, distances[nearest] / (FAR * width)) - 1.0,
        *np.cos(bearings),
        *(part for x, y, vx, vy in movers for part in (x / (FAR * width), vx / FAST)),
        1.0 if episode.move_base.variant == CPP_LIKE else -1.0,
        2.0 * min(1.0, drawn.ground) - 1.0,
        2.0 * (drawn.friction - 1.0),
        drawn.slip - 1.0,
        0.5 * (drawn.odometry - 1.0),
        20.0 * drawn.latency - 1.0,
        0.25 * (drawn.scan_noise - 1.0),
        2.0 * episode.stall.share - 1.0,
    ]
    return np.array(np.clip(values, -1.0, 1.0), np.float32)


def _along(points: np.ndarray, width: float) -> np.ndarray:
    """Return points (k, 2) every STEP widths along a path, up to the last of STATIONS. A short path repeats its end."""
    length = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(points, axis=0).T))])
    at = width * np.arange(0.0, STATIONS[-1] + 0.5 * STEP, STEP)
    return np.column_stack([np.interp(at, length, points[:, axis]) for axis in (0, 1)])


def _clearances(clear: np.ndarray, width: float) -> List[float]:
    """Return the smallest clearance in each section of a path, on a square-root scale in [-1, 1]."""
    ends = [round(station / STEP) for station in STATIONS]
    least = [clear[first : last + 1].min() for first, last in zip([0, *ends], ends)]
    return [2.0 * math.sqrt(min(1.0, max(0.0, value) / (CAP * width))) - 1.0 for value in least]


def _movers(episode: Episode, pose: Pose, time: float) -> List[Tuple[float, ...]]:
    """Return (x, y, vx, vy) of MOVERS moving obstacles in the robot's frame [m, m/s]; missing ones are far ahead."""
    back = inverse(pose)
    movers: List[Tuple[float, ...]] = []
    for mover in episode.world.movers:
        here, later = (transform_point(back, *mover.position(t)) for t in (time, time + 0.1))
        movers.append((*here, 10.0 * (later[0] - here[0]), 10.0 * (later[1] - here[1])))
    movers.sort(key=lambda row: math.hypot(row[0], row[1]))
    return (movers + [(math.inf, 0.0, 0.0, 0.0)] * MOVERS)[:MOVERS]
