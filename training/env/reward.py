"""Reward R = c_f R_f + c_p R_p + c_c R_c of the paper (section III-C), and further terms."""

from __future__ import annotations

from typing import ClassVar, Dict, Tuple

from pydantic import ConfigDict

from applr_ros1.drives.outcome import Outcome
from applr_ros1.policy.decision import PERIOD
from applr_ros1.policy.encoding import Encoding
from training.common.options import Options, option


class RewardOptions(Options):
    """Units of the paper's terms, and coefficients of further terms, which are 0 by default."""

    model_config = ConfigDict(title="Reward")

    # fmt: off
    along_y: bool = option(False,
        "Measure progress along the y axis of the world, as the paper simplified it, instead of "
        "in the direction of the goal.")
    exact_time: bool = option(False,
        "Count the time term in seconds, including the fraction of the last decision, instead of "
        "in whole decisions.")
    lowest: bool = option(False,
        "Take the distance of the nearest obstacle in the clearance term from all scans of a "
        "decision period instead of from its last scan.")
    failure_seconds: float = option(40.0,
        "Time penalty [s] of a final failure, at most the time left until the limit. A "
        "failure is final if the planner gave up, the robot lies on its side, or a stall or "
        "contact ended the episode. The default is the cost of standing still forever, "
        "discounted by .95 per 2 s. With the dimensionless observation, the penalty is "
        "scaled by the robot's time for its courses at top speed, relative to the Jackal's.", ge=0)
    c_collision: float = option(0.0,
        "Cost of a decision period in which the robot touched something.")
    # fmt: on


class Reward(RewardOptions):
    """Reward with its coefficients.

    - R_f = 1(at the goal) - 1: each 2 s before the goal cost 1. With exact_time, R_f = -seconds / 2
      s and includes the last decision, so that a course finished a second earlier is worth more.
      After a final failure (the planner gave up, the robot lies on its side), the robot would stand
      still until the time limit. The cost of this time, at most failure_seconds, is charged at
      once.
    - R_p = distance driven towards the goal [m], `(p' - p) . (goal - p) / |goal - p|`, or along the
      world's y.
    - R_c = -1 / d with the smallest range d. d is at least .1 m (the minimum range of the Jackal's
      laser), so R_c >= -10, and at most the observation's 2 m, so R_c <= -.5.
    - c_collision is charged for a decision in which the robot touched something.

    All times are for the Jackal, and are scaled by the robot's pace (Encoding.pace). Otherwise a
    failure would cost a slow robot less than the way to the goal.
    """

    c_f: float = 1.0  # our own coefficients, because the paper publishes none
    c_p: float = 1.0
    c_c: float = 0.05

    NEAREST: ClassVar[float] = 0.1
    FARTHEST: ClassVar[float] = 2.0

    @classmethod
    def of(cls, options: RewardOptions) -> Reward:
        """Return the reward with the options of a command."""
        return cls(**{name: getattr(options, name) for name in RewardOptions.model_fields})

    def __call__(
        self, outcome: Outcome, limit: int, period: float, encoding: Encoding
    ) -> Tuple[float, Dict[str, float]]:
        """Return the reward of one decision, and its weighted terms {name: value}.

        Args:
            outcome: Trial after the decision.
            limit: Number of decisions after which a trial is truncated.
            period: Decision period [s], by which the time terms are scaled.
            encoding: Encoding, whose scale and pace are the units of lengths and times. A wider
                robot has longer courses and wider gaps.
        """
        # Costs are per 2 s, so that a course costs the same for any period.
        period_share = period / PERIOD / encoding.pace
        if self.exact_time:
            time_term = -outcome.seconds / PERIOD / encoding.pace
        else:
            time_term = (float(outcome.success) - 1.0) * period_share
        if failed(outcome):
            # The robot would stand still until the limit, and gets the cost of this time at once.
            standing = (limit - outcome.decisions) * period_share
            time_term -= min(self.failure_seconds / PERIOD, standing)

        progress = outcome.progress
        if self.along_y:
            progress = outcome.progress_y
        smallest_range = outcome.last_scan_min
        if self.lowest:
            smallest_range = outcome.decision_min
        clearance = min(max(smallest_range / encoding.scale, self.NEAREST), self.FARTHEST)
        terms = {
            "time": self.c_f * time_term,
            "progress": self.c_p * progress / encoding.scale,
            "clearance": -self.c_c * period_share / clearance,
            "collision": -self.c_collision * float(outcome.contact),
        }
        return sum(terms.values()), terms


def failed(outcome: Outcome) -> bool:
    """Return whether the trial is in a terminal state without success.

    A time limit alone is not terminal.
    """
    return outcome.over and not outcome.success and not (outcome.timeout and not outcome.aborted)
