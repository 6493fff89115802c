"""Messages of this package: a bag with typed decisions reads the same as one with the JSON topics of older bags."""

import math
import xml.etree.ElementTree as xml
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import rosbag
import rospy
from nav_msgs.msg import Odometry
from sensor_msgs.msg import LaserScan

from applr_ros1.nodes import applr_topics
from applr_ros1.nodes.applr_inputs import Snapshot
from applr_ros1.policy.parameter_space import SPACE, THETA_0
from training.bags.reader import read


@pytest.fixture
def published(monkeypatch):
    """What a ApplrTopics publishes, as (topic, message)."""
    messages = []

    def publisher(topic, kind, **_):
        return SimpleNamespace(publish=lambda message: messages.append((topic, as_message(kind, message))))

    def as_message(kind, message):
        return message if isinstance(message, kind) else kind(message)

    monkeypatch.setattr(rospy, "Publisher", publisher)
    monkeypatch.setattr(rospy, "get_namespace", lambda: "/")
    return messages


def decide(topics, number, theta, refused=""):
    now = rospy.Time(100 + number, 5)
    stamps = [rospy.Time(100 + number, nanoseconds) for nanoseconds in (1, 2, 3)]
    ranges = np.full(720, 2.0, np.float32)
    seen = Snapshot(ranges, (1.0, 2.0, 0.5), np.zeros((2, 2)), "odom", *stamps)
    observation = np.linspace(0.0, 1.0, 729, dtype=np.float32) + np.float32(number)
    topics.decision(number, now, "goal 7", seen, (1.5, -0.25), observation, THETA_0, theta, refused)
    return now


def written(path, messages):
    with rosbag.Bag(str(path), "w") as bag:
        for second in (100, 101, 102, 103):
            for topic, message in (("/front/scan", LaserScan(ranges=[1.0])), ("/odometry/filtered", Odometry())):
                message.header.stamp, message.header.frame_id = rospy.Time(second, 1), "odom"
                bag.write(topic, message, rospy.Time(second, 1))
        for i, (topic, message) in enumerate(messages):
            bag.write("/" + topic, message, rospy.Time(104, i))
    return read(path)


def test_typed_and_json_decisions_read_the_same(published, tmp_path):
    topics = applr_topics.ApplrTopics()
    theta = SPACE.clip(np.linspace(0.4, 1.9, 8))
    decide(topics, 1, theta)
    decide(topics, 2, None, "not finite")
    old = [(topic, message) for topic, message in published if "/typed/" not in topic]
    typed = [(topic, message) for topic, message in published if "/typed/" in topic]
    assert old
    assert typed
    recordings = [
        written(tmp_path / (name + ".bag"), messages)
        for name, messages in (("old", old), ("typed", typed), ("both", published))
    ]
    for recording in recordings:
        decisions = [{key: value for key, value in d.items() if key != "at"} for d in recording.decisions]
        assert decisions == [
            {
                "number": number,
                "goal": "goal 7",
                "stamp": (100 + number) * 10**9 + 5,
                "scan": (100 + number) * 10**9 + 1,
                "odometry": (100 + number) * 10**9 + 2,
                "plan": (100 + number) * 10**9 + 3,
                "theta_prev": SPACE.as_dict(THETA_0),
                "theta": chosen,
            }
            for number, chosen in ((1, SPACE.as_dict(theta)), (2, None))
        ]
        for number in (1, 2):
            ((_, observation),) = recording.observations[number]
            assert observation.dtype == np.float32
            assert np.array_equal(observation, np.linspace(0, 1, 729, dtype=np.float32) + np.float32(number))


def test_fields_of_the_parameters_are_named_for_plotting():
    message = applr_topics.parameters_message(np.arange(8.0), rospy.Time(3))
    assert message.names == list(SPACE.names)
    assert message.values == list(range(8))
    assert (message.max_vel_x, message.path_distance_bias, message.goal_distance_bias) == (0.0, 5.0, 6.0)
    assert message.inflation_radius == 7.0
    assert message.header.stamp == rospy.Time(3)
    empty = applr_topics.parameters_message(None, rospy.Time(3))
    assert empty.names == []
    assert math.isnan(empty.max_vel_x)


def test_packages_that_build_upon_the_messages_get_what_these_need():
    package = xml.parse(Path(__file__).resolve().parents[1] / "package.xml").getroot()
    exported = {node.text for node in package if node.tag in ("depend", "build_export_depend")}
    assert {"std_msgs", "message_runtime"} <= exported
