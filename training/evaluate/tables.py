"""Tables of the report: the paper's Tables I to IV from our trials, with the paper's numbers, and further tables."""

from __future__ import annotations

import html
import warnings
from itertools import combinations
from typing import Callable, Dict, Iterator, NamedTuple, Sequence, Tuple

import numpy as np
import pandas as pd
import scipy

from applr_ros1.policy.decision import PERIOD
from training.evaluate import paper
from training.evaluate.compare import LEVEL, over_worlds, rate
from training.evaluate.score import FAILURE_SECONDS, barn_metric
from training.evaluate.stored import SETS, Results

NONE = "–"  # cell without a value
Rows = Iterator[Dict[str, str]]


class Table(NamedTuple):
    """Table of the report: name of its file, title, rows of text, and notes below them."""

    name: str
    title: str
    rows: pd.DataFrame
    notes: Sequence[str] = ()

    def html(self) -> str:
        """Return the table as HTML, with its title above and its notes below. A wide table scrolls in its own box."""
        with pd.option_context("display.max_colwidth", None):
            table = self.rows.to_html(index=False, border=0)
        notes = "".join(f"<p class=note>{html.escape(note)}</p>" for note in self.notes)
        return (
            f"<h2 id={self.name}>{html.escape(self.title)}</h2><div class=wide>{table}</div>{notes}"
        )


Made = Callable[[Results], Table]


def number(value: float, digits: int = 2) -> str:
    """Return a number with the given number of decimals, or NONE if it is not finite."""
    return f"{value:.{digits}f}" if np.isfinite(value) else NONE


def span(low: float, high: float, digits: int = 2) -> str:
    """Return an interval with the given number of decimals, or NONE if there is no interval."""
    return f"{low:.{digits}f} to {high:.{digits}f}" if np.isfinite(low) else NONE


def share(n: int, total: int) -> str:
    """Return a count with its percentage of the total, or NONE if the total is 0."""
    return f"{n} ({n / total:.0%})".replace("%", " %") if total else NONE


def table(
    title: str, *notes: str, of_paper: Sequence[str] = ()
) -> Callable[[Callable[[Results], Rows]], Made]:
    """Return a decorator: it turns a function that yields rows into a function that makes the table of the same name.

    Columns whose names begin with "paper" are left out if no row has a value in them. If all these columns are left
    out, the notes `of_paper` about them are left out as well.
    """

    def of(rows: Callable[[Results], Rows]) -> Made:
        def made(results: Results) -> Table:
            frame = pd.DataFrame(list(rows(results)))
            paper_columns = [column for column in frame if column.startswith("paper")]
            empty = [column for column in paper_columns if (frame[column] == NONE).all()]
            about = () if len(empty) == len(paper_columns) else of_paper
            return Table(rows.__name__, title, frame.drop(columns=empty), (*notes, *about))

        return made

    return of


def welch(trials: pd.DataFrame, others: pd.DataFrame) -> pd.DataFrame:
    """Compare the times of two methods' successful trials in each world that both have driven (two-sided Welch test).

    Returns:
        A row per world: "sign", -1 if the first method is faster, 1 if the other is; the p-value "p"; and "holm", p
        corrected over the worlds. p is NaN if a method has fewer than two successes, or if neither method's times vary.
    """
    both = [world for world in trials.world.unique() if world in set(others.world)]
    ours, theirs = (
        one.assign(t=one.time_s.where(one.success))
        .pivot(index="world", columns="trial", values="t")
        .loc[both]
        for one in (trials, others)
    )
    with warnings.catch_warnings():
        warnings.simplefilter(
            "ignore", RuntimeWarning
        )  # scipy warns if a sample is small or hardly varies
        test = scipy.stats.ttest_ind(ours, theirs, axis=1, equal_var=False, nan_policy="omit")
    varies = [one.max(axis=1) > one.min(axis=1) for one in (ours, theirs)]
    p = np.where(varies[0] | varies[1], test.pvalue, np.nan)
    return pd.DataFrame(
        {"sign": np.sign(test.statistic), "p": p, "holm": holm_adjusted(p)}, dtype=float
    )


def significant(tests: pd.DataFrame, column: str = "p") -> Tuple[int, int]:
    """Return in how many worlds the first method is significantly faster at .05, and in how many the other is."""
    worlds = tests.sign[tests[column] < LEVEL]
    return int((worlds == -1).sum()), int((worlds == 1).sum())


