"""A verdict on a robot's policy, or on a tuned set, from pairs of trials, and why drives failed.

several.py and tune_robot.py print it. Methods are compared over worlds (trials/compare.py).
"""

from __future__ import annotations

from typing import TYPE_CHECKING, List, Mapping, Sequence, Tuple

import numpy as np

from training.trials.compare import LEVEL, Estimate, compare, mean_time, over_worlds, rate
from training.trials.score import AIMS, CONTACT_SECONDS, FAILURE_SECONDS, Cost, seconds
from training.trials.trial import BASELINE, Result, Trial

if TYPE_CHECKING:
    import pandas as pd

POLICY, SET = "applr", "static"
WORDS = {BASELINE: "its own parameters", POLICY: "the policy", SET: "the tuned parameters"}
OF_THREE = LEVEL / 3  # of the test of two methods, of which three are compared
LOAD = (
    "Load {0} after your own files, and drive carefully at first (max_speed in this package's launch file, or a "
    "smaller max_vel_x)."
)
KEEP = "Keep your own parameters; the same command with more --minutes searches on from here."


def paired_trials(results: Mapping[Trial, Result], methods: Sequence[str], cost: Cost = seconds) -> pd.DataFrame:
    """Return the trials of those courses that all of some methods have driven with the same seed.

    A row has the "world", "trial" and "method" of a trial, what Result says, and its cost as "score" [s].
    """
    import pandas as pd

    trials = pd.DataFrame([{**vars(trial), **vars(result), "score": cost(result)} for trial, result in results.items()])
    return trials[trials.groupby(["world", "trial"]).method.transform("nunique") == len(methods)]


def mean_scores(trials: pd.DataFrame) -> pd.DataFrame:
    """Return the mean score [s] of each method, a column, in each world, a row."""
    return trials.groupby(["world", "method"], sort=False).score.mean().unstack()


def clearly_better(scores: pd.DataFrame, method: str, other: str) -> bool:
    """Return whether a method is clearly better than another."""
    found = compare(scores[method], scores[other])
    return found.difference.value < 0.0 and found.p < OF_THREE


def verdict(trials: pd.DataFrame, robot: str) -> Tuple[str, List[str]]:
    """Return the verdict on a robot's policy.

    Args:
        trials: of at least one course (paired_trials).
        robot: its name.

    Returns:
        The method to drive with: the policy only where it is clearly better than the robot's own parameters. Two
        sentences: arrivals and times; whether the policy pays.
    """
    scores = mean_scores(trials)
    better = [method for method in scores if method != BASELINE and clearly_better(scores, method, BASELINE)]
    best = min(better, key=lambda method: scores[method].mean(), default=BASELINE)
    saved = compare(scores[BASELINE], scores[POLICY]).difference
    how = f"it takes {abs(saved.value):.1f} s {'less' if saved.value > 0 else 'more'} per course than {WORDS[BASELINE]}"
    if np.isfinite(saved.low):
        how += f" (95 % interval of what it saves: {saved.low:.1f} to {saved.high:.1f} s)"
    how += f", where a failed drive counts as {FAILURE_SECONDS:g} s and a contact as {CONTACT_SECONDS:g} s more"
    if best == POLICY:
        judged = f"The policy pays on {robot}: {how}."
    elif best == SET:
        judged = f"The policy does not pay on {robot}, {WORDS[SET]} do: with the policy {how}."
    elif clearly_better(scores, BASELINE, POLICY):
        judged = f"The policy does not pay on {robot}: {how}."
    else:
        judged = f"Whether the policy pays on {robot} is not clear: {how}."
    return best, [_driven(trials, robot), judged]


