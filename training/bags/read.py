"""Reader of ROS 1 and ROS 2 bags: the drive of a robot with move_base, in columns.

rosbags reads the messages. Nothing in a bag is executed: rosbags takes only names, types and
numbers from message definitions.
"""

from __future__ import annotations

import logging
import os
from contextlib import contextmanager
from functools import partial
from operator import attrgetter
from pathlib import Path
from typing import (
    Any,
    Callable,
    Collection,
    Dict,
    Iterable,
    Iterator,
    List,
    Mapping,
    Optional,
    Sequence,
    Tuple,
)

import numpy as np
from rosbags.highlevel import AnyReader, AnyReaderError
from rosbags.typesys import Stores, get_typestore

from applr_ros1.common.errors import ApplrError
from applr_ros1.common.files import FileError, check_regular, reading
from applr_ros1.drives.columns import TopicNames
from applr_ros1.drives.drive import Drive
from applr_ros1.drives.received import (
    BACK_NS,
    Received,
    TopicSource,
    all_received,
    drive_from,
    received,
    sources_of,
)
from applr_ros1.robots import JACKAL, Robot

_LOGGER = logging.getLogger(__name__)
METADATA = "metadata.yaml"  # name of the file that marks the folder of a ROS 2 bag
CUT_SHORT = "if its recording was cut short, rename it to .bag, run rosbag reindex"
BAG_SUFFIXES = (".bag", ".mcap", ".db3")  # ends of the names of bags that are one file
# Ends of the names of bags that cannot be read as they are, and the remedies
UNREAD_SUFFIXES = {
    ".active": CUT_SHORT,
    **dict.fromkeys((".bz2", ".gz", ".xz", ".zip", ".zst", ".zstd"), "unpack it"),
}


class BagError(ApplrError):
    """Error of a bag that cannot be used at all. Its message is one line with bag and reason."""


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
        is_one: bool = False,
    ) -> Drive:
        """Read the drive. Messages that cannot be unpacked are left out, and logged by topic.

        Args:
            robot: Robot that drove.
            topics: Names of the recorded topics.
            columns: Columns to read; None reads all. Times count from the first message on one of
                their topics.
            is_one: Whether the messages are to be one drive by one clock.
        """
        sources = sources_of(self.types, topics, columns)
        messages = all_received(self._calls(sources), self._name)
        drive = drive_from(messages, robot, is_one)
        drive.name = self._name
        drive.topics = {topic: source.key for topic, source in sources.items()}
        _LOGGER.info("bag %s: %d messages on %s", self._name, len(messages), ", ".join(sources))
        return drive

    def _calls(
        self, sources: Mapping[str, TopicSource]
    ) -> Iterator[Tuple[str, Callable[[], Received]]]:
        """Yield the topic of each message on the sources, and a call that unpacks it."""
        for connection, recording_time, raw_message in self._recorded(sources):
            deserialized = partial(self._reader.deserialize, raw_message, connection.msgtype)
            source = sources[connection.topic]
            unpack = partial(
                received, recording_time, source, raw_message, connection.digest, deserialized
            )
            yield connection.topic, unpack

    def text_on(self, topic: str) -> Optional[str]:
        """Return the last text (std_msgs/String) on a topic, or None."""
        text = None
        for connection, _, raw_message in self._recorded([topic]):
            message: Any = self._reader.deserialize(raw_message, connection.msgtype)
            text = str(message.data)
        return text

    def _recorded(self, topics: Collection[str]) -> Iterable[Any]:
        """Return connection, time [ns] and raw message of all messages on topics.

        They are in the order of the file, as far as it has one: by their times, one could not see
        that a clock was set.
        """
        wanted_connections = []
        for connection in self._reader.connections:
            if connection.topic in topics:
                wanted_connections.append(connection)
        # Without connections, rosbags would return every message.
        if not wanted_connections:
            return ()
        messages = self._reader.messages(wanted_connections)
        places = []
        for connection in wanted_connections:
            # Bags of ROS 1 have an index of places in the file.
            places += getattr(connection.owner, "indexes", {}).get(connection.id, ())
        places.sort(key=attrgetter("time"))
        order = sorted(range(len(places)), key=lambda row: places[row][1:])
        times = np.array([places[row].time for row in order], np.int64)
        # As a rule the order is that of time, but for some milliseconds.
        if (np.diff(times) > -BACK_NS).all():
            return messages
        in_order_of_time = list(messages)
        return [in_order_of_time[row] for row in order]


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
            # A name that is not UTF-8 is shown in answers and on pages.
            bag = OpenBag(reader, os.fsencode(Path(path).name).decode(errors="replace"))
            if not bag.types:
                raise ApplrError("the bag holds no messages; record the drive again")
            yield bag
    except FileError as error:
        message = str(error)
        active_path = Path(f"{path}.active")
        if active_path.exists():
            message += f"; there is {active_path.name}"
        cause = error.__cause__
        lacks_index = isinstance(cause, AnyReaderError) and "index" in str(cause)
        if lacks_index or active_path.exists() or Path(path).suffix == ".active":
            message += f": {CUT_SHORT}"
        raise BagError(message) from error


# -- files -----------------------------------------------------------------------------------------
def bags_in(paths: Sequence[os.PathLike[str] | str]) -> List[Path]:
    """Return the bags among files and folders, those of a folder sorted.

    A bag is a .bag file, a ROS 2 folder, or a single .mcap or .db3 file.

    Raises:
        BagError: A path does not exist, or there is no bag.
    """
    remedy = "give .bag, .mcap or .db3 files or ROS 2 bag folders"
    bags: List[Path] = []
    left_out: List[str] = []
    for given_path in map(Path, paths):
        if not given_path.exists():
            raise BagError(f"{given_path}: there is no such file or folder: {remedy}")
        if given_path.is_file() or (given_path / METADATA).exists():
            bags.append(given_path)
            continue
        for path in sorted(given_path.rglob("*")):
            if _is_bag(path):
                bags.append(path)
            elif Path(path.stem).suffix in BAG_SUFFIXES and path.suffix in UNREAD_SUFFIXES:
                left_out.append(f"{path}: left out: {UNREAD_SUFFIXES[path.suffix]}")
    if not bags:
        problems = left_out or [f"{', '.join(map(str, paths))}: no bags there: {remedy}"]
        raise BagError("; ".join(problems))
    for problem in left_out:
        _LOGGER.warning(problem)
    return bags


def _is_bag(path: Path) -> bool:
    """Return whether a path is a bag. The files in a folder of ROS 2 are parts of one."""
    if (path / METADATA).exists():
        return True
    return path.suffix in BAG_SUFFIXES and not (path.parent / METADATA).exists()
