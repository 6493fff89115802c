"""What a decision is made from, and how often: shared by the policy files, the methods, the node and training."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any, Mapping, Tuple

import numpy as np

from applr_ros1.policy.parameter_space import SPACE, Space

PERIOD = 2.0  # s between two decisions in the paper; files that state no other period have this one


@dataclass(frozen=True)
class Context:
    """What a method may look at when it decides.

    Attributes:
        observation: (729,) float32 in [-1, 1]: scan capped at 2 m, angle to the local goal, parameters in force; other
            numbers for other robots than the Jackal.
        ranges: (720,) float32 [m], +inf where nothing returned. Scans of other lasers are resampled to this: see
            Layout in layout.py.
        phi: Angle to the local goal [rad].
        theta: (n,) float64, the parameters that the planner has now.
        time: Time since the goal was sent [s].
        pose: (x, y, yaw) [m, m, rad] of the robot as its odometry states it. Goal and plan are in the same frame.
        twist: (v, w) [m/s, rad/s] of the robot by its odometry.
        goal: (x, y, yaw) [m, m, rad] that was sent.
        plan: (n, >= 2) x, y [m] of the newest global plan, from robot to goal; (0, 2) before the first one.
        space: The parameters that are in theta.
    """

    observation: np.ndarray
    ranges: np.ndarray
    phi: float
    theta: np.ndarray
    time: float
    pose: Tuple[float, float, float] = (0.0, 0.0, 0.0)
    twist: Tuple[float, float] = (0.0, 0.0)
    goal: Tuple[float, float, float] = (0.0, 0.0, 0.0)
    plan: np.ndarray = field(default_factory=lambda: np.zeros((0, 2)))
    space: Space = SPACE


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
