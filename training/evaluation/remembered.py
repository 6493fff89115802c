"""Drives trials in parallel and remembers each in a file.

set_trials.py and refine_policy.py search with this. A search that was stopped finds the trials that it drove before in
the file, and thereby comes to where it was and to the same result.
"""

from __future__ import annotations

import json
from collections import deque
from dataclasses import asdict
from pathlib import Path
from typing import Any, Deque, Dict, List, Optional, Sequence

from applr_ros1.common.errors import reason
from applr_ros1.common.files import StorageError, read_bytes
from training.workers.pool import PoolError, make_pool
from training.workers.tasks import MessageError, RunnerSpec, Trial, TrialResult, WorkerSettings, build

MANY_ERRORS = 20  # failed trials in one call: something is wrong with all of them


class TrialFile:
    """Trials that were driven, a JSON line for each: what was driven, and how it went.

    A last line that was cut off, where a process was killed while writing it, is dropped.

    Args:
        path: of the file, which is made where it is missing.

    Raises:
        StorageError: with one line, for a file that cannot be read or written or holds something else.
    """

    def __init__(self, path):
        self.path = Path(path)
        self._known: Dict[str, TrialResult] = {}
        whole = b""
        if self.path.exists():
            whole, _, cut = read_bytes(self.path).rpartition(b"\n")
            whole += b"\n" if whole else b""
        for number, line in enumerate(whole.splitlines(), start=1):
            try:
                key, result = json.loads(line)
                self._known[json.dumps(key)] = build(TrialResult, result)
            except (ValueError, TypeError, RecursionError, MessageError):
                raise StorageError(
                    "%s: line %d is no trial of a search; give another --out" % (self.path, number)
                ) from None
        try:
            self._file = self.path.open("ab")
            self._file.truncate(len(whole))
        except OSError as error:
            raise StorageError("%s: cannot be written (%s)" % (self.path, reason(error))) from None

    def find(self, key: List[Any]) -> Optional[TrialResult]:
        """The result of a trial that was driven before, or None."""
        return self._known.get(json.dumps(key))

    def add(self, key: List[Any], result: TrialResult) -> None:
        """Keep a trial."""
        self._known[json.dumps(key)] = result
        self._file.write(json.dumps([key, asdict(result)]).encode() + b"\n")
        self._file.flush()

    def close(self) -> None:
        """Close the file."""
        self._file.close()


class RememberedTrials:
    """Drives trials, those that the file does not know.

    Args:
        runner: who drives them, and how.
        setting: what of that tells results apart, as JSON values; it stands in the file with each trial.
        workers: trials driven at once; 0: in this process.
        pool: "processes" or "ray".
        address: of a Ray cluster, or "".
        file: where trials are kept and looked up; None: nowhere.
    """

    def __init__(
        self,
        runner: RunnerSpec,
        setting: Sequence[Any],
        workers: int = 0,
        pool: str = "processes",
        address: str = "",
        file: Optional[TrialFile] = None,
    ):
        self._setting, self._file = setting, file
        self._queue: Deque[Trial] = deque()
        self.pool = make_pool(WorkerSettings(trial=runner), self._next_task, workers, pool, address)

    def _next_task(self, slot: int) -> Optional[Trial]:
        try:
            return self._queue.popleft()
        except IndexError:
            return None

    def run(self, trials: Sequence[Trial]) -> Dict[Trial, TrialResult]:
        """The results of trials, in which equal ones are driven once.

        Raises:
            PoolError: where many trials fail by an error.
        """
        wanted = dict.fromkeys(trials)
        results: Dict[Trial, TrialResult] = {}
        for trial in wanted:
            known = self._file.find(self._key(trial)) if self._file else None
            if known is not None:
                results[trial] = known
        self._queue.extend(trial for trial in wanted if trial not in results)
        errors = 0
        while len(results) < len(wanted):
            for answer in self.pool.poll(0.2):
                assert isinstance(answer.task, Trial)
                if answer.result is not None:
                    results[answer.task] = answer.result
                    if self._file:
                        self._file.add(self._key(answer.task), answer.result)
                    continue
                errors += 1
                if errors > MANY_ERRORS:
                    raise PoolError("trials fail: %s" % answer.error)
                self._queue.append(answer.task)
        return results

    def _key(self, trial: Trial) -> List[Any]:
        what = [list(trial.theta or ()), *([trial.method_spec] if trial.method_spec else [])]
        return [*self._setting, trial.world_spec, trial.seed, trial.weights, trial.planner, *what]

    def close(self) -> None:
        """End the workers."""
        self.pool.close()
