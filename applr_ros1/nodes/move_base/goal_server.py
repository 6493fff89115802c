"""The server side of move_base's action: goals and cancels in, status, feedback and results out.

Called by the move_base node from its one thread, so there are no races. Rules and texts are those of C++
actionlib's SimpleActionServer (actionlib's own Python one runs on threads and locks of its own and publishes the
whole status list several times per goal).
"""

from __future__ import annotations

from collections import OrderedDict
from typing import Any, Optional, Tuple

from actionlib_msgs.msg import GoalID, GoalStatus, GoalStatusArray
from move_base_msgs.msg import MoveBaseActionFeedback, MoveBaseActionResult

ACCEPTED = "This goal has been accepted by the simple action server"
REPLACED = "This goal was canceled because another goal was recieved by the simple action server"
TOO_OLD = (
    "This goal handle was canceled by the action server because its timestamp is before the timestamp of "
    "the last cancel request"
)
ENDED_KEPT_S = 5.0  # seconds for which an ended goal stays in the status list
MAX_ENDED = 200  # ended goals in the status list
STATUS_PERIOD_S = 0.175  # s after which a cycle repeats the status: 5 Hz, as actionlib does, in cycles of 0.05 s
ENDED = {"succeeded": GoalStatus.SUCCEEDED, "aborted": GoalStatus.ABORTED, "preempted": GoalStatus.PREEMPTED}


class GoalServer:
    """`status`, `feedback`, `result`: publishers. One goal is current, at most one waits; times in seconds."""

    def __init__(self, node_name: str, status, feedback, result):
        self._name, self._status, self._feedback, self._result = node_name, status, feedback, result
        self._tracked: "OrderedDict[str, GoalStatus]" = OrderedDict()
        self._ended: "OrderedDict[str, float]" = OrderedDict()  # id -> when
        self._current: Optional[GoalStatus] = None
        self._waiting: Optional[Tuple[GoalStatus, Any]] = None  # with the goal message
        self._last_cancel = 0.0
        self._count = 0
        self._published, self._news = float("-inf"), True
        self.cancel_requested = False  # of the current goal

    # -- in ----------------------------------------------------------------------------------------------------
    def receive_goal(self, message, stamp) -> None:
        """Take a MoveBaseActionGoal that came at `stamp` (rospy.Time)."""
        now = stamp.to_sec()
        goal_id = GoalID(message.goal_id.stamp, message.goal_id.id)
        if not goal_id.id:
            self._count += 1
            goal_id.id = f"{self._name}-{self._count}-{now:.9f}"
        known = self._tracked.get(goal_id.id)
        if known is not None:
            if known.status == GoalStatus.RECALLING:  # its cancel came first
                self._end(known, GoalStatus.RECALLED, "", stamp)
            return
        if goal_id.stamp.to_sec() == 0.0:
            goal_id.stamp = stamp
        status = self._tracked[goal_id.id] = GoalStatus(goal_id, GoalStatus.PENDING, "")
        self._news = True
        sent = goal_id.stamp.to_sec()
        if message.goal_id.stamp.to_sec() != 0.0 and sent <= self._last_cancel:
            self._end(status, GoalStatus.RECALLED, TOO_OLD, stamp)
            return
        older = [s for s in (self._current, self._waiting and self._waiting[0]) if s]
        if any(sent < s.goal_id.stamp.to_sec() for s in older):
            self._end(status, GoalStatus.RECALLED, REPLACED, stamp)
            return
        if self._waiting is not None:
            self._end(self._waiting[0], GoalStatus.RECALLED, REPLACED, stamp)
        self._waiting = status, message

    def receive_cancel(self, message, stamp) -> None:
        """Cancel that GoalID's goal, all goals up to its stamp, or all where both are empty."""
        until = message.stamp.to_sec()
        everything = not message.id and until == 0.0
        for status in list(self._tracked.values()):
            sent = status.goal_id.stamp.to_sec()
            if everything or status.goal_id.id == message.id or (until != 0.0 and sent <= until):
                self._request_cancel(status)
        if message.id and message.id not in self._tracked:
            goal_id = GoalID(message.stamp, message.id)
            self._tracked[message.id] = GoalStatus(goal_id, GoalStatus.RECALLING, "")
            self._ended[message.id] = stamp.to_sec()
        self._last_cancel = max(self._last_cancel, until)

    def _request_cancel(self, status) -> None:
        if self._current is not None and status is self._current and status.status == GoalStatus.ACTIVE:
            status.status, self.cancel_requested, self._news = GoalStatus.PREEMPTING, True, True
        elif self._waiting is not None and status is self._waiting[0]:
            status.status, self._news = GoalStatus.RECALLING, True

    # -- what the node does --------------------------------------------------------------------------------------
    @property
    def active(self) -> bool:
        """Return whether a goal is being pursued."""
        return self._current is not None

    def take(self, stamp):
        """Return the goal that waits, now accepted (its predecessor ends as preempted), or None."""
        if self._waiting is None:
            return None
        status, message = self._waiting
        self._waiting = None
        if self._current is not None:
            self._end(self._current, GoalStatus.PREEMPTED, REPLACED, stamp)
        self.cancel_requested = status.status == GoalStatus.RECALLING
        status.status = GoalStatus.PREEMPTING if self.cancel_requested else GoalStatus.ACTIVE
        status.text = ACCEPTED
        self._current, self._news = status, True
        return message

    def finish(self, outcome: str, text: str, stamp) -> None:
        """End the current goal: "succeeded", "aborted" or "preempted"."""
        if self._current is not None:
            self._end(self._current, ENDED[outcome], text, stamp)
        self._current, self.cancel_requested = None, False

    def feedback(self, pose, stamp) -> None:
        """Tell the current goal's client where the robot is (geometry_msgs/PoseStamped)."""
        if self._current is not None:
            message = MoveBaseActionFeedback(status=self._current)
            message.header.stamp = stamp
            message.feedback.base_position = pose
            self._feedback.publish(message)

    def publish_status(self, stamp) -> None:
        """Publish the status list if there is news or its time has come; forget what ended long ago."""
        now = stamp.to_sec()
        if not self._news and 0.0 <= now - self._published < STATUS_PERIOD_S:
            return
        self._news, self._published = False, now
        while self._ended:
            oldest, when = next(iter(self._ended.items()))
            if 0.0 <= now - when <= ENDED_KEPT_S and len(self._ended) <= MAX_ENDED:
                break
            del self._ended[oldest]
            self._tracked.pop(oldest, None)
        message = GoalStatusArray(status_list=list(self._tracked.values()))
        message.header.stamp = stamp
        self._status.publish(message)

    def forget_times(self) -> None:
        """Forget what was remembered by the time of a clock that went back."""
        self._last_cancel = 0.0
        for goal_id in self._ended:
            self._tracked.pop(goal_id, None)
        self._ended.clear()
        self._news = True

    def _end(self, status, code, text, stamp) -> None:
        status.status, status.text = code, text
        self._ended[status.goal_id.id] = stamp.to_sec()
        self._ended.move_to_end(status.goal_id.id)
        self._news = True
        result = MoveBaseActionResult(status=GoalStatus(status.goal_id, code, text))
        result.header.stamp = stamp
        self._result.publish(result)
