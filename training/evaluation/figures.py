"""The paper's figures from our trials: time against world index, parameter profiles, driven paths.

page.py calls them.
"""

from __future__ import annotations

from pathlib import Path
from textwrap import fill
from typing import Dict, List, Optional, Tuple

import numpy as np

from training.evaluation.stored import Results
from worlds import World
from worlds.draw import draw
from worlds.world import clearance

# label and colour, the tightest first; LIMITS [m] of the distance from the robot's middle to the nearest obstacle
REGIONS = (("tight: under 0.5 m", "#cc3311"), ("between: 0.5 to 0.9 m", "#ddaa33"), ("open: over 0.9 m", "#228833"))
LIMITS = (0.5, 0.9)
HOLD = 20  # control cycles (1 s) that a region must last, or it is part of the one before


def region_of(world: World, poses: np.ndarray) -> np.ndarray:
    """(n,) int index into REGIONS for poses (n, >= 2)."""
    raw = np.digitize(clearance(world, np.asarray(poses, dtype=np.float64)[:, :2]), LIMITS)
    regions = raw.copy()
    for i in range(1, len(raw)):
        lasts = len(raw) - i >= HOLD and np.all(raw[i : i + HOLD] == raw[i])
        regions[i] = raw[i] if raw[i] == regions[i - 1] or lasts else regions[i - 1]
    return regions


# the baseline red and applr green, as in the paper
COLORS = ("#d62728", "#2ca02c", "#1f77b4", "#ff7f0e", "#9467bd", "#8c564b", "#e377c2", "#7f7f7f")
DPI = 110


def canvas(columns: int = 1, rows: int = 1, size: Tuple[float, float] = (5.5, 4.0)):
    """(figure, axes array) without pyplot: no window, no global state."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(size[0] * columns, size[1] * rows), layout="constrained")
    FigureCanvasAgg(figure)
    return figure, figure.subplots(rows, columns, squeeze=False)


def colors(results: Results) -> Dict[str, str]:
    """The colour of each method."""
    ordered = [results.baseline] + ["applr"] * ("applr" in results.rivals) + [m for m in results.rivals if m != "applr"]
    return {m: COLORS[n % len(COLORS)] for n, m in enumerate(ordered)}


def times(results: Results, folder: Path) -> Optional[str]:
    """Mean time of each world against its index in the order of the baseline's, with linear fits (paper, Fig. 6)."""
    sets = [s for s in ("Training", "Test", "Other") if len(results.of_set(s)) >= 2]
    if not sets:
        return None
    figure, axes = canvas(len(sets), size=(8.0, 4.0) if len(sets) == 1 else (5.5, 4.0))
    shade = colors(results)
    for ax, name in zip(axes[0], sets):
        good = results.trials[results.trials.success & (results.trials.set == name)]
        mean = good.groupby(["method", "world"]).time_s.mean()
        ordered = mean[results.baseline].sort_values().index if results.baseline in mean else []
        for method in results.methods:
            points = [(n, mean[method, world]) for n, world in enumerate(ordered) if (method, world) in mean]
            if not points:
                continue
            x, y = np.array(points, dtype=float).T
            ax.plot(x, y, "o", ms=4.5, color=shade[method], alpha=0.8, label=method)
            if len(x) > 2:
                ax.plot(x, np.polyval(np.polyfit(x, y, 1), x), "--", lw=1.4, color=shade[method])
        ax.set(
            title=f"{name} worlds",
            xlabel=f"world, in the order of {results.baseline}'s mean",
            ylabel="mean time of successful trials [s]",
            ylim=(0, None),
        )
        ax.grid(alpha=0.25)
        ax.xaxis.get_major_locator().set_params(integer=True)
    names = {name: handle for ax in axes[0] for handle, name in zip(*ax.get_legend_handles_labels())}
    figure.legend(list(names.values()), list(names), loc="outside right upper", frameon=False, markerscale=1.5)
    return _save(figure, folder, "times.png")


def paths(results: Results, folder: Path, name: str) -> Optional[str]:
    """The driven paths of all methods over the map of one world."""
    world, traces = results.load(name), _traces(results, name)
    if world is None or not traces:
        return None
    shade = colors(results)
    figure, axes = canvas(size=(6.5, 8.0))
    ax = axes[0, 0]
    draw(ax, world, path=False)
    for method, trace in traces.items():
        first = results.of(method, [name]).iloc[0]
        end = f"{first.time_s:.1f} s" if first.success else first.reason or "failed"
        label = fill(f"{method}: {end}", 30)  # a reason in one line would leave the map no room
        ax.plot(trace["pose"][:, 0], trace["pose"][:, 1], color=shade[method], lw=1.6, label=label)
    _frame(ax, world, traces)
    ax.set_title(f"{name}: driven paths, first trial of each method")
    ax.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0), frameon=False)
    return _save(figure, folder, f"paths_{_file(name)}.png")


