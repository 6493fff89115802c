"""Outcome of a trial: its state after a decision, and the driven path.

episode.py writes both. Rewards, evaluations, datasets and pictures read them.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import List, Tuple

import numpy as np

CLEAR = 3.0  # cap on the distance to the nearest obstacle in mean_clearance_m [widths of the body]


@dataclass
class Outcome:
    """State of a trial after a decision (or after reset, when most fields are zero).

    The fields from progress to seconds describe the last decision, the fields from success on the whole trial.

    Attributes:
        theta: (n,) current parameters of the planner.
        progress: Distance driven towards the goal [m] (the paper's R_p).
        progress_y: Distance driven along y [m].
        last_scan_min: Smallest range of the last scan [m], never below range_min.
        decision_min: Smallest range of all scans [m].
        contact: Whether the robot touched anything.
        seconds: Simulated duration [s]: the decision period, or less if the course ended.
        success: Whether the robot has arrived.
        flipped: Whether the robot lies on its side.
        collided: Whether the robot has touched anything.
        aborted: Whether the planner gave up, or stopped away from the goal.
        timeout: Whether the time limit has passed. Also set after an abort, because the robot would stand until then.
        time_s: Time since the goal was sent [s]; the full limit after a timeout.
        decisions: Number of decisions.
        path_length_m: Length of the driven path [m].
        min_clearance_m: Smallest range [m].
        mean_clearance_m: Mean over time of the smallest range [m], capped at CLEAR widths of the body.
        mean_jerk: Mean magnitude of the jerk [m/s^3].
        mean_turn: Mean magnitude of the yaw acceleration [rad/s^2].
        reason: Why the trial is over, in words.
    """

    theta: np.ndarray
    progress: float = 0.0
    progress_y: float = 0.0
    last_scan_min: float = math.inf
    decision_min: float = math.inf
    contact: bool = False
    seconds: float = 0.0
    success: bool = False
    flipped: bool = False
    collided: bool = False
    aborted: bool = False
    timeout: bool = False
    time_s: float = 0.0
    decisions: int = 0
    path_length_m: float = 0.0
    min_clearance_m: float = math.inf
    mean_clearance_m: float = 0.0
    mean_jerk: float = 0.0
    mean_turn: float = 0.0
    reason: str = ""

    @property
    def over(self) -> bool:
        """Return whether the trial has ended, for any reason."""
        return self.success or self.flipped or self.aborted or self.timeout or bool(self.reason)


@dataclass
class Trace:
    """Driven path for pictures, one row per control cycle."""

    time: List[float] = field(default_factory=list)
    pose: List[Tuple[float, ...]] = field(default_factory=list)  # true pose in the world frame
    twist: List[Tuple[float, ...]] = field(default_factory=list)
    theta: List[np.ndarray] = field(default_factory=list)  # parameters of each decision
    decided: List[float] = field(default_factory=list)  # time of each decision [s]
