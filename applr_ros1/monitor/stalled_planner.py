"""Escape motions that the monitor drives for a planner that has none, such as the C++ move_base.

A planner has stalled if its goal is active and not reached, it has a plan, and it commands zero or
only velocities that the monitor blocks. The node (nodes/monitor/node.py) and the trials
(stack/stack.py) pass each command to a StalledPlanner.
"""

import math
from typing import Hashable, Optional

from applr_ros1.monitor.motion import Twist
from applr_ros1.planner.escape import BLOCKED, Escape

# Maximum age of a plan [s]. A planner without a valid command plans again in each cycle.
FRESH_S = BLOCKED


class StalledPlanner:
    """Stall detector for one planner, with the Escape motions to free the robot.

    Args:
        tolerance: distance from the goal within which the planner may stop because it counts the
            goal as reached [m].
    """

    def __init__(self, tolerance: float):
        self._tolerance = tolerance
        self._begin(None)

    def _begin(self, goal: Optional[Hashable]) -> None:
        self._goal = goal
        self._escape = Escape()
        self._escape.report(False)  # Without a report, an Escape makes no motion.
        self._has_stood = False  # whether the last command was zero

    def report_held(self, held: bool) -> None:
        """Record whether the monitor blocked the last command (Verdict.blocked)."""
        self._escape.report(held)

    @property
    def has_stalled(self) -> bool:
        """True from the first escape motion until the planner's commands have passed for a time."""
        return self._escape.is_held

    def instead(
        self, time: float, command: Twist, goal: Optional[Hashable], distance: Optional[float]
    ) -> Optional[Twist]:
        """Return the escape motion (v [m/s], w [rad/s]) to drive, or None to keep the command.

        Args:
            time: current time [s].
            command: (v, w) of the planner; zeros if it is silent.
            goal: identifier of the active goal; None if there is none or it is cancelled.
            distance: straight-line distance to the end of a plan not older than FRESH_S [m]; None
            without such a plan.
        """
        if goal != self._goal:
            self._begin(goal)
        if goal is None or not all(map(math.isfinite, command)):
            self._escape.restart()
            return None
        is_standing = command == (0.0, 0.0)
        # The planner plans, recovers, or has arrived.
        if is_standing and (distance is None or distance <= self._tolerance):
            self._escape.restart()
            return None

        # The planner's own command passes as soon as there is one again.
        if self._has_stood and not is_standing:
            self._escape.give_way()
        self._has_stood = is_standing
        motion = self._escape.instead(time, is_standing)
        return None if self._escape.is_exhausted else motion
