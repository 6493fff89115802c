"""Whether the policy, or a tuned set, pays on a robot: a verdict from pairs of trials, and why drives failed.

try_robot.py and tune_robot.py print it. For try_robot.py a drive counts as its time, as 100 s where it failed, and as
5 s more where the robot touched something (evaluation/score.py). Methods are compared over worlds
(applr_ros1/drives/comparison.py) after the numbers of courses in LOOKS and at the end: at LEVEL per look, a difference
where there is none is found in at most one of twenty runs. A run that is continued looks once more.
"""

from __future__ import annotations

from pathlib import Path
from typing import Callable, List, Mapping, Sequence, Tuple

import numpy as np
import pandas as pd

from applr_ros1.drives.comparison import Estimate, compare, over_worlds
from training.evaluation.plan import Trial, TrialResult
from training.evaluation.score import AIMS, CONTACT_SECONDS, FAILURE_SECONDS, QUANTITIES, trial_seconds
from training.report.figures import canvas
from training.report.statistics import mean_time, rate

OWN, POLICY, SET = "dwa", "applr", "static"
WORDS = {OWN: "its own parameters", POLICY: "the policy", SET: "the tuned parameters"}
LOOKS = (8, 16)  # numbers of pairs after which it may end; there is a last look when all is driven or the time is spent
LEVEL = 0.05 / (len(LOOKS) + 1)  # of the two-sided test of each look
CLEAR = 0.05  # of the one test of a tuned set
LOAD = (
    "Load {0} after your own files, drive carefully at first (max_speed in this package's launch file, or a smaller "
    "max_vel_x), and go on with ./applr try."
)
KEEP = "Keep your own parameters; the same command with more --minutes searches on from here."


def score(result: TrialResult) -> float:
    """What a drive counts as [s]."""
    return trial_seconds(result.success, result.time_s, result.collided, CONTACT_SECONDS)


def paired_trials(
    results: Mapping[Trial, TrialResult], methods: Sequence[str], cost: Callable[[TrialResult], float] = score
) -> pd.DataFrame:
    """The trials of those courses that all of some methods have driven with the same seed.

    Returns:
        A row per trial: its "world", "trial" and "method", what TrialResult says, and its cost as "score" [s].
    """
    names = ["world", "trial", "method", "success", "collided", "time_s", "reason"]
    names += [quantity.column for quantity in QUANTITIES.values()]
    rows = [{name: getattr(t if hasattr(t, name) else r, name) for name in names} for t, r in results.items()]
    trials = pd.DataFrame(rows, columns=names)
    trials["score"] = [cost(result) for result in results.values()]
    return trials[trials.groupby(["world", "trial"]).method.transform("nunique") == len(methods)]


def mean_scores(trials: pd.DataFrame) -> pd.DataFrame:
    """The mean score [s] of each method, a column, in each world, a row."""
    return trials.groupby(["world", "method"], sort=False).score.mean().unstack()


def clearly_better(scores: pd.DataFrame, method: str, other: str) -> bool:
    """Whether a method is clearly better than another."""
    found = compare(scores[method], scores[other])
    return found.difference.value < 0.0 and found.p < LEVEL


def decided(scores: pd.DataFrame) -> bool:
    """Whether one method is clearly better than each of the others."""
    return any(all(clearly_better(scores, best, other) for other in scores if other != best) for best in scores)


def verdict(trials: pd.DataFrame, robot: str, folder: str, used_up: bool) -> Tuple[str, List[str]]:
    """The verdict on a robot.

    Args:
        trials: of at least one course (paired_trials).
        robot: its name.
        folder: of its description.
        used_up: whether no courses are left, so that more time would not help.

    Returns:
        The method to drive with: the policy only where it is clearly better than the robot's own parameters. Three
        sentences: arrivals and times; whether the policy pays; what to do next.
    """
    scores = mean_scores(trials)
    better = [method for method in scores if method != OWN and clearly_better(scores, method, OWN)]
    best = min(better, key=lambda method: scores[method].mean(), default=OWN)
    saved = compare(scores[OWN], scores[POLICY]).difference
    how = f"it takes {abs(saved.value):.1f} s {'less' if saved.value > 0 else 'more'} per course than {WORDS[OWN]}"
    if np.isfinite(saved.low):
        how += f" (95 % interval of what it saves: {saved.low:.1f} to {saved.high:.1f} s)"
    how += f", where a failed drive counts as {FAILURE_SECONDS:g} s and a contact as {CONTACT_SECONDS:g} s more"
    train = f"python -m training.train --robot {folder} --recipe applr --init-from applr"
    if best == POLICY:
        judged = f"The policy pays on {robot}: {how}."
        advice = f"Drive with it, and let it learn this robot ({train} ...), which may save more."
    elif best == SET:
        judged = f"The policy does not pay on {robot}, {WORDS[SET]} do: with the policy {how}."
        advice = f"Load {folder}/tuned.yaml after your own parameters, or train a policy of its own ({train} ...)."
    elif clearly_better(scores, OWN, POLICY):
        judged = f"The policy does not pay on {robot}: {how}."
        advice = f"Keep your parameters, or train a policy of its own ({train} ...) and try again."
    else:
        judged = f"Whether the policy pays on {robot} is not clear: {how}."
        advice = (
            f"Keep your parameters, or train a policy of its own ({train} ...): no courses are left to drive."
            if used_up
            else "Keep your parameters for now, and give the same command more --minutes: it continues."
        )
    return best, [_driven(trials, robot), judged, advice]


