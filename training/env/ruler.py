"""The ruler of a form: how observations, actions and rewards of one robot are counted, in training and in evaluation.

The environment (env.py) steps with it and the runner of trials (evaluation/trials.py) judges with it, so that what is
measured is what is learnt.
"""

from __future__ import annotations

from typing import Any, Dict, Mapping, Optional, Tuple, Union

import numpy as np

from applr_ros1.policy.decision import Context
from applr_ros1.policy.encoding import Encoding
from applr_ros1.policy.observation import layout_of
from applr_ros1.policy.parameter_space import space_of
from applr_ros1.robots import Robot
from training.env.drawn_robots import JACKAL_WIDTH
from training.env.episode import Episode
from training.env.reward import Reward

OBSERVATIONS = PAPER, DIMENSIONLESS = "paper", "dimensionless"


class PaperForm:
    """The paper's form for one robot, asked as the dimensionless one (Encoding) is: it remembers nothing."""

    def __init__(self, robot: Robot):
        self.space, self.layout = space_of(robot).paper, layout_of(robot)
        self.action, self.theta = self.space.to_action, self.space.to_theta

    def reset(self) -> None:
        """Begin a course."""

    def observe(self, context: Context) -> np.ndarray:
        """The observation, which Context holds in this form."""
        return context.observation


class Ruler:
    """Counts for one robot in one form.

    Args:
        robot: Its description.
        observation: The form, one of OBSERVATIONS.
        period: Decision period [s], on which the dimensionless form's observation depends.
        reward: The coefficients.
        base: Of the dimensionless form (policy/encoding.py).

    Attributes:
        form: The encoder of observations and actions.
        scale: How many of the Jackal's widths the robot is wide, by which the reward's lengths are divided; 1 in the
            paper's form.
    """

    def __init__(
        self,
        robot: Robot,
        observation: str,
        period: Optional[float],
        reward: Reward,
        base: Optional[Mapping[str, float]] = None,
    ):
        self.reward, self.scale = reward, 1.0
        self.form: Union[PaperForm, Encoding] = PaperForm(robot)
        if observation == DIMENSIONLESS:
            if period is None:
                raise ValueError("the dimensionless observation depends on the decision period: state it")
            self.form = Encoding(robot, period, base)
            self.scale = self.form.width / JACKAL_WIDTH

    def judge(self, before: Any, episode: Episode) -> Tuple[float, Dict[str, float]]:
        """The reward of the episode's newest decision, and its terms; before: the parameters (n,) until it."""
        assert episode.outcome is not None
        change = float(np.abs(self.form.action(episode.outcome.theta) - self.form.action(before)).mean())
        return self.reward(episode.outcome, change, episode.limit, episode.period, self.scale)
