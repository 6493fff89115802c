"""The one score: what trials are compared by, in periodic evaluation, in searches and between simulators [s]."""

from __future__ import annotations

import math
from typing import Any, Dict, Mapping, Sequence, Tuple

import numpy as np

from training.actors.tasks import TrialResult
from training.env.episode import TIME_LIMIT
from training.evaluation.store import flag

FAILURE_SECONDS = TIME_LIMIT  # what a failed trial counts as [s]
CONTACT_SECONDS = 5.0  # what a contact adds to a trial's score where policies are compared [s]


def trial_seconds(
    success: bool,
    time_s: float,
    collided: bool = False,
    contact_seconds: float = 0.0,
    failure_seconds: float = FAILURE_SECONDS,
) -> float:
    """A trial's score [s]: its time, or failure_seconds, and contact_seconds more where the robot touched something."""
    return (time_s if success else failure_seconds) + contact_seconds * collided


def summary(results: Sequence[TrialResult], contact_seconds: float) -> Dict[str, Any]:
    """Means over trials, as JSON values.

    Args:
        results: at least one.
        contact_seconds: what a contact adds to a trial's time [s].

    Returns:
        {"trials", "return", "length", "score"}, and where the environment knows courses "success", "collided" and
        "time_s", the mean time of the successes or None. Elsewhere the score is the negated mean return.
    """
    found: Dict[str, Any] = {
        "trials": len(results),
        "return": _mean([r.total_reward for r in results]),
        "length": _mean([r.decisions for r in results]),
    }
    if math.isnan(results[0].time_s):
        return dict(found, score=-found["return"])
    return dict(found, **_of_courses([(r.success, r.time_s, r.collided) for r in results], contact_seconds))


def summary_of_rows(rows: Sequence[Mapping[str, str]]) -> Dict[str, Any]:
    """The same for rows of trials.csv, at least one, with CONTACT_SECONDS: without "return" and "length"."""
    trials = [(flag(row["success"]), float(row["time_s"]), flag(row["collided"])) for row in rows]
    return dict(_of_courses(trials, CONTACT_SECONDS), trials=len(trials))


def _of_courses(trials: Sequence[Tuple[bool, float, bool]], contact_seconds: float) -> Dict[str, Any]:
    """Means over (success, time [s], whether anything was touched)."""
    times = [time_s for success, time_s, _ in trials if success]
    return {
        "success": _mean([success for success, _, _ in trials]),
        "collided": _mean([collided for _, _, collided in trials]),
        "time_s": _mean(times) if times else None,
        "score": _mean([trial_seconds(*trial, contact_seconds) for trial in trials]),
    }


def _mean(values: Sequence[float]) -> float:
    return float(np.mean([float(value) for value in values]))
