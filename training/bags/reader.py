"""Reads what a bag recorded of a drive: ROS 1 bags and ROS 2 / mcap folders alike, through rosbags.

episodes.py rebuilds transitions from it, APPLD its demonstrations. Only standard topics are needed; what the applr node
adds (/applr/decision) says exactly which messages a decision saw, and is compared where it is there.
"""

from __future__ import annotations

import json
import re
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Dict, Iterable, Iterator, List, Tuple

import numpy as np
from rosbags.highlevel import AnyReader
from rosbags.typesys import Stores, get_typestore

from applr_ros1 import robots
from applr_ros1.common.angles import yaw_of
from applr_ros1.common.errors import ApplrError, reason
from applr_ros1.policy.observation import layout_of
from applr_ros1.policy.parameter_space import space_of
from training.bags.compression import bound_rosbags
from training.common.command_line import AnyRobot
from training.common.options import Options, option

SECOND = 1_000_000_000
PATH_HEADER = 80  # a packed nav_msgs/Path of fewer bytes has no poses
RUNNING = (1, 6)  # actionlib: active, preempting


class BagError(ApplrError):
    """A bag that cannot be used as a whole; one line with which and why."""


@dataclass(frozen=True)
class TopicNames:
    """Where a drive was recorded. parameter_updates are found below move_base, whatever the layers are called."""

    scan: str = "/front/scan"
    odometry: str = "/odometry/filtered"
    plan: str = "/move_base/NavfnROS/plan"
    move_base: str = "/move_base"
    collision: str = "/sim_bridge/collision"
    applr: str = "/applr"
    command: str = "/cmd_vel"
    demonstration: str = "/demonstration"  # String: JSON of who demonstrated (demonstrate.py)

    @classmethod
    def of(cls, robot: robots.Robot) -> "TopicNames":
        """Those of a robot without a namespace."""
        given = robot.topics
        scan, odometry, command = ("/" + name.lstrip("/") for name in (given.scan, given.odometry, given.cmd_vel))
        return cls(scan=scan, odometry=odometry, command=command)


class BagOptions(Options):
    """Of which robot bags are, and where they hold what it recorded."""

    robot: AnyRobot
    scan: str = option("", "Topic of the laser scans in the bags. Default: the robot's.")
    odometry: str = option("", "Topic of the odometry in the bags. Default: the robot's.")
    command: str = option("", "Topic of the velocity commands in the bags. Default: the robot's.")

    def topics(self) -> TopicNames:
        """The robot's, and what is given instead."""
        given = {name: value for name, value in self if value and hasattr(TopicNames, name)}
        return replace(TopicNames.of(self.robot), **given)


