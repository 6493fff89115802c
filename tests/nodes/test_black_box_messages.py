"""Tests of what the black box makes of ROS's messages, and publishes."""

import io
import json
import subprocess
import sys
from unittest.mock import MagicMock

import pytest
import rosgraph
import rospy
from nav_msgs.msg import Odometry
from std_msgs.msg import Bool

from applr_ros1.common.errors import ApplrError
from applr_ros1.drives.columns import TopicNames
from applr_ros1.nodes.black_box import node as node_module
from applr_ros1.nodes.black_box.messages import deserialize
from applr_ros1.nodes.black_box.node import BlackBoxNode, marker_of, names_of, stop_message
from applr_ros1.robots import JACKAL
from applr_ros1.why.black_box.answer_process import job_of
from applr_ros1.why.black_box.answering import StopAnswer
from applr_ros1.why.black_box.bag_file import Publication, RawMessage
from applr_ros1.why.black_box.black_box import DESCRIPTION
from applr_ros1.why.black_box.description import DescribedRobot, text_of
from applr_ros1.why.black_box.folder import StopFolder
from applr_ros1.why.black_box.stops import RobotStop
from tests.support import HANGS, ROOT
from tests.support.raw_messages import raw_messages
from tests.support.replays import PLANNER, spoilt_drive

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


@pytest.fixture
def master(monkeypatch):
    """Return the master of a robot with a move_base, in a process that connects to nothing."""
    master = MagicMock()
    monkeypatch.setattr(rosgraph, "Master", lambda name: master)
    plan_topic = "/move_base/NavfnROS/plan"
    master.getPublishedTopics.return_value = [[plan_topic, "nav_msgs/Path"]]
    master.getSystemState.return_value = [[[plan_topic, ["/move_base"]]], [], []]
    for name in ("Publisher", "Subscriber", "Service"):
        monkeypatch.setattr(rospy, name, MagicMock())
    monkeypatch.setattr(rospy, "get_time", lambda: 100.0)
    monkeypatch.setattr(rospy, "get_rostime", lambda: rospy.Time(100))
    monkeypatch.setattr(node_module.time, "sleep", lambda _: None)
    return master


def status_after_a_look(node, monkeypatch):
    """Let a node look for topics and stops once; return its status and its values by name."""
    monkeypatch.setattr(rospy, "is_shutdown", MagicMock(side_effect=[False, True]))
    node.spin()
    (message,) = rospy.Publisher.return_value.publish.call_args.args
    (status,) = message.status
    return status.message, {value.key: value.value for value in status.values}


def test_parameters_of_another_node_are_a_problem_and_no_end(master, monkeypatch, tmp_path):
    """The launch file would start the node again and again."""
    parameters = {"robot": "nobody"}
    monkeypatch.setattr(rospy, "get_param", lambda name, default: parameters)
    names, given = names_of({}, JACKAL)
    node = BlackBoxNode(None, names, given, 1.0, StopFolder(tmp_path, 1, 1))

    text, values = status_after_a_look(node, monkeypatch)
    assert text.startswith("/move_base: robot nobody: give ")
    assert "stops" not in values, "nothing is watched yet"
    parameters["robot"] = "jackal"
    text, values = status_after_a_look(node, monkeypatch)
    assert text == "keeps the last minutes"
    assert values["stops"] == "0"


def test_a_move_base_that_starts_again_is_described_by_its_new_parameters(
    master, monkeypatch, tmp_path
):
    parameters = {"robot": "jackal"}
    monkeypatch.setattr(rospy, "get_param", lambda name, default: parameters)
    described = []
    box = MagicMock(describe=lambda driven: described.append(driven.robot.local_planner))
    box.look.return_value.answer = None
    monkeypatch.setattr(node_module, "BlackBox", lambda driven, *_: box)
    names, given = names_of({}, JACKAL)
    node = BlackBoxNode(None, names, given, 1.0, StopFolder(tmp_path, 1, 1))

    for address in ("http://robot:1", "http://robot:1", "http://robot:2"):
        master.lookupNode.return_value = address
        status_after_a_look(node, monkeypatch)
        parameters["base_local_planner"] = "dwa_local_planner/DWAPlannerROS"

    assert described == ["DWAPlannerROS"], "at the new address alone"


# The program of the process, on a robot without the packages of a desk
PROGRAM = """
import runpy, sys
for package in ("torch", "gymnasium", "rosbags", "pandas", "tqdm", "ray", "training"):
    sys.modules[package] = None
runpy.run_module("applr_ros1.nodes.black_box.answer", run_name="__main__")
"""


def test_the_process_answers_without_a_master_and_without_the_packages_of_a_desk(tmp_path):
    robot, drive = spoilt_drive()
    messages = raw_messages(tmp_path / "drive.bag", drive, robot=robot)
    text = text_of(DescribedRobot(robot, TopicNames.of(robot), True)).encode()
    serialised = len(text).to_bytes(4, "little") + text
    description = RawMessage(messages[0].time, DESCRIPTION, serialised)
    job = job_of(RobotStop("crept", 3.0, 9.0, (0.5, 0.25)), [description, *messages])

    answered = subprocess.run(
        [sys.executable, "-c", PROGRAM], input=job, capture_output=True, cwd=ROOT, timeout=HANGS
    )

    assert answered.returncode == 0, answered.stderr
    first_answer, _, answer = map(json.loads, answered.stdout.splitlines())
    assert (first_answer["kind"], first_answer["reason"]) == ("crept", "")
    assert answer["reason"].startswith("no command faster than 0.10 m/s is sampled")
    assert answer["parameter"] == f"{PLANNER}/vx_samples"
    # What cannot be answered ends in one line.
    refused = subprocess.run(
        [sys.executable, "-c", PROGRAM],
        input=job_of(RobotStop("crept", 3.0, 9.0, (0.5, 0.25)), messages),
        capture_output=True,
        cwd=ROOT,
        timeout=HANGS,
    )
    assert refused.returncode == 1
    (line,) = refused.stderr.decode().splitlines()
    assert line.startswith("black box: no message on /black_box/parameters")
