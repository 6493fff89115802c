"""A person's own class as a method: `module:Class` or `module:Class:text`."""

from __future__ import annotations

import importlib
from typing import Any, Dict, Optional

import numpy as np

from applr_ros1.common.errors import reason
from applr_ros1.policy.decision import PERIOD, Context
from applr_ros1.policy.methods.protocol import Method, MethodError
from applr_ros1.policy.parameter_space import SPACE


class OwnMethod(Method):
    """Wraps an object that has theta(context) and, if it likes, reset(seed), describe(), static, period and weights.

    What comes back is clipped to the ranges; whatever the object raises becomes a MethodError of one line.

    Args:
        made: The object.
        spec: What the person called it.
    """

    def __init__(self, made: Any, spec: str):
        self.made, self.spec = made, spec
        if not callable(getattr(made, "theta", None)):
            raise MethodError("method %s has no theta(context); see docs/extending.md for an example" % spec)
        self.static = bool(getattr(made, "static", False))
        self.period = float(getattr(made, "period", PERIOD))
        self.weights = getattr(made, "weights", None)

    def reset(self, seed: int) -> None:
        """Begin a course, if the object wants to know."""
        if hasattr(self.made, "reset"):
            self.made.reset(seed)

    def theta(self, context: Optional[Context]) -> np.ndarray:
        """The object's parameters, clipped."""
        try:
            return SPACE.clip(self.made.theta(context))
        except Exception as error:
            raise MethodError(
                "method %s gave no parameters: %s: %s" % (self.spec, type(error).__name__, reason(error))
            ) from error

    def describe(self) -> Dict[str, Any]:
        """What the object says of itself, else its specification."""
        return self.made.describe() if hasattr(self.made, "describe") else {"class": self.spec}


def make_own(spec: str, module: str, name: str, text: Optional[str]) -> Method:
    """The class `name` of a module, made with `text` where there is one. Raises MethodError."""
    try:
        made = getattr(importlib.import_module(module), name)
        return OwnMethod(made(text) if text is not None else made(), spec)
    except MethodError:
        raise
    except Exception as error:  # whatever a person's module does wrong is theirs to hear in one line
        raise MethodError("method %s cannot be made: %s: %s" % (spec, type(error).__name__, reason(error))) from None
