"""The animation of one drive: robot, scan, plans and parameters over time, as an animated GIF.

The course is drawn once; each frame adds what moves to a copy of that picture. Called by the demo and by whoever else
has recorded a drive; knows nothing of ROS.
"""

from __future__ import annotations

import math
from typing import Any, Callable, List, Tuple

import numpy as np

from worlds.draw import GOAL, MOVER, OBSTACLE, PATH, START, draw

from .picture import Drive, View

SCAN, PLAN, CHOSEN, ROBOT, DRIVEN = "#cc3311", "#4477aa", "#ee7733", "#228833", "#66ccaa"
SAMPLES = "#ddcc77"
STEP = 0.1  # s of simulated time between two frames
MOST_FRAMES = 300  # of longer drives the frames are farther apart
TALL, WIDE = (460, 900), (900, 560)  # pixels of the course, by its shape; the parameters stand beside it
PANEL = 300  # pixels of the parameters' width


def save(drive: Drive, outline: np.ndarray, path: str) -> None:
    """Writes the animation of a drive.

    Args:
        drive: the recorded drive, with at least one view.
        outline: (n, 2) outline of the robot [m] in its own frame.
        path: the GIF file.

    Raises:
        ValueError: without any view.
        OSError: if the file cannot be written.
    """
    views = drive.views
    if not views:
        raise ValueError("an animation needs at least one view")
    background, pixel = _course(drive)
    every = max(STEP, (views[-1].time - views[0].time) / MOST_FRAMES)
    frames, due = [], -math.inf
    for view in views:
        if view.time >= due:
            due = view.time + every - 1e-6
            frames.append(_frame(background, pixel, drive, view, outline))
    palette = [frame.quantize(palette=_palette(), dither=0) for frame in frames]
    duration = [int(1000 * every)] * (len(frames) - 1) + [2000]
    palette[0].save(path, save_all=True, append_images=palette[1:], duration=duration, loop=0)


def _palette():
    """The colours of all frames: those drawn with, their blends with white at the edges, and greys."""
    from PIL import Image, ImageColor

    named = (SCAN, PLAN, CHOSEN, ROBOT, DRIVEN, SAMPLES, MOVER, PATH, OBSTACLE, START, GOAL)
    colors = [tuple(255 - k * (255 - part) // 4 for part in ImageColor.getrgb(c)) for c in named for k in (1, 2, 3, 4)]
    colors += [(grey, grey, grey) for grey in range(0, 256, 17)]
    image = Image.new("P", (1, 1))
    image.putpalette([part for color in colors for part in color])
    return image


def _course(drive: Drive) -> Tuple[Any, Callable[[np.ndarray], List[Tuple[float, float]]]]:
    """(picture of the course with an empty panel beside it, function from points (n, 2) [m] to its pixels)."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure
    from PIL import Image

    figure = Figure(dpi=100, layout="constrained")
    canvas = FigureCanvasAgg(figure)
    axes = figure.add_subplot()
    draw(axes, drive.world, path=False, movers=False)
    width, height = np.ptp(axes.get_xlim()), np.ptp(axes.get_ylim())
    size = WIDE if width > height else TALL
    figure.set_size_inches(size[0] / 100, size[1] / 100)
    axes.set_title(drive.title, fontsize=9, wrap=True)
    canvas.draw()
    course = Image.frombuffer("RGBA", canvas.get_width_height(), canvas.buffer_rgba()).convert("RGB")
    picture = Image.new("RGB", (course.width + PANEL, course.height), "white")
    picture.paste(course, (0, 0))
    height = course.height

    def pixel(points: np.ndarray) -> List[Tuple[float, float]]:
        at = axes.transData.transform(np.asarray(points, dtype=np.float64).reshape(-1, 2))
        return [(float(x), float(height - y)) for x, y in at]

    return picture, pixel


def _frame(background, pixel, drive: Drive, view: View, outline: np.ndarray):
    from PIL import ImageDraw

    frame = background.copy()
    pen = ImageDraw.Draw(frame)
    for mover in drive.world.movers:
        at = mover.position(drive.world_time + view.time)
        center, edge = pixel([at, np.add(at, (mover.radius, 0.0))])
        _disc(pen, center, abs(edge[0] - center[0]), MOVER)
    for point in pixel(view.samples):
        _disc(pen, point, 0.7, SAMPLES)
    driven = drive.track[drive.track[:, 0] <= view.time, 1:3]
    for points, color, width in ((driven, DRIVEN, 3), (view.plan, PLAN, 2), (view.chosen, CHOSEN, 4)):
        if len(points) > 1:
            pen.line(pixel(points), fill=color, width=width)
    for point in pixel(view.scan):
        _disc(pen, point, 1.0, SCAN)
    c, s = math.cos(view.pose[2]), math.sin(view.pose[2])
    body = np.asarray(outline) @ np.array([[c, s], [-s, c]]) + view.pose[:2]
    pen.polygon(pixel(body), outline=ROBOT, width=2)
    nose = np.array([view.pose[:2], np.add(view.pose[:2], (0.3 * c, 0.3 * s))])
    pen.line(pixel(nose), fill=ROBOT, width=2)
    _panel(pen, background.width - PANEL + 10, drive, view)
    return frame


def _disc(pen, center, radius, color) -> None:
    x, y = center
    pen.ellipse((x - radius, y - radius, x + radius, y + radius), fill=color)


def _panel(pen, left: int, drive: Drive, view: View) -> None:
    """Time, speed and every parameter: its value, and a bar from the smallest to the largest value of the drive."""
    from PIL import ImageFont

    font = ImageFont.load_default(15)
    speed = float(np.interp(view.time, drive.track[:, 0], drive.track[:, 3])) if len(drive.track) else 0.0
    pen.text((left, 40), f"time   {view.time:5.1f} s", fill="black", font=font)
    pen.text((left, 65), f"speed  {speed:5.2f} m/s", fill="black", font=font)
    top = 110
    for name, steps in drive.parameters.items():
        values = [value for _, value in steps]
        now = [value for at, value in steps if at <= view.time + 1e-6] or values[:1]
        low, high = min(values), max(values)
        share = (now[-1] - low) / (high - low) if high > low else 0.0
        pen.text((left, top), f"{name}  {now[-1]:.3g}", fill="black", font=font)
        pen.rectangle((left, top + 20, left + PANEL - 40, top + 28), outline="#bbbbbb")
        if share > 0.0:
            pen.rectangle((left, top + 20, left + share * (PANEL - 40), top + 28), fill=PATH)
        top += 42
    for color, text in (
        (SCAN, "scan"),
        (PLAN, "global plan"),
        (SAMPLES, "sampled trajectories"),
        (CHOSEN, "chosen trajectory"),
        (DRIVEN, "driven"),
    ):
        pen.rectangle((left, top + 12, left + 14, top + 18), fill=color)
        pen.text((left + 22, top + 6), text, fill="black", font=font)
        top += 22
