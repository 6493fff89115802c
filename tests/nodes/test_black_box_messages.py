"""Tests of what the black box makes of ROS's messages, and publishes."""

import io

import pytest
from nav_msgs.msg import Odometry
from std_msgs.msg import Bool

from applr_ros1.common.errors import ApplrError
from applr_ros1.nodes.black_box.messages import deserialize
from applr_ros1.nodes.black_box.node import marker_of, names_of, stop_message
from applr_ros1.robots import JACKAL
from applr_ros1.why.black_box.answering import StopAnswer
from applr_ros1.why.black_box.bag_file import Publication

ANSWER = StopAnswer(
    kind="stood",
    begin=1_700_000_000.5,
    end=1_700_000_006.5,
    x=1.5,
    y=-2.0,
    frame="odom",
    reason="there was no scan for 6.0 s",
    parameter="DWAPlannerROS/sim_time",
    before=4.0,
    after=2.0,
    reproduced=0.97,
)


def bytes_of(message):
    """Return a message as ROS sends it."""
    buffer = io.BytesIO()
    message.serialize(buffer)
    return buffer.getvalue()


def test_messages_are_read_by_the_definitions_that_are_installed():
    odometry = Odometry(child_frame_id="base_link")
    publication = Publication("/odom", Odometry._type, Odometry._md5sum)
    assert deserialize(publication, bytes_of(odometry)).child_frame_id == "base_link"
    # The definition that a publisher sends is not compiled.
    other_definition = publication._replace(md5sum="0" * 32, definition="import os")
    with pytest.raises(ApplrError, match="/odom: nav_msgs/Odometry has another definition"):
        deserialize(other_definition, bytes_of(odometry))
    unknown = Publication("/x", "nobody_msgs/Nothing", "0" * 32, "bool data")
    with pytest.raises(ApplrError, match="/x: nobody_msgs/Nothing is not installed"):
        deserialize(unknown, bytes_of(Bool(True)))


def test_an_answer_is_a_message_and_a_text_in_rviz():
    message = stop_message(ANSWER.values())
    assert message.header.stamp.to_sec() == 1_700_000_000.5
    assert message.header.frame_id == "odom"
    assert (message.kind, message.seconds, message.x, message.y) == ("stood", 6.0, 1.5, -2.0)
    assert (message.parameter, message.before, message.after) == (ANSWER.parameter, 4.0, 2.0)
    assert message.reproduced == 0.97
    assert message.sentence == (
        "the robot stood for 6 s at (1.50, -2.00), because there was no scan for 6.0 s; "
        "try DWAPlannerROS/sim_time 4 -> 2"
    )
    marker = marker_of(message)
    assert marker.text == message.sentence
    assert (marker.pose.position.x, marker.pose.position.y) == (1.5, -2.0)
    # tf has a transform for time 0 also long after the stop.
    assert marker.header.stamp.is_zero()
    bytes_of(message)
    bytes_of(marker)


def test_names_are_the_robots_unless_a_parameter_gives_them():
    names, given = names_of({"scan_topic": "auto", "odom_topic": "/wheels"}, JACKAL)
    assert names.scan == "/front/scan"
    assert names.odometry == "/wheels"
    assert (names.move_base, names.monitor) == ("/move_base", "/collision_monitor")
    assert given == {"odometry"}
