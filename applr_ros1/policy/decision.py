"""What a decision is made from, and how often: shared by the policy files, the methods, the node and training."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Mapping

import numpy as np

PERIOD = 2.0  # s between two decisions in the paper; files that state no other period have this one


@dataclass(frozen=True)
class Context:
    """What a method may look at when it decides.

    Attributes:
        observation: (729,) float32 in [-1, 1]: scan capped at 2 m, angle to the local goal, parameters in force.
        ranges: (720,) float32 [m], +inf where nothing returned. Scans of other lasers are resampled to this: see
            Layout in layout.py.
        phi: Angle to the local goal [rad].
        theta: (8,) float64, the parameters that the planner has now.
        time: Time since the goal was sent [s].
    """

    observation: np.ndarray
    ranges: np.ndarray
    phi: float
    theta: np.ndarray
    time: float


def period_of(metadata: Mapping[str, Any]) -> float:
    """The decision period [s] that a policy file's metadata state (`period_s`), else the paper's.

    Raises:
        ValueError: The period is not a number from 0.05 to 60 s.
    """
    period = metadata.get("period_s", PERIOD)
    if isinstance(period, bool) or not isinstance(period, (int, float)) or not math.isfinite(period):
        raise ValueError("period_s is %r: a number of seconds is needed" % (period,))
    if not 0.05 <= period <= 60.0:
        raise ValueError("period_s is %r: 0.05 to 60 s are possible" % period)
    return float(period)
