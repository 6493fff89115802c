"""Worlds at the scale of another robot: the recipes fit the Jackal, and gaps, courses and posts grow or shrink with it.

Training and evaluation call `scaled` with the scale of the robot that drives.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from .mover import Mover
from .world import Course, Pose, World


def scaled(world: World, factor: float) -> World:
    """The world with all lengths multiplied by `factor`, angles and times kept; the world itself for a factor of 1."""
    if factor == 1.0:
        return world
    return replace(
        world,
        cylinders=world.cylinders * factor,
        boxes=world.boxes * np.array([factor, factor, 1.0, factor, factor]),
        course=_course(world.course, factor),
        movers=tuple(_mover(mover, factor) for mover in world.movers),
    )


def _course(course: Course, factor: float) -> Course:
    return Course(
        _pose(course.start, factor),
        _pose(course.goal, factor),
        None if course.finish_y is None else course.finish_y * factor,
        course.goal_tolerance * factor,
        course.path * factor,
    )


def _pose(pose: Pose, factor: float) -> Pose:
    return pose[0] * factor, pose[1] * factor, pose[2]


def _mover(mover: Mover, factor: float) -> Mover:
    waypoints = tuple((t, x * factor, y * factor) for t, x, y in mover.waypoints)
    return Mover(mover.radius * factor, waypoints, mover.length, mover.repeat)
