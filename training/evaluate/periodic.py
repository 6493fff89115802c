"""Evaluation during training: rounds of trials on held-out worlds, which select the best policy.

The first round, before anything is learnt, is the baseline of the learning curves: it drives the
parameter set or the policy with which the run begins, else the planner's default parameters.
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

# Offset of the seeds of trials that select a policy, above all seeds of ./applr evaluate: an
# evaluation with the seeds of the selection would find the selected policy too good.
CHOOSING = 2**31


class PeriodicEvaluation:
    """Rounds of trials, due every `every` steps (transitions; offline: gradient steps).

    Args:
        folder: Folder of the run; evaluations.jsonl there has a line per round, evaluation/ the
            trials.
        worlds: [(name, specification, ...), ...] of the held-out worlds; if empty, no round is
            ever due.
        every: Number of steps between two rounds.
        seed: Seed of the run. The trials have other seeds than all trials of ./applr evaluate.
        has_start: Whether the untrained policy is one to drive: a parameter set, or a policy.

    Attributes:
        history: Summaries of all rounds so far.
    """

    def __init__(
        self,
        folder: Path,
        worlds: Sequence[Tuple[Any, ...]],
        every: int,
        seed: int,
        has_start: bool,
    ):
        self.folder = Path(folder)
        self.path = self.folder / "evaluations.jsonl"
        self.worlds = worlds
        self.every = every
        self.seed = seed
        self.has_start = has_start
        self.history: List[Dict[str, Any]] = []
        if self.path.exists():
            with reading(self.path):
                self.history.extend(map(json.loads, read_bytes(self.path).splitlines()))

    def due(self, step: int, last: bool = False) -> Optional[int]:
        """Return the number of the round to drive now, or None.

        Args:
            step: Current step of the run.
            last: Whether this is the last step of the run, after which the policy is always
                evaluated.
        """
        if not self.worlds:
            return None
        if not self.history:
            return 0
        latest_step = self.history[-1]["step"]
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
        is_policy = self.has_start or bool(self.history)
        if is_policy:
            # Each policy has a name of its own, so that the table keeps the trials of all.
            method = (f"policy-{sha256(weights)[:16]}", POLICY)
        plan = plan_trials(self.worlds, [method], trials=1, seed=CHOOSING + self.seed, traces=0)
        with TrialTable(self.folder / "evaluation", {"seed": self.seed}) as table:
            results = drive(pool, partial(run, weights=weights), table, plan, show)
        means = summary(list(results.values()))
        record = {**means, "round": number, "method": method[0], **state}
        rival = self.best
        is_better = rival is None or record["score"] < rival["score"]
        record["best"] = is_policy and is_better
        self.history.append(record)
        lines = "\n".join(map(json.dumps, self.history)) + "\n"
        write_bytes(self.path, lines.encode())
        return record

    @property
    def best(self) -> Optional[Dict[str, Any]]:
        """Summary of the round with the best policy so far, or None."""
        for record in self.history[::-1]:
            if record["best"]:
                return record
        return None
