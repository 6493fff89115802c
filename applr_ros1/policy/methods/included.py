"""The methods that are in no file: fixed sets, sets around one, random sets. Policies are in policy/actor.py."""

from __future__ import annotations

from typing import Any, Dict, Optional

import numpy as np

from applr_ros1.policy.decision import Context, Method
from applr_ros1.policy.parameter_space import SPACE, Space

EXPLORED = 0.5  # standard deviation of what exploration adds to a parameter, whose range is from -1 to 1


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


class Exploration(Method):
    """Sets around one, drawn normally at each decision: for drives that a policy learns from.

    Args:
        around: The set.
    """

    period = 1.0

    def __init__(self, around: FixedParameters) -> None:
        self.around, self.space, self.per_cell = around, around.space, around.per_cell
        self.reset(0)

    def reset(self, seed: int) -> None:
        """Begin a course with draws that depend on the seed only."""
        self._draws = np.random.default_rng([seed, 0xE401])

    def theta(self, context: Optional[Context]) -> np.ndarray:
        """Return a new draw."""
        action = self.space.to_action(self.around.values) + EXPLORED * self._draws.normal(size=len(self.space))
        return self.space.to_theta(np.clip(action, -1.0, 1.0))

    def describe(self) -> Dict[str, Any]:
        """Return the set by name, and how far draws are from it."""
        return {**self.around.describe(), "explored": EXPLORED}
