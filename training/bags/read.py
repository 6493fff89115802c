"""Reader of ROS 1 and ROS 2 bags: the drive of a robot with move_base, in columns.

rosbags reads the messages. Nothing in a bag is executed: rosbags takes only names, types and
numbers from message definitions.
"""

from __future__ import annotations

import os
from collections import defaultdict
from contextlib import contextmanager
from fnmatch import fnmatchcase
from pathlib import Path
from typing import (
    Any,
    Collection,
    DefaultDict,
    Dict,
    Iterable,
    Iterator,
    List,
    NamedTuple,
    Optional,
    Sequence,
)

import numpy as np
from rosbags.highlevel import AnyReader, AnyReaderError
from rosbags.typesys import Stores, get_typestore

from applr_ros1.common.errors import ApplrError
from applr_ros1.common.files import FileError, check_regular, reading
from applr_ros1.drives.bag import UnpackedRow, drive_of
from applr_ros1.drives.columns import COLUMNS, SECOND, Row, TopicNames, column_of, topic_of
from applr_ros1.drives.drive import Clearances, Drive, Scans
from applr_ros1.drives.outcome import nearest
from applr_ros1.robots import JACKAL, Robot
from training.bags import paths
from training.bags.robot_time import RecordedStamp, RobotTime

SENSORS = ("odometry", "scans")  # columns whose stamps may set the robot's time
METADATA = "metadata.yaml"  # name of the file that marks the folder of a ROS 2 bag


class BagError(ApplrError):
    """Error of a bag that cannot be used at all. Its message is one line with bag and reason."""


class TopicSource(NamedTuple):
    """Topic of a bag: its key in COLUMNS, and the planner or server that it names, as a field."""

    key: str
    part: Row


class Received(NamedTuple):
    """Message of a bag: when it was recorded [ns], its topic's key in COLUMNS, and its rows."""

    recording_time: int
    key: str
    rows: List[Row]


class OpenBag:
    """Bag that is open for reading.

    Args:
        reader: Its open reader.
        name: Name of the bag, for people.

    Attributes:
        types: {topic: type} of its messages.
    """

    def __init__(self, reader: AnyReader, name: str):
        self._reader = reader
        self._name = name
        self.types: Dict[str, str] = {}
        for connection in reader.connections:
            # ROS 2's recorder also lists topics without messages.
            if connection.msgcount:
                self.types[connection.topic] = connection.msgtype

    def drive(
        self,
        robot: Robot = JACKAL,
        topics: TopicNames = TopicNames(),
        columns: Optional[Collection[str]] = None,
    ) -> Drive:
        """Read the drive.

        Args:
            robot: Robot that drove.
            topics: Names of the recorded topics.
            columns: Columns to read; None reads all. Times count from the first message on one of
                their topics.
        """
        messages = _messages(self._reader, topics, columns)
        # The robot's time at which each message was recorded, since the first one
        robot_time = RobotTime([_stamped(messages, sensor) for sensor in SENSORS])
        first_time = min((message.recording_time for message in messages), default=0)
        begin_time = robot_time.of(first_time)
        unpacked: DefaultDict[str, List[UnpackedRow]] = defaultdict(list)
        for message in messages:
            elapsed = (robot_time.of(message.recording_time) - begin_time) / SECOND
            column = column_of(message.key)
            for row in message.rows:
                unpacked[column].append(UnpackedRow(elapsed, row))

        drive = drive_of(unpacked, begin_time, robot)
        drive.name = self._name
        if robot_time.note:
            drive.notes.append(robot_time.note)
        if drive.scans is not None:
            drive.clearances = _clearances(drive.scans, robot)
        return drive


@contextmanager
def opened(path: os.PathLike[str] | str) -> Iterator[OpenBag]:
    """Open a bag, and convert every error of the block to a BagError that names it.

    Args:
        path: A .bag file, a ROS 2 folder with metadata.yaml, or a single .mcap or .db3 file.
    """
    try:
        # A bag of ROS 2 is a folder of files.
        for bag_file in (Path(path), *Path(path).glob("*")):
            check_regular(bag_file)
        # A ROS 2 bag without message definitions has those of this release.
        typestore = get_typestore(Stores.ROS2_HUMBLE)
        with reading(path), AnyReader([Path(path)], default_typestore=typestore) as reader:
            yield OpenBag(reader, Path(path).name)
    except FileError as error:
        message = str(error)
        cause = error.__cause__
        if isinstance(cause, AnyReaderError) and "index" in str(cause):
            message += ": if its recording was cut short, run rosbag reindex"
        raise BagError(message) from error


