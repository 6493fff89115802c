"""The methods that are in no file: fixed sets, sets around one, random sets. Policies are in policy/actor.py."""

from __future__ import annotations

import math
from typing import Any, Dict, Optional

import numpy as np

from applr_ros1.policy.decision import Context, Method
from applr_ros1.policy.parameter_space import SPACE, Space

EXPLORED = 0.3  # standard deviation of what exploration adds to a parameter, whose range is from -1 to 1
EXPLORED_S = 3.0  # [s] in which that changes


class FixedParameters(Method):
    """One set of parameters throughout.

    Args:
        values: (n,), within the ranges.
        space: The parameters.
        per_cell: As Method says.
    """

    static = True

    def __init__(self, values: np.ndarray, space: Space = SPACE, per_cell: bool = False):
        self.values, self.space, self.per_cell = np.array(values, dtype=np.float64), space, per_cell

    def theta(self, context: Optional[Context]) -> np.ndarray:
        """Return the set."""
        return self.values.copy()

    def describe(self) -> Dict[str, Any]:
        """Return the set by name."""
        return {"parameters": self.space.as_dict(self.values)}


class RandomParameters(Method):
    """Sets drawn uniformly over the ranges at each decision: for trying the stack and for gathering data.

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
        """Return a new draw."""
        return self.space.to_theta(self._draws.uniform(-1.0, 1.0, len(self.space)))

    def describe(self) -> Dict[str, Any]:
        """Say how they are drawn."""
        return {"parameters": "uniform in the ranges, drawn every step"}


class Exploration(FixedParameters):
    """A set with noise that stays for some seconds (an Ornstein-Uhlenbeck process): for data that a policy learns from.

    Args:
        around: The set.
    """

    static = False
    period = 1.0

    def __init__(self, around: FixedParameters) -> None:
        super().__init__(around.values, around.space, around.per_cell)
        self.reset(0)

    def reset(self, seed: int) -> None:
        """Begin a course with draws that depend on the seed only."""
        self._draws = np.random.default_rng([seed, 0xE401])
        self._noise = self._draws.normal(size=len(self.space))

    def theta(self, context: Optional[Context]) -> np.ndarray:
        """Return the set with the noise of the next decision."""
        kept = math.exp(-self.period / EXPLORED_S)
        self._noise = kept * self._noise + math.sqrt(1.0 - kept**2) * self._draws.normal(size=len(self.space))
        return self.space.to_theta(np.clip(self.space.to_action(self.values) + EXPLORED * self._noise, -1.0, 1.0))

    def describe(self) -> Dict[str, Any]:
        """Return the set by name, and how it is changed."""
        return {**super().describe(), "noise": [EXPLORED, EXPLORED_S]}
