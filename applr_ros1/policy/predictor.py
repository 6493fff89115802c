"""A policy as stable-baselines3 has one: `predict(observation)` gives (action, state). load_policy makes it."""

from __future__ import annotations

import os
from typing import Any, Optional, Tuple, Union

import numpy as np

from applr_ros1 import robots
from applr_ros1.common.errors import ApplrError
from applr_ros1.policy import actor, encoding
from applr_ros1.policy.methods import shipped
from applr_ros1.policy.parameter_space import space_of


class Predictor:
    """A policy for one robot, for programs that give it observations of the Gymnasium environment.

    Attributes:
        policy: The network, read from its file.
        environment: What gymnasium.make("applr_ros1/Navigation-v0", ...) has to be given for the observations that the
            policy sees and the actions that it answers with: robot, observation, period [s], base.

    Args:
        robot: Name of an included robot, or folder with robot.yaml.
        file: Of a policy that train.py wrote; "" for the included one.

    Raises:
        ApplrError: There is no such robot, or the file cannot be used for it.
    """

    def __init__(self, robot: Union[str, os.PathLike] = "jackal", file: Union[str, os.PathLike] = ""):
        described = robots.load(os.fspath(robot))
        self.policy = actor.load(file or shipped(robot=described), space_of(described))
        general = isinstance(self.policy, actor.GeneralActor)
        self._inputs = encoding.SIZE if general else self.policy.layout.beams + 1 + len(self.policy.space)
        self.environment = {
            "robot": described.folder,
            "observation": "dimensionless" if general else "paper",
            "period": self.policy.period,
            "base": self.policy.base if general else {},
        }

    def predict(
        self,
        observation: Any,
        state: Optional[Tuple[np.ndarray, ...]] = None,
        episode_start: Optional[np.ndarray] = None,
        deterministic: bool = True,
    ) -> Tuple[np.ndarray, Optional[Tuple[np.ndarray, ...]]]:
        """The actions for observations.

        Args:
            observation: (n,) one observation of the environment, or (k, n) several.
            state: Given back as it is: the policy has no memory.
            episode_start: Without effect, for the same reason.
            deterministic: Without effect: the policy always is.

        Returns:
            (m,) or (k, m) float32 in [-1, 1], and `state`.

        Raises:
            ApplrError: The observation has another size, or holds NaN or inf.
        """
        seen = np.asarray(observation, dtype=np.float32)
        if seen.ndim not in (1, 2) or seen.shape[-1] != self._inputs:
            raise ApplrError(
                f"observation has shape {seen.shape}: ({self._inputs},) or (k, {self._inputs}) needed; "
                "make the environment with **policy.environment"
            )
        if not np.isfinite(seen).all():
            raise ApplrError("observation holds NaN or inf: give what the environment returned")
        return self.policy.action(seen), state
