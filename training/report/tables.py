"""The tables of the report, as CSV and HTML: the paper's Tables I to IV from our trials, with its numbers, and more.

page.py writes them.
"""

from __future__ import annotations

import csv
import html
import io
from dataclasses import dataclass
from itertools import combinations
from typing import Dict, List, Sequence

import numpy as np

from applr_ros1.policy.decision import PERIOD
from training.evaluation.score import barn_metric
from training.report import paper, statistics
from training.report.data import SETS, Results

NONE = "–"


@dataclass
class Table:
    """name: of its file and in the page; rows of strings as long as columns; notes: sentences under it."""

    name: str
    title: str
    columns: List[str]
    rows: List[List[str]]
    notes: Sequence[str] = ()

    @classmethod
    def of(
        cls, name: str, title: str, rows: Sequence[Dict[str, str]], *notes: str, of_paper: Sequence[str] = ()
    ) -> Table:
        """A table of rows that name their columns, all the same ones in the same order.

        Columns whose names begin with "paper", and the notes `of_paper`, are left out where no row has a value in them.
        """
        cited = [c for c in (rows[0] if rows else ()) if c.startswith("paper") and any(row[c] != NONE for row in rows)]
        columns = [c for c in (rows[0] if rows else ()) if c in cited or not c.startswith("paper")]
        shown = [[row[column] for column in columns] for row in rows]
        return cls(name, title, columns, shown, [*notes, *(of_paper if cited else ())])

    def csv(self) -> str:
        """The table as CSV with a header line."""
        buffer = io.StringIO()
        csv.writer(buffer, lineterminator="\n").writerows([self.columns, *self.rows])
        return buffer.getvalue()

    def html(self) -> str:
        """The table in HTML, its title above and its notes below; a wide one scrolls in its own box."""

        def line(tag: str, row: Sequence[str]) -> str:
            return f"<tr>{''.join(f'<{tag}>{html.escape(cell)}</{tag}>' for cell in row)}</tr>"

        head, body = line("th", self.columns), "".join(line("td", row) for row in self.rows)
        notes = "".join(f"<p class=note>{html.escape(note)}</p>" for note in self.notes)
        title = f"<h2 id={self.name}>{html.escape(self.title)}</h2>"
        table = f"<table><thead>{head}</thead><tbody>{body}</tbody></table>"
        return f"{title}<div class=wide>{table}</div>{notes}"


def number(value: float, digits: int = 2) -> str:
    """A number with so many decimals, NONE where there is none."""
    return f"{value:.{digits}f}" if np.isfinite(value) else NONE


def span(low: float, high: float, digits: int = 2) -> str:
    """An interval with so many decimals, NONE where there is none."""
    return f"{low:.{digits}f} to {high:.{digits}f}" if np.isfinite(low) else NONE


def share(n: int, total: int) -> str:
    """How many of all, also in percent; NONE of nothing."""
    return f"{n} ({n / total:.0%})".replace("%", " %") if total else NONE


def table_1(results: Results) -> Table:
    """Average traversal times, in seconds and in two-second decisions."""
    rows = []
    for name, worlds, method in results.groups():
        mean, low, high = statistics.mean_time(results, method, worlds)
        success = results.pooled(method, worlds, "success")
        both = results.both(method, worlds)
        base, own = (statistics.mean_counted(results, m, both) for m in (results.baseline, method))
        gain, least, most = statistics.gain(results, method, worlds)
        rival, stated = method != results.baseline, paper.TIME.get((name, method), np.nan)
        rows.append(
            {
                "worlds": name,
                "method": method,
                "time [s]": number(mean),
                "95 % interval": span(low, high),
                "two-second decisions": number(mean / PERIOD),
                "successes": f"{success.sum():.0f} of {len(success)}",
                f"faster than {results.baseline} [s]": number(base - own) if rival else NONE,
                "faster [%]": number(100 * gain, 1) if rival else NONE,
                "95 % interval [%]": span(100 * least, 100 * most, 1) if rival else NONE,
                "paper [decisions]": number(stated),
                "paper [s]": number(stated * PERIOD),
            }
        )
    return Table.of(
        "table_1",
        "Table I: average traversal time",
        rows,
        "Time: mean over the successful trials of all worlds. Faster: over all trials of the worlds that both have "
        "driven, a failed one counting as the limit. Intervals by bootstrap over worlds. In two-second decisions: "
        "seconds / 2.",
        of_paper=(
            paper.UNIT,
            f"The paper's improvement: training {paper.GAIN['Training']}, test {paper.GAIN['Test']}. {paper.GAIN_SLIP}",
        ),
    )


