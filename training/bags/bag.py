"""Content of a ROS 1 or ROS 2 bag as arrays: drives recorded by a robot with move_base.

rosbags reads the messages. Nothing in a bag is executed: rosbags takes only names, types and numbers from message
definitions. episodes.py converts a Bag to transitions, and demonstration.py to a demonstration for APPLD.
"""

from __future__ import annotations

import json
import os
from collections import defaultdict
from contextlib import contextmanager
from dataclasses import dataclass, replace
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Any, Callable, DefaultDict, Dict, Iterator, List, Mapping, NamedTuple, Sequence, Tuple

import numpy as np
from rosbags.highlevel import AnyReader, AnyReaderError
from rosbags.highlevel.anyreader import ReaderErrors
from rosbags.typesys import Stores, get_typestore

from applr_ros1.common.angles import yaw_of
from applr_ros1.common.errors import ApplrError, reason
from applr_ros1.policy.decision import Seen
from training.bags import SECOND
from training.common.command_line import AnyRobot
from training.common.options import Options, option

METADATA = "metadata.yaml"  # name of the file that marks the folder of a ROS 2 bag
Unpacker = Callable[[Any], Sequence[Any]]  # returns the fields of a message
RUNNING = 1, 6  # status codes of a running goal in actionlib: active, preempting


class BagError(ApplrError):
    """Error of a bag that cannot be used at all. The message has the bag and the reason, in one line."""


@dataclass(frozen=True)
class TopicNames:
    """Names of the topics of a recorded drive."""

    scan: str = "/front/scan"
    odometry: str = "/odometry/filtered"
    move_base: str = "/move_base"
    collision: str = "/sim_bridge/collision"
    applr: str = "/applr"
    command: str = "/cmd_vel"
    demonstration: str = "/demonstration"  # std_msgs/String with JSON about the demonstrator (demonstrate.py)

    @property
    def decision(self) -> str:
        """Topic of the applr node's decisions."""
        return self.applr + "/decision"

    @property
    def course_end(self) -> str:
        """Topic of the observation at the end of a course."""
        return self.applr + "/course_end"

    @classmethod
    def of(cls, robot: Any) -> TopicNames:
        """Return the topics of a robot (robots.Robot) that has no namespace."""
        given = robot.topics
        scan, odometry, command = ("/" + name.lstrip("/") for name in (given.scan, given.odometry, given.cmd_vel))
        return cls(scan=scan, odometry=odometry, command=command)


class BagOptions(Options):
    """Robot that recorded the bags, and topics of its recordings."""

    robot: AnyRobot
    scan: str = option("", "Topic of the laser scans in the bags. Default: the robot's.")
    odometry: str = option("", "Topic of the odometry in the bags. Default: the robot's.")
    command: str = option("", "Topic of the velocity commands in the bags. Default: the robot's.")

    def topics(self) -> TopicNames:
        """Return the robot's topics, replaced by those that are given as options."""
        given = {name: value for name, value in self if value and hasattr(TopicNames, name)}
        return replace(TopicNames.of(self.robot), **given)


class Poses(NamedTuple):
    """Odometry: stamp (n,) [ns], pose (n, 3) x, y [m], yaw [rad], twist (n, 2) v [m/s], w [rad/s], and frame."""

    stamp: np.ndarray
    pose: np.ndarray
    twist: np.ndarray
    frame: str


class Scans(NamedTuple):
    """Laser scans.

    Attributes:
        at: (n,) times of recording [ns].
        stamp: (n,) times in the headers [ns].
        nearest: (n,) smallest range of each scan [m]; NaN if a scan has no return.
        geometry: (n, 4) angle of the first range, angle between ranges [rad], minimum and maximum range [m].
        ranges: Unprocessed ranges (m,) float32 [m] of each scan; empty arrays if not requested.
    """

    at: np.ndarray
    stamp: np.ndarray
    nearest: np.ndarray
    geometry: np.ndarray
    ranges: List[np.ndarray]


class Decision(NamedTuple):
    """Decision of the applr node (msg/Decision.msg), with times [ns] and parameters {name: value}."""

    goal: str
    stamp: int
    scan: int
    before: Dict[str, float]
    after: Dict[str, float]
    seen: Seen


