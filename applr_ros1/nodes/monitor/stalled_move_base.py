"""Asks a StalledPlanner for the collision monitor's node, with what the topics of move_base say.

From its status comes the goal under way, from its global plan how far the robot is from there.
"""

from __future__ import annotations

import math
from typing import Optional, Tuple

import rospy
from actionlib_msgs.msg import GoalStatus, GoalStatusArray
from nav_msgs.msg import Path

from applr_ros1.monitor.stalled_planner import FRESH_S, StalledPlanner

STATUS_AGE_S = 1.0  # s after which a status counts no more: move_base repeats it five times a second
NEVER = rospy.Time(0)


class StalledMoveBase:
    """Watch on a move_base that makes no motions of escape itself. Callbacks only keep the latest message.

    Args:
        tolerance: of its goals [m].
    """

    def __init__(self, tolerance: float):
        self._planner = StalledPlanner(tolerance)
        self.forget()
        rospy.Subscriber("move_base/status", GoalStatusArray, self._take_status, queue_size=1)
        rospy.Subscriber("move_base/NavfnROS/plan", Path, self._take_plan, queue_size=1, buff_size=2**24)
        self.report_held = self._planner.report_held

    def forget(self) -> None:
        """Forget what was heard: the clock jumped back."""
        self._goal: Tuple[rospy.Time, Optional[str]] = NEVER, None
        self._left: Tuple[rospy.Time, Optional[float]] = NEVER, None

    def instead(self, now: rospy.Time, command: Tuple[float, float]) -> Optional[Tuple[float, float]]:
        """Return the motion (v [m/s], w [rad/s]) to be driven instead of a command; None for the command.

        Log the first motion.
        """
        (status_came, goal), (plan_came, left), had_stalled = self._goal, self._left, self._planner.has_stalled
        if (now - status_came).to_sec() > STATUS_AGE_S:
            goal = None
        if (now - plan_came).to_sec() > FRESH_S:
            left = None
        motion = self._planner.instead(now.to_sec(), command, goal, left)
        if self._planner.has_stalled and not had_stalled:
            rospy.logwarn("collision monitor: move_base does not get on with its goal; small motions are tried")
        return motion

    def _take_status(self, message: GoalStatusArray) -> None:
        active = [each.goal_id.id for each in message.status_list if each.status == GoalStatus.ACTIVE]
        self._goal = rospy.get_rostime(), active[-1] if active else None  # none where it is being cancelled

    def _take_plan(self, message: Path) -> None:
        ends = [pose.pose.position for pose in message.poses[:1] + message.poses[-1:]]
        left = math.hypot(ends[1].x - ends[0].x, ends[1].y - ends[0].y) if ends else None
        self._left = rospy.get_rostime(), left
