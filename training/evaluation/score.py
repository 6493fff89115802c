"""The cost of a trial [s]: its score, by which trials are compared, and the prices of what tune aims at."""

from __future__ import annotations

import math
from typing import Any, Callable, Dict, Iterable, NamedTuple, Sequence

import numpy as np

from applr_ros1.robots import Robot
from training.env.episode import TIME_LIMIT
from training.env.outcome import CLEAR
from training.evaluation.trial import Result

Cost = Callable[[Result], float]  # of a trial [s]; less is better

FAILURE_SECONDS = TIME_LIMIT  # what a failed trial counts as [s]
CONTACT_SECONDS = 5.0  # what a contact adds to a trial's score [s]


def seconds(result: Result) -> float:
    """Return a trial's score [s]: its time, or FAILURE_SECONDS, and CONTACT_SECONDS more if it touched something."""
    return (result.time_s if result.success else FAILURE_SECONDS) + CONTACT_SECONDS * result.collided


class Aim(NamedTuple):
    """An aim of tune: prices beside a trial's time, in optimal times.

    The optimal time is the reference path's length at the base's largest speed. failure: instead of the time, also of a
    drive that touched something; slower: of each optimal time that it takes beyond the mean with the robot's own
    parameters; near: of each width of the body by which the mean clearance is short of CLEAR widths; jerk and turn: of
    the mean change of acceleration and the mean yaw acceleration, over those with its own parameters.
    """

    failure: float
    slower: float = 0.0
    near: float = 0.0
    jerk: float = 0.0
    turn: float = 0.0

    def cost(self, result: Result, robot: Robot, baseline: Baseline) -> float:
        """Return what a trial costs [s]."""
        optimal = result.route_m / robot.base.max_speed
        clean = result.success and not result.collided
        price = result.time_s / optimal if clean else self.failure
        price += self.slower * max(0.0, price - baseline.pace) * clean
        price += self.near * (CLEAR - result.mean_clearance_m / robot.body.size[1])
        price += self.jerk * result.mean_jerk / baseline.jerk + self.turn * result.mean_turn / baseline.turn
        return price * optimal


class Baseline(NamedTuple):
    """Means over drives with a robot's own parameters that arrive."""

    pace: float = math.inf  # time in optimal times
    jerk: float = 1.0  # [m/s^3]
    turn: float = 1.0  # yaw acceleration [rad/s^2]

    @classmethod
    def of(cls, results: Iterable[Result], robot: Robot) -> Baseline:
        """Return the means of trials; those that fail do not count, and where all do, nothing is known."""
        good = [result for result in results if result.success]
        if not good:
            return cls()
        times = [result.time_s * robot.base.max_speed / result.route_m for result in good]
        jerk, turn = (_mean([getattr(result, name) for result in good]) for name in ("mean_jerk", "mean_turn"))
        return cls(_mean(times), jerk or 1.0, turn or 1.0)


AIMS = {
    "fast": Aim(failure=20.0),  # with half of it a set drove that arrived in 86 % of BARN's worlds
    "careful": Aim(failure=100.0, slower=10.0, near=60.0),
    "smooth": Aim(failure=60.0, slower=10.0, jerk=15.0, turn=10.0),
}


def barn_metric(success: Any, collided: Any, time_s: Any, route_m: Any) -> Any:
    """Return BARN's metric of trials, numbers or arrays (n,): success x OT / clip(time, 2 OT, 8 OT).

    It is 0 where the trial failed or touched anything. OT is the optimal time: the reference path's length route_m [m]
    at 2 m/s.
    """
    optimal = np.maximum(route_m, 1e-9) / 2.0
    return success * np.logical_not(collided) * optimal / np.clip(time_s, 2.0 * optimal, 8.0 * optimal)


def summary(results: Sequence[Result]) -> Dict[str, Any]:
    """Return means over one or more trials, as JSON values.

    They are {"trials", "return", "length", "success", "collided", "metric" (barn_metric), "time_s" (the mean time of
    the successes, or None), "score"}.
    """
    times = [r.time_s for r in results if r.success]
    return {
        "trials": len(results),
        "return": _mean([r.total_reward for r in results]),
        "length": _mean([r.decisions for r in results]),
        "success": _mean([r.success for r in results]),
        "collided": _mean([r.collided for r in results]),
        "metric": _mean([barn_metric(r.success, r.collided, r.time_s, r.route_m) for r in results]),
        "time_s": _mean(times) if times else None,
        "score": _mean([seconds(r) for r in results]),
    }


def _mean(values: Sequence[float]) -> float:
    return float(np.mean([float(value) for value in values]))