@dataclass
class Recording:
    """The content of a bag in order of recording.

    Times are int64 nanoseconds. `at` is when a message was recorded, `stamp` is the time in its header.
    """

    path: Path
    topics: TopicNames
    robot: robots.Robot = robots.JACKAL  # which parameters were recorded, and how a policy of it sees a scan
    odometry: "Poses" = field(init=False)  # this and the next four: set by _fill
    scan_at: np.ndarray = field(init=False)  # (n,)
    scan_stamp: np.ndarray = field(init=False)  # (n,)
    plan_at: np.ndarray = field(init=False)  # (m,) plans that are not empty
    plan_stamp: np.ndarray = field(init=False)
    # {server as the space names it: [(at, {name: value}), ...]}
    parameters: Dict[str, List[Tuple[int, Dict[str, float]]]] = field(default_factory=dict)
    multipliers: Dict[str, float] = field(default_factory=dict)  # of parameters that the applr node sent multiplied
    status: List[Tuple[int, str]] = field(default_factory=list)  # (at, id of the running goal or "")
    results: Dict[str, Tuple[int, int]] = field(default_factory=dict)  # goal id → (at, actionlib status)
    goals: List[tuple] = field(default_factory=list)  # (at, frame, x, y, yaw)
    sent: List[Tuple[int, str]] = field(default_factory=list)  # goals by their own topic: (at, id)
    commands: List[Tuple[int, float, float]] = field(default_factory=list)  # (at, v [m/s], w [rad/s])
    source: Dict[str, Any] = field(default_factory=dict)  # who demonstrated, and where
    collisions: List[int] = field(default_factory=list)  # when a contact was reported
    transforms: Dict[Tuple[str, str], List[Tuple[int, tuple]]] = field(default_factory=dict)
    decisions: List[dict] = field(default_factory=list)  # /applr/decision, with "at"
    observations: Dict[int, List[tuple]] = field(default_factory=dict)  # decision number → [(at, (729,))]
    end: int = 0

    def __post_init__(self):
        self.space, self.layout = space_of(self.robot), layout_of(self.robot)

    def scans(self, wanted: Iterable[int]) -> Tuple[np.ndarray, Dict[int, Any]]:
        """Smallest range (n,) [m] of every scan, and {index: LaserScan} of those wanted. Reads the bag once more.

        NaN and 0, by which some lasers mean that nothing returned, are no ranges; the smallest is NaN where all are.
        """
        wanted, kept = set(wanted), {}
        nearest = np.full(len(self.scan_at), np.inf)
        for i, message in enumerate(self._messages(self.topics.scan)):
            if len(message.ranges) and i < len(nearest):
                nearest[i] = np.fmin.reduce(np.where(message.ranges == 0.0, np.nan, message.ranges))
            if i in wanted:
                kept[i] = message
        return nearest, kept

    def plans(self, wanted: Iterable[int]) -> Dict[int, Tuple[str, np.ndarray]]:
        """{index: (frame, (k, 2) points)} of the plans wanted. Reads the bag once more."""
        wanted, kept = set(wanted), {}
        for i, message in enumerate(self._messages(self.topics.plan, at_least=PATH_HEADER, wanted=wanted)):
            if message is not None:
                kept[i] = (
                    message.header.frame_id.lstrip("/"),
                    np.array([(p.pose.position.x, p.pose.position.y) for p in message.poses]),
                )
        return kept

    def _messages(self, topic, at_least=0, wanted=None):
        with _open(self.path) as reader:
            connections = [c for c in reader.connections if c.topic == topic]
            packed = (p for p in (reader.messages(connections) if connections else ()) if len(p[2]) >= at_least)
            for i, (connection, _, raw) in enumerate(packed):
                yield reader.deserialize(raw, connection.msgtype) if wanted is None or i in wanted else None


@dataclass
class Poses:
    """Odometry: at (n,), stamp (n,), pose (n, 3) x, y [m], yaw [rad], twist (n, 2) v [m/s], w [rad/s], its frame."""

    at: np.ndarray
    stamp: np.ndarray
    pose: np.ndarray
    twist: np.ndarray
    frame: str


def read_bag(path, topics: TopicNames = TopicNames(), robot: robots.Robot = robots.JACKAL) -> Recording:
    """Read a bag of a robot that move_base drove. BagError also where messages that are needed are not in it."""
    recording = read_messages(path, topics, robot)
    if not len(recording.scan_at):
        raise BagError(f"{path}: no scans on {topics.scan}")
    if not len(recording.odometry.stamp):
        raise BagError(f"{path}: no odometry on {topics.odometry}")
    if abs(np.median(recording.scan_at - recording.scan_stamp)) > SECOND:
        raise BagError(f"{path}: recorded on another clock than its messages'; set use_sim_time where you record")
    for server in dict(recording.space.places()):
        if server not in recording.parameters and not recording.decisions:
            raise BagError(f"{path}: no parameter_updates of {server or 'it'} below {topics.move_base}")
    return recording


def read_messages(path, topics: TopicNames, robot: robots.Robot) -> Recording:
    """Read a bag: everything but scans and plans, of which only the times are read; BagError where it is damaged."""
    recording = Recording(Path(path), topics, robot)
    with refused(path), _open(recording.path) as reader:
        _fill(recording, reader)
    return recording


