"""The paper's Tables I to IV from our trials, the paper's numbers beside them. tables_more.py has what goes beyond."""

from __future__ import annotations

from typing import List

import numpy as np

from applr_ros1.policy.decision import PERIOD
from training.report import paper, statistics
from training.report.data import SETS, THIRDS, Results
from training.report.table import Table

NONE = "–"


def table_1(results: Results) -> Table:
    """Average traversal times, in seconds and in two-second decisions."""
    table = Table(
        "table_1",
        "Table I: average traversal time",
        [
            "worlds",
            "method",
            "time [s]",
            "95 % interval",
            "two-second decisions",
            "successes",
            "faster than %s [s]" % results.baseline,
            "faster [%]",
            "95 % interval [%]",
            "paper [decisions]",
            "paper [s]",
        ],
    )
    for name in SETS:
        worlds = results.of_set(name)
        for method in results.methods if worlds else []:
            mean, low, high = statistics.mean_time(results, method, worlds)
            success = results.pooled(method, worlds, "success")
            row = [
                name,
                method,
                _number(mean),
                _span(low, high),
                _number(mean / PERIOD),
                "%d of %d" % (success.sum(), len(success)),
            ]
            if method == results.baseline:
                row += [NONE] * 3
            else:
                share, low, high = statistics.gain(results, method, worlds)
                both = results.both(method, worlds)
                base, own = (statistics.mean_time(results, m, both)[0] for m in (results.baseline, method))
                row += [
                    _number(base - own),
                    _number(100 * share, 1),
                    _span(100 * low, 100 * high, 1),
                ]
            stated = paper.TIME.get((name, method))
            table.rows.append(row + ([_number(stated), _number(stated * PERIOD)] if stated else [NONE] * 2))
    table.notes = [
        "Means over the successful trials of all worlds, differences over the worlds that both have driven; intervals "
        "by bootstrap over worlds. In "
        "two-second decisions: seconds / 2, as the paper's numbers are to be read.",
        paper.UNIT,
        "The paper's improvement: training %s, test %s. %s"
        % (paper.GAIN["Training"], paper.GAIN["Test"], paper.GAIN_SLIP),
    ]
    return table


def table_2(results: Results) -> Table:
    """Welch tests per world."""
    base = results.baseline
    table = Table(
        "table_2",
        "Table II: worlds in which one method is significantly faster",
        [
            "worlds",
            "method",
            "tested",
            "method better",
            "%s better" % base,
            "method better (Holm)",
            "%s better (Holm)" % base,
            "paper: applr better",
            "paper: dwa better",
        ],
    )
    for name in SETS:
        worlds = results.of_set(name)
        for method in results.rivals if worlds else []:
            verdicts = statistics.welch(results, method, worlds)
            tested = sum(not np.isnan(v.p) for v in verdicts)
            plain, strict = statistics.count(verdicts), statistics.count(verdicts, corrected=True)
            stated = paper.BETTER.get(name, (NONE, NONE)) if (method, base) == ("applr", "dwa") else (NONE, NONE)
            table.rows.append(
                [name, method, "%d of %d" % (tested, len(verdicts))]
                + [_share(n, len(verdicts)) for n in plain + strict]
                + list(stated)
            )
    table.notes = [
        "Two-sided Welch t-test of the successful trials' times at .05, in each world; a world with "
        "fewer than two successes on a side cannot be tested and counts for neither.",
        "Holm: corrected over all tested worlds of the row. " + paper.CHANCE,
    ]
    return table


def table_3(results: Results) -> Table:
    """The same by thirds of difficulty."""
    base, thirds = results.baseline, results.thirds()
    table = Table(
        "table_3",
        "Table III: the same by difficulty",
        [
            "worlds",
            "method",
            "n",
            "method better",
            "%s better" % base,
            "%s mean time, all trials [s]" % base,
            "paper: applr better",
            "paper: dwa better",
        ],
    )
    for third in THIRDS:
        for part in ("Training", "Test", "All"):
            worlds = [w for w in thirds[third] if part == "All" or w in set(results.of_set(part))]
            for method in results.rivals if worlds else []:
                both = results.both(method, worlds)
                better, worse = statistics.count(statistics.welch(results, method, both))
                stated = paper.THIRDS[third, part] if (method, base) == ("applr", "dwa") else None
                mark = " (*)" if (third, part) in paper.SWAPPED else ""
                table.rows.append(
                    [
                        "%s %s" % (third, part),
                        method,
                        str(len(both)),
                        _share(better, len(both)),
                        _share(worse, len(both)),
                        _number(results.pooled(base, worlds, "counted").mean()),
                        "%d %%" % stated[0] if stated else NONE,
                        "%d %%%s" % (stated[1], mark) if stated else NONE,
                    ]
                )
    table.notes = [
        "Thirds of all training and test worlds of this evaluation, by %s's mean time over all trials "
        "(a failed one counts as the limit)." % base,
        "(*) " + paper.SWAP_SLIP,
    ]
    return table


def table_4(results: Results) -> Table:
    """The physical course, with failures named."""
    table = Table(
        "table_4",
        "Table IV: traversal time on the physical course",
        ["method", "time [s] (mean ± sd)", "successes", "failures", "contacts", "paper [s]"],
    )
    for method in results.methods:
        cell = results.cells[method].get("physical_course")
        if cell is None:
            continue
        failures = [r or "failed" for r, good in zip(cell.reason, cell.success) if not good]
        named = "; ".join("%d: %s" % (failures.count(r), r) for r in dict.fromkeys(failures)) or "none"
        table.rows.append(
            [
                method,
                _with_deviation(cell.times),
                "%d of %d" % (cell.success.sum(), len(cell.success)),
                named,
                "%d of %d" % (cell.collided.sum(), len(cell.collided)),
                paper.PHYSICAL.get(method, NONE),
            ]
        )
    table.notes = [
        "A simulated course of cardboard boxes after the paper's description, not the authors' own; "
        "mean and standard deviation over the successful trials. The paper's numbers are from the "
        "real robot, five trials each."
    ]
    return table


def _with_deviation(times: np.ndarray) -> str:
    if not len(times):
        return NONE
    return "%.1f ± %.1f" % (times.mean(), times.std(ddof=1) if len(times) > 1 else 0.0)


def _number(value: float, digits: int = 2) -> str:
    return "%.*f" % (digits, value) if np.isfinite(value) else NONE


def _span(low: float, high: float, digits: int = 2) -> str:
    return "%.*f to %.*f" % (digits, low, digits, high) if np.isfinite(low) else NONE


def _share(n: int, total: int) -> str:
    return "%d (%.0f %%)" % (n, 100.0 * n / total) if total else NONE


PAPER: List = [table_1, table_2, table_3, table_4]
