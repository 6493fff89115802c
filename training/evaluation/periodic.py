"""Evaluation while training: rounds of trials on held-out worlds, and which actor was best. train.py holds one.

One round drives the planner's default parameters: the line in the learning curves, and what is to be beaten.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any, Dict, List, Optional, Sequence, Tuple

from applr_ros1.common.files import StorageError, read_bytes, write_bytes
from applr_ros1.planner.variant import OURS
from training.evaluation.score import summary
from training.evaluation.trial import BASELINE, POLICY, Result, Trial, plan_trials

THETA0 = -1  # number of the round that drives the default
CHOOSING = 2**31  # added to seeds of trials that choose: evaluate.py's seeds are smaller, so it judges on others


class PeriodicEvaluation:
    """Rounds of trials, one due every `every` steps (transitions; offline: gradient steps).

    Args:
        folder: of the run; evaluations.jsonl there holds a line for each round.
        worlds: [(name, specification), ...] of the held-out worlds; none: no round is ever due.
        trials: in each world.
        every: steps between two rounds.
        seed: of the run. No trial of evaluate.py has the seed of a trial that chose the actor.
        setting: which worlds, simulator and planner, in words: rounds of another setting are no rivals, nor are those
            of another number of worlds or trials.
        planner: kind of planner (applr_ros1/planner/variant.py).
    """

    def __init__(
        self,
        folder: Path,
        worlds: Sequence[Tuple[str, str]],
        trials: int,
        every: int,
        seed: int,
        setting: str = "",
        planner: str = OURS,
    ):
        self.path = Path(folder) / "evaluations.jsonl"
        self.worlds, self.trials, self.every, self.seed = worlds, trials, every, seed
        self.planner = planner
        self._judged: Dict[str, Any] = {"setting": setting, "worlds": len(worlds), "trials_per_world": trials}
        self.history: List[Dict[str, Any]] = _read(self.path)
        self.number: Optional[int] = None  # of the round under way
        self._results: List[Result] = []
        self._open = 0

    # -- when --------------------------------------------------------------------------------------
    def due(self, step: int, last: bool = False, default: bool = True) -> Optional[int]:
        """The number of the round to begin now, or None.

        last: no more steps follow, so their policy is driven, too. default: now is the time for the default parameters.
        """
        if self.number is not None or not self.worlds:
            return None
        if default and self.default is None:
            return THETA0
        driven = max((r["step"] for r in self.here if r["round"] != THETA0), default=0)
        number = step // self.every
        return number if number > driven // self.every or (last and step > driven) else None

    def begin(self, number: int, step: int, version: int) -> List[Trial]:
        """The trials of round `number`, begun at `step` with the policy of `version` gradient steps."""
        self.number, self._results = number, []
        self.step, self.version = step, version
        method = (BASELINE, BASELINE) if number == THETA0 else ("policy", POLICY)
        seed = CHOOSING + self.seed
        trials = plan_trials(self.worlds, [method], self.trials, seed, 0, self.planner)
        self._open = len(trials)
        return trials

    def add(self, result: Optional[Result]) -> Optional[Dict[str, Any]]:
        """Takes a trial's result, None for an error. The round's summary when it was the last, else None.

        Raises:
            StorageError: where every trial of the round failed by an error.
        """
        self._open -= 1
        if result is not None:
            self._results.append(result)
        if self._open > 0:
            return None
        number, self.number = self.number, None
        if not self._results:
            raise StorageError("every trial of an evaluation failed; see the messages above")
        found = summary(self._results)
        found.update(round=number, step=self.step, version=self.version, **self._judged)
        rivals = [r["score"] for r in self.here if r["round"] != THETA0]
        # of another round the trials that failed by an error may have been the hard ones
        whole = len(self._results) == len(self.worlds) * self.trials
        found["best"] = whole and number != THETA0 and found["score"] < min(rivals, default=float("inf"))
        self.history.append(found)
        write_bytes(self.path, "".join(json.dumps(line) + "\n" for line in self.history).encode())
        return found

    @property
    def here(self) -> List[Dict[str, Any]]:
        """The rounds of the present setting: another simulator's times are no rivals.

        Rounds of runs that did not note how they were judged were judged as now.
        """
        return [r for r in self.history if all(r.get(name, value) == value for name, value in self._judged.items())]

    # -- what ----------------------------------------------------------------------------------------
    @property
    def default(self) -> Optional[Dict[str, Any]]:
        """The default parameters' summary."""
        return next((r for r in self.here if r["round"] == THETA0), None)

    @property
    def best(self) -> Optional[Dict[str, Any]]:
        """The summary of the round that chose the present best actor."""
        return next((r for r in reversed(self.here) if r["best"]), None)


def _read(path: Path) -> List[Dict[str, Any]]:
    if not path.exists():
        return []
    return [json.loads(line) for line in read_bytes(path).splitlines()]
