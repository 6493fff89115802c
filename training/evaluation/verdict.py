"""Verdict on a robot's policy, or on a tuned set, from pairs of trials: a table, and a line for each comparison.

several.py and tune_robot.py print it. Methods are compared over worlds (evaluation/compare.py).
"""

from __future__ import annotations

from typing import TYPE_CHECKING, List, Mapping, Sequence, Tuple

from training.evaluation.compare import LEVEL, compare, over_worlds
from training.evaluation.score import AIMS, Cost, seconds
from training.evaluation.trial import BASELINE, Result, Trial

if TYPE_CHECKING:
    import pandas as pd

POLICY, SET = "applr", "static"
OF_THREE = LEVEL / 3  # of the test of two methods, of which three are compared


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


def outcomes(trials: pd.DataFrame) -> str:
    """Return a table of the methods: courses, arrivals, contacts, and the mean time of the arrivals [s]."""
    import pandas as pd

    by_method = trials.groupby("method", sort=False)
    times = trials.time_s.where(trials.success).groupby(trials.method, sort=False).mean()
    columns = {"courses": by_method.size(), "arrived": by_method.success.sum(), "contacts": by_method.collided.sum()}
    return pd.DataFrame({**columns, "time [s]": times.round(1)}).rename_axis(None).to_string()


def verdict(trials: pd.DataFrame) -> Tuple[str, List[str]]:
    """Return the verdict on a robot's policy.

    Args:
        trials: of at least one course (paired_trials).

    Returns:
        The method to drive with, the default parameters unless another one is clearly better; a table, and a line for
        each other method.
    """
    scores, lines, better = mean_scores(trials), [outcomes(trials)], []
    for method in scores.columns.drop(BASELINE):
        found = compare(scores[method], scores[BASELINE])
        lines.append(f"{method} {found.line(OF_THREE)}")
        better += [method] * found.better(OF_THREE)
    return min(better, key=lambda method: scores[method].mean(), default=BASELINE), lines


def tuned_verdict(trials: pd.DataFrame, aim: str) -> Tuple[bool, List[str]]:
    """Return the verdict on tuned parameters beside the robot's own.

    Args:
        trials: of at least one course with both (paired_trials), and what they cost by the aim.
        aim: what they were tuned for, one of score.AIMS.

    Returns:
        Whether they are clearly better, and in what the aim is named for, too; a table, a line for each quantity that
        the aim is named for, and one for the cost.
    """
    lines, gains = [outcomes(trials)], []
    both = trials[trials.groupby("world").success.transform("all")]  # a robot that stands has no jerk
    for word, column, unit, better in AIMS[aim].asked():
        own, tuned = (both[both.method == method].groupby("world")[column].mean() for method in (BASELINE, SET))
        gains.append(over_worlds(better * (tuned - own)))
        gain, low, high = gains[-1]
        means = f"{tuned.mean():.3g} {unit}, own {own.mean():.3g}"
        lines.append(f"{word}: {means}, gain {gain:.2g} ({low:.2g} to {high:.2g})")
    scores = mean_scores(trials)
    found = compare(scores[SET], scores[BASELINE])
    pays = all(gain.value > 0.0 for gain in gains) and max((gain.low for gain in gains), default=1.0) > 0.0
    return pays and found.better(LEVEL), [*lines, found.line(LEVEL, pays)]