@dataclass
class Bag:
    """Content of a bag in order of recording.

    Times are int64 nanoseconds. `at` is the time of recording of a message, `stamp` the time in its header.

    Attributes:
        commands: (n,) times and (n, 2) v [m/s], w [rad/s].
        goals: (frame, x, y, yaw) of each goal that move_base accepted.
        status: (at, id of the running goal, or "" if no goal is running).
        results: {id of a goal: (time of its end, its actionlib status)}.
        ends: Observations of the applr node at the ends of courses, with the current parameters.
        collisions: Times of reported contacts.
        source: Demonstrator and place of a demonstration.
    """

    path: Path
    topics: TopicNames
    scans: Scans
    odometry: Poses
    commands: Tuple[np.ndarray, np.ndarray]
    goals: List[Tuple[str, float, float, float]]
    status: List[Tuple[int, str]]
    results: Dict[str, Tuple[int, int]]
    decisions: List[Decision]
    ends: List[Decision]
    collisions: List[int]
    source: Dict[str, Any]


def read(path: os.PathLike[str] | str, topics: TopicNames = TopicNames(), ranges: bool = True) -> Bag:
    """Read a bag.

    Args:
        path: A .bag file, a ROS 2 folder with metadata.yaml, or a single .mcap or .db3 file.
        topics: Names of the recorded topics.
        ranges: Whether to keep the ranges of scans.
    """
    base = topics.move_base
    unpackers: Dict[str, Unpacker] = {
        topics.scan: lambda m: _scan(m, ranges),
        topics.odometry: odometry_of,
        topics.command: command_of,
        base + "/status": lambda m: ([s.goal_id.id for s in m.status_list if s.status in RUNNING],),
        base + "/result": lambda m: (m.status.goal_id.id, int(m.status.status)),
        base + "/current_goal": lambda m: (_frame(m), *pose_of(m.pose)),
        topics.demonstration: lambda m: (json.loads(m.data),),
        topics.collision: lambda m: (m.data,),
        topics.decision: _decision,
        topics.course_end: _decision,
    }
    rows = messages(path, unpackers)
    scans, odometry, commands = (rows[topic] for topic in (topics.scan, topics.odometry, topics.command))
    nearest, geometry, kept = _numbers(scans, 2, 1)[:, 0], _numbers(scans, 3, 4), [row[7] for row in scans]
    frame = odometry[0][2] if odometry else "odom"
    return Bag(
        Path(path),
        topics,
        Scans(_times(scans, 0), _times(scans, 1), nearest, geometry, kept),
        Poses(_times(odometry, 1), _numbers(odometry, 3, 3), _numbers(odometry, 6, 2), frame),
        (_times(commands, 0), _numbers(commands, 1, 2)),
        [goal for _, *goal in rows[base + "/current_goal"]],
        [(at, running[-1] if running else "") for at, running in rows[base + "/status"]],
        {goal: (at, status) for at, goal, status in rows[base + "/result"]},
        [Decision(*row) for _, *row in rows[topics.decision]],
        [Decision(*row) for _, *row in rows[topics.course_end]],
        [at for at, touches in rows[topics.collision] if touches],
        rows[topics.demonstration][-1][1] if rows[topics.demonstration] else {},
    )


def messages(path: os.PathLike[str] | str, unpackers: Mapping[str, Unpacker]) -> DefaultDict[str, List[Any]]:
    """Return the messages of a bag by topic as rows (time of recording [ns], *fields); names may contain `*`."""
    rows: DefaultDict[str, List[Any]] = defaultdict(list)
    with AnyReader([Path(path)], default_typestore=get_typestore(Stores.ROS2_HUMBLE)) as reader:
        every = ((one.topic, name) for one in reader.connections for name in unpackers if fnmatchcase(one.topic, name))
        wanted = {topic: unpackers[name] for topic, name in every}
        needed = [one for one in reader.connections if one.topic in wanted]
        for connection, at, raw in reader.messages(needed) if needed else ():
            message = reader.deserialize(raw, connection.msgtype)
            rows[connection.topic].append((at, *wanted[connection.topic](message)))
    return rows


