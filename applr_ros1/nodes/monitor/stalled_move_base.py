"""Adapter between the topics of move_base and a StalledPlanner, for the collision monitor's node.

The status of move_base gives the active goal, and its global plan the distance to the goal.
"""

from __future__ import annotations

import math
from typing import Optional, Tuple

import rospy
from actionlib_msgs.msg import GoalStatus, GoalStatusArray
from nav_msgs.msg import Path

from applr_ros1.monitor.stalled_planner import FRESH_S, StalledPlanner

STATUS_AGE_S = 1.0  # largest usable age of a status [s]; move_base repeats it five times per second
NEVER = rospy.Time(0)


class StalledMoveBase:
    """Escape motions for a move_base that makes none itself. Callbacks only store the latest message.

    Args:
        tolerance: Goal tolerance of move_base [m].
    """

    def __init__(self, tolerance: float):
        self._planner = StalledPlanner(tolerance)
        self.forget()
        rospy.Subscriber("move_base/status", GoalStatusArray, self._take_status, queue_size=1)
        rospy.Subscriber("move_base/NavfnROS/plan", Path, self._take_plan, queue_size=1, buff_size=2**24)
        self.report_held = self._planner.report_held

    def forget(self) -> None:
        """Drop all messages after the clock jumped back."""
        self._goal: Tuple[rospy.Time, Optional[str]] = NEVER, None
        self._left: Tuple[rospy.Time, Optional[float]] = NEVER, None

    def instead(self, now: rospy.Time, command: Tuple[float, float]) -> Optional[Tuple[float, float]]:
        """Return the escape motion (v [m/s], w [rad/s]) that replaces a command, or None to keep the command.

        The first motion is logged.
        """
        (status_came, goal), (plan_came, left), had_stalled = self._goal, self._left, self._planner.has_stalled
        if (now - status_came).to_sec() > STATUS_AGE_S:
            goal = None
        if (now - plan_came).to_sec() > FRESH_S:
            left = None
        motion = self._planner.instead(now.to_sec(), command, goal, left)
        if self._planner.has_stalled and not had_stalled:
            rospy.logwarn("collision monitor: move_base makes no progress; trying small escape motions")
        return motion

    def _take_status(self, message: GoalStatusArray) -> None:
        active = [each.goal_id.id for each in message.status_list if each.status == GoalStatus.ACTIVE]
        self._goal = rospy.get_rostime(), active[-1] if active else None  # A goal being cancelled is not ACTIVE.

    def _take_plan(self, message: Path) -> None:
        ends = [pose.pose.position for pose in message.poses[:1] + message.poses[-1:]]
        left = math.hypot(ends[1].x - ends[0].x, ends[1].y - ends[0].y) if ends else None
        self._left = rospy.get_rostime(), left
