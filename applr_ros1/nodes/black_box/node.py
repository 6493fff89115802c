"""ROS node `black_box`, beside any move_base: keeps the last minutes, says why the robot stopped.

It keeps the messages that `./applr why` needs in memory, as they came. At a stop (the robot stands,
creeps, swings or turns on the spot for five seconds although it has a goal, the collision monitor
holds it for three, or a goal is given up) it writes them to a bag, and publishes why the robot
stopped on ~answer. The service ~save does the same at any time.

Topics are those that move_base reads and writes. Parameters: ~robot (name or folder of a
description; none is needed), ~map, ~move_base (name of the node; auto, the default: found by
its plans), ~scan_topic, ~odom_topic, ~cmd_vel_topic (auto), ~minutes (2; at most 10), ~folder
(~/.ros/black_box), ~limit (size of all bags [GB], 2).
"""

from __future__ import annotations

import ctypes
import math
import os
import sys
import time
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import Any, Dict, List, Optional, Set, Tuple

import rosgraph
import rospkg
import rospy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from geometry_msgs.msg import Vector3
from std_msgs.msg import ColorRGBA, Header
from std_srvs.srv import Trigger, TriggerResponse
from visualization_msgs.msg import Marker

from applr_ros1.common.arguments import check_names, number_within
from applr_ros1.common.errors import ApplrError, one_line, run_script
from applr_ros1.common.ros_node import command_topic, init_node, status_name, until_shutdown
from applr_ros1.drives.columns import TopicNames
from applr_ros1.drives.names import Connections, names_beside, names_in, unpublished
from applr_ros1.drives.received import TopicSource, received, sources_of
from applr_ros1.msg import Stop as StopMessage
from applr_ros1.nodes import conversions
from applr_ros1.nodes.black_box.messages import deserialize
from applr_ros1.nodes.robot_parameters import named_robot, with_robot
from applr_ros1.robots import JACKAL, Robot
from applr_ros1.why.black_box.answer_process import AnswerProcess
from applr_ros1.why.black_box.bag_file import Publication, RawMessage
from applr_ros1.why.black_box.black_box import BlackBox
from applr_ros1.why.black_box.description import (
    DescribedRobot,
    driving,
    nobody_publishes,
    unknown_robot,
    unwatched,
)
from applr_ros1.why.black_box.folder import StopFolder, moment
from applr_ros1.why.black_box.ring import Ring
from applr_ros1.why.limits import REPLAYED
from applr_ros1.why.outside import OTHER_PLANNER
from applr_ros1.why.recorded import CHANNELS

LOOK_S = 1.0  # interval between two looks for a stop, in wall time [s]
SEARCH_S = 3.0  # interval between two searches for topics, in wall time [s]
REPORT_S = 2.0  # interval between diagnostics, in wall time [s]
MOST_BYTES = 70_000_000  # largest memory of the messages, nine to ten minutes of a Jackal [bytes]
MOST_STOPS = 500  # largest number of bags
MOST_MINUTES = 10.0  # longest time that can be kept [min]
LAUNCH_FILE = "black_box.launch"  # the launch file whose arguments are the node's parameters
NO_ROBOT = "none"  # value of ~robot of a robot without a description
FOUND = "auto"  # value of a topic's parameter that is found
TEXT_M = 0.15  # height of the letters in RViz [m]
M_ARENA_MAX = -8  # option of glibc's mallopt (malloc.h): largest number of arenas
M_MMAP_THRESHOLD = -3  # option of mallopt: size from which on what is freed leaves the process
LARGE_BYTES = 1_000_000  # this size [bytes]
ANSWER = [sys.executable, "-m", "applr_ros1.nodes.black_box.answer_program"]


