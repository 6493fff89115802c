"""Arguments of the commands worlds.draw and worlds.sdf_writer: a world, and its robot.

Only this module of the package imports applr_ros1.robots, because the courses of a map and the
scale of a built-in world depend on the robot.
"""

from __future__ import annotations

import argparse

from applr_ros1 import robots
from applr_ros1.robots.geometry import radius

from .loading import SPECIFICATIONS, load, scaled
from .world import World


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments `world` and --robot."""
    parser.add_argument("world", help=f"World: {SPECIFICATIONS}.")
    parser.add_argument(
        "--robot",
        default="jackal",
        help="Robot that drives in the world, on which the courses of a map and the scale of a "
        f"built-in world depend: {', '.join(robots.NAMES)}, or a folder with robot.yaml. "
        "Default: jackal.",
    )


def world_of(name: str, robot_name: str) -> World:
    """Return a world as a robot drives it. Raise ApplrError if one of them cannot be read."""
    robot = robots.load(robot_name)
    return scaled(load(name, radius(robot)), robot.world_scale)
