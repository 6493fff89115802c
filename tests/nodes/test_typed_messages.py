"""Tests of this package's messages: publication by the applr node, and reading from a bag."""

import io
import math
import shutil
import xmlrpc.client

import numpy as np
import pytest
import rosbag
import rospy
from nav_msgs.msg import Odometry
from sensor_msgs.msg import LaserScan

from applr_ros1 import robots
from applr_ros1.nodes.applr import topics as applr_topics
from applr_ros1.nodes.applr.inputs import Snapshot
from applr_ros1.nodes.robot_parameters import with_robot
from applr_ros1.policy.decision import Context, Seen
from applr_ros1.policy.dimensionless import ENCODINGS, FAR_POINT, DimensionlessEncoding
from applr_ros1.policy.observation import FARTHEST_M, LAYOUT, layout_of
from applr_ros1.policy.parameter_space import SPACE, THETA_0
from applr_ros1.policy.supervisor import Ruling
from tests.support.bags import read

pytest_plugins = ("tests.support.offline_ros",)


def snapshot(number):
    """Return a Snapshot of random numbers, with a plan longer than any encoding needs."""
    rng = np.random.default_rng(number)
    # Stamps of scan, odometry, plan and moving obstacles, which differ by a nanosecond.
    stamps = [rospy.Time(100 + number, nanoseconds) for nanoseconds in (1, 2, 3, 4)]
    ranges = rng.uniform(0.2, 9.0, 720).astype(np.float32)
    first_angle, increment = rng.uniform([-2.4, 0.0065], [-2.35, 0.0066])
    robot_pose = tuple(rng.uniform(-2.0, 2.0, 3))
    twist = tuple(rng.uniform(-2.0, 2.0, 2))
    goal_pose = tuple(rng.uniform(-2.0, 2.0, 3))
    movers = rng.uniform(-2.0, 2.0, (number, 4))
    # 12 m long along x, and winding, as a plan between obstacles
    plan_dx = 0.03 * np.arange(400)
    plan = np.column_stack([robot_pose[0] + plan_dx, robot_pose[1] + np.sin(plan_dx)])
    inputs = Seen(
        scan=(ranges, first_angle, increment),
        time=0.1 * number,
        pose=robot_pose,
        twist=twist,
        goal=goal_pose,
        plan=plan,
        movers=movers,
    )
    return Snapshot(inputs, "odom", *stamps)


def decide(topics, number, theta, refused="", cleared=False):
    """Publish the decision of a number, theta None if it was refused."""
    stamp = rospy.Time(100 + number, 5)
    inputs = snapshot(number)
    context = Context.of(THETA_0, inputs.seen, SPACE, LAYOUT)
    ruling = Ruling(number, theta, refused, cleared, request=None)
    topics.decision(ruling, stamp, "goal 7", inputs, context)


def written(path, published):
    """Write messages {topic: list} into a bag with some scans and odometry, and return it as a
    drive.
    """
    with rosbag.Bag(str(path), "w") as bag:
        for second in (100, 101, 102, 103):
            stamp = rospy.Time(second, 1)
            scan = LaserScan(ranges=[1.0])
            odometry = Odometry()
            for topic, message in (("/front/scan", scan), ("/odometry/filtered", odometry)):
                message.header.stamp = stamp
                message.header.frame_id = "odom"
                bag.write(topic, message, stamp)
        for topic, messages in published.items():
            for index, message in enumerate(messages):
                bag.write("/" + topic, message, rospy.Time(104, index))
    return read(path)