class BlackBoxNode:
    """Node that brings the topics of a running move_base to a BlackBox, and publishes its answers.

    Args:
        described: Robot that the node's parameters name, or None.
        names: Names of topics, found or not.
        given: Fields of `names` that were given.
        minutes: Time that is kept [min].
        folder: Folder of the bags.
    """

    def __init__(
        self,
        described: Optional[Robot],
        names: TopicNames,
        given: Set[str],
        minutes: float,
        folder: StopFolder,
    ):
        self._described = described
        self._names = names
        # names, topics without a publisher, and address of the move_base that is described
        self._described_as: Tuple[TopicNames, Tuple[str, ...], str] = (names, (), "")
        self._given = given
        self._folder = folder
        self._ring = Ring(60.0 * minutes, MOST_BYTES)
        self._master = rosgraph.Master(rospy.get_name())
        self._box: Optional[BlackBox] = None  # None until there is a move_base
        self._subscribers: Dict[str, rospy.Subscriber] = {}
        self._publications: Dict[Tuple[str, str], Publication] = {}
        self._problem = ""
        self._last_sentence = ""  # latest answer, for diagnostics
        self._answer = rospy.Publisher("~answer", StopMessage, queue_size=5, latch=True)
        self._marker = rospy.Publisher("~marker", Marker, queue_size=5, latch=True)
        self._diagnostics = rospy.Publisher("/diagnostics", DiagnosticArray, queue_size=1)
        rospy.Service("~save", Trigger, self._save)

    def spin(self) -> None:
        """Look for topics and stops until shutdown."""
        search_due = report_due = time.monotonic()
        while not rospy.is_shutdown():
            if time.monotonic() >= search_due:
                search_due = time.monotonic() + SEARCH_S
                problem_before = self._problem
                self._search()
                if self._problem not in ("", problem_before):
                    rospy.loginfo("black box: %s", self._problem)
            if self._box is not None:
                self._look(self._box)
            if time.monotonic() >= report_due:
                report_due = time.monotonic() + REPORT_S
                self._report()
            time.sleep(LOOK_S)
        if self._box is not None:
            self._box.end()

    # -- topics ------------------------------------------------------------------------------------
    def _search(self) -> None:
        """Find move_base and its topics, and subscribe to those that are new."""
        try:
            types = dict(self._master.getPublishedTopics(""))
            all_types = dict(self._master.getTopicTypes())
            published, subscribed, _ = self._master.getSystemState()
            names = names_in(types, self._names, self._given)
            # Each start of a node has another address, and may have other parameters.
            address = ""
            if any(names.move_base in nodes for _, nodes in published):
                address = self._master.lookupNode(names.move_base)
        except (OSError, rosgraph.MasterException) as problem:
            self._problem = f"the ROS master does not answer ({problem})"
            return
        except ApplrError as problem:
            self._problem = f"{problem} (~move_base)"
            return
        move_base = Connections(
            {topic for topic, nodes in published if names.move_base in nodes},
            {topic for topic, nodes in subscribed if names.move_base in nodes},
        )
        if not move_base.published:
            self._problem = f"waiting for {names.move_base}: no node of that name"
            return
        names = names_beside(move_base, all_types, names, self._given)
        sources = sources_of(types, names, CHANNELS)
        silent_topics = unpublished(move_base, names, types)
        self._problem = nobody_publishes(silent_topics) or unwatched(sources, names)
        found = (names, silent_topics, address)
        if self._box is None or found != self._described_as:
            try:
                self._begin(names, silent_topics)
            except Exception as problem:  # The parameters of another node are no reason to end.
                self._problem = f"{names.move_base}: {one_line(problem)}"
                return
            self._described_as = found
        for topic, source in sources.items():
            if topic not in self._subscribers:
                take = partial(self._take, source, topic)
                subscriber = rospy.Subscriber(topic, rospy.AnyMsg, take, tcp_nodelay=True)
                self._subscribers[topic] = subscriber

    def _begin(self, names: TopicNames, silent_topics: Tuple[str, ...]) -> None:
        """Begin to keep the topics of a robot, or go on with other names of them.

        Args:
            names: Names of the topics.
            silent_topics: Those that nobody publishes.
        """
        robot, is_known = self._robot(names.move_base)
        driven = DescribedRobot(robot, names, is_known, silent_topics)
        if self._box is not None:
            self._box.describe(driven)
            return
        process = AnswerProcess(ANSWER)
        self._box = BlackBox(driven, self._ring, self._folder, process, moment)
        rospy.loginfo(
            "black box: ready beside %s with %s, bags in %s",
            names.move_base,
            robot.local_planner,
            self._folder.path,
        )
        if robot.local_planner not in REPLAYED:
            rospy.loginfo("black box: %s", OTHER_PLANNER)

    def _robot(self, move_base: str) -> Tuple[Robot, bool]:
        """Return the robot with the parameters of its move_base, and whether it is described."""
        tree, robot = with_robot(rospy.get_param(move_base, {}))
        robot = self._described or robot
        if robot is None:
            return unknown_robot(tree), False
        return driving(robot, tree or robot.parameters()), True

    def _take(self, source: TopicSource, topic: str, message: rospy.AnyMsg) -> None:
        """Keep a message as it came."""
        box = self._box
        if box is None:
            return
        header = message._connection_header
        key = topic, header["callerid"]
        publication = self._publications.get(key)
        if publication is None:
            publication = self._publications[key] = Publication(
                topic,
                header["type"],
                header["md5sum"],
                header.get("message_definition", ""),
                header["callerid"],
                header.get("latching") == "1",
            )
        raw = RawMessage(rospy.get_rostime().to_nsec(), publication, message._buff)
        # rospy keeps the message until the publisher's next one, also if the box does not.
        message._buff = b""
        unpacked = partial(_unpacked, raw, source)
        try:
            box.take(raw, source, unpacked)
        except Exception as problem:
            # Whatever a message holds, the robot drives on, and the others are kept.
            rospy.logerr_throttle(10.0, f"black box: {topic} is not watched: {problem}")

    # -- stops -------------------------------------------------------------------------------------
    def _save(self, request: Any) -> TriggerResponse:
        """Handle the service ~save."""
        if self._box is None:
            return TriggerResponse(False, f"nothing is kept yet: {self._problem}")
        saved_moment = self._box.save(rospy.get_time())
        path = self._folder.path / f"stop_{saved_moment}.bag"
        return TriggerResponse(True, f"{path} follows in ten seconds")

    def _look(self, box: BlackBox) -> None:
        """Look for stops, and publish what is new."""
        output = box.look(rospy.get_time())
        for line in output.lines:
            rospy.loginfo("black box: %s", line)
        for problem in output.problems:
            rospy.logwarn("black box: %s", problem)
        if output.answer is not None:
            rospy.logwarn("black box: %s", output.answer["sentence"])
            self._last_sentence = output.answer["sentence"]
            message = stop_message(output.answer)
            self._answer.publish(message)
            self._marker.publish(marker_of(message))

    def _report(self) -> None:
        """Publish diagnostics."""
        box = self._box
        problem = self._problem
        values = {
            "seconds": self._ring.seconds,
            "megabytes": self._ring.byte_count / 1e6,
            "folder": self._folder.path,
        }
        if box is not None:
            problem = problem or box.problem
            values.update(stops=box.stop_count, lost=box.lost_count)
            values.update(last_stop=self._last_sentence)
        level = DiagnosticStatus.WARN if problem else DiagnosticStatus.OK
        now = rospy.get_rostime()
        name = status_name("black_box", "stops")
        message = problem or "keeps the last minutes"
        self._diagnostics.publish(conversions.diagnostics(name, level, message, values, now))


