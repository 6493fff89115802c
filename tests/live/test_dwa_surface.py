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
DEFAULT_PLANNER = "/move_base/TrajectoryPlannerROS"


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
    published_kinds = {}  # {topic of move_base: its type}
    for topic, message_kind, nodes in published:
        if "/move_base" in nodes:
            published_kinds[topic] = message_kind
    planner_kinds = {}
    for topic, message_kind in published_kinds.items():
        if topic.startswith(SERVER):
            planner_kinds[topic] = message_kind
    assert planner_kinds == SURFACE["publishes"]
    # The planner's parameter odom_topic renames its subscription.
    subscribers = {topic: nodes for topic, message_kind, nodes in subscribed}
    assert "/move_base" in subscribers["/wheels/odom"]
    for service_name, service_kind in SURFACE["services"].items():
        assert rosservice.get_service_type(service_name) == service_kind

    # The planner that move_base has by default is not there.
    services = rosservice.get_service_list(node="/move_base")
    assert not any(name.startswith(DEFAULT_PLANNER) for name in [*published_kinds, *services])


@pytest.mark.slow
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
        settings = space.settings(theta)["DWAPlannerROS"].items()
        return any(settings <= served_values.items() for served_values in in_force)

    applr = master.node("applr", "_robot:=husky", "_method:=static", "_period:=0.4")
    applr.until("ready")
    wait_for(
        lambda: connected(master, "/move_base/NavfnROS/plan", "/applr"),
        "the connection, because the plan is published once",
    )
    global_plans = collect(SERVER + "/global_plan", PathMessage).messages
    local_plans = collect(SERVER + "/local_plan", PathMessage).messages
    cost_clouds = collect(SERVER + "/cost_cloud", PointCloud2).messages
    trajectory_clouds = collect(SERVER + "/trajectory_cloud", PointCloud2).messages
    client = actionlib.SimpleActionClient("move_base", MoveBaseAction)
    assert client.wait_for_server(rospy.Duration(ros.LONGEST))
    client.send_goal(goal(1.0))
    assert finish(client).text == "Goal reached.", node.text
    assert len(decisions) >= 2, applr.text
    for theta in decisions[:-1]:  # The latest decision may not be in force yet.
        assert has(space.from_dict(theta)), applr.text
    assert applr.end() == 0
    # Servers may be slow on a busy machine.
    for warning in lines_with(applr.text, "WARN"):
        assert "does not answer" in warning, applr.text

    wait_for(lambda: global_plans and local_plans, "plans")
    wait_for(lambda: cost_clouds and trajectory_clouds, "clouds")
    trajectory_cloud = trajectory_clouds[0]
    assert [field.name for field in trajectory_cloud.fields] == ["x", "y", "z", "theta", "cost"]
    assert trajectory_cloud.header.frame_id == "odom"
    assert trajectory_cloud.width > 20
    # Seven floats: x, y, z and four costs, as C++'s MapGridCostPoint
    assert cost_clouds[0].point_step == 28