def read(
    path: os.PathLike[str] | str,
    robot: Robot = JACKAL,
    topics: TopicNames = TopicNames(),
    columns: Optional[Collection[str]] = None,
) -> Drive:
    """Read the drive in a bag, as OpenBag.drive does."""
    with opened(path) as bag:
        return bag.drive(robot, topics, columns)


def _messages(
    reader: AnyReader, topics: TopicNames, columns: Optional[Collection[str]]
) -> List[Received]:
    """Return the messages of some columns in order of recording."""
    sources = _sources(reader, topics, columns)
    wanted_connections = []
    for connection in reader.connections:
        if connection.topic in sources:
            wanted_connections.append(connection)
    # Without connections, rosbags would return every message.
    recorded: Iterable[Any] = ()
    if wanted_connections:
        recorded = reader.messages(wanted_connections)
    messages = []
    for connection, recording_time, raw_message in recorded:
        source = sources[connection.topic]
        plan_row = None
        if connection.digest == paths.DIGEST:
            plan_row = paths.path_of(raw_message)
        if plan_row is not None:
            rows = [plan_row]
        else:
            message = reader.deserialize(raw_message, connection.msgtype)
            rows = COLUMNS[source.key].unpack(message)
        if source.part:
            for row in rows:
                row.update(source.part)
        messages.append(Received(recording_time, source.key, rows))
    return messages


def _stamped(messages: Sequence[Received], column: str) -> List[RecordedStamp]:
    """Return recording times and stamps [ns] of a sensor's messages that have a stamp."""
    stamped = []
    for message in messages:
        if message.key == column and message.rows[0]["stamp"]:
            stamped.append((message.recording_time, message.rows[0]["stamp"]))
    return stamped


def _sources(
    reader: AnyReader, topics: TopicNames, columns: Optional[Collection[str]]
) -> Dict[str, TopicSource]:
    """Return {topic: its source} of the topics of a bag that are read."""
    sources = {}
    for key, column in COLUMNS.items():
        if columns is not None and column_of(key) not in columns:
            continue
        # A topic such as MOVE_BASE/SERVER/parameter_updates; a server's name may hold slashes.
        pattern = topic_of(key, topics)
        prefix, _, suffix = pattern.partition("*")
        for connection in reader.connections:
            topic = connection.topic
            if fnmatchcase(topic, pattern) and column.accepts(connection.msgtype):
                part = {}
                if column.part:
                    part[column.part] = topic[len(prefix) : len(topic) - len(suffix)]
                sources[topic] = TopicSource(key, part)
    return sources


def _clearances(scans: Scans, robot: Robot) -> Clearances:
    """Return the smallest range of each scan, in order of the stamps."""
    rows_by_stamp = np.argsort(scans.stamp, kind="stable")
    smallest_ranges = []
    for scan_row in rows_by_stamp:
        ranges = scans.ranges[scan_row]
        if not len(ranges):
            smallest_ranges.append(np.inf)
            continue
        # Some lasers report 0 for beams without a return.
        measured = np.where(ranges == 0.0, np.nan, ranges)
        smallest_ranges.append(nearest(measured, robot.laser.range_min))
    return Clearances(scans.stamp[rows_by_stamp], np.array(smallest_ranges))


# -- files -----------------------------------------------------------------------------------------
def bags_in(paths: Sequence[os.PathLike[str] | str]) -> List[Path]:
    """Return the bags among files and folders, those of a folder sorted.

    A bag is a .bag file, a ROS 2 folder, or a single .mcap or .db3 file.

    Raises:
        BagError: A path does not exist, or there is no bag.
    """
    remedy = "give .bag, .mcap or .db3 files or ROS 2 bag folders"
    bags: List[Path] = []
    for given_path in map(Path, paths):
        if not given_path.exists():
            raise BagError(f"{given_path}: there is no such file or folder: {remedy}")
        if given_path.is_file() or (given_path / METADATA).exists():
            bags.append(given_path)
        else:
            for inner_path in sorted(given_path.rglob("*")):
                if inner_path.suffix == ".bag" or (inner_path / METADATA).exists():
                    bags.append(inner_path)
    if not bags:
        raise BagError(f"{', '.join(map(str, paths))}: no bags there: {remedy}")
    return bags
