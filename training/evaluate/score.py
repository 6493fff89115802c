"""Costs of trials [s]: the score that compares methods, and the objectives of tune.

Reports, the selection of the best policy and the verdict on it compare methods by the same score,
`seconds`.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any, Callable, Dict, Iterable, Mapping, NamedTuple, Sequence

import numpy as np

from applr_ros1.drives.end_rules import TIME_LIMIT
from applr_ros1.drives.outcome import CLEAR, arrived_cleanly
from applr_ros1.robots import Robot
from training.evaluate.trial import Result

if TYPE_CHECKING:
    import pandas as pd

TrialCost = Callable[[Result], float]  # returns the cost of a trial [s]; less is better

# Time that a trial counts as that failed, however early, or touched something [s]
FAILURE_SECONDS = TIME_LIMIT
SECONDS_RULE = f"a failure or contact costs {FAILURE_SECONDS:g} s"


def seconds(trials: Any) -> Any:
    """Return the score [s]: the time of a trial that arrived cleanly, else FAILURE_SECONDS.

    Args:
        trials: A Result, or a table with a row for each trial and the columns `success`,
            `collided` and `time_s`.

    Returns:
        A number for a Result, an array (n,) for a table with n rows.
    """
    is_clean = arrived_cleanly(trials.success, trials.collided)
    scores = np.where(is_clean, trials.time_s, FAILURE_SECONDS)
    return scores[()]  # A number instead of an array without dimensions.


def mean_scores(trials: pd.DataFrame) -> pd.DataFrame:
    """Return the mean scores [s]: a row for each world, a column for each method.

    Args:
        trials: A row for each trial, with the columns `world`, `method` and `score`.
    """
    return trials.groupby(["world", "method"], sort=False).score.mean().unstack()


class Aim(NamedTuple):
    """Objective of tune: weights of the terms of a trial's cost.

    The unit of the cost is the optimal time. The optimal time is the length of the reference path
    divided by the base's largest speed. The baseline is the mean over drives with the robot's
    default parameters.

    Attributes:
        failure: Cost of a trial that failed or touched something, instead of its time.
        slower: Cost of each optimal time by which the trial is slower than the baseline.
        near: Cost of each body width by which the mean clearance falls short of CLEAR widths.
        jerk: Cost of the mean jerk, relative to the baseline.
        turn: Cost of the mean yaw acceleration, relative to the baseline.
    """

    failure: float
    slower: float = 0.0
    near: float = 0.0
    jerk: float = 0.0
    turn: float = 0.0

    def cost(self, result: Result, robot: Robot, baseline: Baseline) -> float:
        """Return the cost of a trial [s]."""
        optimal_s = result.route_m / robot.base.max_speed
        cost = self.failure
        if arrived_cleanly(result.success, result.collided):
            cost = result.time_s / optimal_s
            cost += self.slower * max(0.0, cost - baseline.pace)
        clearance_widths = result.mean_clearance_m / robot.body.size[1]
        cost += self.near * (CLEAR - clearance_widths)
        jerk_cost = self.jerk * result.mean_jerk / baseline.jerk
        turn_cost = self.turn * result.mean_turn / baseline.turn
        cost += jerk_cost + turn_cost
        return cost * optimal_s

    @property
    def rule(self) -> str:
        """Parts of the cost, in words."""
        parts = [f"a failure or contact costs {self.failure:g} times the course's shortest time"]
        if self.near:
            parts.append("nearness to obstacles counts as well")
        if self.jerk or self.turn:
            parts.append("jerk and turning count as well")
        return ", ".join(parts)


class Baseline(NamedTuple):
    """Means over the successful drives with the default parameters of a robot."""

    pace: float = math.inf  # time, in optimal times
    jerk: float = 1.0  # jerk [m/s^3]
    turn: float = 1.0  # yaw acceleration [rad/s^2]

    @classmethod
    def of(cls, results: Iterable[Result], robot: Robot) -> Baseline:
        """Return the means over the trials that succeed, or the default values if none does."""
        arrived = [result for result in results if result.success]
        if not arrived:
            return cls()
        max_speed = robot.base.max_speed
        paces = [result.time_s * max_speed / result.route_m for result in arrived]
        # cost() divides by jerk and turn.
        jerk = _mean_of(arrived, "mean_jerk") or 1.0
        turn = _mean_of(arrived, "mean_turn") or 1.0
        return cls(_mean(paces), jerk, turn)


AIMS = {
    # At half this value, a parameter set won that arrived in only 86 % of BARN's worlds.
    "fast": Aim(failure=20.0),
    "careful": Aim(failure=100.0, slower=10.0, near=60.0),
    "smooth": Aim(failure=60.0, slower=10.0, jerk=15.0, turn=10.0),
}


def barn_metric(success: Any, collided: Any, time_s: Any, route_m: Any) -> Any:
    """Return BARN's metric of trials (n,) or of one: success x OT / clip(time, 2 OT, 8 OT).

    The metric is 0 if the trial failed or touched anything. OT is the optimal time: the length of
    the reference path, route_m [m], at 2 m/s.
    """
    optimal = np.maximum(route_m, 1e-9) / 2.0
    counted_time = np.clip(time_s, 2.0 * optimal, 8.0 * optimal)
    return arrived_cleanly(success, collided) * optimal / counted_time


def summary(results: Sequence[Result]) -> Dict[str, Any]:
    """Return means over one or more trials, as JSON values.

    Keys: "trials" (number of trials), "return", "length", "success", "collided", "metric"
    (barn_metric), "time_s" (mean time of the successful trials, or None), "score".
    """
    # Only successes have a time: failures would be counted with their time limit.
    times = [result.time_s for result in results if result.success]
    metrics = []
    for result in results:
        metrics.append(barn_metric(result.success, result.collided, result.time_s, result.route_m))
    return {
        "trials": len(results),
        "return": _mean_of(results, "total_reward"),
        "length": _mean_of(results, "decisions"),
        "success": _mean_of(results, "success"),
        "collided": _mean_of(results, "collided"),
        "metric": _mean(metrics),
        "time_s": _mean(times) if times else None,
        "score": _mean(list(map(seconds, results))),
    }


def in_words(means: Mapping[str, Any]) -> str:
    """Return means of summary() in words."""
    time_in_words = "-" if means["time_s"] is None else f"{means['time_s']:.2f} s"
    return (
        f"{means['trials']} trials: success {means['success']:.3f}, collision "
        f"{means['collided']:.3f}, time {time_in_words}, metric {means['metric']:.3f}, score "
        f"{means['score']:.2f} s ({SECONDS_RULE})"
    )


def _mean_of(results: Sequence[Result], name: str) -> float:
    """Return the mean of one field of the results."""
    return _mean([getattr(result, name) for result in results])


def _mean(values: Sequence[float]) -> float:
    return float(np.mean(values))
