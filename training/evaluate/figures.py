"""Figures of the paper, drawn from our trials: time against world index, and parameter profiles."""

from __future__ import annotations

from itertools import product
from pathlib import Path
from typing import Any, Dict, Iterator, Sequence, Tuple

import numpy as np

from applr_ros1.drives.drive import Drive
from training.evaluate.stored import Results
from training.evaluate.table import read_trace
from worlds import World
from worlds.draw import draw
from worlds.world import clearance

# label and colour of each region, tightest first; LIMITS: distances to the nearest obstacle between regions [m]
REGIONS = (
    ("tight: under 0.5 m", "#cc3311"),
    ("between: 0.5 to 0.9 m", "#ddaa33"),
    ("open: over 0.9 m", "#228833"),
)
LIMITS = (0.5, 0.9)
AROUND_M = 2.0, 1.0  # margins of the map around the driven path, in x and y [m]

# colours of the methods: the baseline is red and applr green, as in the paper
COLORS = ("#d62728", "#2ca02c", "#1f77b4", "#ff7f0e", "#9467bd", "#8c564b", "#e377c2", "#7f7f7f")


def colors(results: Results) -> Dict[str, str]:
    """Return the colour of each method."""
    ordered = (
        [results.baseline]
        + ["applr"] * ("applr" in results.rivals)
        + [m for m in results.rivals if m != "applr"]
    )
    return {m: COLORS[n % len(COLORS)] for n, m in enumerate(ordered)}


def write(results: Results, folder: Path) -> Iterator[Tuple[str, str]]:
    """Write the figures for which there are trials, and yield the file name and the caption of each.

    Parameter profiles are drawn for the world of median difficulty (of those with all traces) and the physical course.
    """
    sets = [s for s in ("Training", "Test", "Other") if len(results.of_set(s)) >= 2]
    if sets:
        _save(times(results, sets), folder / "times.png")
        order = f"ordered by {results.baseline}'s time, with linear fits"
        yield (
            "times.png",
            f"Traversal time against world index, {order} (the paper's figure of its environments)",
        )
    pairs = product(results.worlds, results.methods)
    traces = {}
    for pair in pairs:
        drive = read_trace(results.folder, *pair, 0)
        if drive is not None:
            traces[pair] = drive
    traced = [w for w in results.worlds if all((w, m) in traces for m in results.methods)]
    ordered = results.by_difficulty([w for w in traced if w != "physical_course"])
    changing = [
        m for m in results.methods if "parameters" not in results.settings["methods"].get(m, {})
    ]
    for name in ordered[len(ordered) // 2 :][:1] + [w for w in traced if w == "physical_course"]:
        world = results.load(name)
        for method in changing[:3]:
            file = "".join(
                c if c.isalnum() or c in "-_." else "-" for c in f"profile_{name}_{method}.png"
            )
            _save(profile(results, world, method, traces[name, method]), folder / file)
            caption = f"Parameters of {method} along {name}: regions by the room around the robot; dotted: θ₀"
            yield file, f"{caption} (the paper's parameter profiles)"


def times(results: Results, sets: Sequence[str]) -> Any:
    """Plot the mean time in each world against world index, ordered by the baseline's mean time (paper, Fig. 6)."""
    figure = _figure(*((8.0, 4.0) if len(sets) == 1 else (5.5 * len(sets), 4.0)))
    shade, (axes,) = colors(results), figure.subplots(1, len(sets), squeeze=False)
    for ax, name in zip(axes, sets):
        good = results.trials[results.trials.success & (results.trials.set == name)]
        means = (
            good.groupby(["world", "method"])
            .time_s.mean()
            .unstack()
            .reindex(columns=results.methods)
        )
        ordered = (
            means.dropna(subset=[results.baseline])
            .sort_values(results.baseline)
            .reset_index(drop=True)
        )
        for method in results.methods:
            of_method = ordered[method].dropna()
            ax.plot(of_method, "o", ms=4.5, color=shade[method], alpha=0.8, label=method)
            if len(of_method) > 2:
                x = of_method.index.to_numpy()
                ax.plot(
                    x, np.polyval(np.polyfit(x, of_method, 1), x), "--", lw=1.4, color=shade[method]
                )
        ax.set(
            title=f"{name} worlds",
            xlabel=f"world, in the order of {results.baseline}'s mean",
            ylabel="mean time of successful trials [s]",
            ylim=(0, None),
        )
        ax.grid(alpha=0.25)
        ax.xaxis.get_major_locator().set_params(integer=True)
    handles, labels = axes[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside right upper", frameon=False, markerscale=1.5)
    return figure


def profile(results: Results, world: World, method: str, drive: Drive) -> Any:
    """Draw a method's parameters along one course, regions coloured (paper, Fig. 5)."""
    assert drive.truth is not None
    space = results.space
    time = drive.truth.time
    path = drive.truth.pose[:, :2].astype(np.float64)
    thetas = np.array([list(decision.after.values()) for decision in drive.decisions])
    decided = [decision.time for decision in drive.decisions]
    regions = np.digitize(clearance(world, path), LIMITS)  # indices (n,) into REGIONS
    rows = max(2, (len(space) + 1) // 2)
    figure = _figure(12.6, 2.1 * rows)
    grid = figure.add_gridspec(rows, 3)
    map_ = figure.add_subplot(grid[:, 0])
    draw(map_, world, path=False)
    lines = [
        map_.plot(*path[regions == region].T, ".", ms=4, color=color, label=label)[0]
        for region, (label, color) in enumerate(REGIONS)
    ]
    low, high = path.min(axis=0) - AROUND_M, path.max(axis=0) + AROUND_M
    map_.set(title=f"{world.name}, {method}", xlim=(low[0], high[0]), ylim=(low[1], high[1]))
    map_.legend(
        handles=lines, fontsize=8, loc="upper center", bbox_to_anchor=(0.5, -0.12), frameon=False
    )
    begins = np.append(decided, max(time[-1], decided[-1]))
    edges = np.flatnonzero(np.diff(regions)) + 1
    for i, name in enumerate(space.names):
        ax = figure.add_subplot(grid[i // 2, 1 + i % 2])
        ax.stairs(thetas[:, i], begins, color="black", baseline=None, lw=1.4)
        ax.axhline(space.theta0[i], color="grey", ls=":", lw=1)
        for first, end in zip(np.append(0, edges), np.append(edges, len(regions))):
            color = REGIONS[regions[first]][1]
            ax.axvspan(time[first], time[end - 1], color=color, alpha=0.18, lw=0)
        span = 0.05 * (space.high[i] - space.low[i])
        ax.set(ylim=(space.low[i] - span, space.high[i] + span), xlim=(0, begins[-1]))
        ax.set_title(name, fontsize=9)
        if i >= len(space) - 2:
            ax.set_xlabel("time [s]")
    return figure


def _figure(width: float, height: float) -> Any:
    """Return a figure made without pyplot, which would open a window and keep global state."""
    from matplotlib.figure import Figure

    return Figure(figsize=(width, height), layout="constrained")


def _save(figure: Any, path: Path) -> None:
    figure.savefig(path, dpi=110, bbox_inches="tight")
