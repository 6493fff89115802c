"""Tests that the move_base node with DWAPlannerROS has the names, types, parameters and displays of
the C++ node.
"""

import copy
import json

import actionlib
import pytest
import rospy
import rosservice
import rostopic
from applr_ros1.msg import Decision
from dynamic_reconfigure.encoding import decode_config
from dynamic_reconfigure.msg import Config
from move_base_msgs.msg import MoveBaseAction
from nav_msgs.msg import Path as PathMessage
from sensor_msgs.msg import PointCloud2

from applr_ros1.policy.parameter_space import space_of
from applr_ros1.robots import load
from tests.support import DATA, lines_with, ros
from tests.support.nodes import POSTS, FakeJackal, collect, connected, decided, finish, goal, start
from tests.support.robots import dwa_parameters
from tests.support.ros import wait_for

pytestmark = pytest.mark.ros
SURFACE = json.loads((DATA / "dwa_surface.json").read_text())
SERVER = "/move_base/DWAPlannerROS"
OTHER = "/move_base/TrajectoryPlannerROS"


@pytest.fixture(scope="module")
def node():
    """Start a move_base with DWAPlannerROS for all tests of this file."""
    master = ros.session()
    parameters = copy.deepcopy(dwa_parameters())
    parameters["DWAPlannerROS"].update(
        publish_cost_grid_pc=True, publish_traj_pc=True, vy_samples=0, odom_topic="wheels/odom"
    )
    jackal = FakeJackal(POSTS)
    child = start(master, parameters)
    yield child
    jackal.close()
    assert child.end() == 0, child.text


def test_topics_and_services_are_those_of_the_cpp_node(node):
    published, subscribed = rostopic.get_topic_list()
    ours = {name: kind for name, kind, nodes in published if "/move_base" in nodes}
    of_planner = {name: kind for name, kind in ours.items() if name.startswith(SERVER)}
    assert of_planner == SURFACE["publishes"]
    # The planner's parameter odom_topic renames its subscription.
    of_odometry = [nodes for name, _, nodes in subscribed if name == "/wheels/odom"]
    assert any("/move_base" in nodes for nodes in of_odometry)
    for name, kind in SURFACE["services"].items():
        assert rosservice.get_service_type(name) == kind

    # The planner that move_base has by default is not there.
    services = rosservice.get_service_list(node="/move_base")
    assert not any(name.startswith(OTHER) for name in [*ours, *services])


def test_drives_to_a_goal_with_the_applr_nodes_parameters_and_shows_plans_and_clouds(node):
    """The Husky's static parameter set is applied, although the costmap layers have other names
    than on the Husky.
    """
    master = ros.session()
    space = space_of(load("husky"))
    decisions = []
    in_force = []

    def on_decision(message):
        decisions.append(decided(message)["theta"])

    def on_update(message):
        in_force.append(decode_config(message))

    rospy.Subscriber("/applr/decision", Decision, on_decision)
    rospy.Subscriber(SERVER + "/parameter_updates", Config, on_update)

    def has(theta):
        """Return whether the parameter set theta was in force at any time."""
        wanted = space.settings(theta)["DWAPlannerROS"].items()
        return any(wanted <= values.items() for values in in_force)

    applr = master.node("applr", "_robot:=husky", "_method:=static", "_period:=0.4")
    applr.until("ready")
    wait_for(
        lambda: connected(master, "/move_base/NavfnROS/plan", "/applr"),
        "the connection, because the plan is published once",
    )
    _, global_plans = collect(SERVER + "/global_plan", PathMessage)
    _, local_plans = collect(SERVER + "/local_plan", PathMessage)
    _, cost_clouds = collect(SERVER + "/cost_cloud", PointCloud2)
    _, trajectory_clouds = collect(SERVER + "/trajectory_cloud", PointCloud2)
    client = actionlib.SimpleActionClient("move_base", MoveBaseAction)
    assert client.wait_for_server(rospy.Duration(ros.LONGEST))
    client.send_goal(goal(1.0))
    assert finish(client)[1] == "Goal reached.", node.text
    assert len(decisions) >= 2, applr.text
    for theta in decisions[:-1]:  # The latest decision may not be in force yet.
        assert has(space.from_dict(theta)), applr.text
    assert applr.end() == 0
    # Servers may be slow on a busy machine.
    for line in lines_with(applr.text, "WARN"):
        assert "does not answer" in line, applr.text

    wait_for(lambda: global_plans and local_plans, "plans")
    wait_for(lambda: cost_clouds and trajectory_clouds, "clouds")
    cloud = trajectory_clouds[0]
    assert [field.name for field in cloud.fields] == ["x", "y", "z", "theta", "cost"]
    assert cloud.header.frame_id == "odom"
    assert cloud.width > 20
    # Seven floats: x, y, z and four costs, as C++'s MapGridCostPoint
    assert cost_clouds[0].point_step == 28
