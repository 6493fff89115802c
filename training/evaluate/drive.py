"""The loop that runs trials in a pool, for evaluations, training rounds, searches and verdicts."""

from __future__ import annotations

from typing import Callable, Dict, Sequence, Tuple

from applr_ros1.common.errors import ApplrError
from training.evaluate.table import TrialTable
from training.evaluate.trial import Result, Trial
from training.workers.calls import CallFailed
from training.workers.pool import Pool

# Function that returns the result, and the packed trace if the trial asks for one, else b"".
Run = Callable[[Trial], Tuple[Result, bytes]]


def drive(
    pool: Pool,
    run: Run,
    table: TrialTable,
    trials: Sequence[Trial],
    show: Callable[[Trial, Result], None] = lambda trial, result: None,
) -> Dict[Trial, Result]:
    """Drive the trials that the table does not hold, each once, and return the results of all.

    Args:
        pool: Pool of workers.
        run: Function that drives a trial in a worker.
        table: Table that keeps the trials, so that a stopped run can continue to the same result.
        trials: Trials whose results are needed.
        show: Called with each trial and its result after it was driven and stored.

    Raises:
        ApplrError: A trial raised an error.
    """
    for trial, future in pool.unordered(run, table.missing(trials)):
        try:
            show(trial, table.add(trial, *future.result()))
        except CallFailed as error:
            problem = f"trial {trial.trial} of {trial.method} in {trial.world} failed"
            raise ApplrError(f"{problem}: {error}") from None

    # From the table, which rounds: a continued run then works with the same numbers.
    return {trial: table.result(trial) for trial in trials}
