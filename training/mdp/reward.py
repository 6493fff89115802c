"""The reward R = c_f R_f + c_p R_p + c_c R_c of the paper (section III-C), and terms beyond it. env.py asks it."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Dict, Tuple

import numpy as np

from applr_ros1.common.errors import ApplrError
from applr_ros1.policy.decision import PERIOD
from training.mdp.episode import DECISION_LIMIT
from training.mdp.outcome import Outcome

MOST_STANDING = 20  # decisions of 2 s that a robot which stands until the limit pays at most: 1 / (1 - .95), discounted


@dataclass(frozen=True)
class Reward:
    """Coefficients. The paper publishes none; those of the first three are ours, the rest are off by default.

    c_f   R_f = 1(at the goal) - 1: each decision before the goal costs 1. A trial that fails for good (the planner
          gave up, the robot lies on its side) stands still until the limit: what that costs is paid at its end, as at
          most MOST_STANDING decisions.
    c_p   R_p = metres driven towards the goal, (p' - p) . (goal - p) / |goal - p|.
    c_c   R_c = -1 / d with d the smallest range of the last scan. d is at least .1 m (what the Jackal's laser can
          tell), so R_c >= -10, and at most the observation's 2 m, so R_c <= -.5.
    along_y     R_p along the world's y instead, as the paper simplified it
    exact_time  R_f = - seconds / 2 s, the last decision's included: a course finished a second earlier is worth more.
                The paper's R_f only counts whole decisions.
    lowest      R_c from the lowest range of the whole decision, not of its last scan
    c_contact   -1 for a decision in which the robot touched something
    c_switch    minus the mean change of the parameters, in action units (paper's future work)
    c_jerk      minus the mean jerk [10 m/s^3] (paper's future work)
    """

    c_f: float = 1.0
    c_p: float = 1.0
    c_c: float = 0.05
    along_y: bool = False
    exact_time: bool = False
    lowest: bool = False
    c_contact: float = 0.0
    c_switch: float = 0.0
    c_jerk: float = 0.0

    NEAREST = 0.1
    FARTHEST = 2.0

    def __post_init__(self):
        for f in fields(self):
            if not np.isfinite(getattr(self, f.name)):
                raise ApplrError("reward coefficient %s is %r: give a finite number" % (f.name, getattr(self, f.name)))

    def __call__(
        self, outcome: Outcome, change: float, limit: int = DECISION_LIMIT, period: float = PERIOD
    ) -> Tuple[float, Dict[str, float]]:
        """The reward of one decision.

        Args:
            outcome: the trial after the decision.
            change: mean |a_t - a_{t-1}| of the parameters in action units.
            limit: decisions until the trial is truncated.
            period: decision period [s]. Terms that count time are scaled with it, so that a course costs the same.

        Returns:
            (R, {term: its weighted part of R}).
        """
        share = period / PERIOD  # costs are per 2 s: a course costs the same with any decision period
        time = -outcome.seconds / PERIOD if self.exact_time else (float(outcome.success) - 1.0) * share
        if failed(outcome):
            time -= min(MOST_STANDING, (limit - outcome.decisions) * share)
        near = outcome.decision_min if self.lowest else outcome.last_scan_min
        near = min(max(near, self.NEAREST), self.FARTHEST)
        terms = {
            "time": self.c_f * time,
            "progress": self.c_p * (outcome.progress_y if self.along_y else outcome.progress),
            "clearance": -self.c_c * share / near,
            "contact": -self.c_contact * float(outcome.contact),
            "switching": -self.c_switch * change,
            "jerk": -self.c_jerk * share * outcome.jerk / 10.0,
        }
        return sum(terms.values()), terms


def failed(outcome: Outcome) -> bool:
    """Over for good without success, and not merely by the time limit: a terminal state."""
    return outcome.over and not outcome.success and not (outcome.timeout and not outcome.aborted)
