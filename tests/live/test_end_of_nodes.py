"""Tests that nodes print no traceback when they are interrupted while messages arrive."""

import itertools
import os
import signal
import threading
import time

import pytest
import rospy
from actionlib_msgs.msg import GoalID
from geometry_msgs.msg import Polygon, PoseStamped, Twist
from move_base_msgs.msg import MoveBaseActionGoal
from std_msgs.msg import Time

from tests.support.robots import JACKAL_PARAMETERS
from tests.support.ros import LONGEST, session, wait_for

pytestmark = pytest.mark.ros

NODES = {
    "sim_bridge": ("_simulator:=kinematic",),
    "move_base": ("odom:=odometry/filtered",),
    "applr": ("_method:=dwa",),
    "collision_monitor": ("scan:=front/scan", "odom:=odometry/filtered"),
    "movers": (),
}
# Topics with callbacks of the nodes, whose threads may run while the node ends.
SENT_TOPICS = {
    "/cmd_vel_in": Twist,
    "/cmd_vel": Twist,
    "/move_base/goal": MoveBaseActionGoal,
    "/move_base/cancel": GoalID,
    "/move_base_simple/goal": PoseStamped,
    "/move_base/local_costmap/footprint": Polygon,
    "/applr/heartbeat": Time,
}


@pytest.mark.parametrize(
    "times", [pytest.param(1, marks=pytest.mark.slow), pytest.param(20, marks=pytest.mark.long)]
)
def test_a_node_that_is_interrupted_while_messages_come_prints_no_traceback(times):
    ros = session()
    rospy.set_param("/use_sim_time", True)
    rospy.set_param("/move_base", JACKAL_PARAMETERS)
    publishers = []
    for topic, message_kind in SENT_TOPICS.items():
        publishers.append(rospy.Publisher(topic, message_kind, queue_size=10))
    nodes_are_up = threading.Event()
    test_is_over = threading.Event()

    def send():
        """Publish a message on each topic, a thousand times per second, while the nodes are up."""
        for publisher in itertools.cycle(publishers):
            nodes_are_up.wait()
            publisher.publish(publisher.data_class())
            if test_is_over.wait(1e-3 / len(publishers)):
                return

    sender = threading.Thread(target=send)
    sender.start()
    for _ in range(times):
        nodes = [ros.node(name, *arguments) for name, arguments in NODES.items()]
        # The first three say when they are ready; the others have subscribed or published.
        for node in nodes[:3]:
            node.until("ready")
        for publisher in publishers:
            wait_for(publisher.get_num_connections, publisher.name)
        wait_for(lambda: "/applr/tracked" in dict(rospy.get_published_topics()), "movers")
        # Messages come for a while before the interrupt, and go on until the nodes have ended.
        nodes_are_up.set()
        time.sleep(0.3)
        for node in nodes:
            os.kill(node.pid, signal.SIGINT)
        exit_statuses = [node.process.wait(LONGEST) for node in nodes]
        output = "".join(node.text for node in nodes)
        # Asserted below, when the thread has ended.
        if "Traceback" in output or any(exit_statuses):
            break
        nodes_are_up.clear()
    # The thread may wait for nodes.
    nodes_are_up.set()
    test_is_over.set()
    sender.join()
    for publisher in publishers:
        publisher.unregister()
    rospy.set_param("/use_sim_time", False)
    assert "Traceback" not in output, output
    assert exit_statuses == [0] * len(nodes), output
