"""Drives sets of parameters through worlds, in parallel, and remembers each trial in a file.

set_search.py drives its candidates with this. A search that was stopped finds the trials that it drove before in the
file, and thereby comes to where it was and to the same result.
"""

from __future__ import annotations

import json
from collections import deque
from dataclasses import asdict
from pathlib import Path
from typing import Any, Deque, Dict, List, Optional, Sequence, Tuple

import numpy as np

from applr_ros1.common.errors import reason
from applr_ros1.common.files import StorageError, read_bytes
from applr_ros1.planner.variant import DEFAULT_WEIGHTS, OURS
from applr_ros1.policy.parameter_space import space_of
from applr_ros1.robots import JACKAL, Robot
from training.evaluation.periodic import CHOOSING
from training.evaluation.trials import TRIAL_RUNNER, seed_of
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


class SetTrials:
    """Drives sets of parameters through worlds.

    Args:
        worlds: [(name, specification), ...].
        simulator: to drive in.
        workers: trials driven at once; 0: in this process.
        pool: "processes" or "ray".
        address: of a Ray cluster, or "".
        weights: how the planner's distance biases count.
        planner: kind of planner (applr_ros1/planner/variant.py).
        planner_frequency: global plans per simulated second; None: as many as the robot makes.
        file: where trials are kept and looked up; None: nowhere.
        runner: "module:Class" that drives the trials.
        robot: whose parameters they are, and which drives.
    """

    def __init__(
        self,
        worlds: Sequence[Tuple[str, str]],
        simulator: str,
        workers: int = 0,
        pool: str = "processes",
        address: str = "",
        weights: str = DEFAULT_WEIGHTS,
        planner: str = OURS,
        planner_frequency: Optional[int] = None,
        file: Optional[TrialFile] = None,
        runner: str = TRIAL_RUNNER,
        robot: Robot = JACKAL,
    ):
        self.space = space_of(robot)
        self.worlds, self.weights, self.planner = worlds, weights, planner
        self.driven = 0  # trials, those of the file included
        self._file, self._setting = file, [simulator, planner_frequency]
        self._queue: Deque[Trial] = deque()
        options: Dict[str, Any] = {"simulator": simulator}
        if robot is not JACKAL:  # a runner of one's own need not know of robots
            options["robot"] = robot.folder
            self._setting.append(robot.name)
        if planner_frequency is not None:
            options["planner_frequency"] = planner_frequency
        self.pool = make_pool(
            WorkerSettings(trial=RunnerSpec(runner, options)), self._next_task, workers, pool, address
        )

    def _next_task(self, slot: int) -> Optional[Trial]:
        try:
            return self._queue.popleft()
        except IndexError:
            return None

    def run(self, sets: np.ndarray, jobs: Sequence[Tuple[int, int]], seed: int) -> List[List[TrialResult]]:
        """Each set in each job: a list of results, in the order of the jobs, for each set.

        Args:
            sets: (k, n), a set of parameters in a row.
            jobs: (index of the world, number of the trial there); all sets drive a job with the same seed.
            seed: from which the seeds of the trials follow.

        Raises:
            PoolError: where many trials fail by an error.
        """
        trials = [[self._trial(theta, world, number, seed) for world, number in jobs] for theta in sets]
        results: Dict[Trial, TrialResult] = {}
        for trial in (trial for own in trials for trial in own):
            known = self._file.find(self._key(trial)) if self._file else None
            if known is not None:
                results[trial] = known
        in_order = dict.fromkeys(trial for of_job in zip(*trials) for trial in of_job)  # equal sets drive once
        self._queue.extend(trial for trial in in_order if trial not in results)
        errors = 0
        while len(results) < len(in_order):
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
        self.driven += len(in_order)
        return [[results[trial] for trial in own] for own in trials]

    def _trial(self, values: np.ndarray, world: int, number: int, seed: int) -> Trial:
        name, spec = self.worlds[world]
        theta = tuple(float(value) for value in self.space.clip(values))
        seed = seed_of(CHOOSING + seed, name, number)
        return Trial(name, "set", number, seed, spec, "", self.weights, self.planner, theta=theta)

    def _key(self, trial: Trial) -> List[Any]:
        return [*self._setting, trial.world_spec, trial.seed, trial.weights, trial.planner, list(trial.theta or ())]

    def close(self) -> None:
        """End the workers."""
        self.pool.close()
