"""Fixtures and helpers for tests of the move_base node with a simulated Jackal."""

import math
import time
import xmlrpc.client
from types import SimpleNamespace

import actionlib
import pytest
import rospy
from move_base_msgs.msg import MoveBaseAction, MoveBaseGoal
from std_srvs.srv import Empty

from tests.support import ros_harness
from tests.support.fake_jackal import FakeJackal
from tests.support.jackal import JACKAL
from tests.support.ros_harness import wait_for

PENDING, ACTIVE, PREEMPTED, SUCCEEDED, ABORTED = range(5)
POSTS = [(1.5, 0.8, 0.15), (1.5, 1.4, 0.15)]
PLANNER = "/move_base/TrajectoryPlannerROS"


def start(master, parameters=None, sim_time=False, name="move_base"):
    """Start the node and return its Child once it is ready."""
    rospy.set_param("/" + name, parameters or JACKAL)
    rospy.set_param("/use_sim_time", sim_time)
    child = master.node("move_base", "odom:=odometry/filtered")
    child.until("ready")
    rospy.set_param("/use_sim_time", False)
    return child


@pytest.fixture(scope="module")
def master():
    return ros_harness.session()


@pytest.fixture(scope="module")
def stack(master):
    jackal = FakeJackal(POSTS)
    node = start(master)
    client = actionlib.SimpleActionClient("move_base", MoveBaseAction)
    assert client.wait_for_server(rospy.Duration(ros_harness.LONGEST))
    yield SimpleNamespace(node=node, jackal=jackal, client=client)
    jackal.close()
    assert node.end() == 0, node.text


@pytest.fixture
def idle(stack):
    """Return the stack in its initial state: robot at the origin, no goal, all topics on."""
    jackal = stack.jackal
    jackal.scans = jackal.transforms = True
    jackal.bend = lambda scan: scan
    if stack.client.get_state() in (PENDING, ACTIVE):
        stack.client.cancel_goal()  # cancel_all_goals uses another connection, and could end the next goal.
        finish(stack.client)
    wait_for(lambda: jackal.robot.twist == (0.0, 0.0), "standstill")
    jackal.put((0.0, 0.0, 0.0), POSTS)
    time.sleep(0.2)
    rospy.ServiceProxy("/move_base/clear_costmaps", Empty)()
    time.sleep(0.15)
    jackal.commands.clear()
    return stack


def goal(x, y=0.0, yaw=0.0, frame="odom", quaternion=None):
    made = MoveBaseGoal()
    made.target_pose.header.frame_id = frame
    made.target_pose.pose.position.x, made.target_pose.pose.position.y = x, y
    q = made.target_pose.pose.orientation
    q.x, q.y, q.z, q.w = quaternion or (0.0, 0.0, math.sin(yaw / 2), math.cos(yaw / 2))
    return made


def collect(topic, kind):
    """Subscribe to a topic that has a publisher; return (subscriber, list that collects its messages)."""
    messages = []
    subscriber = rospy.Subscriber(topic, kind, messages.append)
    wait_for(subscriber.get_num_connections, topic)
    time.sleep(0.2)  # The publisher learns of the connection a moment later.
    return subscriber, messages


def node_api(master):
    """Return a proxy of the XML-RPC server of the move_base node."""
    uri = xmlrpc.client.ServerProxy(master.uri).lookupNode("/test", "/move_base")[2]
    return xmlrpc.client.ServerProxy(uri)


def connected(master, topic, node):
    """Return whether move_base and `node` are connected by a topic."""
    return any(
        (line[1], line[4]) == (node, topic) for line in node_api(master).getBusInfo("/test")[2]
    )


def finish(client):
    assert client.wait_for_result(rospy.Duration(ros_harness.LONGEST)), "no result"
    return client.get_state(), client.get_goal_status_text()