def test_decisions_in_a_bag_are_read_as_they_were_made(offline_ros, tmp_path):
    topics = applr_topics.ApplrTopics()
    theta = SPACE.clip(np.linspace(0.4, 1.9, len(SPACE)))
    decide(topics, 1, theta)
    decide(topics, 2, None, "not finite", cleared=True)
    decisions = written(tmp_path / "a.bag", offline_ros.published).decisions
    decided_parameters = [SPACE.as_dict(theta), {}]
    assert [decision.cleared for decision in decisions] == [False, True]
    decisions_and_parameters = zip(decisions, decided_parameters, strict=True)
    for number, (decision, parameters) in enumerate(decisions_and_parameters, 1):
        assert decision.goal == "goal 7"
        # Since the first message, of 100 s and 1 ns
        assert decision.time == pytest.approx(number + 4e-9, abs=1e-10)
        assert decision.scan_time == pytest.approx(number, abs=1e-10)
        assert decision.before == SPACE.as_dict(THETA_0)
        assert decision.after == parameters

        read_inputs = decision.seen
        sent_inputs = snapshot(number).seen
        assert read_inputs.scan[1:] == sent_inputs.scan[1:]
        assert read_inputs.time == sent_inputs.time
        assert read_inputs.pose == sent_inputs.pose
        assert read_inputs.twist == sent_inputs.twist
        assert read_inputs.goal == sent_inputs.goal
        np.testing.assert_array_equal(read_inputs.scan[0], sent_inputs.scan[0])
        np.testing.assert_array_equal(read_inputs.movers, sent_inputs.movers)

        # A message has only the beginning of the plan, which is enough for each encoding.
        assert len(read_inputs.plan) < 200 < len(sent_inputs.plan)
        for make_encoding in ENCODINGS.values():
            encoding = make_encoding(robots.JACKAL, 1.0)
            read_context = Context.of(THETA_0, read_inputs, SPACE, encoding.layout)
            sent_context = Context.of(THETA_0, sent_inputs, SPACE, encoding.layout)
            np.testing.assert_array_equal(
                encoding.observe(read_context), encoding.observe(sent_context)
            )


def test_a_decision_is_small_and_names_its_inputs(offline_ros):
    decide(applr_topics.ApplrTopics(), 2, THETA_0)
    (message,) = offline_ros.published["applr/decision"]
    stamps = message.scan, message.odometry, message.plan, message.movers.header.stamp
    assert [stamp.to_nsec() % 10**9 for stamp in stamps] == [1, 2, 3, 4]
    # 7 kB in each decision; the scan alone takes 2880 bytes.
    buffer = io.BytesIO()
    message.serialize(buffer)
    assert len(buffer.getvalue()) < 7000


@pytest.mark.parametrize("name", robots.NAMES)
def test_no_encoding_needs_more_than_the_plan_of_a_decision(name):
    robot = robots.load(name)
    robot_width = DimensionlessEncoding(robot, 1.0).width
    longest_lookahead = max(layout_of(robot).lookahead, FAR_POINT * robot_width)
    # 30 % more, because the length is measured along the plan, which winds.
    assert 1.3 * longest_lookahead < FARTHEST_M * robot.world_scale


def test_empty_values_of_a_robots_files_do_not_reach_the_parameter_server(tmp_path):
    """XML-RPC cannot hold None, and move_base would end without a word of the file."""
    folder = tmp_path / "burger"
    shutil.copytree(robots.load("turtlebot3_burger").folder, folder)
    costmap_file = next(folder.rglob("costmap_common_params*.yaml"))
    costmap_file.write_text(costmap_file.read_text() + "\nfootprint_padding:\nempty_section:\n")
    tree, _ = with_robot({"robot": str(folder)})
    assert "empty_section" not in str(tree)
    xmlrpc.client.dumps((tree,))


def test_fields_of_the_parameters_are_named_for_plotting():
    theta = np.arange(float(len(SPACE)))
    message = applr_topics.parameters_message(theta, rospy.Time(3))
    assert message.names == list(SPACE.names)
    assert message.values == theta.tolist()
    assert message.multipliers == [1.0] * len(SPACE.names)
    # The fields have the names of move_base's parameters.
    assert message.max_vel_x == 0.0
    assert message.path_distance_bias == 5.0
    assert message.goal_distance_bias == 6.0
    assert message.inflation_radius == 7.0
    assert message.header.stamp == rospy.Time(3)
    # Before the first values are known
    empty_message = applr_topics.parameters_message(None, rospy.Time(3))
    assert empty_message.names == []
    assert math.isnan(empty_message.max_vel_x)
