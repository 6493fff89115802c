"""Tables beyond the paper's: rates with intervals, BARN's metric, smoothness, ablation, methods.

page.py writes them.
"""

from __future__ import annotations

from itertools import combinations
from typing import List

import numpy as np

from training.evaluation.score import barn_metric
from training.report import statistics
from training.report.data import SETS, Results
from training.report.table import NONE, Table, number, share, span


def rates(results: Results) -> Table:
    """What share succeeds, touches something, runs out of time; BARN's metric."""
    rows = []
    for name, worlds, method in results.groups():
        row = {"worlds": name, "method": method, "trials": str(len(results.pooled(method, worlds, "success")))}
        for column, field in (("success", "success"), ("collided", "collided"), ("timed out", "timeout")):
            row[f"{column} [%]"] = _rate(results, method, worlds, field)
        for lower in (2, 4):
            cells = [results.cells[method][w] for w in worlds if w in results.cells[method]]
            scores = [barn_metric(c.success, c.collided, c.time, c.route, float(lower)) for c in cells]
            sums, counts = np.array([s.sum() for s in scores]), np.array([float(len(s)) for s in scores])
            value, low, high = statistics.over_worlds([sums, counts], statistics.ratio)
            row[f"metric, {lower} OT"] = number(value, 3)
            row[f"95 % interval, {lower} OT"] = span(low, high, 3)
        rows.append(row)
    return Table.of(
        "rates",
        "Success, collisions, time-outs, and BARN's metric",
        rows,
        "Rates with Wilson's 95 % interval, wider where the trials of a world go alike; collided: touched anything at "
        "any time, also where the trial went on and succeeded.",
        "BARN's metric: success × OT / clip(AT, 2 OT, 8 OT) (since 2025, at most .5; before, the "
        "lower clip was 4 OT, at most .25), OT = reference route / (2 m/s), intervals by bootstrap "
        "over worlds; a trial with a contact scores 0. It is comparable with the Challenge's numbers "
        "only under --protocol barn-challenge: default DWA there has .16 (2 OT), success .88, "
        "collision .048, time-out .072, 33.5 s.",
    )


def smoothness(results: Results) -> Table:
    """How smooth, how near, how restless."""
    rows = []
    for name, worlds, method in results.groups():
        success = results.pooled(method, worlds, "success").astype(bool)
        fields = ("jerk", "turn", "clearance", "switching", "path_length", "route")
        good = {field: results.pooled(method, worlds, field)[success] for field in fields}
        values = {
            "mean |jerk| [m/s³]": good["jerk"],
            "mean |yaw acceleration| [rad/s²]": good["turn"],
            "median smallest range [m]": good["clearance"],
            "change of parameters per decision": good["switching"],
            "driven / reference route": good["path_length"] / good["route"],
        }
        known = {column: value[~np.isnan(value)] for column, value in values.items()}
        average = {column: np.median if column.startswith("median") else np.mean for column in known}
        told = {column: number(float(average[column](v)), 3) if len(v) else NONE for column, v in known.items()}
        rows.append({"worlds": name, "method": method, **told})
    return Table.of(
        "smoothness",
        "Smoothness, clearance and switching",
        rows,
        "Over successful trials; true speeds at 20 Hz. The smallest range is the laser's (its sensor "
        "sits .055 m ahead of the robot's middle). Change of parameters: mean |difference| of the "
        "eight, each scaled to [-1, 1].",
    )


def pairs(results: Results) -> Table:
    """Every method against every other: paired over worlds, and world by world."""
    rows = []
    whole = [m for m in results.methods if "-without-" not in m]  # the ablation has a table of its own
    for name in SETS:
        worlds = results.of_set(name)
        couples = [c for c in combinations(whole, 2) if results.both(c[0], worlds, c[1])]
        found = [statistics.paired(results, a, b, worlds) for a, b in couples]
        adjusted = statistics.holm_adjusted(np.array([f.p for f in found]))
        for (a, b), f, p in zip(couples, found, adjusted):
            verdicts = statistics.welch(results, a, worlds, b)
            faster, slower = (share(n, len(verdicts)) for n in statistics.count(verdicts, corrected=True))
            rows.append(
                {
                    "worlds": name,
                    "method": a,
                    "other": b,
                    "n": str(f.worlds),
                    "difference, all trials [s]": number(f.difference),
                    "95 % interval": span(f.low, f.high),
                    "p": _p(f.p),
                    "p (Holm)": _p(p),
                    "method faster in": faster,
                    "other faster in": slower,
                }
            )
    return Table.of(
        "pairs",
        "Between any two methods",
        rows,
        "Difference: the method's mean time less the other's, over worlds, with a failed trial counting as the limit; "
        "negative where the method is faster. Interval by bootstrap over worlds. The trials of both have the same "
        "seeds, and p is of the test of this mean by exchanging the two methods in worlds at random.",
        "Holm: p corrected for all pairs of the same worlds, so that the chance of any false difference among them is "
        "at most .05 where p (Holm) < .05 is taken for a difference. Faster in: worlds by Welch's test of the "
        "successful trials' times at .05, corrected by Holm over the worlds of the row.",
    )


def ablation(results: Results) -> Table:
    """Methods X-without-P beside X: what share of X's gain goes when P stays at theta_0."""
    rows = []
    for name in results.methods:
        method, found, parameter = name.partition("-without-")
        if not found or method not in results.methods:
            continue
        worlds = results.both(method, results.both(name, results.worlds))
        base, whole, without = (statistics.mean_counted(results, m, worlds) for m in (results.baseline, method, name))
        lost = 100.0 * (without - whole) / (base - whole) if base != whole else np.nan
        rows.append(
            {
                "method": method,
                "parameter held": parameter,
                "time, all trials [s]": number(without),
                "success [%]": _rate(results, name, worlds, "success"),
                "share of the gain lost [%]": number(lost, 0),
            }
        )
    return Table.of(
        "ablation",
        "Ablation: one parameter at a time held at θ₀",
        rows,
        "Means over all trials in the worlds that all three have driven, a failed one counting as the limit. Shares "
        "need not add up to 100: parameters act together, and one that is held may be made up for by the others.",
    )


def methods(results: Results) -> Table:
    """What each method is, as recorded when it was driven."""
    rows = []
    for name in results.methods:
        parts = []
        for key, value in results.settings.get("methods", {}).get(name, {}).items():
            if isinstance(value, dict):
                items = value.items()
                value = ", ".join(("%s %g" if isinstance(v, (int, float)) else "%s %s") % (k, v) for k, v in items)
            parts.append(f"{key}: {value}")
        rows.append({"method": name, "what it is": "; ".join(parts) or NONE})
    return Table.of("methods", "Methods", rows)


def _p(value: float) -> str:
    if np.isnan(value):
        return NONE
    return "≤ 0.0001" if value < 1.5e-4 else f"{value:.4f}"


def _rate(results: Results, method: str, worlds: List[str], field: str) -> str:
    flags = [getattr(results.cells[method][w], field) for w in worlds if w in results.cells[method]]
    if not flags:
        return NONE
    share, low, high = statistics.rate(flags)
    return f"{100 * share:.1f} ({100 * low:.1f} to {100 * high:.1f})"


MORE = [pairs, rates, smoothness, ablation, methods]
