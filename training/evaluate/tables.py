"""Tables of the report: the paper's Tables I to IV from our trials, and further tables.

Beside our numbers stand those of the paper.
"""

from __future__ import annotations

import html
import math
import warnings
from itertools import combinations
from typing import Any, Callable, Dict, Iterator, NamedTuple, Sequence

import numpy as np
import pandas as pd
import scipy

from applr_ros1.drives.contact import MOVING_M_S
from applr_ros1.policy.decision import PERIOD
from applr_ros1.robots import JACKAL
from training.attempts.verdict import LEVEL, Estimate, over_worlds, rate
from training.evaluate import paper
from training.evaluate.score import SECONDS_RULE, barn_metric
from training.evaluate.stored import SETS, TEST, TRAINING, Results

NONE = "–"  # cell without a value
COMPARED_IN_PAPER = ("applr", "dwa")  # methods of the paper's Tables II and III
NO_PAPER = (NONE, NONE)  # cells of other methods in these tables
# Names of the columns of words; all others have numbers.
WORDS = ("worlds", "method", "other", "failures", "what it is")
TableRows = Iterator[Dict[str, str]]


class Table(NamedTuple):
    """Table of the report: name of its file, title, rows of text, and notes below them."""

    name: str
    title: str
    rows: pd.DataFrame
    notes: Sequence[str] = ()

    def html(self) -> str:
        """Return the table as HTML, with its title above and its notes below.

        A wide table scrolls in its own box.
        """
        head = "".join(_cell("th", name, name) for name in self.rows)
        body = ""
        for row in self.rows.to_dict("records"):
            cells = "".join(_cell("td", name, text) for name, text in row.items())
            body += f"<tr>{cells}</tr>\n"
        table = f"<table><thead><tr>{head}</tr></thead>\n<tbody>\n{body}</tbody></table>"
        title = f"<h2>{html.escape(self.title)}</h2>"
        kind = "wide words" if self.name == "methods" else "wide"
        notes = "".join(f"<p class=note>{html.escape(note)}</p>" for note in self.notes)
        # Whoever has no mouse scrolls the box by keys.
        return f'{title}<div class="{kind}" tabindex=0>{table}</div>{notes}'


def _cell(tag: str, column: Any, text: Any) -> str:
    """Return a cell of a table as HTML: words from the left, numbers to the right.

    Args:
        tag: Element of the cell, th or td.
        column: Name of its column.
        text: What it says.
    """
    attributes = ' scope="col"' if tag == "th" else ""
    if column not in WORDS:
        attributes += ' class="number"'
    return f"<{tag}{attributes}>{html.escape(str(text))}</{tag}>"


Made = Callable[[Results], Table]  # makes the table of an evaluation


def number(value: float, digits: int = 2) -> str:
    """Return a number with the given number of decimals, or NONE if it is not finite."""
    if not np.isfinite(value):
        return NONE
    return f"{value:.{digits}f}"


def span(low: float, high: float, digits: int = 2) -> str:
    """Return an interval with the given number of decimals, or NONE if there is no interval."""
    if not np.isfinite(low):
        return NONE
    return f"{low:.{digits}f} to {high:.{digits}f}"


def share(n: int, total: int) -> str:
    """Return a count with its percentage of the total, or NONE if the total is 0."""
    if total == 0:
        return NONE
    return f"{n} ({n / total:.0%})".replace("%", " %")


def table(
    title: str, *notes: str, of_paper: Sequence[str] = ()
) -> Callable[[Callable[[Results], TableRows]], Made]:
    """Return a decorator that turns a function that yields rows into one that makes a table.

    The table has the function's name. Columns whose names begin with "paper" are left out for
    another robot than the paper's, and if no row has a value in them. If all these columns are left
    out, the notes `of_paper` about them are left out as well.
    """

    def decorate(rows_of: Callable[[Results], TableRows]) -> Made:
        def make(results: Results) -> Table:
            rows = pd.DataFrame(list(rows_of(results)))
            in_paper = rows.filter(regex="^paper")
            is_empty = (in_paper == NONE).all() | (results.robot["name"] != JACKAL.name)
            all_notes = list(notes)
            if not is_empty.all():
                all_notes += of_paper
            rows = rows.drop(columns=in_paper.columns[is_empty])
            return Table(rows_of.__name__, title, rows, all_notes)

        return make

    return decorate


