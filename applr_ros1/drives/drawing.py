"""A drive as a picture: the course on the left, speed and parameters over time on the right.

The path is coloured by speed. Called by the demo and by whoever else has recorded a drive; knows nothing of ROS.
"""

from __future__ import annotations

from typing import Any, Sequence

import numpy as np

from worlds.draw import draw
from worlds.world import World


def save(
    path: str,
    title: str,
    world: World,
    track: np.ndarray,
    contacts: Sequence[float],
    names: Sequence[str],
    times: np.ndarray,
    values: np.ndarray,
) -> None:
    """Draw a drive into a PNG file. OSError if it cannot be written.

    Args:
        path: The file.
        title: Of the picture.
        world: What was driven through.
        track: (n, 6) time [s], x [m], y [m], yaw [rad], speed [m/s], turn rate [rad/s], in the world's frame.
        contacts: Times [s] at which the robot touched something.
        names: Of the parameters (k,).
        times: (d,) at which they changed [s].
        values: (d, k) that they had from then on.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.collections import LineCollection
    from matplotlib.figure import Figure

    rows = 1 + len(names)
    figure = Figure(figsize=(13, 8), layout="constrained")
    FigureCanvasAgg(figure)
    grid = figure.add_gridspec(rows, 2, width_ratios=(1, 1.25), height_ratios=[2.5] + [1] * (rows - 1))
    course, curves = figure.add_subplot(grid[:, 0]), [figure.add_subplot(grid[0, 1])]
    curves += [figure.add_subplot(grid[row, 1], sharex=curves[0]) for row in range(1, rows)]
    draw(course, world)
    if len(track) > 1:
        points = track[:, 1:3]
        lines = LineCollection(list(np.stack([points[:-1], points[1:]], axis=1)), cmap="viridis", lw=3)
        lines.set_array(track[:-1, 4])
        lines.set_clim(0, max(0.2, float(track[:, 4].max())))
        course.add_collection(lines)
        figure.colorbar(lines, ax=course, label="speed [m/s]", shrink=0.6)
    if len(contacts):
        at = np.interp(contacts, track[:, 0], np.arange(len(track))).astype(int)
        course.plot(track[at, 1], track[at, 2], "x", color="tab:red", label="contact")
    course.legend(loc="upper left", bbox_to_anchor=(1.02, 1.0), fontsize=8, frameon=False)
    _speed(curves[0], track, contacts)
    end = max(track[-1, 0] if len(track) else 0.0, times[-1] if len(times) else 0.0)
    for axes, name, column in zip(curves[1:], names, np.transpose(values)):
        _parameter(axes, name, np.append(times, end), np.append(column, column[-1:]))
    for upper in curves[:-1]:
        upper.tick_params(labelbottom=False)
    curves[-1].set_xlabel("time [s]")
    figure.suptitle(title)
    figure.savefig(path, dpi=110)


def _speed(axes: Any, track: np.ndarray, contacts: Sequence[float]) -> None:
    axes.plot(track[:, 0], track[:, 4], label="speed [m/s]")
    axes.plot(track[:, 0], track[:, 5], lw=0.7, alpha=0.7, label="turn rate [rad/s]")
    for contact in contacts:
        axes.axvline(contact, color="tab:red", lw=0.8)
    axes.legend(loc="lower left", bbox_to_anchor=(0.0, 1.0), ncol=2, fontsize=8, frameon=False)
    axes.grid(alpha=0.3)


def _parameter(axes: Any, name: str, times: np.ndarray, values: np.ndarray) -> None:
    axes.step(times, values, where="post", color="tab:purple")
    axes.set_ylabel(name, rotation=0, ha="right", va="center", fontsize=8)
    axes.tick_params(labelsize=7)
    axes.margins(y=0.3)
    axes.grid(alpha=0.3)
