"""Evaluation during training: rounds of trials on held-out worlds, which select the best policy.

One round drives the planner's default parameters, which are the baseline of the learning curves.
"""

from __future__ import annotations

import json
from functools import partial
from pathlib import Path
from typing import Any, Callable, Dict, List, Optional, Sequence, Tuple

from applr_ros1.common.files import read_bytes, reading, sha256, write_bytes
from training.evaluate.drive import drive
from training.evaluate.score import summary
from training.evaluate.table import TrialTable
from training.evaluate.trial import BASELINE, POLICY, Result, Trial, plan_trials
from training.workers.pool import Pool

THETA0 = -1  # number of the round that drives the default parameters
# Offset of the seeds of trials that select a policy, above all seeds of ./applr evaluate: an
# evaluation with the seeds of the selection would find the selected policy too good.
CHOOSING = 2**31


class PeriodicEvaluation:
    """Rounds of trials, due every `every` steps (transitions; offline: gradient steps).

    Args:
        folder: Folder of the run; evaluations.jsonl there has a line per round, evaluation/ the
            trials.
        worlds: [(name, specification), ...] of the held-out worlds; if empty, no round is ever due.
        every: Number of steps between two rounds.
        seed: Seed of the run. The trials have other seeds than all trials of ./applr evaluate.

    Attributes:
        history: Summaries of all rounds so far.
    """

    def __init__(self, folder: Path, worlds: Sequence[Tuple[str, str]], every: int, seed: int):
        self.folder = Path(folder)
        self.path = self.folder / "evaluations.jsonl"
        self.worlds = worlds
        self.every = every
        self.seed = seed
        self.history: List[Dict[str, Any]] = []
        if self.path.exists():
            with reading(self.path):
                self.history.extend(map(json.loads, read_bytes(self.path).splitlines()))

    def due(self, step: int, last: bool = False, default: bool = True) -> Optional[int]:
        """Return the number of the round to drive now, or None.

        Args:
            step: Current step of the run.
            last: Whether this is the last step of the run, after which the policy is always
                evaluated.
            default: Whether the round of the default parameters may be driven now.
        """
        if not self.worlds:
            return None
        if default and self.default is None:
            return THETA0
        latest_step = 0
        for record in self.history:
            if record["round"] != THETA0:
                latest_step = record["step"]
        number = step // self.every
        if number > latest_step // self.every or (last and step > latest_step):
            return number
        return None

    def drive(
        self,
        number: int,
        pool: Pool,
        run: Callable[..., Tuple[Result, bytes]],
        weights: bytes,
        show: Callable[[Trial, Result], None] = lambda trial, result: None,
        **state: int,
    ) -> Dict[str, Any]:
        """Drive a round, and return its summary, including whether the policy is the best so far.

        Args:
            number: Number of the round.
            pool: Pool of workers.
            run: Function that drives a trial in a worker with the weights of a policy.
            weights: Weights of the current policy.
            show: Called with each driven trial and its result.
            state: "step" of the run, and "version" of the policy in gradient steps.

        Raises:
            ApplrError: A trial raised an error.
        """
        method = (BASELINE, BASELINE)
        if number != THETA0:
            # Each policy has a name of its own, so that the table keeps the trials of all.
            method = (f"policy-{sha256(weights)[:16]}", POLICY)
        plan = plan_trials(self.worlds, [method], trials=1, seed=CHOOSING + self.seed, traces=0)
        with TrialTable(self.folder / "evaluation", {"seed": self.seed}) as table:
            results = drive(pool, partial(run, weights=weights), table, plan, show)
        record = {**summary(list(results.values())), "round": number, **state}
        rival = self.best
        is_better = rival is None or record["score"] < rival["score"]
        record["best"] = number != THETA0 and is_better
        self.history.append(record)
        lines = "\n".join(map(json.dumps, self.history)) + "\n"
        write_bytes(self.path, lines.encode())
        return record

    @property
    def default(self) -> Optional[Dict[str, Any]]:
        """Summary of the round that drove the default parameters, or None."""
        for record in self.history:
            if record["round"] == THETA0:
                return record
        return None

    @property
    def best(self) -> Optional[Dict[str, Any]]:
        """Summary of the round with the best policy so far, or None."""
        for record in self.history[::-1]:
            if record["best"]:
                return record
        return None
