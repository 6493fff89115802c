"""Reader of ROS 1 and ROS 2 bags: the drive of a robot with move_base, in columns.

rosbags reads the messages. Nothing in a bag is executed: rosbags takes only names, types and
numbers from message definitions.
"""

from __future__ import annotations

import os
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any, Collection, Dict, Iterable, Iterator, List, Optional, Sequence

from rosbags.highlevel import AnyReader, AnyReaderError
from rosbags.typesys import Stores, get_typestore

from applr_ros1.common.errors import ApplrError
from applr_ros1.common.files import FileError, check_regular, reading
from applr_ros1.drives.columns import TopicNames
from applr_ros1.drives.drive import Drive
from applr_ros1.drives.received import Received, drive_from, received, sources_of
from applr_ros1.robots import JACKAL, Robot

METADATA = "metadata.yaml"  # name of the file that marks the folder of a ROS 2 bag


class BagError(ApplrError):
    """Error of a bag that cannot be used at all. Its message is one line with bag and reason."""


def read(
    path: os.PathLike[str] | str,
    robot: Robot = JACKAL,
    topics: TopicNames = TopicNames(),
    columns: Optional[Collection[str]] = None,
) -> Drive:
    """Read the drive in a bag.

    Args:
        path: A .bag file, a ROS 2 folder with metadata.yaml, or a single .mcap or .db3 file.
        robot: Robot that drove.
        topics: Names of the recorded topics.
        columns: Columns to read; None reads all. Times count from the first message on one of
            their topics.
    """
    drive = drive_from(_messages(Path(path), topics, columns), robot)
    drive.name = Path(path).name
    return drive


def topics_in(path: os.PathLike[str] | str) -> Dict[str, str]:
    """Return {topic: type} of the messages in a bag."""
    message_types = {}
    with AnyReader([Path(path)], default_typestore=get_typestore(Stores.ROS2_HUMBLE)) as reader:
        for connection in reader.connections:
            # ROS 2's recorder also lists topics without messages.
            if connection.msgcount:
                message_types[connection.topic] = connection.msgtype
    return message_types


def text_on(path: os.PathLike[str] | str, topic: str) -> Optional[str]:
    """Return the last text (std_msgs/String) on a topic of a bag, or None."""
    text = None
    with AnyReader([Path(path)], default_typestore=get_typestore(Stores.ROS2_HUMBLE)) as reader:
        connections = [entry for entry in reader.connections if entry.topic == topic]
        # Without connections, rosbags would return every message.
        if not connections:
            return None
        for connection, _, raw_message in reader.messages(connections):
            message: Any = reader.deserialize(raw_message, connection.msgtype)
            text = str(message.data)
    return text


def _messages(path: Path, topics: TopicNames, columns: Optional[Collection[str]]) -> List[Received]:
    """Return the messages of some columns in order of recording."""
    messages = []
    # A ROS 2 bag without message definitions has those of this release.
    with AnyReader([path], default_typestore=get_typestore(Stores.ROS2_HUMBLE)) as reader:
        types = {connection.topic: connection.msgtype for connection in reader.connections}
        sources = sources_of(types, topics, columns)
        wanted_connections = []
        for connection in reader.connections:
            if connection.topic in sources:
                wanted_connections.append(connection)
        # Without connections, rosbags would return every message.
        recorded: Iterable[Any] = ()
        if wanted_connections:
            recorded = reader.messages(wanted_connections)
        for connection, recording_time, raw_message in recorded:
            message = received(
                recording_time,
                sources[connection.topic],
                raw_message,
                connection.digest,
                partial(reader.deserialize, raw_message, connection.msgtype),
            )
            messages.append(message)
    return messages


# -- files -----------------------------------------------------------------------------------------
@contextmanager
def refused(path: os.PathLike[str] | str) -> Iterator[None]:
    """Convert every error of the block that reads a bag to a BagError that names the bag."""
    try:
        # A bag of ROS 2 is a folder of files.
        for bag_file in (Path(path), *Path(path).glob("*")):
            check_regular(bag_file)
        with reading(path):
            yield
    except FileError as error:
        message = str(error)
        cause = error.__cause__
        if isinstance(cause, AnyReaderError) and "index" in str(cause):
            message += ": if its recording was cut short, run rosbag reindex"
        raise BagError(message) from error


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
