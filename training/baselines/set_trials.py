"""Drives sets of parameters through worlds, in parallel. set_search.py drives its candidates with this."""

from __future__ import annotations

from typing import Any, Dict, List, Optional, Sequence, Tuple

import numpy as np

from applr_ros1.planner.variant import OURS
from applr_ros1.policy.parameter_space import space_of
from applr_ros1.robots import JACKAL, Robot
from training.actors.tasks import RunnerSpec, Trial, TrialResult
from training.evaluation.periodic import CHOOSING
from training.evaluation.remembered import RememberedTrials
from training.evaluation.store import TrialTable
from training.evaluation.trials import TRIAL_RUNNER, seed_of


class SetTrials:
    """Drives sets of parameters through worlds.

    Args:
        worlds: [(name, specification), ...].
        simulator: to drive in.
        workers: trials driven at once; 0: in this process.
        pool: "processes" or "ray".
        address: of a Ray cluster, or "".
        planner: kind of planner (applr_ros1/planner/variant.py).
        planner_frequency: global plans per simulated second; None: as many as the robot makes.
        file: SQLite file where trials are kept and looked up; None: nowhere.
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
        planner: str = OURS,
        planner_frequency: Optional[int] = None,
        file: Optional[str] = None,
        runner: str = TRIAL_RUNNER,
        robot: Robot = JACKAL,
    ):
        self.space = space_of(robot)
        self.worlds, self.planner = worlds, planner
        self.driven = 0  # trials, those of the file included
        setting: List[Any] = [simulator, planner_frequency]
        options: Dict[str, Any] = {"simulator": simulator}
        if robot is not JACKAL:  # a runner of one's own need not know of robots
            options["robot"] = robot.folder
            setting.append(robot.name)
        if planner_frequency is not None:
            options["planner_frequency"] = planner_frequency
        self._table = None if file is None else TrialTable(file, setting)
        self.trials = RememberedTrials(RunnerSpec(runner, options), workers, pool, address, self._table)

    def run(self, sets: np.ndarray, jobs: Sequence[Tuple[int, int]], seed: int) -> List[List[TrialResult]]:
        """Each set in each job: a list of results, in the order of the jobs, for each set.

        Args:
            sets: (k, n), a set of parameters in a row.
            jobs: (index of the world, number of the trial there); all sets drive a job with the same seed.
            seed: from which the seeds of the trials follow.

        Raises:
            ApplrError: where a trial fails by an error.
        """
        trials = [[self._trial(theta, world, number, seed) for world, number in jobs] for theta in sets]
        results = self.trials.run([trial for of_job in zip(*trials) for trial in of_job])  # equal sets drive once
        self.driven += len(results)
        return [[results[trial] for trial in own] for own in trials]

    def _trial(self, values: np.ndarray, world: int, number: int, seed: int) -> Trial:
        name, spec = self.worlds[world]
        theta = tuple(float(value) for value in self.space.clip(values))
        seed = seed_of(CHOOSING + seed, name, number)
        return Trial(name, "set", number, seed, spec, "", self.planner, theta=theta)

    def close(self) -> None:
        """End the workers."""
        self.trials.close()
        if self._table is not None:
            self._table.close()
