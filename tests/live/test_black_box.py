"""The black box beside a running move_base: what it finds, writes and answers.

tests/why/black_box tests its rules without processes; this file tests the topics.
"""

import time
from pathlib import Path

import actionlib
import pytest
import rospy
from move_base_msgs.msg import MoveBaseAction
from std_srvs.srv import Trigger

from tests.support.box import Box
from tests.support.nodes import POSTS, FakeJackal, goal, start
from tests.support.robots import JACKAL_PARAMETERS
from tests.support.ros import LONGEST, Kept, session, wait_for
from training.bags.read import opened

pytestmark = pytest.mark.ros
# Time after a stop was found within which the answer comes if a core is free [s]
LATEST_S = 10.0


def arenas_of(pid):
    """Return the number of further arenas of a process: 64 MiB of memory, in part in use."""
    arena_bytes = 64 * 2**20
    spans = []
    for line in Path(f"/proc/{pid}/maps").read_text().splitlines():
        addresses, permissions, *_ = line.split()
        begin, end = (int(address, 16) for address in addresses.split("-"))
        spans.append((begin, end, permissions))
    count = 0
    for (begin, middle, used), (next_begin, end, spare) in zip(spans, spans[1:]):
        is_whole = begin % arena_bytes == 0 and end - begin == arena_bytes
        count += is_whole and middle == next_begin and (used, spare) == ("rw-p", "---p")
    return count


def test_a_stop_is_answered_and_written(tmp_path):
    """Of a robot without a folder, beside a move_base whose parameters are on the server."""
    ros = session()
    jackal = FakeJackal(POSTS)
    move_base = start(ros, dict(JACKAL_PARAMETERS))
    box = Box(ros.node("black_box", f"_folder:={tmp_path}"), tmp_path)
    box.node.until("ready beside /move_base with TrajectoryPlannerROS")
    box.node.until(lambda: float(box.diagnostics.get("megabytes", 0)) > 0.01)
    client = actionlib.SimpleActionClient("move_base", MoveBaseAction)
    assert client.wait_for_server(rospy.Duration(LONGEST))

    # The laser falls silent on the way.
    client.send_goal(goal(12.0))
    box.node.until(lambda: jackal.robot.pose[0] > 1.0)
    jackal.scans = False
    box.node.until("the robot stood at")
    stopwatch = Kept()
    found_at = time.time()

    def has_answered():
        # The process that answers, at low priority, keeps its last waiting time when it has ended.
        stopwatch.waiting()
        time.sleep(0.1)
        return box.answers and box.markers

    box.node.until(has_answered)
    answered_at, answer = box.answers[-1]
    assert answered_at - found_at < LATEST_S + stopwatch.waiting()
    assert answer.kind == "stood"
    assert answer.reason.startswith("there was no scan for"), answer
    assert answer.header.frame_id == "odom"
    assert abs(answer.x - jackal.robot.pose[0]) < 0.2
    assert answer.header.stamp.to_sec() < found_at - 4.0
    assert answer.sentence in box.node.text
    assert box.markers[-1].text == answer.sentence

    # The robot drives on meanwhile, and the bag follows.
    jackal.scans = True
    box.node.until(lambda: jackal.robot.pose[0] > answer.x + 1.0)
    box.node.until(lambda: box.bags)
    (bag_path,) = box.bags
    with opened(bag_path) as bag:
        recorded = bag.types
    for topic in ("/front/scan", "/odometry/filtered", "/tf", "/move_base/status", "/cmd_vel"):
        assert topic in recorded
    assert "/black_box/parameters" in recorded

    # Somebody asks.
    saved = rospy.ServiceProxy("/black_box/save", Trigger)()
    assert saved.success
    box.node.until(lambda: len(box.bags) == 2)
    assert str(box.bags[1]) in saved.message
    wait_for(lambda: int(box.diagnostics["stops"]) == 2, "diagnostics")
    assert box.diagnostics["last_stop"].startswith("the robot ")
    # Each further one would keep what was freed in it, up to 250 MB after seven stops.
    assert arenas_of(box.node.pid) == 0
    client.cancel_goal()
    assert box.node.end() == 0, box.node.text
    assert "Traceback" not in box.node.text, box.node.text
    jackal.close()
    move_base.end()


@pytest.mark.slow
def test_the_planners_own_reason_comes_from_a_replay_of_what_was_heard(tmp_path):
    """Beside a move_base that behaves as the C++ one."""
    ros = session()
    jackal = FakeJackal(POSTS)
    # The planner samples only its slowest speed.
    parameters = dict(JACKAL_PARAMETERS)
    parameters["TrajectoryPlannerROS"] = dict(parameters["TrajectoryPlannerROS"], vx_samples=1)
    move_base = start(ros, parameters, program="tests.support.cpp_move_base")
    box = Box(ros.node("black_box", f"_folder:={tmp_path}"), tmp_path)
    box.node.until("ready beside /move_base")
    client = actionlib.SimpleActionClient("move_base", MoveBaseAction)
    assert client.wait_for_server(rospy.Duration(LONGEST))
    client.send_goal(goal(12.0))
    box.node.until(lambda: box.answers and box.answers[-1][1].parameter)
    _, answer = box.answers[-1]
    assert answer.kind == "crept"
    assert answer.reason.startswith("no command faster than 0.1"), answer
    assert answer.parameter == "TrajectoryPlannerROS/vx_samples"
    assert answer.reproduced > 0.8, answer
    client.cancel_goal()
    assert box.node.end() == 0, box.node.text
    jackal.close()
    move_base.end()
