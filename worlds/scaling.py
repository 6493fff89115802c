"""Worlds at the scale of another robot: the recipes fit the Jackal, and gaps, courses and posts grow or shrink with it.

Training, evaluation and the simulated robot call `scaled` with the scale of the robot that drives. Worlds from files
keep their size: they are places.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from . import physical_course
from .world import Course, Mover, Pose, World

RECIPES = ("generated:", "fresh:", "dynamic:")  # how the names of their worlds begin


def scaled(world: World, factor: float) -> World:
    """A world of a recipe (generated:N, fresh:N, dynamic:N, physical_course) with all lengths multiplied by `factor`.

    Angles and times stay. A room of moving obstacles grows no larger: its goal would lie off the planners' maps.
    A world from a file, or a factor of 1, gives the world itself.
    """
    if world.movers:
        factor = min(factor, 1.0)
    if factor == 1.0 or not (world.name.startswith(RECIPES) or world.name == physical_course.NAME):
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
