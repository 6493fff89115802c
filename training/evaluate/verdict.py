"""Verdict on a policy or a tuned parameter set from paired trials: a table, and lines.

A comparison names the arrivals first, then the times of the drives in which both methods arrive,
then the test. A mean over all drives would be made of the time limits of those that fail.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, List, Mapping, NamedTuple, Sequence

from applr_ros1.drives.drive import FLIPPED
from training.attempts.verdict import Comparison, compare, corrected
from training.common.words import counted
from training.evaluate.score import SECONDS_RULE, TrialCost, mean_scores, seconds
from training.evaluate.trial import BASELINE, Result, Trial

if TYPE_CHECKING:
    import pandas as pd

# Names of the methods that drive with a policy and with a tuned set
POLICY = "applr"
SET = "static"
DRIVE = ["world", "trial"]  # columns that name a drive, which each method makes once
# columns of the table with means over the drives in which all methods arrive, and their titles
MEANS = {
    "time_s": "time [s]",
    "mean_clearance_m": "clearance [m]",
    "mean_jerk": "jerk [m/s^3]",
    "mean_turn": "yaw acceleration [rad/s^2]",
}


class ComparisonVerdict(NamedTuple):
    """Verdict on the methods of some paired trials.

    Attributes:
        method: Method to drive with.
        lines: Table of the methods, a line for each comparison, what they mean, and the failures of
            each rival.
    """

    method: str
    lines: List[str]


def paired_trials(
    results: Mapping[Trial, Result], methods: Sequence[str], cost: TrialCost = seconds
) -> pd.DataFrame:
    """Return the trials of the courses that all methods have driven with the same seed.

    Each row has the fields of a Trial and of its Result, and the cost of the trial as "score" [s].
    """
    import pandas as pd

    rows = []
    for trial, result in results.items():
        rows.append({**vars(trial), **vars(result), "score": cost(result)})
    trials = pd.DataFrame(rows)
    driven_by = trials.groupby(DRIVE).method.transform("nunique")
    return trials[driven_by == len(methods)]


def verdict(trials: pd.DataFrame, rule: str = SECONDS_RULE) -> ComparisonVerdict:
    """Compare methods with the robot's default parameters.

    The verdict is BASELINE unless another method is significantly better on average, falls over no
    more often, and is not worse in its worst tenth of the worlds.

    Args:
        trials: Trials of at least one course, from paired_trials().
        rule: What the scores of the trials count, in words.
    """
    scores = mean_scores(trials)
    worst = worst_tenth(scores).rename("worst tenth, cost [s]")
    lines = [str(_table(trials).join(worst).round(2).rename_axis(None).to_string())]
    rivals = scores.columns.drop(BASELINE)
    judged_rivals = judged(trials, rivals, BASELINE)
    lines += [compared(trials, rival) for rival in judged_rivals]
    lines.append(
        "time to yaw acceleration: means over the drives in which all methods arrive; "
        f"p: paired sign-flip permutation test of the cost; {rule}"
    )
    lines += [failures(trials, method) for method in rivals]
    better = [rival.method for rival in judged_rivals if rival.is_better]
    best = min(better, key=lambda method: scores[method].mean(), default=BASELINE)
    return ComparisonVerdict(best, lines)


class Judged(NamedTuple):
    """Whether a method is better than another.

    Attributes:
        method: The method.
        other: The other method.
        comparison: Test of their costs.
        level: Significance level, below which the test decides.
        flaw: Why the method is not better in spite of the test, in words.
    """

    method: str
    other: str
    comparison: Comparison
    level: float
    flaw: str

    @property
    def is_better(self) -> bool:
        """True if the method is significantly better, and has no flaw."""
        return self.comparison.better(self.level) and not self.flaw


def judged(trials: pd.DataFrame, rivals: Sequence[str], other: str) -> List[Judged]:
    """Judge each rival of another method over the worlds in which both have trials, if any.

    A rival has a flaw if it falls over more often, or is worse in its worst tenth of the worlds.
    """
    scores = mean_scores(trials)
    pairs = {rival: scores[[rival, other]].dropna() for rival in rivals}
    level = corrected(sum(len(pair) > 0 for pair in pairs.values()))
    judgements = []
    for rival, pair in pairs.items():
        if pair.empty:
            continue
        in_both = trials[trials.world.isin(pair.index)]
        flaw = ""
        fall_count = falls(in_both, rival)
        worst = worst_tenth(pair)
        if fall_count > falls(in_both, other):
            remedy = "lower base.max_speed in robot.yaml to what the base bears"
            flaw = f"it falls over in {counted(fall_count, 'drive')}: {remedy}"
        elif worst[rival] > worst[other]:
            flaw = "its worst tenth is worse"
        comparison = compare(pair[rival], pair[other])
        judgements.append(Judged(rival, other, comparison, level, flaw))
    return judgements


def worst_tenth(scores: pd.DataFrame) -> pd.Series:
    """Return the mean score of each method in its worst tenth of the worlds [s].

    A set that is better on average may still stand for minutes in a few worlds.
    """
    return scores.apply(lambda column: column.nlargest(max(1, len(column) // 10)).mean())


def _table(trials: pd.DataFrame) -> pd.DataFrame:
    """Return a row per method: courses, arrivals, contacts, and the means of MEANS."""
    by_method = trials.groupby("method", sort=False)
    counts = by_method.size().to_frame("courses")
    counts["arrived"] = by_method.success.sum()
    counts["contacts"] = by_method.collided.sum()
    # A method that arrives on harder courses, too, would look slower in a mean over its own
    # arrivals.
    all_arrive = trials.groupby(DRIVE).success.transform("all")
    means = trials[all_arrive].groupby("method")[list(MEANS)].mean()
    return counts.join(means.rename(columns=MEANS))


def compared(trials: pd.DataFrame, judgement: Judged) -> str:
    """Return a line on whether a method is better than another.

    It has the arrivals, the times of the drives in which both arrive, and the test.

    Args:
        trials: Trials of at least both methods.
        judgement: What was found of them.
    """
    method, other, comparison, level, flaw = judgement
    # An unfinished evaluation may hold drives of one method only.
    of_pair = trials[trials.method.isin([method, other])].set_index(DRIVE)
    success = of_pair.pivot(columns="method", values="success").dropna().astype(bool)
    findings = [
        f"{method} better: {'yes' if judgement.is_better else 'no'}, "
        f"{success[method].sum()} of {len(success)} arrive ({other}: {success[other].sum()})"
    ]
    # Drives in which only one arrives have no times to compare.
    both_arrive = success.index[success.all(axis=1)]
    if len(both_arrive):
        times = of_pair.pivot(columns="method", values="time_s").loc[both_arrive].mean()
        change = f"{times[method]:.1f} s instead of {times[other]:.1f} s"
        findings.append(f"{change} where both arrive ({len(both_arrive)} drives)")

    if math.isnan(comparison.p):
        findings.append("too few courses to tell")
    elif comparison.p < level:
        findings.append(f"p = {comparison.p:.2g}")
    else:
        findings.append(f"p = {comparison.p:.2g}: too few courses to tell")
    if flaw:
        findings.append(flaw)
    return "; ".join(findings)


def falls(trials: pd.DataFrame, method: str) -> int:
    """Return the number of drives of a method in which the robot falls over."""
    return int((trials.reason[trials.method == method] == FLIPPED).sum())


def failures(trials: pd.DataFrame, method: str) -> str:
    """Return a line: on which courses a method fails, by reason."""
    driven = trials[trials.method == method]
    failed = driven[~driven.success]
    if failed.empty:
        return f"{method} fails on none of {len(driven)} courses"
    failures_by_reason = []
    for reason, of_reason in failed.groupby("reason", sort=False):
        failures_by_reason.append(f"{reason} ({', '.join(of_reason.world.unique())})")
    failed_share = f"{len(failed)} of {len(driven)} courses"
    return f"{method} fails on {failed_share}: {'; '.join(failures_by_reason)}"
