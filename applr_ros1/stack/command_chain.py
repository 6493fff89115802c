"""Chain in which a command of the planner is changed: escape motions, then the collision monitor.

A planner that makes no escape motions itself, such as the C++ move_base, is watched from outside by
a StalledPlanner. policy/stuck.py says who else finds that the robot is stuck. Simulated drives
(stack.py) and the collision monitor's node (nodes/monitor/node.py) share these classes.
"""

from __future__ import annotations

import math
from typing import Any, Callable, Hashable, NamedTuple, Optional

from applr_ros1.common.angles import Twist
from applr_ros1.monitor.monitor import Verdict
from applr_ros1.planner.escape import BLOCKED, Escape

# Maximum age of a plan [s]. A planner without a valid command plans again in each cycle.
FRESH_S = BLOCKED
# Judges (command, whether the command may creep) for the base, as CollisionMonitor.filter does.
Judge = Callable[[Twist, bool], Verdict]


class Progress(NamedTuple):
    """Knowledge of the planner's goal.

    Attributes:
        goal: Identifier of the active goal; None if there is none or it is being cancelled.
        plan_time: Time at which the latest plan came [s].
        distance: Straight-line distance from the begin to the end of this plan [m]; None for an
            empty plan.
    """

    goal: Optional[Hashable] = None
    plan_time: float = -math.inf
    distance: Optional[float] = None

    def left(self, now: float) -> Optional[float]:
        """Return the distance that is left at a time [m]; None if it is not known."""
        # A plan that the planner has not renewed says nothing about the way that is left.
        return self.distance if now - self.plan_time <= FRESH_S else None


def across(plan: Any) -> Optional[float]:
    """Return the distance [m] between the ends of a plan, a sequence of points (x, y, ...) [m].

    It is None for an empty plan, which move_base publishes if planning fails.
    """
    if not len(plan):
        return None
    begin_x, begin_y, *_ = plan[0]
    end_x, end_y, *_ = plan[-1]
    return math.hypot(end_x - begin_x, end_y - begin_y)


class StalledPlanner:
    """Stall detector for one planner, with the Escape motions to free the robot.

    A planner has stalled if its goal is active and not reached, it has a plan, and it commands zero
    or only velocities that the monitor blocks.

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

    def escape_motion(self, now: float, command: Twist, progress: Progress) -> Optional[Twist]:
        """Return the escape motion (v [m/s], w [rad/s]) to drive, or None to keep the command.

        Args:
            now: Current time [s].
            command: (v, w) of the planner; zeros if it is silent.
            progress: Knowledge of the planner's goal.
        """
        if progress.goal != self._goal:
            self._begin(progress.goal)
        if progress.goal is None or not all(map(math.isfinite, command)):
            self._escape.restart()
            return None
        is_standing = command == (0.0, 0.0)
        distance = progress.left(now)
        # The planner plans, recovers, or has arrived.
        if is_standing and (distance is None or distance <= self._tolerance):
            self._escape.restart()
            return None

        # The planner's own command passes as soon as there is one again.
        if self._has_stood and not is_standing:
            self._escape.give_way()
        self._has_stood = is_standing
        motion = self._escape.motion(now, is_standing)
        return None if self._escape.is_exhausted else motion


def judged(
    command: Twist, motion: Optional[Twist], judge: Judge, planner: Optional[StalledPlanner]
) -> Verdict:
    """Return the verdict on a planner's command, or on the escape motion that replaces it.

    Args:
        command: (v, w) of the planner.
        motion: (v, w) of the escape motion, if there is one.
        judge: Judges one of them.
        planner: Detector that is told what was blocked; None for a planner that makes escape
            motions itself.
    """
    if motion is None:
        verdict = judge(command, True)
    else:
        # An escape motion is small: slowed to a creep, it would free nothing.
        verdict = judge(motion, False)
    if planner is not None:
        planner.report_held(verdict.blocked)
    return verdict
