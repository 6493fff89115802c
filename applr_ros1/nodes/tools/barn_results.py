"""A run of the BARN Challenge, its score, and what many runs amount to. Used by barn.py."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Dict, List

import numpy as np

from applr_ros1.common.errors import ApplrError

LIMIT = 100.0  # [s] a run
SPEED = 2.0  # [m/s] at which the optimal time is driven


@dataclass(frozen=True)
class Run:
    """One row: what the runner wrote (time_s and metric), and the score computed from it."""

    world: int
    trial: int
    success: int
    collided: int
    timeout: int
    time_s: float
    metric: float  # as run.py computes it
    score: float  # with no less than 2 optimal times counted, as run.py does since 2025
    score_2024: float  # no less than 4, as until then
    optimal_s: float

    @property
    def outcome(self) -> str:
        """In a word."""
        return "succeeded" if self.success else "collided" if self.collided else "timeout"


def score(success: bool, seconds: float, optimal: float, least: float) -> float:
    """The Challenge's score of a run: success x OT / clip(AT, `least` OT, 8 OT), 0 to 1 / `least`; times in seconds."""
    return float(success) * optimal / float(np.clip(seconds, least * optimal, 8.0 * optimal))


def run_of(line: str, trial: int, route: float) -> Run:
    """From the line that run.py appends to its file: world, success, collided, timeout, seconds, metric."""
    words = line.split()
    try:
        world, success, collided, timeout = (int(word) for word in words[:4])
        seconds, metric = (float(word) for word in words[4:6])
    except ValueError:
        raise ApplrError(f"the runner wrote {line[:80]!r}: no line of six numbers") from None
    optimal = route / SPEED
    scores = [round(score(bool(success), seconds, optimal, least), 4) for least in (2.0, 4.0)]
    return Run(world, trial, success, collided, timeout, seconds, metric, scores[0], scores[1], round(optimal, 4))


def summary(runs: List[Run]) -> Dict[str, object]:
    """Counts, rates and means over all runs; times over the successful ones."""
    times = [run.time_s for run in runs if run.success]

    def mean(values) -> float:
        return round(float(np.mean(values)), 4)

    return {
        "runs": len(runs),
        "worlds": len({run.world for run in runs}),
        "success_rate": mean([run.success for run in runs]),
        "collision_rate": mean([run.collided for run in runs]),
        "timeout_rate": mean([run.timeout for run in runs]),
        "time_s": mean(times) if times else None,
        "score": mean([run.score for run in runs]),
        "score_2024": mean([run.score_2024 for run in runs]),
        "metric_of_runner": mean([run.metric for run in runs]),
    }
