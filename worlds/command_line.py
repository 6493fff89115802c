"""Arguments of the commands worlds.draw and worlds.sdf_writer: a world, and its robot.

Only this module of the package imports applr_ros1.robots, because the courses of a map and the
scale of a built-in world depend on the robot.
"""

from __future__ import annotations

import argparse

from applr_ros1 import robots
from applr_ros1.robots.robot_world import world_of

from .loading import SPECIFICATIONS
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


def named_world(arguments: argparse.Namespace) -> World:
    """Return the world of these arguments. Raise ApplrError if it or its robot cannot be read."""
    return world_of(arguments.world, robots.load(arguments.robot))
