"""The loop that runs trials in a pool, shared by evaluations, training rounds, searches and verdicts."""

from __future__ import annotations

from typing import Callable, Dict, Sequence, Tuple

from applr_ros1.common.errors import ApplrError
from training.evaluate.table import Trials
from training.evaluate.trial import Result, Trial
from training.workers.calls import CallFailed
from training.workers.pool import Pool

# Function that returns the result, and the packed trace if the trial asks for one, else b"".
Run = Callable[[Trial], Tuple[Result, bytes]]


def drive(
    pool: Pool,
    run: Run,
    table: Trials,
    trials: Sequence[Trial],
    show: Callable[[Trial, Result], None] = lambda trial, result: None,
) -> Dict[Trial, Result]:
    """Drive the trials that the table does not hold, each once, and return the results of all trials.

    Args:
        pool: Pool of workers.
        run: Function that drives a trial in a worker.
        table: Table that keeps the trials, so that a stopped run can continue to the same result.
        trials: Trials whose results are needed.
        show: Called with each trial and its result after it was driven and stored.

    Raises:
        ApplrError: A trial raised an error.
    """
    missing = [trial for trial in dict.fromkeys(trials) if table.find(trial) is None]
    for trial, future in pool.unordered(run, missing):
        try:
            show(trial, table.add(trial, *future.result()))
        except CallFailed as error:
            raise ApplrError(
                f"trial {trial.trial} of {trial.method} in {trial.world} failed: {error}"
            ) from None
    return {trial: kept for trial in trials if (kept := table.find(trial))}