@contextmanager
def refused(path) -> Iterator[None]:
    """Around what reads a bag: its errors become a BagError that names the bag."""
    try:
        yield
    except ApplrError as error:
        raise BagError(f"{path}: {str(error).removeprefix(f'{path}: ')}") from None
    except Exception as error:  # rosbags raises many kinds for damaged files
        remedy = "; it was not closed: try `rosbag reindex`" if Path(path).suffix in (".active", ".bag") else ""
        raise BagError(f"{path}: damaged or not a bag ({reason(error)}){remedy}") from None


def _open(path: Path) -> AnyReader:
    """A reader of a .bag file, or of a ROS 2 folder (with metadata.yaml) or .mcap file in it."""
    if not path.exists():
        raise BagError(f"{path}: not there")
    if path.is_file() and path.stat().st_size == 0:
        raise BagError(f"{path}: empty file")
    if path.suffix in (".mcap", ".db3") and (path.parent / "metadata.yaml").exists():
        path = path.parent
    for file in path.iterdir() if path.is_dir() else [path]:
        if not file.is_file() and not file.is_dir():
            raise BagError(f"{path}: {file.name} is a pipe or device; give a regular file")
    bound_rosbags()
    return AnyReader([path], default_typestore=get_typestore(Stores.ROS2_HUMBLE))


def _fill(recording: Recording, reader: AnyReader) -> None:
    topics, base = recording.topics, recording.topics.move_base
    light = {
        topics.odometry: _odometry,
        base + "/status": _status,
        base + "/result": _result,
        base + "/current_goal": _goal,
        base + "/goal": _sent,
        topics.command: _command,
        topics.demonstration: _demonstrator,
        topics.collision: _collision,
        "/tf": _tf,
        "/tf_static": _tf,
        topics.applr + "/decision": _decision,
        topics.applr + "/parameters": _multipliers,
    }
    updates = re.compile(re.escape(base) + r"(?:/[^/]+){0,2}/parameter_updates")
    heavy: Dict[str, List[Tuple[int, int]]] = {topics.scan: [], topics.plan: []}
    rows: List[tuple] = []
    connections = [c for c in reader.connections if c.topic in light or c.topic in heavy or updates.fullmatch(c.topic)]
    if not reader.message_count:
        raise BagError(f"{recording.path}: holds no messages")
    header = reader.typestore.fielddefs.get("std_msgs/msg/Header", ((), ()))[1]
    stamp_offset = 4 * reader.is2 + 4 * (header[0][0] == "seq" if header else 0)
    for connection, at, raw in reader.messages(connections) if connections else ():
        recording.end = at
        if connection.topic in heavy:
            seconds, nanoseconds = np.frombuffer(raw, "<i4", 2, stamp_offset).tolist()
            if connection.topic == topics.scan or len(raw) >= PATH_HEADER:
                heavy[connection.topic].append((at, seconds * SECOND + nanoseconds))
            continue
        message = reader.deserialize(raw, connection.msgtype)
        if connection.topic in light:
            light[connection.topic](recording, at, message, rows)
        else:
            _parameters(recording, at, message, connection.topic)
    for name, topic in (("scan", topics.scan), ("plan", topics.plan)):
        times = np.array(heavy[topic], dtype=np.int64).reshape(-1, 2)
        setattr(recording, name + "_at", times[:, 0])
        setattr(recording, name + "_stamp", times[:, 1])
    frame = rows[0][7] if rows else "odom"
    times = np.array([row[:2] for row in rows], dtype=np.int64).reshape(-1, 2)
    table = np.array([row[2:7] for row in rows], dtype=np.float64).reshape(-1, 5)
    recording.odometry = Poses(times[:, 0], times[:, 1], table[:, :3], table[:, 3:], frame)


def _odometry(recording, at, message, rows):
    p, q, t = message.pose.pose.position, message.pose.pose.orientation, message.twist.twist
    frame = message.header.frame_id.lstrip("/")
    rows.append((at, _stamp(message), p.x, p.y, yaw_of(q), t.linear.x, t.angular.z, frame))


def _status(recording, at, message, rows):
    running = [s.goal_id.id for s in message.status_list if s.status in RUNNING]
    recording.status.append((at, running[-1] if running else ""))


def _result(recording, at, message, rows):
    recording.results[message.status.goal_id.id] = (at, int(message.status.status))