def tuned_verdict(trials: pd.DataFrame, robot: str, file: str, aim: str) -> Tuple[bool, List[str]]:
    """Return the verdict on tuned parameters beside the robot's own.

    Args:
        trials: of at least one course with both (paired_trials), and what they cost by the aim.
        robot: its name.
        file: of the tuned parameters for move_base.
        aim: what they were tuned for, one of score.AIMS.

    Returns:
        Whether they are clearly better, and in what the aim is named for, too; and three sentences: arrivals, times and
        contacts; how sure; what to do next.
    """
    asked, how = AIMS[aim].asked(), ""
    gains: List[Estimate] = []
    both = trials[trials.groupby("world").success.transform("all")]  # who stands has no jerk
    for word, column, unit, better in asked:
        before, after = (both[both.method == method].groupby("world")[column].mean() for method in (BASELINE, SET))
        gains.append(over_worlds(better * (after - before)))
        how += f"where both arrive, the {word} is {after.mean():.3g} {unit} with them and {before.mean():.3g} {unit} "
        how += (
            f"with {WORDS[BASELINE]} (95 % interval of the gain: {gains[-1].low:.2g} to {gains[-1].high:.2g} {unit}); "
        )
    pays = all(gain.value > 0.0 for gain in gains) and max((gain.low for gain in gains), default=1.0) > 0.0
    scores = mean_scores(trials)
    found = compare(scores[BASELINE], scores[SET])
    saved, low, high = found.difference
    how += f"by what --for {aim} counts they cost {abs(saved):.1f} s {'less' if saved > 0.0 else 'more'} per course"
    how += f" (95 % interval of what they save: {low:.1f} to {high:.1f} s, p = {found.p:.2g})"
    own, tuned = (trials[trials.method == method] for method in (BASELINE, SET))
    less = ["arrives less often"] if tuned.success.sum() < own.success.sum() else []
    less += ["touches something more often"] if tuned.collided.sum() > own.collided.sum() else []
    how += f", although {robot} {' and '.join(less)} with them" if less else ""
    where = "This holds in simulation, with a planner like the C++ move_base and the collision monitor, on courses "
    where += "like these, which the search did not use."
    if pays and saved > 0.0 and found.p < LEVEL:
        judged = f"The tuned parameters are better: {how}. {where}"
        return True, [_driven(trials, robot), judged, LOAD.format(file)]
    named = "" if pays else " in " + " and ".join(quantity.name for quantity in asked)
    judged = f"Nothing clearly better{named} was found: {how}. {where}"
    return False, [_driven(trials, robot), judged, KEEP]


def _driven(trials: pd.DataFrame, robot: str) -> str:
    """The first sentence: arrivals, times and contacts with each method, and whether most courses fail with all."""
    of_method = {method: trials[trials.method == method] for method in WORDS if method in set(trials.method)}
    fails = f"{robot} fails in most courses, whatever sets its parameters: of"
    begin = fails if all(one.success.mean() < 0.5 for one in of_method.values()) else "Of"
    ends = ", ".join(f"{_ends(one)} with {WORDS[method]}" for method, one in of_method.items())
    return f"{begin} {len(of_method[BASELINE])} courses {robot} finished {ends}."


def _ends(trials: pd.DataFrame) -> str:
    text = _share(trials.success, trials)
    mean, low, high = mean_time(trials)
    text += f" in {mean:.1f} s" if np.isfinite(mean) else ""
    text += f" ({low:.1f} to {high:.1f} s)" if np.isfinite(low) else ""
    return f"{text} and touched something in {_share(trials.collided, trials)}"


def _share(flags: pd.Series, trials: pd.DataFrame) -> str:
    """State how many, in percent, and the 95 % interval of that."""
    share, low, high = rate(flags, trials.world)
    return f"{flags.sum()} ({100 * share:.0f} %, {100 * low:.0f} to {100 * high:.0f} %)"


def failures(trials: pd.DataFrame) -> List[str]:
    """Return a line for each of the three commonest reasons of failures, with how often each method failed for it.

    "aborted: ..." is said where the planner gave up, whatever time the trial stands for.
    """
    failed = trials[~trials.success.astype(bool)]
    reasons = failed.reason.str.replace("planner aborted: ", "aborted: ").replace("", "failed")
    lines = []
    for why in reasons.value_counts().index[:3]:
        counts = failed.method[reasons == why].value_counts(sort=False)
        who = ", ".join(f"{count} with {WORDS[method]}" for method, count in counts.items())
        lines.append(f"failed: {why} ({who})")
    return lines
