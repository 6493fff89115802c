"""Writer of ROS 1 bags with the topics of a robot, without ROS, for demonstrate.py and tests."""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import Any, Dict, Sequence

import numpy as np
from rosbags.rosbag1 import Writer
from rosbags.typesys import Stores, get_typestore

from applr_ros1.common.angles import Pose, quaternion_of
from applr_ros1.common.errors import ApplrError
from applr_ros1.robots import JACKAL, Robot
from training.bags import SECOND
from training.bags.bag import TopicNames


class BagWriter:
    """Context manager that writes a ROS 1 bag with the topics of a robot's stack.

    Times are in seconds from 0. Until the bag is complete, it has a temporary name.

    Args:
        path: Path of the bag, which must not exist.
        topics: Names of the topics.
        robot: Robot whose laser and frames are used.

    Raises:
        ApplrError: The bag already exists.
    """

    def __init__(self, path: os.PathLike[str] | str, topics: TopicNames = TopicNames(), robot: Robot = JACKAL):
        self.path, self.topics, self.robot = Path(path), topics, robot
        self.store = get_typestore(Stores.ROS1_NOETIC)
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

    # -- the topics --------------------------------------------------------------------------------
    def scan(self, time: float, ranges: np.ndarray) -> None:
        """Write a scan: ranges (beams,) [m] of the robot's laser."""
        laser = self.robot.laser
        last = laser.first_angle + laser.increment * (len(ranges) - 1)
        fan = laser.first_angle, last, laser.increment, 0.0, 1.0 / laser.rate, laser.range_min, laser.range_max
        measured = np.ascontiguousarray(ranges, np.float32), np.empty(0, np.float32)
        header = self._header(time, laser.frame)
        self._put(self.topics.scan, "sensor_msgs/msg/LaserScan", time, header, *fan, *measured)

    def odometry(self, time: float, pose: Pose, twist: Sequence[float]) -> None:
        """Write the odometry: pose (x, y, yaw) [m, rad] in the robot's odometry frame, twist (v, w) [m/s, rad/s]."""
        frames, zeros = self.robot.frames, np.zeros(36)
        driven = self._make("geometry_msgs/msg/Twist", self._vector(twist[0]), self._vector(0.0, 0.0, twist[1]))
        where = self._make("geometry_msgs/msg/PoseWithCovariance", self._pose(pose), zeros)
        moving = self._make("geometry_msgs/msg/TwistWithCovariance", driven, zeros)
        header = self._header(time, frames.odom)
        self._put(self.topics.odometry, "nav_msgs/msg/Odometry", time, header, frames.base, where, moving)

    def command(self, time: float, v: float, w: float) -> None:
        """Write a command to the base [m/s, rad/s]."""
        self._put(self.topics.command, "geometry_msgs/msg/Twist", time, self._vector(v), self._vector(0.0, 0.0, w))

    def demonstrator(self, time: float, **what: Any) -> None:
        """Write demonstrator and place as JSON."""
        self._put(self.topics.demonstration, "std_msgs/msg/String", time, json.dumps(what))

    def goal(self, time: float, goal: Pose, frame: str = "") -> None:
        """Write a goal accepted by move_base: (x, y, yaw) in `frame`, by default the robot's odometry frame."""
        header = self._header(time, frame or self.robot.frames.odom)
        topic = self.topics.move_base + "/current_goal"
        self._put(topic, "geometry_msgs/msg/PoseStamped", time, header, self._pose(goal))

    # -- messages ----------------------------------------------------------------------------------
    def _put(self, topic: str, kind: str, time: float, *fields: Any) -> None:
        if topic not in self._connections:
            self._connections[topic] = self._writer.add_connection(topic, kind, typestore=self.store)
        message = self.store.serialize_ros1(self._make(kind, *fields), kind)
        self._writer.write(self._connections[topic], nanoseconds(time), message)

    def _make(self, kind: str, *fields: Any) -> Any:
        return self.store.types[kind](*fields)

    def _time(self, time: float) -> Any:
        return self._make("builtin_interfaces/msg/Time", *divmod(nanoseconds(time), SECOND))

    def _header(self, time: float, frame: str) -> Any:
        return self._make("std_msgs/msg/Header", 0, self._time(time), frame)

    def _vector(self, x: float, y: float = 0.0, z: float = 0.0, kind: str = "Vector3") -> Any:
        return self._make("geometry_msgs/msg/" + kind, float(x), float(y), float(z))

    def _pose(self, pose: Pose) -> Any:
        x, y, yaw = pose
        turn = self._make("geometry_msgs/msg/Quaternion", *quaternion_of(yaw))
        return self._make("geometry_msgs/msg/Pose", self._vector(x, y, kind="Point"), turn)


def nanoseconds(time: float) -> int:
    """Return a time [s] in whole nanoseconds."""
    return int(round(time * SECOND))
