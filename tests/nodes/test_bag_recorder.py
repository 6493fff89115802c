"""Test of the condition for which a drive waits that is recorded."""

import time
from types import SimpleNamespace

import pytest
import rosgraph
import rospy

from applr_ros1.nodes.tools import bag_recorder
from applr_ros1.nodes.tools.bag_recorder import BagRecorder

pytest_plugins = ("tests.support.offline_ros",)
PLAN = "/robot1/move_base/NavfnROS/plan"
COSTMAP = "/robot1/move_base/local_costmap/costmap"
GOAL = "/robot1/move_base/goal"


class Master:
    """Master of two nodes, both of which publish goals."""

    def getSystemState(self):  # noqa: N802  # rosgraph's name
        """Return publishers, subscribers and services."""
        publications = [
            [PLAN, ["/robot1/move_base"]],
            [COSTMAP, ["/robot1/move_base"]],
            [GOAL, ["/robot1/move_base", "/robot1/send_goal"]],
        ]
        return publications, [], []

    def lookupNode(self, name):  # noqa: N802  # rosgraph's name
        """Return the name as address."""
        return name


@pytest.fixture
def scene(offline_ros, monkeypatch):
    """Provide the connections (node, subscriber, topic), the warnings and the BagRecorder."""
    scene = SimpleNamespace(connections=[], lines=offline_ros.log["warn"], is_dead=False)

    def slave(node, _):
        def bus_info(_):
            if scene.is_dead:
                raise ConnectionRefusedError
            rows = []
            for publisher, subscriber, topic in scene.connections:
                if publisher == node:
                    rows.append([0, subscriber, "o", "TCPROS", topic, True])
            return 1, "", rows

        return SimpleNamespace(getBusInfo=bus_info)

    monkeypatch.setattr(rospy, "get_name", lambda: "/robot1/send_goal")
    # In the demo, whose argument record:=drive.bag rospy takes for a remapping
    monkeypatch.setattr(rospy, "resolve_name", lambda _: "/robot1/drive.bag")
    offline_ros.parameters["record/unrecorded"] = ".*/costmap(_updates)?|/clock"
    monkeypatch.setattr(rosgraph, "Master", lambda _: Master())
    monkeypatch.setattr(bag_recorder, "ServerProxy", slave)
    scene.recorder = BagRecorder("record")
    return scene


def test_a_recorder_is_ready_when_all_publishers_are_connected_but_those_of_large_topics(scene):
    scene.connections.append(("/robot1/move_base", "/robot1/record", GOAL))
    scene.connections.append(("/robot1/send_goal", "/robot1/record", GOAL))
    scene.connections.append(("/robot1/move_base", "/rviz", PLAN))
    assert not scene.recorder.is_ready(), "only RViz gets the plan"
    scene.connections.append(("/robot1/move_base", "/robot1/record", PLAN))
    assert scene.recorder.is_ready()
    scene.connections.remove(("/robot1/send_goal", "/robot1/record", GOAL))
    assert not scene.recorder.is_ready(), "the goal comes from the other publisher"
    assert scene.lines == []


def test_a_drive_begins_in_the_end_without_a_recorder(scene, monkeypatch):
    scene.is_dead = True
    assert not scene.recorder.is_ready()
    after_patience = time.monotonic() + bag_recorder.PATIENCE_S
    monkeypatch.setattr(bag_recorder.time, "monotonic", lambda: after_patience)
    assert scene.recorder.is_ready()
    assert scene.lines == [f"/robot1/record does not record {PLAN}, {GOAL} yet"]
