"""Tables beyond the paper's: rates with intervals, BARN's metric in both versions, smoothness, ablation, methods.

page.py writes them.
"""

from __future__ import annotations

from itertools import combinations

import numpy as np

from training.report import statistics
from training.report.data import SETS, Results
from training.report.table import Table
from training.report.tables import NONE, _number, _share, _span


def rates(results: Results) -> Table:
    """What share succeeds, touches something, runs out of time; BARN's metric."""
    table = Table(
        "rates",
        "Success, collisions, time-outs, and BARN's metric",
        [
            "worlds",
            "method",
            "trials",
            "success [%]",
            "collided [%]",
            "timed out [%]",
            "metric, 2 OT",
            "95 % interval",
            "metric, 4 OT",
            "95 % interval",
        ],
    )
    for name in SETS:
        worlds = results.of_set(name)
        for method in results.methods if worlds else []:
            row = [name, method, str(len(results.pooled(method, worlds, "success")))]
            row += [_rate(results.pooled(method, worlds, field)) for field in ("success", "collided", "timeout")]
            cells = [results.cells[method][w] for w in worlds if w in results.cells[method]]
            for lower in (2.0, 4.0):
                scores = [statistics.barn_metric(c, lower) for c in cells]
                value, low, high = statistics.over_worlds(
                    [np.array([s.sum() for s in scores]), np.array([float(len(s)) for s in scores])],
                    statistics.ratio,
                )
                row += [_number(value, 3), _span(low, high, 3)]
            table.rows.append(row)
    table.notes = [
        "Rates with Wilson's 95 % interval; collided: touched anything at any time, also where the "
        "trial went on and succeeded.",
        "BARN's metric: success × OT / clip(AT, 2 OT, 8 OT) (since 2025, at most .5; before, the "
        "lower clip was 4 OT, at most .25), OT = reference route / (2 m/s), intervals by bootstrap "
        "over worlds; a trial with a contact scores 0. It is comparable with the Challenge's numbers "
        "only under --protocol barn-challenge: default DWA there has .16 (2 OT), success .88, "
        "collision .048, time-out .072, 33.5 s.",
    ]
    return table


def smoothness(results: Results) -> Table:
    """How smooth, how near, how restless."""
    table = Table(
        "smoothness",
        "Smoothness, clearance and switching",
        [
            "worlds",
            "method",
            "mean |jerk| [m/s³]",
            "mean |yaw acceleration| [rad/s²]",
            "median smallest range [m]",
            "change of parameters per decision",
            "driven / reference route",
        ],
    )
    for name in SETS:
        worlds = results.of_set(name)
        for method in results.methods if worlds else []:
            success = results.pooled(method, worlds, "success")

            def good(field, method=method, worlds=worlds, success=success):
                return results.pooled(method, worlds, field)[success]

            if success.any():
                values = [
                    np.nanmean(good("jerk")),
                    np.nanmean(good("turn")),
                    np.nanmedian(good("clearance")),
                    np.nanmean(good("switching")),
                    np.nanmean(good("path_length") / good("route")),
                ]
            else:
                values = [np.nan] * 5
            table.rows.append([name, method] + [_number(float(v), 3) for v in values])
    table.notes = [
        "Over successful trials; true speeds at 20 Hz. The smallest range is the laser's (its sensor "
        "sits .12 m ahead of the robot's middle). Change of parameters: mean |difference| of the "
        "eight, each scaled to [-1, 1]."
    ]
    return table


def pairs(results: Results) -> Table:
    """Every method against every other: paired over worlds, and world by world."""
    table = Table(
        "pairs",
        "Between any two methods",
        [
            "worlds",
            "method",
            "other",
            "n",
            "difference, all trials [s]",
            "95 % interval",
            "p",
            "p (Holm)",
            "method faster in",
            "other faster in",
        ],
    )
    whole = [m for m in results.methods if "-without-" not in m]  # the ablation has a table of its own
    for name in SETS:
        worlds = results.of_set(name)
        couples = [c for c in combinations(whole, 2) if results.both(c[0], worlds, c[1])]
        found = [statistics.paired(results, a, b, worlds) for a, b in couples]
        adjusted = statistics.holm_adjusted(np.array([f.p for f in found]))
        for (a, b), f, p in zip(couples, found, adjusted):
            verdicts = statistics.welch(results, a, worlds, b)
            better = [_share(n, len(verdicts)) for n in statistics.count(verdicts, corrected=True)]
            row = [name, a, b, str(f.worlds), _number(f.difference), _span(f.low, f.high), _p(f.p), _p(p)]
            table.rows.append(row + better)
    table.notes = [
        "Difference: the method's mean time less the other's, over worlds, with a failed trial counting as the limit; "
        "negative where the method is faster. Interval by bootstrap over worlds. The trials of both have the same "
        "seeds, and p is of Wilcoxon's signed-rank test of the worlds' differences.",
        "Holm: p corrected for all pairs of the same worlds, so that the chance of any false difference among them is "
        "at most .05 where p (Holm) < .05 is taken for a difference. Faster in: worlds by Welch's test of the "
        "successful trials' times at .05, corrected by Holm over the worlds of the row.",
    ]
    return table


def ablation(results: Results) -> Table:
    """Methods X-without-P beside X: what share of X's gain goes when P stays at theta_0."""
    table = Table(
        "ablation",
        "Ablation: one parameter at a time held at θ₀",
        ["method", "parameter held", "time [s]", "success [%]", "share of the gain lost [%]"],
    )
    for name in results.methods:
        method, found, parameter = name.partition("-without-")
        if not found or method not in results.methods:
            continue
        worlds = results.both(method, results.both(name, results.worlds))
        base, whole, without = (statistics.mean_time(results, m, worlds)[0] for m in (results.baseline, method, name))
        lost = 100.0 * (without - whole) / (base - whole) if base != whole else np.nan
        table.rows.append(
            [method, parameter, _number(without), _rate(results.pooled(name, worlds, "success")), _number(lost, 0)]
        )
    table.notes = [
        "Means over successful trials in all worlds that all three have driven. Shares need not add up to "
        "100: parameters act together, and one that is held may be made up for by the others."
    ]
    return table


def methods(results: Results) -> Table:
    """What each method is, as recorded when it was driven."""
    table = Table("methods", "Methods", ["method", "what it is"])
    for name in results.methods:
        told = results.settings.get("methods", {}).get(name, {})
        parts = []
        for key, value in told.items():
            if isinstance(value, dict):
                value = ", ".join(
                    "%s %g" % item if isinstance(item[1], (int, float)) else "%s %s" % item for item in value.items()
                )
            parts.append("%s: %s" % (key, value))
        table.rows.append([name, "; ".join(parts) or NONE])
    return table


def _p(value: float) -> str:
    if np.isnan(value):
        return NONE
    return "< 0.0001" if value < 1e-4 else "%.4f" % value


def _rate(flags: np.ndarray) -> str:
    if not len(flags):
        return NONE
    low, high = statistics.wilson(int(flags.sum()), len(flags))
    return "%.1f (%.1f to %.1f)" % (100 * flags.mean(), 100 * low, 100 * high)


MORE = [pairs, rates, smoothness, ablation, methods]