def _unpacked(raw: RawMessage, source: TopicSource) -> Any:
    """Return a message with its rows."""
    read = partial(deserialize, raw.publication, raw.data)
    return received(raw.time, source, raw.data, raw.publication.md5sum, read)


def stop_message(answer: Dict[str, Any]) -> StopMessage:
    """Return applr_ros1/Stop of the JSON values of an answer's message."""
    fields = dict(answer)
    stamp = rospy.Time.from_sec(fields.pop("begin"))
    return StopMessage(header=Header(0, stamp, fields.pop("frame")), **fields)


def marker_of(message: StopMessage) -> Marker:
    """Return a text for RViz at the place of a stop."""
    # It holds at any time: after a while tf has no transform for the time of the stop.
    marker = Marker(header=Header(0, rospy.Time(0), message.header.frame_id), ns="stop")
    marker.type = Marker.TEXT_VIEW_FACING
    marker.text = message.sentence
    marker.pose.position.x = message.x
    marker.pose.position.y = message.y
    marker.pose.position.z = 1.0
    marker.pose.orientation.w = 1.0
    marker.scale = Vector3(0.0, 0.0, TEXT_M)
    marker.color = ColorRGBA(0.85, 0.1, 0.1, 1.0)
    return marker


def names_of(parameters: Dict[str, Any], robot: Robot) -> Tuple[TopicNames, Set[str]]:
    """Return the names of topics and nodes, and the fields of them that parameters give.

    Args:
        parameters: The node's private parameters.
        robot: Robot whose names are looked for otherwise.
    """
    usual_names = {
        "scan": ("scan_topic", robot.topics.scan),
        "odometry": ("odom_topic", robot.topics.odometry),
        "command": ("cmd_vel_topic", command_topic(robot.topics.cmd_vel)),
        "move_base": ("move_base", "move_base"),
    }
    names = {
        "applr": rospy.resolve_name("applr"),
        "monitor": rospy.resolve_name("collision_monitor"),
    }
    given = set()
    for field_name, (parameter, usual_name) in usual_names.items():
        given_name = str(parameters.get(parameter, FOUND))
        if given_name != FOUND:
            given.add(field_name)
            usual_name = given_name
        names[field_name] = rospy.resolve_name(usual_name)
    return TopicNames(**names), given


