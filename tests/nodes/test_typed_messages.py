"""Messages of this package: what the applr node publishes, and what a bag's reader makes of it."""

import math
from types import SimpleNamespace

import numpy as np
import pytest
import rosbag
import rospy
from nav_msgs.msg import Odometry
from sensor_msgs.msg import LaserScan

from applr_ros1.nodes.applr import topics as applr_topics
from applr_ros1.nodes.applr.inputs import Snapshot
from applr_ros1.policy.parameter_space import SPACE, THETA_0
from training.bags.bag import read


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
    *stamps, movers = (rospy.Time(100 + number, nanoseconds) for nanoseconds in (1, 2, 3, 4))
    ranges = np.full(720, 2.0, np.float32)
    seen = Snapshot(ranges, (1.0, 2.0, 0.5), np.zeros((2, 2)), "odom", *stamps, movers_stamp=movers)
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


def test_decisions_in_a_bag_are_read_as_they_were_made(published, tmp_path):
    topics = applr_topics.ApplrTopics()
    theta = SPACE.clip(np.linspace(0.4, 1.9, len(SPACE)))
    decide(topics, 1, theta)
    decide(topics, 2, None, "not finite")
    assert [m.movers.to_nsec() % 10**9 for topic, m in published if topic == "applr/decision"] == [4, 4]
    bag = written(tmp_path / "a.bag", published)
    decisions = [d._asdict() for d in bag.decisions]
    observations = [(decision.pop("at"), decision.pop("observation"))[1] for decision in decisions]
    assert decisions == [
        {
            "number": number,
            "goal": "goal 7",
            "stamp": (100 + number) * 10**9 + 5,
            "scan": (100 + number) * 10**9 + 1,
            "odometry": (100 + number) * 10**9 + 2,
            "before": SPACE.as_dict(THETA_0),
            "after": chosen,
        }
        for number, chosen in ((1, SPACE.as_dict(theta)), (2, {}))
    ]
    for number, observation in enumerate(observations, 1):
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