def _goal(recording, at, message, rows):
    p, q = message.pose.position, message.pose.orientation
    recording.goals.append((at, message.header.frame_id.lstrip("/"), p.x, p.y, yaw_of(q)))


def _sent(recording, at, message, rows):
    recording.sent.append((at, message.goal_id.id))
    _goal(recording, at, message.goal.target_pose, rows)


def _command(recording, at, message, rows):
    message = getattr(message, "twist", message)  # TwistStamped too
    recording.commands.append((at, message.linear.x, message.angular.z))


def _demonstrator(recording, at, message, rows):
    try:
        said = json.loads(message.data)
    except (ValueError, RecursionError):
        return
    if isinstance(said, dict):
        recording.source = {str(k)[:40]: v if isinstance(v, (int, float)) else str(v)[:200] for k, v in said.items()}


def _collision(recording, at, message, rows):
    if getattr(message, "data", False):
        recording.collisions.append(at)


def _tf(recording, at, message, rows):
    for t in message.transforms:
        key = t.header.frame_id.lstrip("/"), t.child_frame_id.lstrip("/")
        p = t.transform.translation
        recording.transforms.setdefault(key, []).append((at, (p.x, p.y, yaw_of(t.transform.rotation))))


def _decision(recording, at, message, rows):
    number = int(message.number)
    before, after = (dict(zip(p.names, map(float, p.values))) for p in (message.before, message.after))
    stamps = {name: _nanoseconds(getattr(message, name)) for name in ("scan", "odometry", "plan")}
    decision = {"at": at, "number": number, "goal": message.goal, "stamp": _stamp(message), **stamps}
    recording.decisions.append(dict(decision, theta_prev=before, theta=after or None))
    observation = np.array(message.observation, dtype=np.float32)
    recording.observations.setdefault(number, []).append((at, observation))


def _nanoseconds(time) -> int:
    return int(time.sec) * SECOND + int(time.nanosec)


def _multipliers(recording, at, message, rows):
    """What the planner has from now on are a set's values multiplied by these."""
    given = {str(name): float(factor) for name, factor in zip(message.names, message.multipliers)}
    if set(given) <= set(recording.space.names) and all(0.0 < factor < np.inf for factor in given.values()):
        recording.multipliers = {name: factor for name, factor in given.items() if factor != 1.0}


def _parameters(recording, at, message, topic):
    values = {p.name: p.value for kind in ("bools", "ints", "doubles") for p in getattr(message, kind)}
    space = recording.space
    for name, factor in recording.multipliers.items():
        values.update((n, values[n] / factor) for n in space.targets[name][0].names if n in values)
    server = topic[len(recording.topics.move_base) : -len("/parameter_updates")].lstrip("/")
    place = server.rpartition("/")[0]
    for wanted in space.servers:  # layers have any name: one in the same place that knows the values
        names = (target.names for _, target in space.targets_of(wanted))
        if wanted.rpartition("/")[0] == place and all(any(n in values for n in known) for known in names):
            recording.parameters.setdefault(wanted, []).append((at, values))


def _stamp(message) -> int:
    """A header's stamp in nanoseconds."""
    return _nanoseconds(message.header.stamp)


def find(paths) -> List[Path]:
    """The bags among files and folders: .bag files, ROS 2 folders, and lone .mcap files, sorted.

    Raises:
        BagError: A path does not exist, or there are no bags.
    """
    found = []
    for path in map(Path, paths):
        if not path.exists():
            raise BagError(f"{path}: there is no such file or folder; give .bag or .mcap files or ROS 2 bag folders")
        if path.is_dir() and not (path / "metadata.yaml").exists():
            inside = sorted(path.rglob("*"))
            found += [
                p
                for p in inside
                if p.suffix == ".bag"
                or p.name.endswith(".bag.active")
                or (p.suffix == ".mcap" and not (p.parent / "metadata.yaml").exists())
                or (p.is_dir() and (p / "metadata.yaml").exists())
            ]
        else:
            found.append(path)
    if not found:
        raise BagError(f"{', '.join(map(str, paths))}: no bags there; give .bag or .mcap files or ROS 2 bag folders")
    return found
