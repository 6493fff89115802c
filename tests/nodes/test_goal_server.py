"""Test of the action server of move_base, without a ROS master."""

from types import SimpleNamespace
from unittest.mock import MagicMock

import pytest
import rospy
from actionlib_msgs.msg import GoalID, GoalStatus
from move_base_msgs.msg import MoveBaseActionGoal

from applr_ros1.nodes.move_base.goal_server import GoalServer


@pytest.fixture
def server(monkeypatch):
    """Provide goal(id) and cancel(id), which send messages; statuses() of the goals by id; and
    lines, the errors in the log.
    """
    callbacks = {}
    lines = []

    def subscribe(topic, kind, callback, **options):
        callbacks[topic] = callback

    def log(line, *arguments):
        lines.append(line % arguments if arguments else line)

    rospy.rostime.set_rostime_initialized(True)
    monkeypatch.setattr(rospy, "get_rostime", lambda: rospy.Time(100))
    monkeypatch.setattr(rospy, "Subscriber", subscribe)
    monkeypatch.setattr(rospy, "Publisher", MagicMock())
    monkeypatch.setattr(rospy, "Timer", MagicMock())
    monkeypatch.setattr(rospy, "get_param", lambda name, default: default)
    monkeypatch.setattr(rospy, "has_param", lambda name: False)
    monkeypatch.setattr(rospy, "search_param", lambda name: None)
    monkeypatch.setattr(rospy, "logerr", log)
    goals = GoalServer()
    goals.start()

    def goal(goal_id):
        callbacks["move_base/goal"](MoveBaseActionGoal(goal_id=GoalID(rospy.Time(100), goal_id)))

    def cancel(goal_id):
        callbacks["move_base/cancel"](GoalID(id=goal_id))

    def statuses():
        by_id = {}
        for tracker in goals.action_server.status_list:
            by_id[tracker.status.goal_id.id] = tracker.status.status
        return by_id

    return SimpleNamespace(goal=goal, cancel=cancel, statuses=statuses, lines=lines, goals=goals)


def test_cancellations_that_come_before_their_goals_are_kept_and_log_nothing(server):
    """The topics of goals and cancellations have no common order."""
    for number in range(100):
        server.cancel(f"goal {number}")
    server.cancel("")  # cancels all goals
    server.cancel("goal 7")
    server.goal("goal 7")
    assert not server.goals.is_new_goal_available()
    assert server.statuses()["goal 7"] == GoalStatus.RECALLED
    assert len(server.goals.action_server.status_list) == 100

    # A goal that has arrived is cancelled as usual.
    server.goal("another goal")
    assert server.goals.is_new_goal_available()
    server.cancel("another goal")
    assert server.statuses()["another goal"] == GoalStatus.RECALLING
    assert server.lines == []