@contextmanager
def refused(path: os.PathLike[str] | str) -> Iterator[None]:
    """Convert errors of rosbags, and ApplrErrors, to a BagError that names the bag."""
    try:
        yield
    except (ApplrError, AnyReaderError, *ReaderErrors) as error:
        remedy = ": if its recording was cut short, run rosbag reindex" if "index" in str(error) else ""
        raise BagError(f"{path}: {reason(error)}{remedy}") from None


def bags_in(paths: Sequence[os.PathLike[str] | str]) -> List[Path]:
    """Return the bags among files and folders, sorted: .bag files, ROS 2 folders, and single .mcap or .db3 files.

    Raises:
        BagError: A path does not exist, or there is no bag.
    """
    kinds = "give .bag, .mcap or .db3 files or ROS 2 bag folders"
    bags: List[Path] = []
    for path in map(Path, paths):
        if not path.exists():
            raise BagError(f"{path}: there is no such file or folder: {kinds}")
        is_bag = path.is_file() or (path / METADATA).exists()
        inside = [] if is_bag else sorted(path.rglob("*"))
        bags += [path] if is_bag else [one for one in inside if one.suffix == ".bag" or (one / METADATA).exists()]
    if not bags:
        raise BagError(f"{', '.join(map(str, paths))}: no bags there: {kinds}")
    return bags


# -- messages ----------------------------------------------------------------------------------------------------------
def _scan(m: Any, keep: bool) -> Sequence[Any]:
    """Return stamp, nearest range, geometry and ranges. Some lasers report NaN or 0 for beams without a return."""
    ranges = np.where(m.ranges == 0.0, np.nan, m.ranges)
    nearest = np.fmin.reduce(ranges) if len(ranges) else np.inf
    geometry = m.angle_min, m.angle_increment, m.range_min, m.range_max
    return nanoseconds_of(m.header.stamp), nearest, *geometry, np.array(m.ranges if keep else (), np.float32)


def odometry_of(m: Any) -> Sequence[Any]:
    """Return stamp [ns], frame, pose (x, y, yaw) and twist (v, w) of a nav_msgs/Odometry."""
    twist = m.twist.twist
    return nanoseconds_of(m.header.stamp), _frame(m), *pose_of(m.pose.pose), twist.linear.x, twist.angular.z


def command_of(m: Any) -> Sequence[Any]:
    """Return (v, w) of a geometry_msgs/Twist or TwistStamped."""
    m = getattr(m, "twist", m)
    return m.linear.x, m.angular.z


def _decision(m: Any) -> Sequence[Any]:
    """Return the fields of a Decision."""
    before, after = (dict(zip(p.names, p.values.tolist())) for p in (m.before, m.after))
    scan = m.ranges.astype(np.float32), m.angle_min, m.angle_increment
    movers = np.column_stack([np.float64(getattr(m.movers, name)) for name in ("x", "y", "vx", "vy")])
    pose, goal = (m.x, m.y, m.yaw), (m.goal_x, m.goal_y, m.goal_yaw)
    seen = Seen(scan, m.elapsed, pose, (m.v, m.w), goal, np.column_stack([m.plan_x, m.plan_y]), movers)
    return m.goal, nanoseconds_of(m.header.stamp), nanoseconds_of(m.scan), before, after, seen


def pose_of(m: Any) -> Tuple[float, float, float]:
    """Return (x, y, yaw) of a geometry_msgs/Pose."""
    return m.position.x, m.position.y, yaw_of(m.orientation)


def _frame(m: Any) -> str:
    return str(m.header.frame_id.lstrip("/"))


def nanoseconds_of(time: Any) -> int:
    """Return a time of a message [ns]."""
    return int(time.sec) * SECOND + int(time.nanosec)


def _times(rows: Sequence[Any], column: int) -> np.ndarray:
    """Return a column of rows as int64 (n,) [ns]."""
    return np.array([row[column] for row in rows], np.int64)


def _numbers(rows: Sequence[Any], first: int, width: int) -> np.ndarray:
    """Return columns of rows as float64 (n, width)."""
    return np.array([row[first : first + width] for row in rows], np.float64).reshape(-1, width)
