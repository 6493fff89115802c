"""The move_base node beside a made-up Jackal, for the test files that share them: fixtures and small helpers."""

import math
import time
from types import SimpleNamespace

import pytest

from tests.support import ros_harness
from tests.support.ros_harness import wait_for

ACTIVE, PREEMPTED, SUCCEEDED, ABORTED = 1, 2, 3, 4
POSTS = [(1.5, 0.8, 0.15), (1.5, 1.4, 0.15)]
PLANNER = "/move_base/TrajectoryPlannerROS"


def start(master, parameters=None, sim_time=False, name="move_base"):
    """The node as a child, ready."""
    import rospy

    from tests.support.jackal import JACKAL

    rospy.set_param("/" + name, parameters or JACKAL)
    rospy.set_param("/use_sim_time", sim_time)
    child = master.node("move_base", "odom:=odometry/filtered")
    wait_for(lambda: "ready" in child.text or not child.alive(), 150.0, "move_base")
    rospy.set_param("/use_sim_time", False)
    assert child.alive(), child.text
    return child


@pytest.fixture(scope="module")
def master():
    return ros_harness.session()


@pytest.fixture(scope="module")
def stack(master):
    import actionlib
    import rospy
    from move_base_msgs.msg import MoveBaseAction

    from tests.support.fake_jackal import FakeJackal

    jackal = FakeJackal(POSTS)
    node = start(master)
    client = actionlib.SimpleActionClient("move_base", MoveBaseAction)
    assert client.wait_for_server(rospy.Duration(10.0))
    yield SimpleNamespace(node=node, jackal=jackal, client=client)
    jackal.close()
    assert node.end() == 0, node.text


@pytest.fixture
def idle(stack):
    """The stack at its start: robot at the origin, nothing to do, everything switched on."""
    import rospy
    from std_srvs.srv import Empty

    jackal = stack.jackal
    jackal.scans = jackal.transforms = True
    jackal.bend = lambda scan: scan
    stack.client.cancel_all_goals()
    wait_for(lambda: jackal.robot.twist == (0.0, 0.0), 2.0, "standstill")
    jackal.put((0.0, 0.0, 0.0), POSTS)
    time.sleep(0.2)
    rospy.ServiceProxy("/move_base/clear_costmaps", Empty)()
    time.sleep(0.15)
    jackal.commands.clear()
    return stack


def goal(x, y=0.0, yaw=0.0, frame="odom", quaternion=None):
    from move_base_msgs.msg import MoveBaseGoal

    made = MoveBaseGoal()
    made.target_pose.header.frame_id = frame
    made.target_pose.pose.position.x, made.target_pose.pose.position.y = x, y
    q = made.target_pose.pose.orientation
    q.x, q.y, q.z, q.w = quaternion or (0.0, 0.0, math.sin(yaw / 2), math.cos(yaw / 2))
    return made


def collect(topic, kind):
    """(subscriber, list of the messages that come)."""
    import rospy

    got = []
    return rospy.Subscriber(topic, kind, got.append), got


def finish(client, seconds=20.0):
    import rospy

    assert client.wait_for_result(rospy.Duration(seconds * ros_harness.slowness())), "no result"
    return client.get_state(), client.get_goal_status_text()
