"""The reward R = c_f R_f + c_p R_p + c_c R_c of the paper (section III-C), and terms beyond it. env.py asks it."""

from __future__ import annotations

from typing import ClassVar, Dict, Tuple

from pydantic import ConfigDict

from applr_ros1.policy.decision import PERIOD
from applr_ros1.policy.encoding import Encoding
from training.common.options import Options, option
from training.env.episode import Episode
from training.env.outcome import Outcome


class RewardOptions(Options):
    """Units of the paper's terms, and coefficients of terms beyond them, which are off by default."""

    model_config = ConfigDict(title="Reward")

    # fmt: off
    along_y: bool = option(False,
        "Measure progress along the y axis of the world, as the paper simplified it, instead of in the direction of "
        "the goal.")
    exact_time: bool = option(False,
        "Count the time term in seconds, including the fraction of the last decision, instead of in whole decisions.")
    lowest: bool = option(False,
        "Take the distance of the nearest obstacle in the clearance term from all scans of a decision period instead "
        "of from its last scan.")
    failure_seconds: float = option(40.0,
        "Time [s] that a failure for good costs, at most what is left until the limit: the robot gave up, lies on its "
        "side, or has stalled or touched something where that ends an episode. The default is what standing for ever "
        "costs, discounted by .95 per 2 s. With the dimensionless observation a robot whose courses take longer at its "
        "top speed than the Jackal's pays as much longer.", ge=0)
    c_collision: float = option(0.0, "Cost of a decision period in which the robot touched something.")
    # fmt: on


class Reward(RewardOptions):
    """The reward with its coefficients.

    - R_f = 1(at the goal) - 1: each 2 s before the goal cost 1; with exact_time - seconds / 2 s, the last decision's
      included, so that a course finished a second earlier is worth more. A trial that fails for good (the planner gave
      up, the robot lies on its side) stands still until the limit: what that costs is paid at its end, as at most
      failure_seconds.
    - R_p = metres driven towards the goal, `(p' - p) . (goal - p) / |goal - p|`, or along the world's y.
    - R_c = -1 / d with d the smallest range. d is at least .1 m (what the Jackal's laser can tell), so R_c >= -10, and
      at most the observation's 2 m, so R_c <= -.5.
    - c_collision is charged for a decision in which the robot touched something.

    All these seconds are the Jackal's. They are scaled by the robot's pace (Encoding.pace), because for a slow robot a
    failure would otherwise cost less than the way to the goal.
    """

    c_f: float = 1.0  # the paper publishes no coefficients; these are ours
    c_p: float = 1.0
    c_c: float = 0.05

    NEAREST: ClassVar[float] = 0.1
    FARTHEST: ClassVar[float] = 2.0

    @classmethod
    def of(cls, options: RewardOptions) -> Reward:
        """Return the reward with a command's options."""
        return cls(**{name: getattr(options, name) for name in RewardOptions.model_fields})

    def __call__(
        self, outcome: Outcome, limit: int, period: float, scale: float, pace: float = 1.0
    ) -> Tuple[float, Dict[str, float]]:
        """The reward of one decision.

        Args:
            outcome: the trial after the decision.
            limit: decisions until the trial is truncated.
            period: decision period [s]. Terms that count time are scaled with it, so that a course costs the same.
            scale: lengths are counted in so many metres; a wider robot's courses are longer and its gaps wider.
            pace: times are counted in so many seconds.

        Returns:
            (R, {term: its weighted part of R}).
        """
        share = period / PERIOD / pace  # costs are per 2 s: a course costs the same whatever the period
        time = -outcome.seconds / PERIOD / pace if self.exact_time else (float(outcome.success) - 1.0) * share
        if failed(outcome):
            time -= min(self.failure_seconds / PERIOD, (limit - outcome.decisions) * share)
        near = outcome.decision_min if self.lowest else outcome.last_scan_min
        near = min(max(near / scale, self.NEAREST), self.FARTHEST)
        terms = {
            "time": self.c_f * time,
            "progress": self.c_p * (outcome.progress_y if self.along_y else outcome.progress) / scale,
            "clearance": -self.c_c * share / near,
            "collision": -self.c_collision * float(outcome.contact),
        }
        return sum(terms.values()), terms

    def judge(self, encoding: Encoding, episode: Episode) -> Tuple[float, Dict[str, float]]:
        """Return the reward of an episode's newest decision, as __call__ does, in the scale and pace of an encoding."""
        assert episode.outcome is not None
        return self(episode.outcome, episode.limit, episode.period, encoding.scale, encoding.pace)


def failed(outcome: Outcome) -> bool:
    """Over for good without success, and not merely by the time limit: a terminal state."""
    return outcome.over and not outcome.success and not (outcome.timeout and not outcome.aborted)
