"""Adapter between the topics of move_base and a StalledPlanner, for the collision monitor's node.

The status of move_base gives the active goal, and its global plan the distance to the goal.
"""

from __future__ import annotations

from typing import Optional, Tuple

import rospy
from actionlib_msgs.msg import GoalStatus, GoalStatusArray
from nav_msgs.msg import Path

from applr_ros1.common.ros_node import LARGE_BUFFER
from applr_ros1.nodes.conversions import goal_in, path_points
from applr_ros1.senses.standing import STATUS_AGE_S
from applr_ros1.stack.command_chain import Progress, across

NEVER = rospy.Time(0)


class MoveBaseProgress:
    """Goal and plan of move_base, from its topics. Callbacks only store the latest message."""

    def __init__(self) -> None:
        self.forget()
        rospy.Subscriber("move_base/status", GoalStatusArray, self._take_status, queue_size=1)
        rospy.Subscriber(
            "move_base/NavfnROS/plan", Path, self._take_plan, queue_size=1, buff_size=LARGE_BUFFER
        )

    def forget(self) -> None:
        """Drop all messages after the clock jumped back."""
        self._goal: Tuple[rospy.Time, Optional[str]] = NEVER, None
        self._plan: Tuple[rospy.Time, Optional[float]] = NEVER, None

    def progress(self, now: rospy.Time) -> Progress:
        """Return goal and plan at a time. A goal counts only while move_base repeats its status."""
        status_time, goal_id = self._goal
        plan_time, distance = self._plan
        is_stale = (now - status_time).to_sec() > STATUS_AGE_S
        return Progress(None if is_stale else goal_id, plan_time.to_sec(), distance)

    def _take_status(self, message: GoalStatusArray) -> None:
        # A goal being cancelled is not ACTIVE.
        self._goal = rospy.get_rostime(), goal_in(message, (GoalStatus.ACTIVE,))

    def _take_plan(self, message: Path) -> None:
        """Store the straight distance between the ends of a plan."""
        ends = message.poses[:1] + message.poses[-1:]
        self._plan = rospy.get_rostime(), across(path_points(ends))
