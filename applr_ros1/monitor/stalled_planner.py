"""Escape motions for a planner that makes none itself, as the C++ move_base: what the monitor drives in its place.

The planner's stall shows in what it says: its goal is active, it has a plan to a goal that is not reached, and it
commands nothing, or only what the monitor holds back. The node (nodes/monitor/node.py) and the trials
(training/env/episode.py) ask a StalledPlanner with each command.
"""

import math
from typing import Hashable, Optional, Tuple

from applr_ros1.planner.escape import BLOCKED, Escape

Twist = Tuple[float, float]
FRESH_S = BLOCKED  # [s] for which a plan counts: a planner that has found no command plans again in each cycle


class StalledPlanner:
    """Watch on one planner, with the Escape that it lacks.

    Args:
        tolerance: distance [m] from a goal within which the planner takes it for reached, and may stand.
    """

    def __init__(self, tolerance: float):
        self._tolerance = tolerance
        self._begin(None)

    def _begin(self, goal: Optional[Hashable]) -> None:
        self._goal, self._escape, self._stood = goal, Escape(), False
        self._escape.report(False)

    def report_held(self, held: bool) -> None:
        """Note if the monitor let next to nothing of what was driven last through (Verdict.blocked)."""
        self._escape.report(held)

    @property
    def has_stalled(self) -> bool:
        """Whether a motion was made since the planner's own commands last came through for a while."""
        return self._escape.is_held

    def instead(self, now: float, command: Twist, goal: Optional[Hashable], left: Optional[float]) -> Optional[Twist]:
        """Return the motion (v [m/s], w [rad/s]) to be driven instead of a command; None for the command.

        Args:
            now: time [s].
            command: (v, w) of the planner; zeros where it is silent.
            goal: what identifies the goal under way; None where there is none, or it is cancelled.
            left: straight way [m] to the end of a plan no older than FRESH_S; None without one.
        """
        if goal != self._goal:
            self._begin(goal)
        if goal is None or not all(map(math.isfinite, command)):
            self._escape.restart()
            return None
        stands = command == (0.0, 0.0)
        if stands and (left is None or left <= self._tolerance):  # it plans, recovers, or has arrived
            self._escape.restart()
            return None
        if self._stood and not stands:
            self._escape.give_way()
        self._stood = stands
        motion = self._escape.instead(now, stands)
        return None if self._escape.is_exhausted else motion
