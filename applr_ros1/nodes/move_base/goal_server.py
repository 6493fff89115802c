"""Action server of the move_base node, which repairs four faults of actionlib's.

Its timer of the statuses ends when the clock jumps back. The latest goal and the latest
cancellation are kept for good, and goals stamped before them are cancelled, also those of an
earlier time. After one goal of a computer whose clock is ahead, all others are cancelled until that
time. And a cancellation that comes before its goal is kept as a goal without a handle, for which
the next ones log an error each.
"""

from __future__ import annotations

from typing import Any

import rospy
from actionlib import SimpleActionServer
from move_base_msgs.msg import MoveBaseAction

# Interval between two messages of goal statuses, as in actionlib
STATUS_PERIOD = rospy.Duration(0.2)


class GoalServer(SimpleActionServer):  # type: ignore[misc]  # ROS packages have no type hints.
    """SimpleActionServer of the action `move_base`, started by start()."""

    def __init__(self) -> None:
        super().__init__("move_base", MoveBaseAction, auto_start=False)
        self._take_cancellation = self.action_server.internal_cancel_callback
        self.action_server.internal_cancel_callback = self._cancel
        self._take_goal = self.action_server.internal_goal_callback
        self.action_server.internal_goal_callback = self._accept

    def start(self) -> None:
        """Accept goals."""
        super().start()
        server = self.action_server
        server.status_timer.shutdown()
        server.status_timer = rospy.Timer(STATUS_PERIOD, server.publish_status_async, reset=True)

    def forget_stamps(self) -> None:
        """Accept goals of an earlier time after the clock jumped back."""
        self.action_server.last_cancel = rospy.Time()
        for handle in (self.current_goal, self.next_goal):
            if handle.get_goal():
                handle.get_goal_id().stamp = rospy.Time()

    def _accept(self, goal: Any) -> None:
        """Take a move_base_msgs/MoveBaseActionGoal."""
        _limit_stamp(goal.goal_id)
        self._take_goal(goal)

    def _cancel(self, cancelled_id: Any) -> None:
        """Cancel the goals that an actionlib_msgs/GoalID names."""
        _limit_stamp(cancelled_id)
        server = self.action_server
        with server.lock:
            # Cancellations that came before their goals cannot be cancelled.
            early_cancellations = []
            goals = []
            for tracker in server.status_list:
                if tracker.goal is not None:
                    goals.append(tracker)
                elif tracker.status.goal_id.id != cancelled_id.id:
                    early_cancellations.append(tracker)
            server.status_list = goals
            self._take_cancellation(cancelled_id)
            server.status_list += early_cancellations


def _limit_stamp(goal_id: Any) -> None:
    """Stamp an actionlib_msgs/GoalID now if it is stamped ahead of the clock."""
    goal_id.stamp = min(goal_id.stamp, rospy.get_rostime())
