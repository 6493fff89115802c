"""Chain of commands: an escape motion may replace a command, then the monitor limits it.

Simulated drives (stack.py) and the collision monitor's node (nodes/monitor/node.py) share the order
of these steps.
"""

import math
from typing import Callable, Hashable, NamedTuple, Optional

from applr_ros1.monitor.monitor import Verdict
from applr_ros1.monitor.motion import Twist
from applr_ros1.monitor.stalled_planner import FRESH_S, StalledPlanner

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


class CommandChain:
    """Escape motions and a collision monitor, in the order in which they change a command.

    Args:
        escapes: Detector of a stalled planner that makes no escape motions itself; None for one
            that does.
    """

    def __init__(self, escapes: Optional[StalledPlanner] = None):
        self.escapes = escapes

    def escape(self, now: float, command: Twist, progress: Progress) -> Optional[Twist]:
        """Return the escape motion (v, w) that replaces a command, or None to keep the command."""
        if self.escapes is None:
            return None
        # A plan that the planner has not renewed says nothing about the way that is left.
        is_fresh = now - progress.plan_time <= FRESH_S
        distance = progress.distance if is_fresh else None  # None: not known
        return self.escapes.instead(now, command, progress.goal, distance)

    def judged(self, command: Twist, motion: Optional[Twist], judge: Judge) -> Verdict:
        """Return the verdict on a planner's command, or on the escape motion that replaces it."""
        judged_command = command
        may_creep = True
        if motion is not None:
            judged_command = motion
            # An escape motion is small: slowed to a creep, it would free nothing.
            may_creep = False
        verdict = judge(judged_command, may_creep)
        if self.escapes is not None:
            self.escapes.report_held(verdict.blocked)
        return verdict
