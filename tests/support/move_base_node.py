"""A move_base node without a ROS master, for tests of its cycles."""

from unittest.mock import create_autospec

from applr_ros1.nodes.move_base import node as node_module
from applr_ros1.nodes.robot_parameters import with_robot
from applr_ros1.nodes.sensors import Sensors
from applr_ros1.planner.costmap.costmap import Costmap
from applr_ros1.planner.local_planner import LocalPlanner
from applr_ros1.planner.move_base import MoveBase
from applr_ros1.planner.state_machine import Cycle
from tests.support.offline_ros import OfflineRos

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
    """Return a node with private parameters, and the OfflineRos around it.

    Sensors, goals and planner are stand-ins: nothing is measured, no goal comes, and a cycle of the
    planner does nothing.
    """
    ros = OfflineRos(monkeypatch)
    for name in CONNECTED:
        monkeypatch.setattr(node_module, name, create_autospec(getattr(node_module, name)))
    tree, robot = with_robot(parameters)
    node = node_module.MoveBaseNode(tree, robot)
    node.sensors = create_autospec(Sensors, instance=True)
    node.sensors.base = "base_link"
    node.sensors.pose_trouble = ""
    node.sensors.odometry_problem = ""
    node.sensors.twist = (0.0, 0.0)
    node.sensors.pose.return_value = None
    node.sensors.place_of.return_value = None
    node.sensors.frame.return_value = (0.0, 0.0, 0.0)
    node.sensors.ages.return_value = {}
    node.goals.is_new_goal_available.return_value = False
    node.goals.is_preempt_requested.return_value = False
    node.move_base = create_autospec(MoveBase, instance=True)
    node.move_base.local_planner = create_autospec(LocalPlanner, instance=True)
    node.move_base.local_costmap = create_autospec(Costmap, instance=True)
    node.move_base.missing_map = ""
    node.move_base.goal = None
    node.move_base.frequency = 20.0
    node.move_base.step.return_value = Cycle()
    node.move_base.in_global_frame.side_effect = lambda pose: pose
    return node, ros
