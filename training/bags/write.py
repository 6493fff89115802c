"""Writer of ROS 1 bags with the topics of a robot's stack, without ROS, from simulated drives."""

from __future__ import annotations

import math
import os
from operator import itemgetter
from pathlib import Path
from typing import Any, Dict, List, Tuple

from rosbags.rosbag1 import Writer

from applr_ros1.common.errors import ApplrError
from applr_ros1.drives.drive import Drive
from applr_ros1.robots import JACKAL, Robot
from training.bags.topics import (
    CHANNELS,
    CODE_OF_END,
    PREEMPTED,
    Maker,
    TopicNames,
    nanoseconds,
    topic_of,
)

BEGIN_S = 1.0  # ROS time of a bag's first drive, because 0 means "no time" [s]
PAUSE_S = 5.0  # time between two drives of a bag [s]

# Time [s], channel, fields of its `pack`, and planner or server
Entry = Tuple[float, str, Tuple[Any, ...], str]


class BagWriter:
    """Context manager that writes a ROS 1 bag with the topics of a robot's stack.

    Until the bag is complete, it has a temporary name.

    Args:
        path: Path of the bag, which must not exist.
        robot: Robot whose frames and sizes are used.
        topics: Names of the topics.

    Raises:
        ApplrError: The bag already exists.
    """

    def __init__(
        self, path: os.PathLike[str] | str, robot: Robot = JACKAL, topics: TopicNames = TopicNames()
    ):
        self.path = Path(path)
        self.robot = robot
        self.topics = topics
        self._begin = BEGIN_S  # time of the next drive [s]
        self._maker = Maker()
        self._connections: Dict[str, Any] = {}
        if self.path.exists():
            raise ApplrError(f"{path} already exists: give another name")
        self._partial = self.path.with_name(f"{self.path.name}.{os.getpid()}.partial")
        self._writer = Writer(self._partial)
        self._writer.open()

    def __enter__(self) -> BagWriter:
        return self

    def __exit__(self, failed: Any, *exc: Any) -> None:
        self._writer.close()
        if failed:
            self._partial.unlink()
        else:
            self._partial.rename(self.path)

    def write(self, drive: Drive) -> None:
        """Write a drive, PAUSE_S after the drive before it."""
        entries = sorted(_entries(drive, self.robot), key=itemgetter(0))
        offset = self._begin - entries[0][0]
        for drive_time, channel, fields, part in entries:
            self.put(channel, offset + drive_time, *fields, part=part)
        self._begin = offset + entries[-1][0] + PAUSE_S

    def put(self, channel: str, time: float, *fields: Any, part: str = "*") -> None:
        """Write a message of a channel (topics.CHANNELS) at `time` [s].

        `part` names its planner or server.
        """
        message_type = CHANNELS[channel].type
        message = CHANNELS[channel].pack(self._maker, time, *fields)
        topic = topic_of(channel, self.topics, part)
        if topic not in self._connections:
            self._connections[topic] = self._writer.add_connection(
                topic, message_type, typestore=self._maker.store
            )
        serialised = self._maker.store.serialize_ros1(message, message_type)
        self._writer.write(self._connections[topic], nanoseconds(time), serialised)


def write(
    path: os.PathLike[str] | str,
    *drives: Drive,
    robot: Robot = JACKAL,
    topics: TopicNames | None = None,
) -> Path:
    """Write drives as a bag, one after the other, with the columns that they have.

    Return the path.
    """
    with BagWriter(path, robot, topics or TopicNames.of(robot)) as writer:
        for drive in drives:
            writer.write(drive)
    return Path(path)


def _entries(drive: Drive, robot: Robot) -> List[Entry]:
    """Return the messages of a drive, those of one time in the order of a stack."""
    entries: List[Entry] = []

    def add(channel: str, time: float, *fields: Any, part: str = "*") -> None:
        entries.append((float(time), channel, fields, part))

    if drive.source:
        add("source", 0.0, drive.source)
    for sent in drive.sent:
        add("sent", sent.time, sent.pose, sent.frame)
    for goal in drive.goals:
        add("status", goal.begin, goal.id)
    if drive.odometry is not None:
        motion = drive.odometry
        for motion_time, pose, twist in zip(motion.time, motion.pose, motion.twist):
            add("odometry", motion_time, drive.frame, robot.frames.base, pose, twist)
    if drive.transforms is not None:
        links = drive.transforms
        for row, link_time in enumerate(links.time):
            channel = "static_transforms" if links.is_static[row] else "transforms"
            add(channel, link_time, links.parent[row], links.child[row], links.place[row])
    if drive.scans is not None:
        scans = drive.scans
        for scan_time, fan, ranges in zip(scans.time, scans.fan, scans.ranges):
            add("scans", scan_time, robot.laser.frame, fan, ranges)
    if drive.changes is not None:
        changes = drive.changes
        for change_time, server, values in zip(changes.time, changes.server, changes.values):
            add("changes", change_time, values, part=server)
    for number, decision in enumerate(drive.decisions):
        add("decisions", decision.time, drive.frame, number, decision, robot.world_scale)
    if drive.plans is not None:
        planner = drive.planners[0] if drive.planners else robot.local_planner
        for plan_time, followed_plan in zip(drive.plans.time, drive.plans.path):
            add("plans", plan_time, drive.frame, followed_plan, part=planner)
    elif drive.routes is not None:
        # Beside the followed plans nobody reads them, and they are long.
        for route_time, route in zip(drive.routes.time, drive.routes.path):
            add("routes", route_time, drive.frame, route, part="NavfnROS")
    for column in ("planned", "commands"):
        commands = getattr(drive, column)
        if commands is not None:
            for command_time, command in zip(commands.time, commands.twist):
                add(column, command_time, command)
    for contact_time in drive.contacts:
        add("contacts", contact_time, True)
    for recovery_time in drive.recoveries:
        add("recoveries", recovery_time, drive.frame)
    for course_end in drive.ends:
        add("ends", course_end.time, drive.frame, 0, course_end, robot.world_scale)
    for goal in drive.goals:
        if math.isfinite(goal.end):
            end_code = CODE_OF_END.get(goal.status, PREEMPTED)
            add("results", goal.end, goal.id, end_code)
            add("status", goal.end, goal.id, end_code)
    return entries