def profile(results: Results, folder: Path, name: str, method: str) -> Optional[str]:
    """A method's parameters along one course, regions coloured (paper, Fig. 5)."""
    world, trace = results.load(name), results.trace(name, method, 0)
    if world is None or trace is None or not len(trace["theta"]):
        return None
    regions = region_of(world, trace["pose"])
    space = results.space
    rows = max(2, (len(space) + 1) // 2)
    figure, axes = canvas(3, rows, size=(4.2, 2.1))
    for ax in axes[:, 0]:
        ax.remove()
    grid = axes[0, 0].get_gridspec()
    map_ = figure.add_subplot(grid[:, 0])
    draw(map_, world, path=False)
    for region, (label, color) in enumerate(REGIONS):
        inside = regions == region
        map_.plot(trace["pose"][inside, 0], trace["pose"][inside, 1], ".", ms=4, color=color, label=label)
    _frame(map_, world, {method: trace})
    handles = [h for h in zip(*map_.get_legend_handles_labels()) if h[1] in [label for label, _ in REGIONS]]
    map_.legend(*zip(*handles), fontsize=8, loc="upper center", bbox_to_anchor=(0.5, -0.12), frameon=False)
    map_.set_title(f"{name}, {method}")
    begins = np.append(trace["decided"], max(trace["time"][-1], trace["decided"][-1]))
    for i, ax in enumerate(axes[:, 1:].ravel()):
        if i >= len(space):
            ax.remove()
            continue
        ax.stairs(trace["theta"][:, i], begins, color="black", baseline=None, lw=1.4)
        ax.axhline(space.theta0[i], color="grey", ls=":", lw=1)
        _shade(ax, trace["time"], regions)
        low, high = space.low[i], space.high[i]
        span = 0.05 * (high - low)
        ax.set(title=space.names[i], ylim=(low - span, high + span), xlim=(0, begins[-1]))
        ax.title.set_fontsize(9)
        if i >= len(space) - 2:
            ax.set_xlabel("time [s]")
    return _save(figure, folder, f"profile_{_file(name)}_{_file(method)}.png")


def _shade(ax, time: np.ndarray, regions: np.ndarray) -> None:
    edges = np.flatnonzero(np.diff(regions)) + 1
    for first, last in zip(np.concatenate([[0], edges]), np.concatenate([edges, [len(regions)]])):
        ax.axvspan(time[first], time[last - 1], color=REGIONS[regions[first]][1], alpha=0.18, lw=0)
        if first:
            ax.axvline(time[first], color="grey", ls="--", lw=0.6)


def chosen(results: Results) -> List[str]:
    """The worlds whose paths and profiles are drawn.

    They are the world of median difficulty among those with all traces, and the physical course.
    """
    with_traces = [w for w in results.worlds if len(_traces(results, w)) == len(results.methods)]
    ordered = results.by_difficulty([w for w in with_traces if w != "physical_course"])
    return ordered[len(ordered) // 2 :][:1] + [w for w in with_traces if w == "physical_course"]


def _traces(results: Results, name: str) -> Dict[str, dict]:
    found = {m: results.trace(name, m, 0) for m in results.methods}
    return {m: trace for m, trace in found.items() if trace is not None and len(trace["pose"])}


def _frame(ax, world: World, traces: Dict[str, dict]) -> None:
    """The part of the map that was driven through, and a little more."""
    points = np.concatenate([t["pose"][:, :2] for t in traces.values()] + [np.array([world.course.start[:2]])])
    low, high = points.min(axis=0), points.max(axis=0)
    for setter, a, b in ((ax.set_ylim, low[1], high[1]), (ax.set_xlim, low[0], high[0])):
        setter(a - 1.0, b + 1.0)
    xs = np.concatenate([world.cylinders[:, 0], world.boxes[:, 0]])
    near = xs[(xs > low[0] - 5) & (xs < high[0] + 5)]
    if len(near):
        ax.set_xlim(min(low[0] - 0.5, near.min() - 0.3), max(high[0] + 0.5, near.max() + 0.3))


def _file(name: str) -> str:
    return "".join(c if c.isalnum() or c in "-_." else "-" for c in name)


def _save(figure, folder: Path, name: str) -> str:
    figure.savefig(folder / name, dpi=DPI, bbox_inches="tight")
    return name
