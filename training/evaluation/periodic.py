"""Evaluation while training: rounds of trials on held-out worlds, and which actor was best. train.py holds one.

One round drives the planner's default parameters: the line in the learning curves, and what is to be beaten.
"""

from __future__ import annotations

import json
from functools import partial
from pathlib import Path
from typing import Any, Callable, Dict, List, Optional, Sequence, Tuple

from applr_ros1.common.files import read_bytes, sha256, write_bytes
from training.evaluation.drive import drive
from training.evaluation.score import summary
from training.evaluation.table import Trials
from training.evaluation.trial import BASELINE, POLICY, Result, Trial, plan_trials
from training.workers.pool import Pool

THETA0 = -1  # number of the round that drives the default
CHOOSING = 2**31  # added to seeds of trials that choose: evaluate.py's seeds are smaller, so it judges on others


class PeriodicEvaluation:
    """Rounds of trials, one due every `every` steps (transitions; offline: gradient steps).

    Args:
        folder: of the run; evaluations.jsonl there holds a line for each round, evaluation-* the trials.
        worlds: [(name, specification), ...] of the held-out worlds; none: no round is ever due.
        every: steps between two rounds.
        seed: of the run. No trial of evaluate.py has the seed of a trial that chose the actor.
        setting: which worlds, simulator and planner, in words: rounds of another setting are no rivals, nor are those
            of another number of worlds.
    """

    def __init__(
        self,
        folder: Path,
        worlds: Sequence[Tuple[str, str]],
        every: int,
        seed: int,
        setting: str = "",
    ):
        self.folder, self.path = Path(folder), Path(folder) / "evaluations.jsonl"
        self.worlds, self.every, self.seed = worlds, every, seed
        self._judged: Dict[str, Any] = {"setting": setting, "worlds": len(worlds), "trials_per_world": 1}
        lines = read_bytes(self.path).splitlines() if self.path.exists() else []
        self.history: List[Dict[str, Any]] = [json.loads(line) for line in lines]

    def due(self, step: int, last: bool = False, default: bool = True) -> Optional[int]:
        """Return the number of the round to drive now, or None.

        Args:
            step: of the run.
            last: no more steps follow, so their policy is driven, too.
            default: now is the time for the default parameters.
        """
        if not self.worlds:
            return None
        if default and self.default is None:
            return THETA0
        driven = max((r["step"] for r in self.here if r["round"] != THETA0), default=0)
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
        """Drive a round, and return its summary, with whether the policy is the best so far.

        Args:
            number: of the round.
            pool: of workers.
            run: drives a trial there with the weights of a policy.
            weights: of the present policy.
            show: called with each trial that was driven.
            state: "step" of the run, and "version" of the policy in gradient steps.

        Raises:
            ApplrError: a trial failed by an error.
        """
        policy = f"policy-{sha256(weights)[:16]}", POLICY
        method = (BASELINE, BASELINE) if number == THETA0 else policy
        plan = plan_trials(self.worlds, [method], 1, CHOOSING + self.seed, 0)
        kept = {**self._judged, "seed": self.seed}
        with Trials(self.folder / f"evaluation-{sha256(json.dumps(kept).encode())[:8]}", kept) as table:
            results = drive(pool, partial(run, weights=weights), table, plan, show)
        found = {**summary(list(results.values())), "round": number, **state, **self._judged}
        rivals = [r["score"] for r in self.here if r["round"] != THETA0]
        found["best"] = number != THETA0 and found["score"] < min(rivals, default=float("inf"))
        self.history.append(found)
        write_bytes(self.path, "".join(json.dumps(line) + "\n" for line in self.history).encode())
        return found

    @property
    def here(self) -> List[Dict[str, Any]]:
        """The rounds of the present setting: another simulator's times are no rivals."""
        return [r for r in self.history if all(r.get(name, value) == value for name, value in self._judged.items())]

    @property
    def default(self) -> Optional[Dict[str, Any]]:
        """The default parameters' summary."""
        return next((r for r in self.here if r["round"] == THETA0), None)

    @property
    def best(self) -> Optional[Dict[str, Any]]:
        """The summary of the round that chose the present best actor."""
        return next((r for r in reversed(self.here) if r["best"]), None)
