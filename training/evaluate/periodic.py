"""Evaluation during training: rounds of trials on held-out worlds, which select the best policy.

One round drives the planner's default parameters, which are the baseline of the learning curves.
"""

from __future__ import annotations

import json
from functools import partial
from pathlib import Path
from typing import Any, Callable, Dict, List, Optional, Sequence, Tuple

from applr_ros1.common.files import read_bytes, sha256, write_bytes
from training.evaluate.drive import drive
from training.evaluate.score import summary
from training.evaluate.table import Trials
from training.evaluate.trial import BASELINE, POLICY, Result, Trial, plan_trials
from training.workers.pool import Pool

THETA0 = -1  # number of the round that drives the default parameters
CHOOSING = (
    2**31
)  # offset of the seeds of trials that select a policy; all seeds of evaluate.py are smaller


class PeriodicEvaluation:
    """Rounds of trials. A round is due every `every` steps (transitions; offline: gradient steps).

    Args:
        folder: Folder of the run; evaluations.jsonl there has a line per round, evaluation/ the trials.
        worlds: [(name, specification), ...] of the held-out worlds; if empty, no round is ever due.
        every: Number of steps between two rounds.
        seed: Seed of the run. The trials have other seeds than all trials of evaluate.py.
    """

    def __init__(self, folder: Path, worlds: Sequence[Tuple[str, str]], every: int, seed: int):
        self.folder, self.path = Path(folder), Path(folder) / "evaluations.jsonl"
        self.worlds, self.every, self.seed = worlds, every, seed
        lines = read_bytes(self.path).splitlines() if self.path.exists() else []
        self.history: List[Dict[str, Any]] = [json.loads(line) for line in lines]

    def due(self, step: int, last: bool = False, default: bool = True) -> Optional[int]:
        """Return the number of the round to drive now, or None.

        Args:
            step: Current step of the run.
            last: Whether this is the last step of the run, after which the policy is always evaluated.
            default: Whether the round of the default parameters may be driven now.
        """
        if not self.worlds:
            return None
        if default and self.default is None:
            return THETA0
        driven = max((r["step"] for r in self.history if r["round"] != THETA0), default=0)
        number = step // self.every
        return number if number > driven // self.every or (last and step > driven) else None

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
        policy = f"policy-{sha256(weights)[:16]}", POLICY
        method = (BASELINE, BASELINE) if number == THETA0 else policy
        plan = plan_trials(self.worlds, [method], 1, CHOOSING + self.seed, 0)
        with Trials(self.folder / "evaluation", {"seed": self.seed}) as table:
            results = drive(pool, partial(run, weights=weights), table, plan, show)
        line = {**summary(list(results.values())), "round": number, **state}
        rivals = [r["score"] for r in self.history if r["round"] != THETA0]
        line["best"] = number != THETA0 and line["score"] < min(rivals, default=float("inf"))
        self.history.append(line)
        write_bytes(self.path, "".join(json.dumps(each) + "\n" for each in self.history).encode())
        return line

    @property
    def default(self) -> Optional[Dict[str, Any]]:
        """Summary of the round that drove the default parameters, or None."""
        return next((r for r in self.history if r["round"] == THETA0), None)

    @property
    def best(self) -> Optional[Dict[str, Any]]:
        """Summary of the round with the best policy so far, or None."""
        return next((r for r in reversed(self.history) if r["best"]), None)