def tuned_verdict(trials: pd.DataFrame, robot: str, file: str, aim: str) -> Tuple[bool, List[str]]:
    """Whether tuned parameters are better than the robot's own.

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
        before, after = (both[both.method == method].groupby("world")[column].mean() for method in (OWN, SET))
        gains.append(over_worlds(better * (after - before)))
        how += f"where both arrive, the {word} is {after.mean():.3g} {unit} with them and {before.mean():.3g} {unit} "
        how += f"with {WORDS[OWN]} (95 % interval of the gain: {gains[-1].low:.2g} to {gains[-1].high:.2g} {unit}); "
    pays = all(gain.value > 0.0 for gain in gains) and max((gain.low for gain in gains), default=1.0) > 0.0
    scores = mean_scores(trials)
    found = compare(scores[OWN], scores[SET])
    saved, low, high = found.difference
    how += f"by what --for {aim} counts they cost {abs(saved):.1f} s {'less' if saved > 0.0 else 'more'} per course"
    how += f" (95 % interval of what they save: {low:.1f} to {high:.1f} s, p = {found.p:.2g})"
    own, tuned = (trials[trials.method == method] for method in (OWN, SET))
    less = ["arrives less often"] if tuned.success.sum() < own.success.sum() else []
    less += ["touches something more often"] if tuned.collided.sum() > own.collided.sum() else []
    how += f", although {robot} {' and '.join(less)} with them" if less else ""
    where = "This holds in simulation, with the collision monitor, on courses like these, which the search did not use."
    if pays and saved > 0.0 and found.p < CLEAR:
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
    return f"{begin} {len(of_method[OWN])} courses {robot} finished {ends}."


def _ends(trials: pd.DataFrame) -> str:
    text = _share(trials.success, trials)
    mean, low, high = mean_time(trials)
    text += f" in {mean:.1f} s" if np.isfinite(mean) else ""
    text += f" ({low:.1f} to {high:.1f} s)" if np.isfinite(low) else ""
    return f"{text} and touched something in {_share(trials.collided, trials)}"


def _share(flags: pd.Series, trials: pd.DataFrame) -> str:
    """How many, in percent, and the 95 % interval of that."""
    share, low, high = rate(flags, trials.world)
    return f"{flags.sum()} ({100 * share:.0f} %, {100 * low:.0f} to {100 * high:.0f} %)"


def failures(trials: pd.DataFrame) -> List[str]:
    """A line for each of the three commonest reasons of failures, with how often each method failed for it.

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


def picture(scores: pd.DataFrame, robot: str, path: Path) -> None:
    """Draws each course's score with the robot's own parameters against that with the others, into a PNG file."""
    figure, ((axes,),) = canvas(size=(6, 6))
    most = 1.05 * float(scores.max(axis=None))
    axes.plot([0, most], [0, most], color="gray", linewidth=1)
    for method, mark in zip([method for method in scores if method != OWN], "ox"):
        axes.plot(scores[OWN], scores[method], mark, alpha=0.7, label=WORDS[method])
    axes.set(xlim=(0, most), ylim=(0, most), aspect="equal", title=f"{robot}: a point per world, faster below the line")
    axes.set(xlabel=f"with {WORDS[OWN]} [s], a failure as {FAILURE_SECONDS:g}", ylabel="with the other [s]")
    axes.legend(loc="upper left")
    figure.savefig(path, dpi=100)
