"""Pictures of worlds: `python -m worlds.draw generated:7 out.png`. Reports and the demo draw their maps with `draw`.

`top_view` is a small picture from above with the robot in it, as an array: the training environment renders it, with
Pillow in milliseconds.
"""

from __future__ import annotations

import argparse
import math
import sys
from typing import Any, List, Optional, Sequence, Tuple

import numpy as np

from applr_ros1.common.errors import run_main

from .loading import FORMS, load
from .world import Pose, World, WorldError

OBSTACLE, PATH, START, GOAL, MOVER = "#4a4a4a", "#4477aa", "#228833", "#cc3311", "#aa3377"
PIXELS_PER_METRE = 60.0
SHOWN_BEYOND_M = 1.5  # m beyond start and goal line that are shown
SHOWN_BESIDE_M = 5.0  # m to its sides within which obstacles are shown
MAX_PIXELS = 1200  # pixels; longer courses are shown at a smaller scale
ROBOT, SCAN = "#000000", "#ee7733"


def draw(axes: Any, world: World, path: bool = True) -> None:
    """Obstacles, reference path, start and goal into a matplotlib Axes, in metres, equal scales.

    Args:
        axes: where to draw.
        world: what to draw; of moving obstacles the ways, and where they begin.
        path: whether to draw the reference path.
    """
    from matplotlib.collections import PatchCollection
    from matplotlib.patches import Circle, Polygon

    patches: List[Any] = [Circle((x, y), radius) for x, y, radius in world.cylinders]
    patches += [Polygon(corners(box)) for box in world.boxes]
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
    axes.annotate(
        "", (x + 0.5 * math.cos(yaw), y + 0.5 * math.sin(yaw)), (x, y), arrowprops=dict(arrowstyle="->", color=START)
    )
    axes.plot(course.goal[0], course.goal[1], "*", color=GOAL, ms=11, label="goal")
    if course.finish_y is not None:
        axes.axhline(course.finish_y, color=GOAL, lw=0.8, ls=":", label="finish line")
    axes.set_aspect("equal")
    axes.autoscale_view()
    axes.set_xlabel("x [m]")
    axes.set_ylabel("y [m]")


def corners(box: Sequence[float]) -> np.ndarray:
    """(4, 2) corners of a box x, y, yaw, size_x, size_y."""
    x, y, yaw, size_x, size_y = box
    c, s = math.cos(yaw), math.sin(yaw)
    half = 0.5 * np.array([[size_x, size_y], [-size_x, size_y], [-size_x, -size_y], [size_x, -size_y]])
    return np.array([x, y]) + half @ np.array([[c, s], [-s, c]])


def picture(world: World, file: str) -> None:
    """Draws `world` into a picture file; its ending says which kind. Raises WorldError or OSError."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(6, 9))
    axes = figure.add_subplot()
    draw(axes, world)
    axes.set_title(world.name)
    axes.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0), frameon=False)
    try:
        figure.savefig(file, dpi=120, bbox_inches="tight")
    except ValueError as error:
        raise WorldError(f"{file} cannot be written: {error}") from None


def top_view(
    world: World,
    pose: Pose,
    track: Sequence[Sequence[float]] = (),
    points: Optional[np.ndarray] = None,
    time: float = 0.0,
    body: Tuple[float, float] = (0.42, 0.33),
) -> np.ndarray:
    """The world with the robot as an RGB picture (height, width, 3) uint8; x to the right, y upwards.

    Args:
        world: what is around.
        pose: (x, y, yaw) of the robot in the world's frame [m, m, rad].
        track: points (n, >= 2) that it has driven through [m].
        points: (k, 2) that the laser measured [m].
        time: of the simulation [s], for moving obstacles.
        body: length and width of the robot [m].
    """
    from PIL import Image, ImageDraw

    (left, bottom), (right, top) = _frame(world)
    scale = min(PIXELS_PER_METRE, MAX_PIXELS / max(right - left, top - bottom))
    size = round((right - left) * scale), round((top - bottom) * scale)
    image = Image.new("RGB", size, "white")
    pen = ImageDraw.Draw(image)

    def pixels(xy: Any) -> list:
        xy = np.atleast_2d(np.asarray(xy, dtype=np.float64))[:, :2]
        return [tuple(row) for row in ((xy - (left, top)) * (scale, -scale)).tolist()]

    def disc(x: float, y: float, radius: float, fill: str) -> None:
        ((u, v),), r = pixels((x, y)), max(1.0, radius * scale)
        pen.ellipse((u - r, v - r, u + r, v + r), fill=fill)

    for x, y, radius in world.cylinders:
        disc(x, y, radius, OBSTACLE)
    for box in world.boxes:
        pen.polygon(pixels(corners(box)), fill=OBSTACLE)
    for mover in world.movers:
        disc(*mover.position(time), mover.radius, MOVER)
    course = world.course
    if course.finish_y is not None:
        pen.line(pixels([(left, course.finish_y), (right, course.finish_y)]), fill=GOAL)
    disc(course.goal[0], course.goal[1], 0.12, GOAL)
    disc(course.start[0], course.start[1], 0.08, START)
    for point in () if points is None else points:
        disc(point[0], point[1], 0.03, SCAN)
    if len(track) > 1:
        pen.line(pixels([row[:2] for row in track]), fill=PATH, width=2)
    pen.polygon(pixels(corners((*pose, *body))), fill=ROBOT)
    ahead = 0.5 * body[0]
    disc(pose[0] + ahead * math.cos(pose[2]), pose[1] + ahead * math.sin(pose[2]), 0.07, SCAN)
    return np.array(image)


def _frame(world: World) -> Tuple[np.ndarray, np.ndarray]:
    """Lower left and upper right corner [m]: always the same for a world, whatever is driven."""
    course = world.course
    end = course.goal[:2] if course.finish_y is None else (course.start[0], course.finish_y)
    ends = np.array([course.start[:2], end])
    low, high = ends.min(axis=0), ends.max(axis=0)
    across = int(np.ptp(ends[:, 1]) <= np.ptp(ends[:, 0]))  # 0: the course runs along y, obstacles along x bound it
    sides = np.concatenate([world.cylinders[:, across], world.boxes[:, across]])
    sides = sides[(sides > low[across] - SHOWN_BESIDE_M) & (sides < high[across] + SHOWN_BESIDE_M)]
    low[1 - across], high[1 - across] = low[1 - across] - SHOWN_BEYOND_M, high[1 - across] + SHOWN_BEYOND_M
    low[across] = min([low[across] - 1.0, *(sides - 0.3)])
    high[across] = max([high[across] + 1.0, *(sides + 0.3)])
    return low, high


def main() -> int:
    """Exit status 1 and one line where the world cannot be read or the picture not written."""
    parser = argparse.ArgumentParser(prog="python -m worlds.draw", description="Draws a world into a picture.")
    parser.add_argument("world", help=f"World to draw: {FORMS}.")
    parser.add_argument("picture", help="File for the picture, such as out.png.")
    arguments = parser.parse_args()
    return run_main(lambda: picture(load(arguments.world), arguments.picture), "draw")


if __name__ == "__main__":
    sys.exit(main())
