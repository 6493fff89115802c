"""The action protocol by itself: which goal wins, what the others are told, what a cancel reaches."""

import genpy
import pytest
from actionlib_msgs.msg import GoalID, GoalStatus
from move_base_msgs.msg import MoveBaseActionGoal

from applr_ros1.nodes.move_base.goal_server import REPLACED, TOO_OLD, GoalServer

RECALLED, PREEMPTED, SUCCEEDED = GoalStatus.RECALLED, GoalStatus.PREEMPTED, GoalStatus.SUCCEEDED


class Topic(list):
    publish = list.append


@pytest.fixture
def server():
    made = GoalServer("/move_base", Topic(), Topic(), Topic())
    made.ends = lambda: [(r.status.goal_id.id, r.status.status, r.status.text) for r in made._result]
    return made


def at(seconds):
    return genpy.Time.from_sec(seconds)


def send(server, name, stamp, now=None):
    server.receive_goal(MoveBaseActionGoal(goal_id=GoalID(at(stamp), name)), at(now or stamp))


def test_one_goal_from_start_to_end(server):
    send(server, "a", 1.0)
    assert not server.active
    assert server.take(at(1.1)).goal_id.id == "a"
    assert server.active
    assert server.take(at(1.2)) is None
    server.publish_status(at(1.2))
    assert [(s.goal_id.id, s.status, s.text) for s in server._status[-1].status_list] == [
        ("a", GoalStatus.ACTIVE, "This goal has been accepted by the simple action server")
    ]
    server.feedback(None, at(1.3))
    assert server._feedback[-1].status.goal_id.id == "a"
    server.finish("succeeded", "Goal reached.", at(2.0))
    assert server.ends() == [("a", SUCCEEDED, "Goal reached.")]
    assert not server.active


def test_newer_goal_wins_and_older_is_refused(server):
    send(server, "a", 1.0)
    server.take(at(1.0))
    send(server, "b", 2.0)
    send(server, "c", 3.0)
    send(server, "old", 0.5)
    assert server.ends() == [("b", RECALLED, REPLACED), ("old", RECALLED, REPLACED)]
    assert server.take(at(3.0)).goal_id.id == "c"
    assert server.ends()[-1] == ("a", PREEMPTED, REPLACED)


@pytest.mark.parametrize("cancel", [GoalID(), GoalID(at(0.0), "a"), GoalID(at(1.5), ""), GoalID(at(1.0), "")])
def test_cancel_reaches_the_current_goal(server, cancel):
    send(server, "a", 1.0)
    server.take(at(1.0))
    server.receive_cancel(cancel, at(1.6))
    assert server.cancel_requested
    server.finish("preempted", "", at(1.7))
    assert server.ends() == [("a", PREEMPTED, "")]
    assert not server.cancel_requested


@pytest.mark.parametrize("cancel", [GoalID(at(0.0), "other"), GoalID(at(0.9), "")])
def test_cancel_of_others_does_not(server, cancel):
    send(server, "a", 1.0)
    server.take(at(1.0))
    server.receive_cancel(cancel, at(1.6))
    assert not server.cancel_requested


def test_cancel_before_the_goal_is_taken(server):
    send(server, "a", 1.0)
    server.receive_cancel(GoalID(), at(1.0))
    assert server.take(at(1.1)) is not None
    assert server.cancel_requested


def test_cancel_before_the_goal_comes(server):
    server.receive_cancel(GoalID(at(0.0), "late"), at(1.0))
    send(server, "late", 1.1)
    assert server.take(at(1.2)) is None
    assert server.ends() == [("late", RECALLED, "")]
    server.receive_cancel(GoalID(at(5.0), ""), at(5.0))
    send(server, "older", 4.0, now=6.0)
    assert server.ends()[-1] == ("older", RECALLED, TOO_OLD)


def test_a_goal_sent_twice_counts_once_and_one_without_id_gets_one(server):
    send(server, "a", 1.0)
    send(server, "a", 1.0)
    server.take(at(1.0))
    assert server.take(at(1.0)) is None
    server.receive_goal(MoveBaseActionGoal(), at(2.0))
    server.take(at(2.0))
    assert server._current.goal_id.id.startswith("/move_base-1-")
    assert server._current.goal_id.stamp == at(2.0)


def test_status_comes_at_5_hz_in_cycles_of_20_hz(server):
    for cycle in range(200):
        server.publish_status(at(7.3 + 0.05 * cycle + 0.004 * (cycle % 3)))
    assert len(server._status) == 50


def test_status_list_forgets_and_is_bounded(server):
    for i in range(500):
        send(server, str(i), 1.0 + 0.001 * i)
    server.take(at(2.0))
    server.publish_status(at(2.0))
    assert len(server._status[-1].status_list) <= 202
    server.publish_status(at(2.01))
    assert len(server._status) == 1  # no news
    server.publish_status(at(8.0))
    assert len(server._status[-1].status_list) == 1
    server.forget_times()
    send(server, "again", 0.5)
    assert server.ends()[-1][1] == RECALLED  # the current one is newer by its stamp
