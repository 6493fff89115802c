"""A world as a certain robot drives it."""

from __future__ import annotations

import worlds
from applr_ros1.robots.geometry import radius
from applr_ros1.robots.robot import Robot


def world_of(specification: str, robot: Robot) -> worlds.World:
    """Return the world that `specification` names, at the robot's scale.

    The courses of a map depend on the radius of the circle around the robot.

    Raises:
        ApplrError: There is no such world, or it cannot be read.
    """
    return worlds.scaled(worlds.load(specification, radius(robot)), robot.world_scale)
