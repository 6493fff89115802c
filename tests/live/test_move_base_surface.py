"""Names and types of the move_base node, which equal those of the C++ node, and its eight parameter
servers.
"""

import json
import math
import time

import pytest
import rospy
import rosservice
from dynamic_reconfigure import DynamicReconfigureCallbackException
from dynamic_reconfigure.client import Client

from tests.support import DATA
from tests.support.nodes import node_api
from tests.support.ros import LONGEST, wait_for

pytestmark = pytest.mark.ros
pytest_plugins = ("tests.support.nodes",)
SURFACE = json.loads((DATA / "move_base_surface.json").read_text())
OWN_TOPICS = (  # topics that the C++ node does not have
    "/rosout",
    "/applr/heartbeat",
    "/collision_monitor/held_back",
    "/diagnostics",
    "/move_base/TrajectoryPlannerROS/trajectory_cloud",
)


# -- surface ---------------------------------------------------------------------------------------
@pytest.mark.parametrize(
    ("what", "call"), [("publishes", "getPublications"), ("subscribes", "getSubscriptions")]
)
def test_topics_are_those_of_the_cpp_node(stack, master, what, call):
    topics = dict(getattr(node_api(master), call)("/test")[2])
    for topic in OWN_TOPICS:
        topics.pop(topic, None)
    assert topics == SURFACE[what]


def test_services_are_those_of_the_cpp_node(stack):
    service_types = {}
    for service_name in rosservice.get_service_list(node="/move_base"):
        # rospy and roscpp have different services of logging.
        if "logger" not in service_name:
            service_types[service_name] = rosservice.get_service_type(service_name)
    assert service_types == SURFACE["services"]


def test_parameters_are_on_the_server(stack):
    for server, parameters in SURFACE["dynamic_reconfigure"].items():
        for parameter in parameters:
            full_name = server + "/" + parameter["name"]

            def is_served(full_name=full_name, jackal_value=parameter["jackal"]):
                return rospy.get_param(full_name, None) == jackal_value

            wait_for(is_served, full_name)


# -- dynamic_reconfigure ---------------------------------------------------------------------------
@pytest.mark.parametrize(
    ("server", "name", "value", "beyond", "bound", "others"),
    [
        ("/move_base", "planner_patience", 7.5, 1e9, 100.0, {"shutdown_costmaps": True}),
        (
            "/move_base/local_costmap/obstacles_layer",
            "max_obstacle_height",
            1.0,
            -1.0,
            0.0,
            {"combination_method": 0},
        ),
    ],
)
def test_a_server_is_read_set_clamped_and_refuses_nan(
    idle, server, name, value, beyond, bound, others
):
    client = Client(server, timeout=LONGEST)
    values_before = client.get_configuration(timeout=LONGEST)
    try:
        assert client.update_configuration({name: value})[name] == value
        wait_for(lambda: client.get_configuration()[name] == value, "update")
        wait_for(lambda: rospy.get_param(server + "/" + name) == value, "mirror")
        assert client.update_configuration({name: beyond})[name] == bound
        # The client keeps what the topic of updates says, which may come after the answer.
        wait_for(lambda: client.get_configuration()[name] == bound, "the bound")
        earlier_output = len(idle.node.text)
        with pytest.raises(DynamicReconfigureCallbackException):
            client.update_configuration(dict(others, **{name: math.nan}))
        assert "refused a change: %s is nan" % name in idle.node.text[earlier_output:]
        time.sleep(0.05)
        # Of a refused request nothing is applied, neither the other parameter that it had.
        values_after = client.get_configuration()
        assert values_after[name] == bound
        for other_name in others:
            assert values_after[other_name] == values_before[other_name]
    finally:
        client.update_configuration({name: values_before[name]})
        client.close()
