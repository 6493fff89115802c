"""The methods that come with the package: fixed sets, random sets, functions of the observation."""

from __future__ import annotations

import os
from typing import Any, Dict, Optional

import numpy as np

from applr_ros1.common.errors import ApplrError
from applr_ros1.common.files import read_bytes, sha256
from applr_ros1.policy.decision import Context, period_of
from applr_ros1.policy.encoding import Encoding
from applr_ros1.policy.methods.protocol import Method
from applr_ros1.policy.parameter_space import SPACE, Space
from applr_ros1.policy.stall import Stall
from applr_ros1.robots import Robot


class FixedParameters(Method):
    """One set of parameters throughout.

    Args:
        values: (n,); clipped to the ranges.
        space: The parameters.
        per_cell: As Method says.
    """

    static = True

    def __init__(self, values: np.ndarray, space: Space = SPACE, per_cell: bool = False):
        self.values, self.space, self.per_cell = space.clip(values), space, per_cell

    def theta(self, context: Optional[Context]) -> np.ndarray:
        """The set."""
        return self.values.copy()

    def describe(self) -> Dict[str, Any]:
        """The set by name."""
        return {"parameters": self.space.as_dict(self.values)}


class RandomParameters(Method):
    """Uniform over the ranges at each decision: for trying the stack and for gathering data.

    Args:
        space: The parameters.
    """

    def __init__(self, space: Space = SPACE) -> None:
        self.space = space
        self.reset(0)

    def reset(self, seed: int) -> None:
        """Begin a course with draws that depend on the seed only."""
        self._draws = np.random.default_rng([seed, 0x7A4D])

    def theta(self, context: Optional[Context]) -> np.ndarray:
        """A new draw."""
        return self.space.to_theta(self._draws.uniform(-1.0, 1.0, len(self.space)))

    def describe(self) -> Dict[str, Any]:
        """How they are drawn."""
        return {"parameters": "uniform in the ranges, drawn every step"}


class ObservationPolicy(Method):
    """A function of the observation: an actor, or APPLD's contexts.

    Args:
        policy: Has theta(observation), a period [s] and, where it states them, space and layout.
        path: The file that it was read from; "" for none.
        per_cell: As Method says.
    """

    def __init__(self, policy: Any, path: str = "", per_cell: bool = True):
        self.policy, self.path, self.per_cell = policy, path, per_cell
        self.period = float(policy.period)
        if hasattr(policy, "space"):
            self.space = getattr(policy.space, "whole", policy.space)
        if hasattr(policy, "layout"):
            self.layout = policy.layout

    def theta(self, context: Optional[Context]) -> np.ndarray:
        """The policy's parameters for the observation."""
        if context is None:
            raise ApplrError("a policy needs an observation to decide on")
        return self.policy.theta(context.observation)

    def describe(self) -> Dict[str, Any]:
        """The policy's class and its file with checksum."""
        kind = {"class": type(self.policy).__name__}
        if not self.path:
            return kind
        return dict(kind, file=os.path.basename(self.path), sha256=sha256(read_bytes(self.path)))


class GeneralPolicy(ObservationPolicy):
    """A policy in the dimensionless form (policy/encoding.py) on one robot.

    While the robot stalls (policy/stall.py), what the policy answers has not helped: then each decision draws its
    parameters at random, from the course's seed.

    Args:
        policy: Has action(observation), a period [s] and the base of encoding.Encoding.
        robot: The robot that it drives.
        path: The file that it was read from; "" for none.
    """

    def __init__(self, policy: Any, robot: Robot, path: str = ""):
        super().__init__(policy, path)
        self.encoding = Encoding(robot, self.period, policy.base)
        self.space, self.layout = self.encoding.space, self.encoding.layout
        self._stall = Stall(robot.world_scale)
        self.reset(0)

    def reset(self, seed: int) -> None:
        """Begin a course: there was no decision before."""
        self.encoding.period = self.period  # at_period() or the node's ~period may have changed it
        self.encoding.reset()
        self._stall.reset()
        self._draws = np.random.default_rng([seed, 0x57A1])

    def theta(self, context: Optional[Context]) -> np.ndarray:
        """The policy's parameters, within the robot's ranges."""
        if context is None:
            raise ApplrError("a policy needs an observation to decide on")
        action = self.policy.action(self.encoding.observe(context))
        if self._stall.look(context.time, *context.pose[:2]):
            self.stalls += 1
            action = self._draws.uniform(-1.0, 1.0, len(action))
        return self.encoding.theta(action)


def at_period(method: Method, seconds: str) -> Method:
    """The method, deciding at another period; seconds: its text, 0.05 to 60.

    Raises:
        ApplrError: The text is no such number.
    """
    try:
        method.period = period_of({"period_s": float(seconds)})
    except ValueError:
        raise ApplrError("period:%s: give a decision period from 0.05 to 60 s" % seconds) from None
    return method
