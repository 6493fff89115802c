"""Writer of ROS 1 bags with the topics of a robot's stack, without ROS, from simulated drives."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any, Dict, Mapping

from rosbags.rosbag1 import Writer

from applr_ros1.common.errors import ApplrError
from applr_ros1.drives.bag import rows_of
from applr_ros1.drives.columns import COLUMNS, Sender, TopicNames, topic_of
from applr_ros1.drives.drive import Drive
from applr_ros1.robots import JACKAL, Robot
from training.bags.maker import Maker, nanoseconds

BEGIN_S = 1.0  # ROS time of a bag's first drive, because 0 means "no time" [s]
PAUSE_S = 5.0  # time between two drives of a bag [s]


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
        rows = rows_of(drive, self.robot)
        begin = self._begin - rows[0].time
        for row in rows:
            sender = Sender(self.robot, drive.frame, begin, row.number)
            self.put(row.key, row.values, sender, row.part)
        self._begin = begin + rows[-1].time + PAUSE_S

    def put(self, key: str, values: Mapping[str, Any], sender: Sender, part: str = "") -> None:
        """Write a row of a topic of COLUMNS; `part` names its planner or server."""
        column = COLUMNS[key]
        message = self._maker.make(column.type, column.pack(values, sender))
        topic = topic_of(key, self.topics, part)
        if topic not in self._connections:
            self._connections[topic] = self._writer.add_connection(
                topic, column.type, typestore=self._maker.store
            )
        serialised = self._maker.store.serialize_ros1(message, column.type)
        time = nanoseconds(sender.begin + float(values["time"]))
        self._writer.write(self._connections[topic], time, serialised)
