"""A small picture of a world from above with the robot in it, as an array: what the training environment renders.

It is drawn with Pillow in milliseconds; pictures for people to keep are those of draw.py.
"""

from __future__ import annotations

import math
from typing import Any, Optional, Sequence, Tuple

import numpy as np

from .draw import GOAL, MOVER, OBSTACLE, PATH, START, corners
from .world import Pose, World

PIXELS_PER_METRE = 60.0
REACH = 1.5  # m beyond start and goal line that are shown
BESIDE = 5.0  # m to its sides within which obstacles are shown
LARGEST = 1200  # pixels; longer courses are shown at a smaller scale
ROBOT, SCAN = "#000000", "#ee7733"


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
    scale = min(PIXELS_PER_METRE, LARGEST / max(right - left, top - bottom))
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
    sides = sides[(sides > low[across] - BESIDE) & (sides < high[across] + BESIDE)]
    low[1 - across], high[1 - across] = low[1 - across] - REACH, high[1 - across] + REACH
    low[across] = min([low[across] - 1.0, *(sides - 0.3)])
    high[across] = max([high[across] + 1.0, *(sides + 0.3)])
    return low, high
