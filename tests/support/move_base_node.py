"""A move_base node without a ROS master, for tests of its cycles."""

from collections import defaultdict
from types import SimpleNamespace
from unittest.mock import MagicMock

import rospy

from applr_ros1.nodes.move_base import node as node_module
from applr_ros1.nodes.robot_parameters import with_robot
from applr_ros1.planner.state_machine import Cycle

# What the node makes of ROS beside its publishers
CONNECTED = (
    "BaseCommands",
    "CostmapDisplay",
    "GoalServer",
    "PlanDisplay",
    "ReconfigureServer",
    "Sensors",
)


def lone_node(monkeypatch, **parameters):
    """Return a node with private parameters, and its messages by topic.

    Sensors, goals and planner are stand-ins: nothing is measured, no goal comes, and a cycle of the
    planner does nothing.
    """
    messages = defaultdict(list)

    def publisher(topic, *_, **__):
        return SimpleNamespace(publish=messages[topic].append)

    monkeypatch.setattr(rospy, "Publisher", publisher)
    for name in ("set_param", "logerr_throttle"):
        monkeypatch.setattr(rospy, name, MagicMock())
    for name in CONNECTED:
        monkeypatch.setattr(node_module, name, MagicMock())
    tree, robot = with_robot(parameters)
    node = node_module.MoveBaseNode(tree, robot)
    node.sensors = MagicMock(pose_trouble="", odometry_problem="", twist=(0.0, 0.0))
    node.sensors.pose.return_value = None
    node.sensors.place_of.return_value = None
    node.sensors.frame.return_value = (0.0, 0.0, 0.0)
    node.sensors.ages.return_value = {}
    node.goals.is_new_goal_available.return_value = False
    node.goals.is_preempt_requested.return_value = False
    node.move_base = MagicMock(missing_map="", goal=None, frequency=20.0)
    node.move_base.step.return_value = Cycle()
    node.move_base.in_global_frame.side_effect = lambda pose: pose
    return node, messages