def holm_adjusted(p: np.ndarray) -> np.ndarray:
    """Return p-values (n,) adjusted by Holm's procedure. NaN stays NaN and does not count as a test."""
    adjusted = np.full(len(p), np.nan)
    order = np.argsort(p)[: np.count_nonzero(~np.isnan(p))]  # argsort puts NaN last
    adjusted[order] = np.maximum.accumulate(
        np.minimum(1.0, np.arange(len(order), 0, -1) * p[order])
    )
    return adjusted


@table(
    "Table I: average traversal time",
    "Time: mean over the successful trials of all worlds. Faster: difference of the scores (times "
    f"in which a failed trial counts as {FAILURE_SECONDS:g} s), averaged over the worlds that both "
    "have driven. Intervals: bootstrap over worlds. Two-second decisions: seconds / 2.",
    of_paper=(
        paper.UNIT,
        f"The paper's improvement: training {paper.GAIN['Training']}, test {paper.GAIN['Test']}. {paper.GAIN_SLIP}",
    ),
)
def table_1(results: Results) -> Rows:
    """Tabulate average traversal times, in seconds and in two-second decisions."""
    for name, method, trials in results.groups():
        times = trials.time_s.where(trials.success).groupby(trials.world, sort=False)
        mean, low, high = over_worlds(times.sum(), times.count())
        comparison = results.compare(method, results.baseline, results.of_set(name))
        gain, least, most = comparison.gain
        rival, stated = method != results.baseline, paper.TIME.get((name, method), np.nan)
        yield {
            "worlds": name,
            "method": method,
            "time [s]": number(mean),
            "95 % interval": span(low, high),
            "two-second decisions": number(mean / PERIOD),
            "successes": f"{trials.success.sum()} of {len(trials)}",
            f"faster than {results.baseline} [s]": number(-comparison.difference.value)
            if rival
            else NONE,
            "faster [%]": number(100 * gain, 1) if rival else NONE,
            "95 % interval [%]": span(100 * least, 100 * most, 1) if rival else NONE,
            "paper [decisions]": number(stated),
            "paper [s]": number(stated * PERIOD),
        }


@table(
    "Table II: worlds in which one method is significantly faster",
    "Two-sided Welch t-test of the successful trials' times at .05, in each world. A world in which a method has "
    "fewer than two successes cannot be tested and counts for neither.",
    "Holm: corrected over all tested worlds of the row. " + paper.CHANCE,
)
def table_2(results: Results) -> Rows:
    """Tabulate the Welch tests per world."""
    base = results.baseline
    for name, method, trials in results.groups(results.rivals):
        tests = welch(trials, results.of(base, results.of_set(name)))
        counts = significant(tests) + significant(tests, "holm")
        shares = [share(n, len(tests)) for n in counts]
        stated = (
            paper.BETTER.get(name, (NONE, NONE))
            if (method, base) == ("applr", "dwa")
            else (NONE, NONE)
        )
        yield {
            "worlds": name,
            "method": method,
            "tested": f"{tests.p.count()} of {len(tests)}",
            "method better": shares[0],
            f"{base} better": shares[1],
            "method better (Holm)": shares[2],
            f"{base} better (Holm)": shares[3],
            "paper: applr better": stated[0],
            "paper: dwa better": stated[1],
        }


@table(
    "Table III: worlds in which one method is significantly faster, by difficulty",
    "Thirds of all training and test worlds of this evaluation, by the baseline's score (Table I).",
    of_paper=("(*) " + paper.SWAP_SLIP,),
)
def table_3(results: Results) -> Rows:
    """Tabulate the Welch tests by thirds of difficulty."""
    base, thirds = results.baseline, results.thirds()
    parts = {part: set(results.of_set(part)) for part in SETS[:2]}
    for third, part in paper.THIRDS:
        worlds = [w for w in thirds[third] if w in parts.get(part, thirds[third])]
        for method in results.rivals if worlds else []:
            tests = welch(results.of(method, worlds), results.of(base, worlds))
            better, worse = significant(tests)
            stated = (NONE, NONE)
            if (method, base) == ("applr", "dwa"):
                mark = " (*)" if (third, part) in paper.SWAPPED else ""
                theirs = paper.THIRDS[third, part]
                stated = f"{theirs[0]} %", f"{theirs[1]} %{mark}"
            yield {
                "worlds": f"{third} {part}",
                "method": method,
                "n": str(len(tests)),
                "method better": share(better, len(tests)),
                f"{base} better": share(worse, len(tests)),
                f"{base} mean time, all trials [s]": number(results.of(base, worlds).score.mean()),
                "paper: applr better": stated[0],
                "paper: dwa better": stated[1],
            }


