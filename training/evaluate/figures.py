"""The paper's parameter profiles, drawn from our trials."""

from __future__ import annotations

import re
from itertools import product
from pathlib import Path
from typing import Any, Dict, Iterator, NamedTuple

import numpy as np

from applr_ros1.drives.drive import Drive
from training.evaluate.stored import Results
from training.evaluate.table import read_trace
from worlds import World
from worlds.draw import draw
from worlds.world import clearance

# Label and colour of each region by the distance to the nearest obstacle, tightest first
REGIONS = (
    ("tight: under 0.5 m", "#cc3311"),
    ("between: 0.5 to 0.9 m", "#ddaa33"),
    ("open: over 0.9 m", "#228833"),
)
LIMITS = (0.5, 0.9)  # distances to the nearest obstacle between the regions [m]
AROUND_M = np.array([2.0, 1.0])  # margins of the map around the driven path, in x and y [m]
PROFILES = 3  # largest number of methods whose parameters are drawn per world


class Figure(NamedTuple):
    """Written figure: name of its file, and caption."""

    file: str
    caption: str


def write(results: Results, folder: Path) -> Iterator[Figure]:
    """Write the profiles for which there are traces, and yield them.

    They are drawn for the world of median difficulty (of those with all traces) and
    the physical course.
    """
    # Drives {world: {method: drive}} of the worlds with all traces
    traces: Dict[str, Dict[str, Drive]] = {}
    for world in results.worlds:
        drives = {}
        for method in results.methods:
            drive = read_trace(results.folder, world, method, trial=0)
            if drive is not None:
                drives[method] = drive
        if len(drives) == len(results.methods):
            traces[world] = drives
    ordered = results.by_difficulty(list(traces.keys() - {"physical_course"}))
    drawn = ordered[len(ordered) // 2 :][:1]
    if "physical_course" in traces:
        drawn.append("physical_course")

    # A constant parameter set has no profile.
    changing = []
    for method in results.methods:
        if "parameters" not in results.settings["methods"].get(method, {}):
            changing.append(method)
    for world_name, method in product(drawn, changing[:PROFILES]):
        file_name = re.sub(r"[^\w.-]", "-", f"profile_{world_name}_{method}.png")
        _save(
            profile(results, results.load(world_name), method, traces[world_name][method]),
            folder / file_name,
        )
        regions = "regions by the room around the robot; dotted: θ₀"
        caption = f"Parameters of {method} along {world_name}: {regions}"
        yield Figure(file_name, f"{caption} (the paper's parameter profiles)")


def profile(results: Results, world: World, method: str, drive: Drive) -> Any:
    """Draw a method's parameters along one course, regions coloured (paper, Fig. 5)."""
    assert drive.truth is not None
    time = drive.truth.time
    path = drive.truth.pose[:, :2].astype(np.float64)
    regions = np.digitize(clearance(world, path), LIMITS)  # indices (n,) into REGIONS
    rows = max(2, (len(results.space) + 1) // 2)
    figure = _figure(12.6, 2.1 * rows)
    grid = figure.add_gridspec(rows, 3)

    # Map with the driven path, in the left column
    axes = figure.add_subplot(grid[:, 0])
    draw(axes, world, path=False)
    for region, (label, color) in enumerate(REGIONS):
        region_x, region_y = path[regions == region].T
        axes.plot(region_x, region_y, ".", ms=4, color=color, label=label)
    low = path.min(axis=0) - AROUND_M
    high = path.max(axis=0) + AROUND_M
    axes.set(title=f"{world.name}, {method}", xlim=(low[0], high[0]), ylim=(low[1], high[1]))
    handles = axes.get_lines()[-len(REGIONS) :]
    below = (0.5, -0.12)  # in axes' units
    axes.legend(
        handles=handles, fontsize=8, loc="upper center", bbox_to_anchor=below, frameon=False
    )

    # Parameters over time, in two columns
    space = results.space
    thetas = np.array([list(decision.after.values()) for decision in drive.decisions])
    decided = [decision.time for decision in drive.decisions]
    edges = np.append(decided, max(time[-1], decided[-1]))
    changes = np.flatnonzero(np.diff(regions)) + 1
    firsts = np.append(0, changes)
    ends = np.append(changes, len(regions))
    for i, parameter in enumerate(space.names):
        axes = figure.add_subplot(grid[i // 2, 1 + i % 2])
        axes.stairs(thetas[:, i], edges, color="black", baseline=None, lw=1.4)
        axes.axhline(space.theta0[i], color="grey", ls=":", lw=1)
        for first, end in zip(firsts, ends):
            _, color = REGIONS[regions[first]]
            axes.axvspan(time[first], time[end - 1], color=color, alpha=0.18, lw=0)
        margin = 0.05 * (space.high[i] - space.low[i])
        axes.set(ylim=(space.low[i] - margin, space.high[i] + margin), xlim=(0, edges[-1]))
        axes.set_title(parameter, fontsize=9)
        if i >= len(space) - 2:
            axes.set_xlabel("time [s]")
    return figure


def _figure(width: float, height: float) -> Any:
    """Return a figure made without pyplot, which would open a window and keep global state."""
    from matplotlib.figure import Figure as MatplotlibFigure

    return MatplotlibFigure(figsize=(width, height), layout="constrained")


def _save(figure: Any, path: Path) -> None:
    figure.savefig(path, dpi=110, bbox_inches="tight")
