"""The one score: what trials are compared by, in periodic evaluation, in searches and between simulators [s]."""

from __future__ import annotations

import math
from typing import Any, Dict, NamedTuple, Sequence

import numpy as np
from scipy import stats

from applr_ros1.robots import Robot
from training.env.episode import TIME_LIMIT
from training.evaluation.plan import TrialResult

FAILURE_SECONDS = TIME_LIMIT  # what a failed trial counts as [s]
LEVEL = 0.05  # of the one-sided paired t-test
FEWEST = 5  # common trials before the test is asked
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


class Aim(NamedTuple):
    """What parameters are tuned for: prices beside a trial's time, in optimal times.

    The optimal time is the reference path's length at the base's largest speed. failure: instead of the time;
    contact: more where the robot touched something; near: more the nearer its laser came to
    something, nothing beyond 1.5 of the body's widths, all at half a width; jerk and turn: times the mean change of
    acceleration and the mean yaw acceleration, in the base's largest speeds [1/s^2] and [1/s].
    """

    failure: float
    contact: float
    near: float = 0.0
    jerk: float = 0.0
    turn: float = 0.0

    def seconds(self, result: TrialResult, robot: Robot) -> float:
        """What a trial costs [s]."""
        optimal, width, base = result.route_m / robot.base.max_speed, robot.body.size[1], robot.base
        short = float(np.clip(1.5 - result.min_clearance_m / width, 0.0, 1.0))
        jerk, turn = result.mean_jerk / base.max_speed, result.mean_turn / base.max_yaw_rate
        price = self.contact * result.collided + self.near * short + self.jerk * jerk + self.turn * turn
        return (result.time_s if result.success else self.failure * optimal) + price * optimal


AIMS = {
    "fast": Aim(failure=20.0, contact=4.0),  # with half of it a set drove that arrived in 86 % of BARN's worlds
    "careful": Aim(failure=20.0, contact=20.0, near=5.0),
    "smooth": Aim(failure=20.0, contact=4.0, jerk=0.4, turn=4.0),
}


def barn_metric(success: Any, collided: Any, time_s: Any, route_m: Any, least: float = 2.0) -> Any:
    """The BARN Challenge's metric of trials, numbers or arrays (n,): success x OT / clip(time, least x OT, 8 x OT).

    It is 0 where the trial failed or touched anything. OT is the optimal time: the reference path's length route_m [m]
    at 2 m/s. The Challenge's `least` is 2 since 2025, so that the most is .5; before, it was 4.
    """
    optimal = np.maximum(route_m, 1e-9) / 2.0
    return success * np.logical_not(collided) * optimal / np.clip(time_s, least * optimal, 8.0 * optimal)


def clearly_worse(scores: np.ndarray, best: np.ndarray, level: float = LEVEL) -> bool:
    """Whether the first scores (n,) are significantly larger than the second (n,) of the same n trials."""
    difference = scores - best
    if len(difference) < FEWEST or level <= 0.0:
        return False
    if np.ptp(difference) == 0.0:
        return bool(difference[0] > 0.0)
    return bool(stats.ttest_1samp(difference, 0.0, alternative="greater").pvalue < level)


def summary(results: Sequence[TrialResult], contact_seconds: float) -> Dict[str, Any]:
    """Means over trials, as JSON values.

    Args:
        results: at least one.
        contact_seconds: what a contact adds to a trial's time [s].

    Returns:
        {"trials", "return", "length", "score"}, and where the environment knows courses "success", "collided",
        "metric" (barn_metric) and "time_s", the mean time of the successes or None. Elsewhere the score is the negated
        mean return.
    """
    found: Dict[str, Any] = {
        "trials": len(results),
        "return": _mean([r.total_reward for r in results]),
        "length": _mean([r.decisions for r in results]),
    }
    if math.isnan(results[0].time_s):
        return dict(found, score=-found["return"])
    times = [r.time_s for r in results if r.success]
    return {
        **found,
        "success": _mean([r.success for r in results]),
        "collided": _mean([r.collided for r in results]),
        "metric": _mean([barn_metric(r.success, r.collided, r.time_s, r.route_m) for r in results]),
        "time_s": _mean(times) if times else None,
        "score": _mean([trial_seconds(r.success, r.time_s, r.collided, contact_seconds) for r in results]),
    }


def _mean(values: Sequence[float]) -> float:
    return float(np.mean([float(value) for value in values]))