@table(
    "Table IV: traversal time on the physical course",
    "A simulated course of cardboard boxes built from the paper's description, not the authors' course. "
    "Mean and standard deviation over the successful trials.",
    of_paper=("The paper's numbers are from the real robot, five trials each.",),
)
def table_4(results: Results) -> Rows:
    """Tabulate the physical course, with the reasons of failures."""
    for method in results.methods:
        trials = results.of(method, ["physical_course"])
        if trials.empty:
            continue
        times = trials.time_s[trials.success]
        failures = trials.reason[~trials.success].replace("", "failed").value_counts(sort=False)
        deviation = times.std() if len(times) > 1 else 0.0
        yield {
            "method": method,
            "time [s] (mean ± sd)": f"{times.mean():.1f} ± {deviation:.1f}" if len(times) else NONE,
            "successes": f"{trials.success.sum()} of {len(trials)}",
            "failures": "; ".join(f"{n}: {why}" for why, n in failures.items()) or "none",
            "contacts": f"{trials.collided.sum()} of {len(trials)}",
            "paper [s]": paper.PHYSICAL.get(method, NONE),
        }


@table(
    "Arrivals, contacts, and BARN's metric",
    "With Wilson's 95 % interval, widened if trials in one world resemble each other. BARN's metric is comparable with "
    "the Challenge's numbers only under --protocol barn-challenge.",
)
def rates(results: Results) -> Rows:
    """Tabulate the shares of trials that arrive and that touch something, and BARN's metric."""
    for name, method, trials in results.groups():
        row = {"worlds": name, "method": method, "trials": str(len(trials))}
        for column, flags in (("success [%]", trials.success), ("collided [%]", trials.collided)):
            share, low, high = (100.0 * value for value in rate(flags, trials.world))
            row[column] = f"{share:.1f} ({low:.1f} to {high:.1f})"
        scores = barn_metric(trials.success, trials.collided, trials.time_s, trials.route_m)
        row["metric"] = number(scores.mean(), 3)
        yield row


@table(
    "Between any two methods",
    "Difference: the method's score (Table I) minus the other's, averaged over worlds. p: paired "
    "sign-flip permutation test of this mean over worlds; Holm: corrected for all pairs of the "
    "group. Faster in: number of worlds by Welch's test as in Table II, corrected by Holm over the "
    "worlds of the row.",
)
def pairs(results: Results) -> Rows:
    """Tabulate every method against every other: paired over worlds, and world by world."""
    for name in SETS:
        worlds = results.of_set(name)
        compared = {
            couple: results.compare(*couple, worlds) for couple in combinations(results.methods, 2)
        }
        compared = {
            couple: comparison for couple, comparison in compared.items() if comparison.worlds
        }
        adjusted = holm_adjusted(np.array([one.p for one in compared.values()]))
        for ((a, b), one), p in zip(compared.items(), adjusted):
            tests = welch(results.of(a, worlds), results.of(b, worlds))
            faster, slower = (share(n, len(tests)) for n in significant(tests, "holm"))
            yield {
                "worlds": name,
                "method": a,
                "other": b,
                "n": str(one.worlds),
                "difference, all trials [s]": number(one.difference.value),
                "95 % interval": span(one.difference.low, one.difference.high),
                "p": _p(one.p),
                "p (Holm)": _p(p),
                "method faster in": faster,
                "other faster in": slower,
            }


@table("Methods")
def methods(results: Results) -> Rows:
    """Tabulate the methods, as recorded when they were driven."""
    for name in results.methods:
        parts = []
        for key, value in results.settings.get("methods", {}).get(name, {}).items():
            if isinstance(value, dict):
                items = value.items()
                value = ", ".join(
                    ("%s %g" if isinstance(v, (int, float)) else "%s %s") % (k, v) for k, v in items
                )
            parts.append(f"{key}: {value}")
        yield {"method": name, "what it is": "; ".join(parts) or NONE}


def _p(value: float) -> str:
    if np.isnan(value):
        return NONE
    return "≤ 0.0001" if value < 1.5e-4 else f"{value:.4f}"


TABLES = [table_1, table_2, table_3, table_4, pairs, rates, methods]