def table_2(results: Results) -> Table:
    """Welch tests per world."""
    base, rows = results.baseline, []
    for name, worlds, method in results.groups(results.rivals):
        verdicts = statistics.welch(results, method, worlds)
        counts = statistics.count(verdicts) + statistics.count(verdicts, corrected=True)
        shares = [share(n, len(verdicts)) for n in counts]
        stated = paper.BETTER.get(name, (NONE, NONE)) if (method, base) == ("applr", "dwa") else (NONE, NONE)
        rows.append(
            {
                "worlds": name,
                "method": method,
                "tested": f"{sum(not np.isnan(v.p) for v in verdicts)} of {len(verdicts)}",
                "method better": shares[0],
                f"{base} better": shares[1],
                "method better (Holm)": shares[2],
                f"{base} better (Holm)": shares[3],
                "paper: applr better": stated[0],
                "paper: dwa better": stated[1],
            }
        )
    return Table.of(
        "table_2",
        "Table II: worlds in which one method is significantly faster",
        rows,
        "Two-sided Welch t-test of the successful trials' times at .05, in each world; a world with "
        "fewer than two successes on a side cannot be tested and counts for neither.",
        "Holm: corrected over all tested worlds of the row. " + paper.CHANCE,
    )


def table_3(results: Results) -> Table:
    """The same by thirds of difficulty."""
    base, thirds, rows = results.baseline, results.thirds(), []
    parts = {part: set(results.of_set(part)) for part in SETS[:2]}
    for third, part in paper.THIRDS:
        worlds = [w for w in thirds[third] if w in parts.get(part, thirds[third])]
        for method in results.rivals if worlds else []:
            both = results.both(method, worlds)
            better, worse = statistics.count(statistics.welch(results, method, both))
            stated = (NONE, NONE)
            if (method, base) == ("applr", "dwa"):
                mark = " (*)" if (third, part) in paper.SWAPPED else ""
                theirs = paper.THIRDS[third, part]
                stated = f"{theirs[0]} %", f"{theirs[1]} %{mark}"
            rows.append(
                {
                    "worlds": f"{third} {part}",
                    "method": method,
                    "n": str(len(both)),
                    "method better": share(better, len(both)),
                    f"{base} better": share(worse, len(both)),
                    f"{base} mean time, all trials [s]": number(results.pooled(base, worlds, "counted").mean()),
                    "paper: applr better": stated[0],
                    "paper: dwa better": stated[1],
                }
            )
    return Table.of(
        "table_3",
        "Table III: the same by difficulty",
        rows,
        f"Thirds of all training and test worlds of this evaluation, by {base}'s mean time over all trials "
        "(a failed one counts as the limit).",
        of_paper=("(*) " + paper.SWAP_SLIP,),
    )


def table_4(results: Results) -> Table:
    """The physical course, with failures named."""
    rows = []
    for method in results.methods:
        cell = results.cells[method].get("physical_course")
        if cell is None:
            continue
        times, failures = cell.times, [r or "failed" for r, good in zip(cell.reason, cell.success) if not good]
        deviation = times.std(ddof=1) if len(times) > 1 else 0.0
        rows.append(
            {
                "method": method,
                "time [s] (mean ± sd)": f"{times.mean():.1f} ± {deviation:.1f}" if len(times) else NONE,
                "successes": f"{cell.success.sum()} of {len(cell.success)}",
                "failures": "; ".join(f"{failures.count(r)}: {r}" for r in dict.fromkeys(failures)) or "none",
                "contacts": f"{cell.collided.sum()} of {len(cell.collided)}",
                "paper [s]": paper.PHYSICAL.get(method, NONE),
            }
        )
    return Table.of(
        "table_4",
        "Table IV: traversal time on the physical course",
        rows,
        "A simulated course of cardboard boxes after the paper's description, not the authors' own; "
        "mean and standard deviation over the successful trials.",
        of_paper=("The paper's numbers are from the real robot, five trials each.",),
    )


PAPER = [table_1, table_2, table_3, table_4]


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
    for name in SETS:
        worlds = results.of_set(name)
        couples = [c for c in combinations(results.methods, 2) if results.both(c[0], worlds, c[1])]
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


MORE = [pairs, rates, smoothness, methods]
