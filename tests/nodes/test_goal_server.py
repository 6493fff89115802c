"""Test of the action server of move_base, without a ROS master."""

from types import SimpleNamespace

import pytest
import rospy
from actionlib_msgs.msg import GoalID, GoalStatus
from move_base_msgs.msg import MoveBaseActionGoal

from applr_ros1.nodes.move_base.goal_server import GoalServer

pytest_plugins = ("tests.support.offline_ros",)


@pytest.fixture
def server(offline_ros):
    """Provide goal(id) and cancel(id), which send messages; time(t) to set the clock [s];
    statuses() of the goals by id; and lines, the errors in the log.
    """
    callbacks = offline_ros.callbacks
    goals = GoalServer()
    goals.start()

    def time(seconds):
        offline_ros.now = seconds

    def goal(goal_id, stamp=100):
        callbacks["move_base/goal"](MoveBaseActionGoal(goal_id=GoalID(rospy.Time(stamp), goal_id)))

    def cancel(goal_id, stamp=0):
        callbacks["move_base/cancel"](GoalID(rospy.Time(stamp), goal_id))

    def statuses():
        by_id = {}
        for tracker in goals.action_server.status_list:
            by_id[tracker.status.goal_id.id] = tracker.status.status
        return by_id

    return SimpleNamespace(
        goal=goal,
        cancel=cancel,
        time=time,
        statuses=statuses,
        lines=offline_ros.log["err"],
        goals=goals,
    )


def finish(server):
    """Accept the waiting goal, and end it."""
    assert server.goals.is_new_goal_available()
    server.goals.accept_new_goal()
    server.goals.set_succeeded()


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


def test_a_goal_or_cancellation_stamped_far_ahead_cancels_no_later_goal(server):
    """The clock of another computer may be ahead."""
    server.goal("ahead", 1100)
    finish(server)
    server.time(101)
    server.goal("next", 101)
    finish(server)
    server.cancel("", 1101)
    server.time(102)
    server.goal("last", 102)
    finish(server)
    assert server.lines == []


def test_after_a_clock_jump_back_goals_are_accepted(server):
    server.goal("before")
    finish(server)
    server.cancel("", 100)
    server.time(5)
    server.goals.forget_stamps()
    server.goal("after", 5)
    finish(server)
    assert server.lines == []
