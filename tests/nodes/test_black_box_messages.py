"""Tests of what the black box makes of ROS's messages, and publishes."""

import io
import json
import subprocess
import sys
from unittest.mock import create_autospec

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
from applr_ros1.planner.parameters.settings import Change
from applr_ros1.robots import JACKAL
from applr_ros1.why.answer import Answer
from applr_ros1.why.black_box.bag_file import Publication
from applr_ros1.why.black_box.black_box import BlackBox
from applr_ros1.why.black_box.description import DescribedRobot
from applr_ros1.why.black_box.folder import StopFolder
from applr_ros1.why.events import Event, RobotStop
from applr_ros1.why.outside import OTHER_PLANNER
from tests.support import HANGS, ROOT
from tests.support.raw_messages import description_of, piped, raw_messages
from tests.support.replays import PLANNER, spoilt_drive

pytest_plugins = ("tests.support.offline_ros",)
STOPPED = Event("stood", 0.5, 6.5, (1.5, -2.0), reason="there was no scan for 6.0 s")
ANSWER = Answer(
    name="stop",
    robot="jackal",
    length=0.5,
    scale=1.0,
    begin=1_700_000_000.0,
    frame="odom",
    events=[STOPPED],
    told_row=0,
    first_kind="stood",
    guess=(Change("DWAPlannerROS", "sim_time", 4.0, 2.0),),
    commands=100,
    reproduced=97,
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
    message = stop_message(ANSWER.message())
    assert message.header.stamp.to_sec() == 1_700_000_000.5
    assert message.header.frame_id == "odom"
    assert (message.kind, message.seconds, message.x, message.y) == ("stood", 6.0, 1.5, -2.0)
    assert (message.parameter, message.before, message.after) == (
        "DWAPlannerROS/sim_time",
        4.0,
        2.0,
    )
    assert message.reproduced == 0.97
    assert message.sentence == (
        "the robot stood for 6 s at (1.50, -2.00), because there was no scan for 6.0 s; "
        "the replay's guess: DWAPlannerROS/sim_time 4 -> 2"
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
def master(offline_ros, monkeypatch):
    """Return the master of a robot with a move_base, which names its robot."""
    offline_ros.parameters["/move_base"] = {"robot": "jackal"}
    master = create_autospec(rosgraph.Master, instance=True)
    monkeypatch.setattr(rosgraph, "Master", lambda name: master)
    plan_topic = "/move_base/NavfnROS/plan"
    master.getPublishedTopics.return_value = [
        [plan_topic, "nav_msgs/Path"],
        ["/move_base/status", "actionlib_msgs/GoalStatusArray"],
        ["/odometry/filtered", "nav_msgs/Odometry"],
    ]
    master.getSystemState.return_value = [[[plan_topic, ["/move_base"]]], [], []]
    monkeypatch.setattr(node_module.time, "sleep", lambda _: None)
    return master


@pytest.fixture
def node(master, tmp_path):
    """Return a node without a description of its own."""
    names, given = names_of({}, JACKAL)
    return BlackBoxNode(None, names, given, 1.0, StopFolder(tmp_path, 1, 1))


def status_after_a_look(node, offline_ros, monkeypatch):
    """Let a node look for topics and stops once; return its status and its values by name."""
    is_shutdown = iter([False, True])
    monkeypatch.setattr(rospy, "is_shutdown", lambda: next(is_shutdown))
    node.spin()
    (status,) = offline_ros.published["/diagnostics"][-1].status
    return status.message, {value.key: value.value for value in status.values}


def nested(depth):
    """Return sections in sections."""
    section = {}
    for _ in range(depth):
        section = {"section": section}
    return section


@pytest.mark.parametrize(
    ("parameters", "problem"),
    [
        ({"robot": "nobody"}, "robot nobody: give "),
        (5, "AttributeError: 'int' object has no "),
        (nested(2000), "RecursionError: "),
    ],
    ids=["robot", "number", "levels"],
)
def test_parameters_of_another_node_are_a_problem_and_no_end(
    parameters, problem, node, offline_ros, monkeypatch
):
    """The launch file would start the node again and again."""
    offline_ros.parameters["/move_base"] = parameters

    text, values = status_after_a_look(node, offline_ros, monkeypatch)
    assert text.startswith(f"/move_base: {problem}")
    assert "stops" not in values, "nothing is watched yet"
    offline_ros.parameters["/move_base"] = {"robot": "jackal"}
    text, values = status_after_a_look(node, offline_ros, monkeypatch)
    assert text == "keeps the last minutes"
    assert values["stops"] == "0"


class NotedBox(BlackBox):
    """BlackBox that notes the robots that it is told of."""

    def __init__(self, driven, *settings):
        super().__init__(driven, *settings)
        self.driven = [driven]

    def describe(self, driven):
        super().describe(driven)
        self.driven.append(driven)


@pytest.fixture
def boxes(monkeypatch):
    """Return the boxes that a node has begun."""
    boxes = []

    def begin(*settings):
        boxes.append(NotedBox(*settings))
        return boxes[-1]

    monkeypatch.setattr(node_module, "BlackBox", begin)
    return boxes


def test_a_laser_that_nobody_publishes_is_said_and_no_other_one_is_taken(
    node, master, boxes, offline_ros, monkeypatch
):
    # Given: costmaps that read /laser/scan, of which nothing comes, and the raw scans of its driver
    published = master.getPublishedTopics.return_value
    published.append(["/front/scan", "sensor_msgs/LaserScan"])
    scans = ["/laser/scan", "sensor_msgs/LaserScan"]
    master.getTopicTypes.return_value = [*published, scans]
    move_base_publishes, _, _ = master.getSystemState.return_value
    move_base_reads = [["/laser/scan", ["/move_base"]]]
    master.getSystemState.return_value = [move_base_publishes, move_base_reads, []]
    # When
    for _ in range(2):
        text, _ = status_after_a_look(node, offline_ros, monkeypatch)
    # Then: once on the screen, and in what the answers know
    assert text == "nobody publishes /laser/scan"
    assert offline_ros.log["info"].count("black box: nobody publishes /laser/scan") == 1
    (box,) = boxes
    driven = box.driven[-1]
    assert (driven.topics.scan, driven.unpublished) == ("/laser/scan", ("/laser/scan",))
    # When its driver starts
    published.append(scans)
    text, _ = status_after_a_look(node, offline_ros, monkeypatch)
    # Then
    assert text == "keeps the last minutes"
    driven = box.driven[-1]
    assert (driven.topics.scan, driven.unpublished) == ("/laser/scan", ())


@pytest.mark.parametrize(
    ("topic", "problem"),
    [
        ("/move_base/status", "no goals on /move_base/status"),
        ("/odometry/filtered", "no odometry on /odometry/filtered"),
    ],
)
def test_without_a_topic_that_shows_stops_the_box_says_that_none_is_found(
    topic, problem, node, master, offline_ros, monkeypatch
):
    published = master.getPublishedTopics.return_value
    missing = [entry for entry in published if entry[0] == topic]
    for entry in missing:
        published.remove(entry)
    text, _ = status_after_a_look(node, offline_ros, monkeypatch)
    assert text.startswith(f"{problem}, so that stops are not found: give ~")
    # The goals of move_base_flex are those of its actions.
    flex_topic = topic.replace("/status", "/exe_path/status")
    published.append([flex_topic, missing[0][1]])
    text, _ = status_after_a_look(node, offline_ros, monkeypatch)
    assert text == "keeps the last minutes"


def test_without_a_move_base_the_screen_says_so_once(node, master, offline_ros, monkeypatch):
    master.getSystemState.return_value = [[], [], []]
    for _ in range(2):
        status_after_a_look(node, offline_ros, monkeypatch)
    assert offline_ros.log["info"] == ["black box: waiting for /move_base: no node of that name"]


@pytest.mark.parametrize(
    ("words", "is_refused"),
    [
        (["roslaunch", "applr_ros1", "black_box.launch", "minutes:=5", "__ns:=a"], False),
        (["roslaunch", "--screen", "/a/black_box.launch", "minuts:=5"], True),
        # The arguments of another launch file are its own.
        (["roslaunch", "applr_ros1", "jackal_applr.launch", "method:=dwa"], False),
        (["bash"], False),
    ],
)
def test_a_misspelt_argument_of_its_launch_file_ends_in_one_line(
    words, is_refused, offline_ros, monkeypatch
):
    monkeypatch.setattr(node_module, "init_node", lambda name: None)
    monkeypatch.setattr(node_module.Path, "read_text", lambda path: "\0".join([*words, ""]))
    offline_ros.parameters["~"] = {"minutes": 5.0, "limit": -1.0}
    problem = "minuts:=5 is not an argument: give ARG:=VALUE with one of minutes, limit"
    if not is_refused:
        problem = "limit is -1.0: give"
    with pytest.raises(ApplrError, match=f"^{problem}"):
        node_module.main()


def test_beside_another_planner_the_screen_says_once_what_is_not_known(
    node, offline_ros, monkeypatch
):
    planner = "teb_local_planner/TebLocalPlannerROS"
    offline_ros.parameters["/move_base"]["base_local_planner"] = planner
    for _ in range(2):
        status_after_a_look(node, offline_ros, monkeypatch)
    lines = offline_ros.log["info"]
    assert lines.count(f"black box: {OTHER_PLANNER}") == 1
    assert "ready beside /move_base with TebLocalPlannerROS" in lines[0]


def test_a_move_base_that_starts_again_is_described_by_its_new_parameters(
    node, master, boxes, offline_ros, monkeypatch
):
    parameters = offline_ros.parameters["/move_base"]
    for address in ("http://robot:1", "http://robot:1", "http://robot:2"):
        master.lookupNode.return_value = address
        status_after_a_look(node, offline_ros, monkeypatch)
        parameters["base_local_planner"] = "dwa_local_planner/DWAPlannerROS"

    (box,) = boxes
    planners = [driven.robot.local_planner for driven in box.driven]
    assert planners == ["TrajectoryPlannerROS", "DWAPlannerROS"], "at the new address alone"


# The program of the process, on a robot without the packages of a desk
PROGRAM = """
import runpy, sys
for package in ("torch", "gymnasium", "rosbags", "pandas", "tqdm", "ray", "training"):
    sys.modules[package] = None
runpy.run_module("applr_ros1.nodes.black_box.answer_program", run_name="__main__")
"""


def test_the_process_answers_without_a_master_and_without_the_packages_of_a_desk(tmp_path):
    robot, drive = spoilt_drive()
    messages = raw_messages(tmp_path / "drive.bag", drive, robot=robot)
    stop = RobotStop("crept", 3.0, 9.0, (0.5, 0.25))
    driven = DescribedRobot(robot, TopicNames.of(robot), True)
    description = description_of(driven, messages[0].time, stop)

    answered = subprocess.run(
        [sys.executable, "-c", PROGRAM],
        input=piped([description, *messages]),
        capture_output=True,
        cwd=ROOT,
        timeout=HANGS,
    )

    assert answered.returncode == 0, answered.stderr
    first_answer, _, answer = map(json.loads, answered.stdout.splitlines())
    assert (first_answer["kind"], first_answer["reason"]) == ("crept", "")
    assert answer["reason"].startswith("no command faster than 0.10 m/s is sampled")
    assert answer["parameter"] == f"{PLANNER}/vx_samples"
    # What cannot be answered ends in one line.
    refused = subprocess.run(
        [sys.executable, "-c", PROGRAM],
        input=piped(messages),
        capture_output=True,
        cwd=ROOT,
        timeout=HANGS,
    )
    assert refused.returncode == 1
    (line,) = refused.stderr.decode().splitlines()
    assert line.startswith("black box: no message on /black_box/parameters")