def _share_memory() -> None:
    """Let all threads share one arena of glibc's malloc, which keeps nothing large that was freed.

    Each arena keeps what was freed in it. With one for each thread, the node had 250 instead of 130
    MB after seven stops in six minutes. Plans of 6 MB left 55 MB in it.
    """
    with suppress(AttributeError):  # another C library
        ctypes.CDLL(None).mallopt(M_ARENA_MAX, 1)
        ctypes.CDLL(None).mallopt(M_MMAP_THRESHOLD, LARGE_BYTES)


def _words_of_launch() -> List[str]:
    """Return the arguments ARG:=VALUE of the roslaunch that started this node by LAUNCH_FILE.

    roslaunch itself ignores those that are misspelt.
    """
    words = Path(f"/proc/{os.getppid()}/cmdline").read_text().split("\0")
    if not any(word.endswith(LAUNCH_FILE) for word in words):
        return []
    return [word for word in words if ":=" in word]


def main() -> int:
    """Run the node.

    Raises:
        ApplrError: A parameter is invalid.
    """
    _share_memory()
    init_node("black_box")
    parameters = rospy.get_param("~", {})
    # The launch file hands each of its arguments on as a parameter.
    check_names(_words_of_launch(), parameters)
    described = None
    if str(parameters.get("robot", NO_ROBOT)) != NO_ROBOT:
        described, _ = named_robot(parameters)
    names, given = names_of(parameters, described or JACKAL)
    minutes = number_within("minutes", parameters.get("minutes", 2.0), 0.2, MOST_MINUTES)
    limit = number_within("limit", parameters.get("limit", 2.0), 0.0, math.inf)
    default_path = str(Path(rospkg.get_ros_home()) / "black_box")
    path = Path(str(parameters.get("folder", default_path))).expanduser()
    folder = StopFolder(path, int(limit * 1e9), MOST_STOPS)
    node = BlackBoxNode(described, names, given, minutes, folder)
    with until_shutdown():
        node.spin()
    return 0


if __name__ == "__main__":
    run_script("applr_ros1.nodes.black_box.node", node=True)
