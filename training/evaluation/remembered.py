"""Drives trials in a pool of workers, those whose results a table does not hold yet.

evaluate.py and static_search.py drive with this. What was stopped finds the trials that it drove
before in the table, and thereby comes to where it was and to the same result.
"""

from __future__ import annotations

from collections import deque
from typing import Callable, Deque, Dict, Optional, Sequence, Union

from applr_ros1.common.errors import ApplrError
from training.actors.pool import make_pool
from training.actors.tasks import RunnerSpec, Trial, TrialResult, WorkerSettings
from training.evaluation.store import TrialStore, TrialTable


class RememberedTrials:
    """Drives trials, those that the table does not hold.

    Args:
        runner: who drives them, and how.
        workers: trials driven at once; 0: in this process.
        ray_address: of a Ray cluster, or "" for child processes.
        table: where trials are kept and looked up; None: nowhere.
    """

    def __init__(
        self,
        runner: RunnerSpec,
        workers: int = 0,
        ray_address: str = "",
        table: Optional[Union[TrialStore, TrialTable]] = None,
    ):
        self._table = table
        self._queue: Deque[Trial] = deque()
        self.pool = make_pool(WorkerSettings(trial=runner), self._next_task, workers, ray_address)

    def _next_task(self, slot: int) -> Optional[Trial]:
        return self._queue.popleft() if self._queue else None

    def run(
        self, trials: Sequence[Trial], told: Callable[[Trial, TrialResult], None] = lambda trial, result: None
    ) -> Dict[Trial, TrialResult]:
        """The results of trials, in which equal ones are driven once.

        Args:
            trials: to be driven where the table does not hold them.
            told: hears of each trial that was driven, after it was kept.

        Raises:
            ApplrError: a trial failed by an error.
        """
        wanted = dict.fromkeys(trials)
        known = {trial: self._table.find(trial) for trial in wanted} if self._table else {}
        results = {trial: result for trial, result in known.items() if result is not None}
        self._queue.extend(trial for trial in wanted if trial not in results)
        while len(results) < len(wanted):
            for answer in self.pool.poll(0.2):
                trial = answer.task
                assert isinstance(trial, Trial)
                if answer.result is None:
                    raise ApplrError(f"trial {trial.trial} of {trial.method} in {trial.world} failed: {answer.error}")
                if self._table:
                    self._table.add(trial, answer.result, answer.data)
                results[trial] = answer.result
                told(trial, answer.result)
        return results

    def close(self) -> None:
        """End the workers."""
        self.pool.close()
