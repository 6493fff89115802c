"""Tests that the move_base node with DWAPlannerROS has the names, types, parameters and displays of
the C++ node.
"""

import copy
import json

import pytest
import rosservice
import rostopic

from tests.support import DATA, ros
from tests.support.nodes import POSTS, FakeJackal, start
from tests.support.robots import dwa_parameters

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