def welch(trials: pd.DataFrame, others: pd.DataFrame) -> pd.DataFrame:
    """Compare the times of two methods' successful trials in each world that both have driven.

    Returns:
        A row per world: "sign", -1 if the first method is faster, 1 if the other is; the p-value
        "p" of a two-sided Welch test; and "holm", p corrected over the worlds. p is NaN if a method
        has fewer than two successes, or if neither method's times vary.
    """
    times = _success_times(trials)
    other_times = _success_times(others)
    worlds = times.index.intersection(other_times.index, sort=False)
    times = times.loc[worlds]
    other_times = other_times.loc[worlds]
    with warnings.catch_warnings():
        # scipy warns if a sample is small or hardly varies.
        warnings.simplefilter("ignore", RuntimeWarning)
        welch_test = scipy.stats.ttest_ind(
            times, other_times, axis=1, equal_var=False, nan_policy="omit"
        )
    # Means of equal times may differ in the last bit, which would be infinitely significant.
    varies = _varies(times) | _varies(other_times)
    p_values = np.where(varies, welch_test.pvalue, np.nan)
    return pd.DataFrame(
        {"sign": np.sign(welch_test.statistic), "p": p_values, "holm": holm_adjusted(p_values)},
        dtype=float,
    )


def _success_times(trials: pd.DataFrame) -> pd.DataFrame:
    """Return a row of times [s] for each world, in the order of the trials; NaN for a failure."""
    times = trials.assign(time=trials.time_s.where(trials.success))
    by_world = times.pivot(index="world", columns="trial", values="time")
    return by_world.loc[trials.world.unique()]


def _varies(times: pd.DataFrame) -> pd.Series:
    return times.max(axis=1) > times.min(axis=1)


class Significant(NamedTuple):
    """Numbers of worlds in which the first of two methods, and the other, is clearly faster."""

    faster: int
    slower: int


def significant(tests: pd.DataFrame, column: str = "p") -> Significant:
    """Count the worlds in which one method is significantly faster, by a column of welch()."""
    sign = tests.sign[tests[column] < LEVEL]
    return Significant(int((sign == -1).sum()), int((sign == 1).sum()))


def holm_adjusted(p: np.ndarray) -> np.ndarray:
    """Return p-values (n,) adjusted by Holm's procedure.

    NaN stays NaN and does not count as a test.
    """
    adjusted = np.full(len(p), np.nan)
    order = np.argsort(p)[: np.count_nonzero(~np.isnan(p))]  # argsort puts NaN last.
    # The smallest of m p-values is multiplied by m, the next one by m - 1, ...
    factors = np.arange(len(order), 0, -1)
    adjusted[order] = np.maximum.accumulate(np.minimum(1.0, factors * p[order]))
    return adjusted


@table(
    "Table I: average traversal time",
    "Time: mean over the successful trials of all worlds. Faster: difference of the scores (times "
    f"in which {SECONDS_RULE}), averaged over the worlds that both have driven. Intervals: "
    "bootstrap over worlds.",
    of_paper=(
        paper.UNIT,
        f"The paper's improvement: training {paper.GAIN[TRAINING]}, test {paper.GAIN[TEST]}. "
        + paper.GAIN_SLIP,
    ),
)
def table_1(results: Results) -> TableRows:
    """Tabulate average traversal times."""
    for set_name, method, trials in results.groups(results.methods):
        times = trials.time_s.where(trials.success).groupby(trials.world, sort=False)
        mean_time = over_worlds(times.sum(), times.count())
        # The baseline is not compared with itself.
        saved_s = math.nan
        gain = Estimate(math.nan, math.nan, math.nan)
        if method != results.baseline:
            comparison = results.compare(method, results.baseline, results.of_set(set_name))
            saved_s = -comparison.difference.value
            gain = comparison.gain
        paper_time = paper.TIME.get((set_name, method), math.nan)
        yield {
            "worlds": set_name,
            "method": method,
            "time [s]": number(mean_time.value),
            "95 % interval": span(mean_time.low, mean_time.high),
            "successes": f"{trials.success.sum()} of {len(trials)}",
            f"faster than {results.baseline} [s]": number(saved_s),
            "faster [%]": number(100 * gain.value, 1),
            "95 % interval [%]": span(100 * gain.low, 100 * gain.high, 1),
            "paper [decisions]": number(paper_time),
            "paper [s]": number(paper_time * PERIOD),
        }


