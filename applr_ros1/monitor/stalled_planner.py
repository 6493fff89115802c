"""Escape motions that the monitor drives for a planner that has none, such as the C++ move_base.

A planner has stalled if its goal is active and not reached, it has a plan, and it commands zero or only velocities that
the monitor blocks. The node (nodes/monitor/node.py) and the trials (training/env/episode.py) pass each command to a
StalledPlanner.
"""

import math
from typing import Hashable, Optional

from applr_ros1.monitor.motion import Twist
from applr_ros1.planner.escape import BLOCKED, Escape

FRESH_S = BLOCKED  # maximum age of a plan [s]; a planner without a valid command plans again in each cycle


class StalledPlanner:
    """Stall detector for one planner, with the Escape motions to free the robot.

    Args:
        tolerance: distance from the goal within which the planner may stop because it counts the goal as reached [m].
    """

    def __init__(self, tolerance: float):
        self._tolerance = tolerance
        self._begin(None)

    def _begin(self, goal: Optional[Hashable]) -> None:
        self._goal, self._escape, self._stood = goal, Escape(), False
        self._escape.report(False)

    def report_held(self, held: bool) -> None:
        """Record whether the monitor blocked the last command (Verdict.blocked)."""
        self._escape.report(held)

    @property
    def has_stalled(self) -> bool:
        """True from the first escape motion until the planner's own commands have passed for some time."""
        return self._escape.is_held

    def instead(self, now: float, command: Twist, goal: Optional[Hashable], left: Optional[float]) -> Optional[Twist]:
        """Return the escape motion (v [m/s], w [rad/s]) to drive instead of a command, or None to keep the command.

        Args:
            now: time [s].
            command: (v, w) of the planner; zeros if it is silent.
            goal: identifier of the active goal; None if there is none or it is cancelled.
            left: straight-line distance to the end of a plan not older than FRESH_S [m]; None without such a plan.
        """
        if goal != self._goal:
            self._begin(goal)
        if goal is None or not all(map(math.isfinite, command)):
            self._escape.restart()
            return None
        stands = command == (0.0, 0.0)
        if stands and (left is None or left <= self._tolerance):  # The planner plans, recovers, or has arrived.
            self._escape.restart()
            return None
        if self._stood and not stands:
            self._escape.give_way()
        self._stood = stands
        motion = self._escape.instead(now, stands)
        return None if self._escape.is_exhausted else motion
