"""A drive as a picture and as an animation: the course on the left, speed and parameters over time on the right.

The picture's path is coloured by speed. The animation draws the same once, without the path; each frame adds what moves
and where its time is on the curves. Called by the demo and by whoever else has recorded a drive; knows nothing of ROS.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any, Dict, List, Tuple

import numpy as np

from worlds.draw import GOAL, MOVER, draw
from worlds.world import World

SCAN, PLAN, CHOSEN, ROBOT, DRIVEN, SAMPLES = "#cc3311", "#4477aa", "#ee7733", "#228833", "#66ccaa", "#ddcc77"
MOVING = {SCAN: "scan", PLAN: "global plan", SAMPLES: "sampled trajectories", CHOSEN: "chosen trajectory"}
STEP = 0.1  # s of simulated time between two frames
MOST_FRAMES = 300  # of longer drives the frames are farther apart


@dataclass
class View:
    """What was known at one instant of a drive, everything in the world's frame.

    time    [s] since the goal was sent
    pose    (x, y, yaw) of the robot
    scan    (k, 2) points that the laser measured
    plan    (n, 2) the global plan
    chosen  (m, 2) the trajectory that the local planner chose
    samples (j, 2) points of the trajectories that it sampled
    """

    time: float
    pose: Tuple[float, float, float]
    scan: np.ndarray
    plan: np.ndarray
    chosen: np.ndarray
    samples: np.ndarray = field(default_factory=lambda: np.empty((0, 2)))


@dataclass
class Drive:
    """What was recorded of a drive in `world`, in the world's frame.

    track       (n, 5) float64: time [s], x [m], y [m], speed [m/s], turn rate [rad/s]
    parameters  per name the (time [s], value) pairs at which it was seen to have that value
    contacts    times [s] at which the robot touched something
    views       what was known while driving, for the animation; in the order of time
    world_time  time [s] of the world when the drive's time was 0: what its moving obstacles go by
    """

    world: World
    track: np.ndarray
    parameters: Dict[str, List[Tuple[float, float]]] = field(default_factory=dict)
    contacts: List[float] = field(default_factory=list)
    title: str = ""
    views: List[View] = field(default_factory=list)
    world_time: float = 0.0

    def length(self) -> float:
        """Driven distance [m]."""
        return float(np.hypot(*np.diff(self.track[:, 1:3], axis=0).T).sum())


def save(drive: Drive, path: str) -> None:
    """Draw `drive` into the PNG file `path`. OSError if it cannot be written."""
    figure, (course, *_) = _figure(drive)
    track = drive.track
    if len(track) > 1:
        from matplotlib.collections import LineCollection

        points = track[:, 1:3]
        lines = LineCollection(list(np.stack([points[:-1], points[1:]], axis=1)), cmap="viridis", lw=3)
        lines.set_array(track[:-1, 3])
        lines.set_clim(0, max(0.2, float(track[:, 3].max())))
        course.add_collection(lines)
        figure.colorbar(lines, ax=course, label="speed [m/s]", shrink=0.6)
    if drive.contacts:
        at = np.interp(drive.contacts, track[:, 0], np.arange(len(track))).astype(int)
        course.plot(track[at, 1], track[at, 2], "x", color="tab:red", label="contact")
    _legend(course)
    figure.savefig(path, dpi=110)


def save_animation(drive: Drive, outline: np.ndarray, path: str) -> None:
    """Write the animation of a drive.

    Args:
        drive: the recorded drive, with at least one view.
        outline: (n, 2) outline of the robot [m] in its own frame.
        path: the GIF file.

    Raises:
        ValueError: without any view.
        OSError: if the file cannot be written.
    """
    from PIL import Image, ImageColor

    views = drive.views
    if not views:
        raise ValueError("an animation needs at least one view")
    figure, axes = _figure(drive, moving=True)
    for color, label in {**MOVING, DRIVEN: "driven"}.items():
        axes[0].plot([], [], color=color, lw=3, label=label)
    _legend(axes[0])
    figure.set_dpi(80)
    figure.canvas.draw()
    size = figure.canvas.get_width_height()
    background = Image.frombuffer("RGBA", size, figure.canvas.buffer_rgba()).convert("RGB")
    palette = Image.new("P", (1, 1))
    moving = [part for color in (*MOVING, DRIVEN, ROBOT, MOVER, GOAL, "white") for part in ImageColor.getrgb(color)]
    palette.putpalette(moving + (background.quantize(240).getpalette() or []))
    every = max(STEP, (views[-1].time - views[0].time) / MOST_FRAMES)
    frames, due = [], -math.inf
    for view in views:
        if view.time >= due:
            due = view.time + every - 1e-6
            frame = background.copy()
            _move(frame, axes, drive, view, outline)
            frames.append(frame.quantize(palette=palette, dither=Image.Dither.NONE))
    duration = [int(1000 * every)] * (len(frames) - 1) + [2000]
    frames[0].save(path, save_all=True, append_images=frames[1:], duration=duration, loop=0)


def _move(frame: Any, axes: List[Any], drive: Drive, view: View, outline: np.ndarray) -> None:
    """Draws what was known at a time into a frame."""
    from PIL import ImageDraw

    pen = ImageDraw.Draw(frame)

    def pixels(points: Any, on: Any = axes[0]) -> List[Tuple[float, float]]:
        at = on.transData.transform(np.asarray(points, dtype=np.float64).reshape(-1, 2))
        return [(float(x), float(frame.height - y)) for x, y in at]

    def discs(points: Any, radius: float, color: str) -> None:
        for x, y in pixels(points):
            pen.ellipse((x - radius, y - radius, x + radius, y + radius), fill=color)

    for mover in drive.world.movers:
        at = mover.position(drive.world_time + view.time)
        (left, _), (right, _) = pixels([at, np.add(at, (mover.radius, 0.0))])
        discs(at, right - left, MOVER)
    discs(view.samples, 0.7, SAMPLES)
    driven = drive.track[drive.track[:, 0] <= view.time, 1:3]
    for points, color, width in ((driven, DRIVEN, 3), (view.plan, PLAN, 2), (view.chosen, CHOSEN, 4)):
        if len(points) > 1:
            pen.line(pixels(points), fill=color, width=width)
    discs(view.scan, 1.0, SCAN)
    c, s = math.cos(view.pose[2]), math.sin(view.pose[2])
    body = np.asarray(outline) @ np.array([[c, s], [-s, c]]) + view.pose[:2]
    pen.polygon(pixels(body), outline=ROBOT, width=2)
    pen.line(pixels([view.pose[:2], np.add(view.pose[:2], (0.3 * c, 0.3 * s))]), fill=ROBOT, width=2)
    for curve in axes[1:]:
        pen.line(pixels([(view.time, value) for value in curve.get_ylim()], curve), fill=GOAL, width=1)


def _figure(drive: Drive, moving: bool = False) -> Tuple[Any, List[Any]]:
    """(figure, [axes of the course, of the speed, of each parameter]); moving: without what frames add."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    rows = 1 + len(drive.parameters)
    figure = Figure(figsize=(13, 8), layout="constrained")
    FigureCanvasAgg(figure)
    grid = figure.add_gridspec(rows, 2, width_ratios=(1, 1.25), height_ratios=[2.5] + [1] * (rows - 1))
    axes = [figure.add_subplot(grid[:, 0]), figure.add_subplot(grid[0, 1])]
    draw(axes[0], drive.world, path=not moving, movers=not moving)
    _speed(axes[1], drive)
    for row, (name, steps) in enumerate(drive.parameters.items(), start=1):
        axes.append(figure.add_subplot(grid[row, 1], sharex=axes[1]))
        _parameter(axes[-1], name, steps, drive.track)
    for upper in axes[1:-1]:
        upper.tick_params(labelbottom=False)
    axes[-1].set_xlabel("time [s]")
    figure.suptitle(drive.title)
    return figure, axes


def _legend(course):
    course.legend(loc="upper left", bbox_to_anchor=(1.02, 1.0), fontsize=8, frameon=False)


def _speed(axes, drive):
    time, speed, turn = drive.track[:, 0], drive.track[:, 3], drive.track[:, 4]
    axes.plot(time, speed, label="speed [m/s]")
    axes.plot(time, turn, lw=0.7, alpha=0.7, label="turn rate [rad/s]")
    for contact in drive.contacts:
        axes.axvline(contact, color="tab:red", lw=0.8)
    axes.legend(loc="lower left", bbox_to_anchor=(0.0, 1.0), ncol=2, fontsize=8, frameon=False)
    axes.grid(alpha=0.3)


def _parameter(axes, name, steps, track):
    times, values = np.array(steps, dtype=np.float64).reshape(-1, 2).T
    end = max(track[-1, 0] if len(track) else 0.0, times[-1] if len(times) else 0.0)
    axes.step(np.append(times, end), np.append(values, values[-1:]), where="post", color="tab:purple")
    axes.set_ylabel(name, rotation=0, ha="right", va="center", fontsize=8)
    axes.tick_params(labelsize=7)
    axes.margins(y=0.3)
    axes.grid(alpha=0.3)