@table(
    "Table II: worlds in which one method is significantly faster",
    "Two-sided Welch t-test of the successful trials' times at .05, in each world. A world in "
    "which a method has fewer than two successes cannot be tested and counts for neither.",
    "Holm: corrected over all tested worlds of the row. " + paper.CHANCE,
)
def table_2(results: Results) -> TableRows:
    """Tabulate the Welch tests per world."""
    baseline = results.baseline
    for set_name, method, trials in results.groups(results.rivals):
        tests = welch(trials, results.of(baseline, results.of_set(set_name)))
        count = significant(tests)
        corrected = significant(tests, "holm")
        applr_better, dwa_better = NO_PAPER
        if (method, baseline) == COMPARED_IN_PAPER:
            applr_better, dwa_better = paper.BETTER.get(set_name, NO_PAPER)
        yield {
            "worlds": set_name,
            "method": method,
            "tested": f"{tests.p.count()} of {len(tests)}",
            "method better": share(count.faster, len(tests)),
            f"{baseline} better": share(count.slower, len(tests)),
            "method better (Holm)": share(corrected.faster, len(tests)),
            f"{baseline} better (Holm)": share(corrected.slower, len(tests)),
            "paper: applr better": applr_better,
            "paper: dwa better": dwa_better,
        }


@table(
    "Table III: worlds in which one method is significantly faster, by difficulty",
    "Thirds of all training and test worlds of this evaluation, by the baseline's score (Table I).",
    of_paper=("(*) " + paper.SWAP_SLIP,),
)
def table_3(results: Results) -> TableRows:
    """Tabulate the Welch tests by thirds of difficulty."""
    baseline = results.baseline
    thirds = results.thirds()
    for (third, part), (applr_percent, dwa_percent) in paper.THIRDS.items():
        worlds = thirds[third]
        if part in SETS:  # else "All"
            of_part = results.of_set(part)
            worlds = [world for world in worlds if world in of_part]
        if not worlds:
            continue
        baseline_trials = results.of(baseline, worlds)
        for method in results.rivals:
            tests = welch(results.of(method, worlds), baseline_trials)
            count = significant(tests)
            applr_better, dwa_better = NO_PAPER
            if (method, baseline) == COMPARED_IN_PAPER:
                applr_better = f"{applr_percent} %"
                dwa_better = f"{dwa_percent} %"
                if (third, part) in paper.SWAPPED:
                    dwa_better += " (*)"
            yield {
                "worlds": f"{third} {part}",
                "method": method,
                "n": str(len(tests)),
                "method better": share(count.faster, len(tests)),
                f"{baseline} better": share(count.slower, len(tests)),
                f"{baseline} mean time, all trials [s]": number(baseline_trials.score.mean()),
                "paper: applr better": applr_better,
                "paper: dwa better": dwa_better,
            }


@table(
    "Table IV: traversal time on the physical course",
    "A simulated course of cardboard boxes built from the paper's description, not the authors' "
    "course. Mean and standard deviation over the successful trials.",
    of_paper=("The paper's numbers are from the real robot, five trials each.",),
)
def table_4(results: Results) -> TableRows:
    """Tabulate the physical course, with the reasons of failures."""
    for method in results.methods:
        trials = results.of(method, ["physical_course"])
        if trials.empty:
            continue
        times = trials.time_s[trials.success]
        time_text = NONE
        if len(times):
            deviation = times.std() if len(times) > 1 else 0.0
            time_text = f"{times.mean():.1f} ± {deviation:.1f}"
        failures = trials.reason[~trials.success].replace("", "failed").value_counts(sort=False)
        counts = [f"{count}: {reason}" for reason, count in failures.items()]
        yield {
            "method": method,
            "time [s] (mean ± sd)": time_text,
            "successes": f"{trials.success.sum()} of {len(trials)}",
            "failures": "; ".join(counts) or "none",
            "contacts": f"{trials.collided.sum()} of {len(trials)}",
            "paper [s]": paper.PHYSICAL.get(method, NONE),
        }


