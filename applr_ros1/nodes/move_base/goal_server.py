"""Action server of the move_base node, which repairs three faults of actionlib's.

Its timer of the statuses ends when the clock jumps back. A cancellation is kept for good, so that
it cancels all goals from before it, also those of an earlier time. And a cancellation that comes
before its goal is kept as a goal without a handle, for which the next ones log an error each.
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

    def start(self) -> None:
        """Accept goals."""
        super().start()
        server = self.action_server
        server.status_timer.shutdown()
        server.status_timer = rospy.Timer(STATUS_PERIOD, server.publish_status_async, reset=True)

    def forget_cancellations(self) -> None:
        """Accept goals of an earlier time after the clock jumped back."""
        self.action_server.last_cancel = rospy.Time()

    def _cancel(self, cancelled_id: Any) -> None:
        """Cancel the goals that an actionlib_msgs/GoalID names."""
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
