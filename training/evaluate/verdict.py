"""Verdict on a policy or a tuned parameter set from paired trials: a table, and a line for each comparison."""

from __future__ import annotations

from typing import TYPE_CHECKING, List, Mapping, Sequence, Tuple

from training.evaluate.compare import LEVEL, compare
from training.evaluate.score import Cost, seconds
from training.evaluate.trial import BASELINE, Result, Trial

if TYPE_CHECKING:
    import pandas as pd

POLICY, SET = "applr", "static"
MEANS = {  # columns of the table with means over the successful trials, and their titles
    "time_s": "time [s]",
    "mean_clearance_m": "clearance [m]",
    "mean_jerk": "jerk [m/s^3]",
    "mean_turn": "yaw acceleration [rad/s^2]",
}


def paired_trials(results: Mapping[Trial, Result], methods: Sequence[str], cost: Cost = seconds) -> pd.DataFrame:
    """Return the trials of the courses that all methods have driven with the same seed.

    Each row has the fields of a Trial and of its Result, and the cost of the trial as "score" [s].
    """
    import pandas as pd

    trials = pd.DataFrame([{**vars(trial), **vars(result), "score": cost(result)} for trial, result in results.items()])
    return trials[trials.groupby(["world", "trial"]).method.transform("nunique") == len(methods)]


def mean_scores(trials: pd.DataFrame) -> pd.DataFrame:
    """Return the mean scores [s]: a row for each world, a column for each method."""
    return trials.groupby(["world", "method"], sort=False).score.mean().unstack()


def verdict(trials: pd.DataFrame) -> Tuple[str, List[str]]:
    """Compare methods with the robot's default parameters.

    Args:
        trials: Trials of at least one course, from paired_trials().

    Returns:
        The method to drive with, which is BASELINE unless another method is significantly better on average and not
        worse in its worst tenth of the worlds; and the lines of the verdict: a table, and a line for each other method.
    """
    import pandas as pd

    scores = mean_scores(trials)
    worst = scores.apply(lambda column: column.nlargest(max(1, len(column) // 10)).mean())
    by_method = trials.groupby("method", sort=False)
    counts = {"courses": by_method.size(), "arrived": by_method.success.sum(), "contacts": by_method.collided.sum()}
    means = trials[trials.success].groupby("method")[list(MEANS)].mean().rename(columns=MEANS)
    table = pd.DataFrame(counts).join(means).join(worst.rename("worst tenth [s]"))
    lines, better = [str(table.round(2).rename_axis(None).to_string())], []
    rivals = scores.columns.drop(BASELINE)
    for method in rivals:
        comparison = compare(scores[method], scores[BASELINE])
        lines.append(f"{method} {comparison.line(LEVEL / len(rivals))}")
        if worst[method] > worst[BASELINE]:
            lines[-1] += ", but its worst tenth is worse"
        elif comparison.better(LEVEL / len(rivals)):
            better.append(method)
    return min(better, key=lambda method: scores[method].mean(), default=BASELINE), lines
