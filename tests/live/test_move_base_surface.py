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

from applr_ros1.nodes.move_base import heartbeat_watchdog
from applr_ros1.planner.move_base import MoveBase
from applr_ros1.policy.parameter_space import SPACE
from tests.support import DATA
from tests.support.nodes import PLANNER, node_api
from tests.support.robots import JACKAL_PARAMETERS
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
    ours = [
        (topic, kind)
        for topic, kind in getattr(node_api(master), call)("/test")[2]
        if topic not in OWN_TOPICS
    ]
    assert sorted(ours) == sorted(SURFACE[what].items())


def test_services_are_those_of_the_cpp_node(stack):
    ours = {
        name: rosservice.get_service_type(name)
        for name in rosservice.get_service_list(node="/move_base")
    }
    assert {name: kind for name, kind in ours.items() if "logger" not in name} == SURFACE[
        "services"
    ]


def test_a_server_describes_the_cpp_parameters(stack):
    """The tables of the other servers are compared in tests/planner/parameters."""
    server = PLANNER
    client = Client(server, timeout=LONGEST)
    got = {p["name"]: p for p in client.get_parameter_descriptions(timeout=LONGEST)}
    values = client.get_configuration(timeout=LONGEST)
    client.close()
    for p in SURFACE["dynamic_reconfigure"][server]:
        mine = got.pop(p["name"])
        low, high = (float(v) if v in ("inf", "-inf") else v for v in (p["min"], p["max"]))
        assert (mine["type"], mine["min"], mine["max"], mine["default"]) == (
            p["type"],
            low,
            high,
            p["default"],
        )
        assert values[p["name"]] == p["jackal"]
    assert set(got) <= {"pdist_scale", "gdist_scale"}


def test_parameters_are_on_the_server(stack):
    for server, parameters in SURFACE["dynamic_reconfigure"].items():
        for name, value in ((server + "/" + p["name"], p["jackal"]) for p in parameters):
            wait_for(lambda name=name, value=value: rospy.get_param(name, None) == value, name)


# -- dynamic_reconfigure ---------------------------------------------------------------------------
@pytest.mark.parametrize(
    ("server", "name", "value", "beyond", "bound", "other"),
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
    idle, server, name, value, beyond, bound, other
):
    client = Client(server, timeout=LONGEST)
    before = client.get_configuration(timeout=LONGEST)
    try:
        assert client.update_configuration({name: value})[name] == value
        wait_for(lambda: client.get_configuration()[name] == value, "update")
        wait_for(lambda: rospy.get_param(server + "/" + name) == value, "mirror")
        assert client.update_configuration({name: beyond})[name] == bound
        printed = len(idle.node.text)
        with pytest.raises(DynamicReconfigureCallbackException):
            client.update_configuration(dict(other, **{name: math.nan}))
        assert "refused a change: %s is nan" % name in idle.node.text[printed:]
        time.sleep(0.05)
        now = client.get_configuration()
        assert (now[name], [now[n] for n in other]) == (bound, [before[n] for n in other])
    finally:
        client.update_configuration({name: before[name]})
        client.close()


def test_a_lost_heartbeat_is_reported_once():
    """Test of the watchdog class alone. tests/faults/test_processes.py tests the watchdog in a
    running stack.
    """
    watch = heartbeat_watchdog.HeartbeatWatchdog(2.0)
    assert not watch.is_lost(100.0)  # There was no heartbeat yet.
    watch.heartbeat(100.0)
    assert not watch.is_lost(105.0)
    assert watch.is_lost(105.05)
    assert not watch.is_lost(200.0)
    watch.heartbeat(300.0)
    assert not watch.is_lost(10.0)
    assert watch.is_lost(15.1)
    jackal = MoveBase(JACKAL_PARAMETERS)
    capped = heartbeat_watchdog.start_up_requests(jackal, SPACE, max_speed=0.3)
    assert capped["TrajectoryPlannerROS"]["max_vel_x"] == 0.3
    assert heartbeat_watchdog.start_up_requests(jackal, SPACE) == SPACE.settings(SPACE.theta0)
