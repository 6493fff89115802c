"""Plots of worlds: `python -m worlds.draw generated:7 out.png`. Reports and the demo use `draw` for their maps."""

from __future__ import annotations

import argparse
import math
import sys
from typing import Any, List

import numpy as np

from applr_ros1.common.errors import run_main

from .world import World

OBSTACLE, PATH, START, GOAL, MOVER = "#4a4a4a", "#4477aa", "#228833", "#cc3311", "#aa3377"


def draw(axes: Any, world: World, path: bool = True) -> None:
    """Draw obstacles, reference path, start and goal into matplotlib Axes in metres, with equal scales.

    Args:
        axes: Axes to draw into.
        world: World to draw; moving obstacles appear at their start, with their paths.
        path: Whether to draw the reference path.
    """
    from matplotlib.collections import PatchCollection
    from matplotlib.patches import Circle, Rectangle

    patches: List[Any] = [Circle((x, y), radius) for x, y, radius in world.cylinders]
    for x, y, yaw, along, across in world.boxes:
        corner = x - 0.5 * along, y - 0.5 * across
        patches.append(Rectangle(corner, along, across, angle=math.degrees(yaw), rotation_point="center"))
    axes.add_collection(PatchCollection(patches, facecolor=OBSTACLE, edgecolor="none"))
    for mover in world.movers:
        times = np.linspace(0.0, mover.length * 0.999, 200)
        axes.plot(*zip(*[mover.position(t) for t in times]), color=MOVER, lw=0.8, alpha=0.6)
        axes.add_patch(Circle(mover.position(0.0), mover.radius, facecolor=MOVER, alpha=0.6))
    course = world.course
    if path:
        axes.plot(course.path[:, 0], course.path[:, 1], color=PATH, lw=1.2, ls="--", label="reference path")
    x, y, yaw = course.start
    axes.plot([x], [y], "o", color=START, ms=6, label="start")
    ahead = x + 0.5 * math.cos(yaw), y + 0.5 * math.sin(yaw)
    axes.annotate("", ahead, (x, y), arrowprops=dict(arrowstyle="->", color=START))
    axes.plot(course.goal[0], course.goal[1], "*", color=GOAL, ms=11, label="goal")
    if course.finish_y is not None:
        axes.axhline(course.finish_y, color=GOAL, lw=0.8, ls=":", label="finish line")
    axes.set(aspect="equal", xlabel="x [m]", ylabel="y [m]")
    axes.autoscale_view()


def main() -> int:
    """Write a picture of a world. Return exit status 1 if reading or writing fails."""
    from . import command_line  # It imports all that describes robots, which `draw` does not need.

    parser = argparse.ArgumentParser(prog="python -m worlds.draw", description="Draw a picture of a world.")
    command_line.add_arguments(parser)
    parser.add_argument("picture", help="File for the picture, such as out.png.")
    arguments = parser.parse_args()

    def picture() -> None:
        from matplotlib.figure import Figure

        world = command_line.world_of(arguments.world, arguments.robot)
        figure = Figure(figsize=(6, 9))
        axes = figure.add_subplot()
        draw(axes, world)
        axes.set_title(world.name)
        axes.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0), frameon=False)
        figure.savefig(arguments.picture, dpi=120, bbox_inches="tight")

    return run_main(picture, "draw")


if __name__ == "__main__":
    sys.exit(main())
