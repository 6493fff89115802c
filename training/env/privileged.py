"""Input of critics alone, which a policy cannot know: the course behind the obstacles in view, and this robot as drawn.

A critic serves in training only, where the simulator knows all of it (asymmetric actor-critic, Pinto et al. 2018). The
environment puts these numbers behind its observation; the policy is shown what stands before them.
"""

from __future__ import annotations

import math
from typing import List, Tuple

import numpy as np

from applr_ros1.common.angles import Pose, inverse, transform_point
from applr_ros1.planner.variant import CPP_LIKE
from applr_ros1.policy.dimensionless import JACKAL_WIDTH
from training.env.episode import Episode
from worlds.world import clearance

STATIONS = (0.5, 1.0, 1.5, 2.0, 3.0, 4.0, 6.0, 9.0)  # ends of the stretches of a way whose clearance is told [widths]
STEP = 0.2  # between the points of a way where it is measured [widths]
AHEAD = (2.0, 5.0)  # points of the true course whose directions are told [widths]
CAP, FAR, LONG, FAST = 2.0, 8.0, 30.0, 2.0  # largest clearance, distance and length [widths], and speed [m/s] told
MOVERS = 2  # the nearest moving obstacles that are told
ODD = tuple(range(len(AHEAD) + 2 * MOVERS))  # indices of the numbers that change sign in a mirrored scene
SIZE = len(ODD) + 2 * len(STATIONS) + 1 + 2 + len(AHEAD) + 2 * MOVERS + 7 + 1


def privileged(episode: Episode, scale: float) -> np.ndarray:
    """The numbers (SIZE,) float32 in [-1, 1] of an episode as it stands.

    First those that turn round in a mirror: sines of the directions of the true course ahead, and of the nearest moving
    obstacles y and sideways velocity. Then the clearance along the global plan and along the true course (the
    world's reference path, which was found with all obstacles known), how far the plan is free, what is left of the
    true course and how far off the robot is, the cosines, x and forward velocity of moving obstacles, planner,
    ground, friction, slip, odometry, delay, the laser's noise, and how near the robot is to a stall.

    Args:
        episode: After its reset() or decide().
        scale: How many of the Jackal's widths the robot is wide.
    """
    width, state, world = JACKAL_WIDTH * scale, episode.simulator.state, episode.world
    course, drawn = world.course, episode.simulator.drawn
    plan = episode.move_base.global_plan
    plan = np.asarray(plan, dtype=np.float64)[:, :2] if plan is not None and len(plan) else np.zeros((0, 2))
    believed = inverse(state.odom_pose)
    plan = np.column_stack(transform_point(state.pose, *transform_point(believed, plan[:, 0], plan[:, 1])))
    along_plan = _way(np.vstack([state.pose[:2], plan]), width)
    clear_plan = clearance(world, along_plan, state.time)
    blocked = np.flatnonzero(clear_plan < 0.5 * episode.robot.body.size[1])
    free = STEP * (blocked[0] if len(blocked) else STATIONS[-1] / STEP)
    route = np.vstack([course.path, course.goal[:2]])
    distances = np.hypot(*(route - state.pose[:2]).T)
    nearest = int(np.argmin(distances))
    left = np.hypot(*np.diff(route[nearest:], axis=0).T).sum() / width
    along_route = _way(route[nearest:], width)
    ahead = along_route[[min(len(along_route) - 1, round(far / STEP)) for far in AHEAD]] - state.pose[:2]
    bearings = np.arctan2(ahead[:, 1], ahead[:, 0]) - state.pose[2]
    movers = _movers(episode, state.pose, state.time)
    values = [
        *np.sin(bearings),
        *(part for x, y, vx, vy in movers for part in (y / (FAR * width), vy / FAST)),
        *_told(clear_plan, width),
        *_told(clearance(world, along_route, state.time), width),
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
    return np.clip(np.array(values), -1.0, 1.0).astype(np.float32)


def _way(points: np.ndarray, width: float) -> np.ndarray:
    """Points (k, 2) every STEP widths along the way through `points`, to the last of STATIONS; its end is repeated."""
    length = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(points, axis=0).T))])
    at = width * np.arange(0.0, STATIONS[-1] + 0.5 * STEP, STEP)
    return np.column_stack([np.interp(at, length, points[:, axis]) for axis in (0, 1)])


def _told(clear: np.ndarray, width: float) -> List[float]:
    """The least clearance in each stretch of a way, in [-1, 1], finer where it is small."""
    ends = [round(station / STEP) for station in STATIONS]
    least = [clear[first : last + 1].min() for first, last in zip([0, *ends], ends)]
    return [2.0 * math.sqrt(min(1.0, max(0.0, value) / (CAP * width))) - 1.0 for value in least]


def _movers(episode: Episode, pose: Pose, time: float) -> List[Tuple[float, ...]]:
    """(x, y, vx, vy) of the nearest moving obstacles in the robot's frame [m, m/s]; far ahead where there are fewer."""
    back = inverse(pose)
    found: List[Tuple[float, ...]] = []
    for mover in episode.world.movers:
        here, later = (transform_point(back, *mover.position(t)) for t in (time, time + 0.1))
        found.append((*here, 10.0 * (later[0] - here[0]), 10.0 * (later[1] - here[1])))
    found.sort(key=lambda row: math.hypot(row[0], row[1]))
    return (found + [(math.inf, 0.0, 0.0, 0.0)] * MOVERS)[:MOVERS]
