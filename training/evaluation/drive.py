"""The one loop that has trials driven: of evaluations, of searches and of the verdict on what they find."""

from __future__ import annotations

from typing import Callable, Dict, Sequence, Tuple

from applr_ros1.common.errors import ApplrError
from training.evaluation.table import Trials
from training.evaluation.trial import Result, Trial
from training.workers.pool import CallFailed, Pool

Run = Callable[[Trial], Tuple[Result, bytes]]  # gives the result, and the packed trace where the trial asks for it


def drive(
    pool: Pool,
    run: Run,
    table: Trials,
    trials: Sequence[Trial],
    show: Callable[[Trial, Result], None] = lambda trial, result: None,
) -> Dict[Trial, Result]:
    """Return the results of trials, of which those are driven that the table does not hold; equal ones once.

    Args:
        pool: of workers.
        run: drives a trial there.
        table: where trials are kept, so that what was stopped comes to where it was and to the same result.
        trials: to be driven.
        show: called with each trial that was driven, after it was kept.

    Raises:
        ApplrError: a trial failed by an error.
    """
    missing = [trial for trial in dict.fromkeys(trials) if table.find(trial) is None]
    for trial, future in pool.unordered(run, missing):
        try:
            show(trial, table.add(trial, *future.result()))
        except CallFailed as error:
            raise ApplrError(f"trial {trial.trial} of {trial.method} in {trial.world} failed: {error}") from None
    return {trial: kept for trial in trials if (kept := table.find(trial))}
