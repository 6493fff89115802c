"""Outcome of a trial: its state after a decision, and the driven path.

episode.py fills both; rewards, evaluations, datasets and pictures read them.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import List, Tuple

import numpy as np

CLEAR = 3.0  # widths of the body beyond which an obstacle is not near


@dataclass
class Outcome:
    """State of a trial after a decision (or after reset, when most fields are zero).

    Attributes:
        theta: (n,) what the planner really has.
        progress: Of this decision, as all up to `seconds`: metres driven towards the goal (the paper's R_p).
        progress_y: Metres driven along y.
        last_scan_min: Smallest range of the scan at its end [m], never under range_min.
        decision_min: Smallest range of all its scans [m].
        contact: Whether the robot touched anything.
        seconds: Simulated time that it took: the decision period, less where the course ended.
        success: Of the trial so far, as all below: whether the robot has arrived.
        flipped: Whether it lies on its side.
        collided: Whether it has touched anything.
        aborted: Whether the planner gave up, or stopped off the goal.
        timeout: Whether the limit has passed; also set for an abort, which stands until the limit.
        time_s: Seconds since the goal was sent; the full limit where it timed out.
        decisions: Number of them.
        path_length_m: Way driven.
        min_clearance_m: Lowest range.
        mean_clearance_m: Mean over time of the lowest range, which counts as at most CLEAR widths of the body.
        mean_jerk: Mean magnitude of the change of acceleration [m/s^3].
        mean_turn: The same of the yaw acceleration.
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
    reason: str = ""  # in words, why the trial is over

    @property
    def over(self) -> bool:
        """Return whether the episode has ended, for whatever reason."""
        return self.success or self.flipped or self.aborted or self.timeout or bool(self.reason)


@dataclass
class Trace:
    """Driven path, a row per control cycle, for pictures."""

    time: List[float] = field(default_factory=list)
    pose: List[Tuple[float, float, float]] = field(default_factory=list)  # true, world frame
    twist: List[Tuple[float, float]] = field(default_factory=list)
    theta: List[np.ndarray] = field(default_factory=list)  # a row per decision over the parameters
    decided: List[float] = field(default_factory=list)  # when it was made
