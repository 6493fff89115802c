"""A person's own class as a method: `module:Class` or `my_file.py:Class`, `:text` behind it for its constructor."""

from __future__ import annotations

import os
from typing import Any, Dict, Optional

import numpy as np

from applr_ros1.common import user_module
from applr_ros1.common.arguments import number_within
from applr_ros1.common.errors import ApplrError, one_line
from applr_ros1.common.files import read_bytes, sha256
from applr_ros1.policy.decision import PERIOD, Context, Method

PERIODS = 0.01, 60.0  # [s] between two decisions


class UserMethod(Method):
    """An object that has theta(context), as a method.

    It may have reset(seed), describe(), static, period, layout and per_cell as well.

    Parameters that come back are clipped to the ranges; whatever the object raises becomes an ApplrError of one line.

    Args:
        made: The object.
        spec: What the person called it.
    """

    def __init__(self, made: Any, spec: str):
        self.made, self.spec = made, spec
        if not callable(getattr(made, "theta", None)):
            raise ApplrError("method %s has no theta(context); see docs/tutorials/own_method.md for an example" % spec)
        self.static = bool(getattr(made, "static", False))
        self.period = float(getattr(made, "period", PERIOD))
        if not self.static:
            number_within("the period of method %s" % spec, self.period, *PERIODS)
        self.per_cell = bool(getattr(made, "per_cell", False))
        if hasattr(made, "layout"):
            self.layout = made.layout

    def reset(self, seed: int) -> None:
        """Begin a course, if the object wants to know."""
        try:
            if hasattr(self.made, "reset"):
                self.made.reset(seed)
        except Exception as error:
            raise self._failed("cannot begin a course", error) from error

    def theta(self, context: Optional[Context]) -> np.ndarray:
        """Return the object's parameters, clipped."""
        try:
            return self.space.clip(self.made.theta(context))
        except Exception as error:
            raise self._failed("gave no parameters", error) from error

    def describe(self) -> Dict[str, Any]:
        """Return what the object says of itself, else its specification; of a class in a file its checksum, too."""
        if hasattr(self.made, "describe"):
            return self.made.describe()
        path, colon, rest = self.spec.partition(".py:")
        if not colon:
            return {"class": self.spec}
        file = path + ".py"
        return {"class": rest, "file": os.path.basename(file), "sha256": sha256(read_bytes(file))}

    def _failed(self, what: str, error: Exception) -> ApplrError:
        return ApplrError("method %s %s: %s" % (self.spec, what, one_line(error)))


def make_user_method(spec: str, module: str, name: str, text: Optional[str]) -> Method:
    """Make the class `name` of a module or of a .py file, with `text` where there is one. Raises ApplrError."""
    try:
        made = getattr(user_module.load(module), name)
        made = made(text) if text is not None else made()
        return made if isinstance(made, Method) else UserMethod(made, spec)
    except ApplrError:
        raise
    except Exception as error:  # whatever a person's module does wrong is theirs to hear in one line
        raise ApplrError("method %s cannot be made: %s" % (spec, one_line(error))) from error