@table(
    "Arrivals, contacts, and BARN's metric",
    "With Wilson's 95 % interval, widened if trials in one world resemble each other. Moving: "
    f"trials in which the robot was faster than {MOVING_M_S:g} m/s when it was first touched. "
    "BARN's metric is comparable with the Challenge's numbers only under --protocol "
    "barn-challenge.",
)
def rates(results: Results) -> TableRows:
    """Tabulate the shares of trials that arrive and that touch something, and BARN's metric."""
    for set_name, method, trials in results.groups(results.methods):
        metric = barn_metric(trials.success, trials.collided, trials.time_s, trials.route_m)
        yield {
            "worlds": set_name,
            "method": method,
            "trials": str(len(trials)),
            "success [%]": _percent(rate(trials.success, trials.world)),
            "collided [%]": _percent(rate(trials.collided, trials.world)),
            "moving": _moving_contacts(trials),
            "metric": number(metric.mean(), 3),
        }


@table(
    "Between any two methods",
    "Difference: the method's score (Table I) minus the other's, averaged over worlds. p: paired "
    "sign-flip permutation test of this mean over worlds; Holm: corrected for all pairs of the "
    "group. Faster in: number of worlds by Welch's test as in Table II, corrected by Holm over the "
    "worlds of the row.",
)
def pairs(results: Results) -> TableRows:
    """Tabulate every method against every other: paired over worlds, and world by world."""
    for set_name in SETS:
        worlds = results.of_set(set_name)
        comparisons = {}
        for couple in combinations(results.methods, 2):
            comparison = results.compare(*couple, worlds)
            if comparison.worlds:
                comparisons[couple] = comparison
        p_values = np.array([comparison.p for comparison in comparisons.values()])
        for (couple, comparison), adjusted in zip(comparisons.items(), holm_adjusted(p_values)):
            method, other = couple
            tests = welch(results.of(method, worlds), results.of(other, worlds))
            count = significant(tests, "holm")
            difference = comparison.difference
            yield {
                "worlds": set_name,
                "method": method,
                "other": other,
                "n": str(comparison.worlds),
                "difference, all trials [s]": number(difference.value),
                "95 % interval": span(difference.low, difference.high),
                "p": _p_text(comparison.p),
                "p (Holm)": _p_text(adjusted),
                "method faster in": share(count.faster, len(tests)),
                "other faster in": share(count.slower, len(tests)),
            }


@table("Methods")
def methods(results: Results) -> TableRows:
    """Tabulate the methods, as recorded when they were driven."""
    for name in results.methods:
        parts = []
        for key, value in results.settings["methods"].get(name, {}).items():
            if isinstance(value, dict):
                value = ", ".join(f"{item} {_text_of(part)}" for item, part in value.items())
            parts.append(f"{key}: {value}")
        yield {"method": name, "what it is": "; ".join(parts) or NONE}


def _text_of(value: Any) -> str:
    """Return a parameter's value as text, a number with at most six digits."""
    return f"{value:g}" if isinstance(value, float) else str(value)


def _moving_contacts(trials: pd.DataFrame) -> str:
    """Return how many trials have a contact of a moving robot; NONE if a speed is unknown."""
    speeds = trials.contact_speed[trials.collided]
    if speeds.isna().any():
        return NONE
    return str((speeds > MOVING_M_S).sum())


def _percent(estimate: Estimate) -> str:
    """Return a share in percent, with its interval."""
    value, low, high = np.multiply(100.0, estimate)
    return f"{value:.1f} ({low:.1f} to {high:.1f})"


def _p_text(value: float) -> str:
    """Return a p-value with four decimals."""
    if np.isnan(value):
        return NONE
    return "≤ 0.0001" if value < 1.5e-4 else f"{value:.4f}"


TABLES = [table_1, table_2, table_3, table_4, pairs, rates, methods]
