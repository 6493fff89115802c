"""Tests of this package's messages: publication by the applr node, and reading from a bag."""

import io
import math
from types import SimpleNamespace

import numpy as np
import pytest
import rosbag
import rospy
from nav_msgs.msg import Odometry
from sensor_msgs.msg import LaserScan

from applr_ros1 import robots
from applr_ros1.nodes.applr import topics as applr_topics
from applr_ros1.nodes.applr.inputs import Snapshot
from applr_ros1.policy.decision import Context, Seen
from applr_ros1.policy.dimensionless import ENCODINGS, FAR_POINT, DimensionlessEncoding
from applr_ros1.policy.observation import FARTHEST_M, LAYOUT, layout_of
from applr_ros1.policy.parameter_space import SPACE, THETA_0
from training.bags.read import read


@pytest.fixture
def published(monkeypatch):
    """Provide the list of published messages, as (topic, message)."""
    messages = []

    def publisher(topic, kind, **_):
        return SimpleNamespace(
            publish=lambda message: messages.append((topic, as_message(kind, message)))
        )

    def as_message(kind, message):
        return message if isinstance(message, kind) else kind(message)

    monkeypatch.setattr(rospy, "Publisher", publisher)
    monkeypatch.setattr(rospy, "get_namespace", lambda: "/")
    return messages


def snapshot(number):
    """Return a Snapshot of random numbers, with a plan longer than any encoding needs."""
    rng = np.random.default_rng(number)
    stamps = (rospy.Time(100 + number, nanoseconds) for nanoseconds in (1, 2, 3, 4))
    scan = (
        rng.uniform(0.2, 9.0, 720).astype(np.float32),
        *rng.uniform([-2.4, 0.0065], [-2.35, 0.0066]),
    )
    pose, twist, goal, moving = (tuple(rng.uniform(-2.0, 2.0, n)) for n in (3, 2, 3, (number, 4)))
    along = 0.03 * np.arange(400)
    plan = np.column_stack([pose[0] + along, pose[1] + np.sin(along)])
    seen = Seen(scan, 0.1 * number, pose, twist, goal, plan, np.reshape(moving, (-1, 4)))
    return Snapshot(seen, "odom", *stamps)


def decide(topics, number, theta, refused=""):
    now = rospy.Time(100 + number, 5)
    inputs = snapshot(number)
    context = Context.of(THETA_0, inputs.seen, SPACE, LAYOUT)
    topics.decision(number, now, "goal 7", inputs, context, theta, refused)
    return now


def written(path, messages):
    with rosbag.Bag(str(path), "w") as bag:
        for second in (100, 101, 102, 103):
            for topic, message in (
                ("/front/scan", LaserScan(ranges=[1.0])),
                ("/odometry/filtered", Odometry()),
            ):
                message.header.stamp = rospy.Time(second, 1)
                message.header.frame_id = "odom"
                bag.write(topic, message, rospy.Time(second, 1))
        for index, (topic, message) in enumerate(messages):
            bag.write("/" + topic, message, rospy.Time(104, index))
    return read(path)


def test_decisions_in_a_bag_are_read_as_they_were_made(published, tmp_path):
    topics = applr_topics.ApplrTopics()
    theta = SPACE.clip(np.linspace(0.4, 1.9, len(SPACE)))
    decide(topics, 1, theta)
    decide(topics, 2, None, "not finite")
    bag = written(tmp_path / "a.bag", published)
    decisions = [d._asdict() for d in bag.decisions]
    observed = [decision.pop("seen") for decision in decisions]
    assert decisions == [
        {
            "goal": "goal 7",
            "time": pytest.approx(
                number + 4e-9, abs=1e-10
            ),  # since the first message, of 100 s and 1 ns
            "scan_time": pytest.approx(number, abs=1e-10),
            "before": SPACE.as_dict(THETA_0),
            "after": chosen,
        }
        for number, chosen in ((1, SPACE.as_dict(theta)), (2, {}))
    ]
    for number, seen in enumerate(observed, 1):
        sent = snapshot(number).seen
        assert seen.scan[1:] == sent.scan[1:]
        assert (seen.time, seen.pose, seen.twist, seen.goal) == (
            sent.time,
            sent.pose,
            sent.twist,
            sent.goal,
        )
        np.testing.assert_array_equal(seen.scan[0], sent.scan[0])
        np.testing.assert_array_equal(seen.movers, sent.movers)
        assert len(seen.plan) < 200 < len(sent.plan)
        for kind in ENCODINGS.values():
            encoding = kind(robots.JACKAL, 1.0)
            encoded = [
                encoding.observe(Context.of(THETA_0, each, SPACE, encoding.layout))
                for each in (seen, sent)
            ]
            np.testing.assert_array_equal(*encoded)


def test_a_decision_is_small_and_names_its_inputs(published):
    decide(applr_topics.ApplrTopics(), 2, THETA_0)
    ((_, message),) = [one for one in published if one[0] == "applr/decision"]
    stamps = message.scan, message.odometry, message.plan, message.movers.header.stamp
    assert [stamp.to_nsec() % 10**9 for stamp in stamps] == [1, 2, 3, 4]
    packed = io.BytesIO()
    message.serialize(packed)
    assert len(packed.getvalue()) < 7000  # size in bytes, including 2880 of the scan


@pytest.mark.parametrize("name", robots.NAMES)
def test_no_encoding_needs_more_than_the_plan_of_a_decision(name):
    robot = robots.load(name)
    width = DimensionlessEncoding(robot, 1.0).width
    farthest = max(layout_of(robot).lookahead, FAR_POINT * width)
    assert 1.3 * farthest < FARTHEST_M * robot.world_scale


def test_fields_of_the_parameters_are_named_for_plotting():
    message = applr_topics.parameters_message(np.arange(8.0), rospy.Time(3))
    assert message.names == list(SPACE.names)
    assert message.values == list(range(8))
    assert (message.max_vel_x, message.path_distance_bias, message.goal_distance_bias) == (
        0.0,
        5.0,
        6.0,
    )
    assert message.inflation_radius == 7.0
    assert message.header.stamp == rospy.Time(3)
    empty = applr_topics.parameters_message(None, rospy.Time(3))
    assert empty.names == []
    assert math.isnan(empty.max_vel_x)
