"""Plots of worlds: `python -m worlds.draw generated:7 out.png`."""

from __future__ import annotations

import argparse
import math
import sys
from typing import Any, List

import numpy as np

from applr_ros1.common.errors import run_main

from .world import World

OBSTACLE_COLOUR = "#4a4a4a"
PATH_COLOUR = "#4477aa"
START_COLOUR = "#228833"
GOAL_COLOUR = "#cc3311"
MOVER_COLOUR = "#aa3377"
HEADING_M = 0.5  # length of the arrow at the start [m]


def draw(axes: Any, world: World) -> None:
    """Draw obstacles, reference path, start and goal into matplotlib Axes in metres.

    Args:
        axes: Axes to draw into.
        world: World to draw; moving obstacles appear at their start, with their paths.
    """
    # matplotlib takes .7 s to import, and most commands that import this module draw nothing.
    from matplotlib.collections import PatchCollection
    from matplotlib.patches import Circle, Rectangle

    patches: List[Any] = [Circle((x, y), radius) for x, y, radius in world.cylinders]
    for x, y, yaw, size_x, size_y in world.boxes:
        corner = x - 0.5 * size_x, y - 0.5 * size_y
        degrees = math.degrees(yaw)
        box = Rectangle(corner, size_x, size_y, angle=degrees, rotation_point="center")
        patches.append(box)
    axes.add_collection(PatchCollection(patches, facecolor=OBSTACLE_COLOUR, edgecolor="none"))

    for mover in world.movers:
        # At the end of its animation a moving obstacle would be at its start again.
        sample_times = np.linspace(0.0, mover.length * 0.999, 200)
        track_points = []
        for sample_time in sample_times:
            track_points.append(mover.position(sample_time))
        track_x, track_y = np.array(track_points).T
        axes.plot(track_x, track_y, color=MOVER_COLOUR, lw=0.8, alpha=0.6)
        disc = Circle(track_points[0], mover.radius, facecolor=MOVER_COLOUR, alpha=0.6)
        axes.add_patch(disc)

    course = world.course
    path_x, path_y = course.path.T
    axes.plot(path_x, path_y, color=PATH_COLOUR, lw=1.2, ls="--", label="reference path")
    x, y, yaw = course.start
    axes.plot([x], [y], "o", color=START_COLOUR, ms=6, label="start")
    arrow_tip = x + HEADING_M * math.cos(yaw), y + HEADING_M * math.sin(yaw)
    axes.annotate("", arrow_tip, (x, y), arrowprops=dict(arrowstyle="->", color=START_COLOUR))
    goal_x, goal_y, _ = course.goal
    axes.plot(goal_x, goal_y, "*", color=GOAL_COLOUR, ms=11, label="goal")
    if course.finish_y is not None:
        axes.axhline(course.finish_y, color=GOAL_COLOUR, lw=0.8, ls=":", label="finish line")
    axes.set(aspect="equal", xlabel="x [m]", ylabel="y [m]")
    axes.autoscale_view()


def main() -> int:
    """Write a picture of a world. Return exit status 1 if reading or writing fails."""
    from . import command_line  # It imports all that describes robots, which `draw` does not need.

    parser = argparse.ArgumentParser(
        prog="python -m worlds.draw", description="Draw a picture of a world."
    )
    command_line.add_arguments(parser)
    parser.add_argument("picture", help="File for the picture, such as out.png.")
    arguments = parser.parse_args()

    def picture() -> None:
        from matplotlib.figure import Figure

        figure = Figure(figsize=(6, 9))
        world = command_line.named_world(arguments)
        axes = figure.add_subplot()
        draw(axes, world)
        axes.set_title(world.name)
        axes.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0), frameon=False)
        figure.savefig(arguments.picture, dpi=120, bbox_inches="tight")

    return run_main(picture, "draw")


if __name__ == "__main__":
    sys.exit(main())
