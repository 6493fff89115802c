"""The picture of one drive: course and driven path on the left, speed and parameters over time on the right.

The path is coloured by speed. Called by the demo and by whoever else has recorded a drive; knows nothing of ROS.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Dict, List, Tuple

import numpy as np

from worlds.draw import draw
from worlds.world import World


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
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    rows = 1 + len(drive.parameters)
    figure = Figure(figsize=(13, 8), layout="constrained")
    FigureCanvasAgg(figure)
    grid = figure.add_gridspec(rows, 2, width_ratios=(1, 1.25), height_ratios=[2.5] + [1] * (rows - 1))
    _course(figure, figure.add_subplot(grid[:, 0]), drive)
    first = figure.add_subplot(grid[0, 1])
    _speed(first, drive)
    last = first
    for row, (name, steps) in enumerate(drive.parameters.items(), start=1):
        last = figure.add_subplot(grid[row, 1], sharex=first)
        _parameter(last, name, steps, drive.track)
        if row < rows - 1:
            last.tick_params(labelbottom=False)
    if last is not first:
        first.tick_params(labelbottom=False)
    last.set_xlabel("time [s]")
    figure.suptitle(drive.title)
    figure.savefig(path, dpi=110)


def _course(figure, axes, drive):
    from matplotlib.collections import LineCollection

    track = drive.track
    draw(axes, drive.world)
    if len(track) > 1:
        points = track[:, 1:3]
        lines = LineCollection(list(np.stack([points[:-1], points[1:]], axis=1)), cmap="viridis", lw=3)
        lines.set_array(track[:-1, 3])
        lines.set_clim(0, max(0.2, float(track[:, 3].max())))
        axes.add_collection(lines)
        figure.colorbar(lines, ax=axes, label="speed [m/s]", shrink=0.6)
    if drive.contacts:
        at = np.interp(drive.contacts, track[:, 0], np.arange(len(track))).astype(int)
        axes.plot(track[at, 1], track[at, 2], "x", color="tab:red", label="contact")
    axes.legend(loc="upper left", bbox_to_anchor=(1.02, 1.0), fontsize=8, frameon=False)


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
