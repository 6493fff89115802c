"""Reads what a bag recorded of a drive: ROS 1 bags and ROS 2 / mcap folders alike, through rosbags.

episodes.py rebuilds transitions from it, APPLD its demonstrations. Only standard topics are needed; what the applr node
adds (/applr/decision) says exactly which messages a decision saw, and what the planner had.
"""

from __future__ import annotations

import bz2
import json
import re
import sqlite3
from collections import Counter
from contextlib import closing, contextmanager, suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Callable, Dict, Iterable, Iterator, List, Sequence, Set, Tuple

import lz4.frame
import numpy as np
from rosbags.highlevel import AnyReader
from rosbags.interfaces import MessageDefinitionFormat, Nodetype
from rosbags.rosbag1 import reader as rosbag1
from rosbags.rosbag2 import reader as rosbag2
from rosbags.rosbag2 import storage_mcap, storage_sqlite3
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from applr_ros1 import robots
from applr_ros1.common import files
from applr_ros1.common.angles import yaw_of
from applr_ros1.common.errors import ApplrError, reason
from applr_ros1.common.yaml_files import read_yaml
from applr_ros1.policy.observation import layout_of
from applr_ros1.policy.parameter_space import space_of
from training.bags.cut_short import open_cut
from training.common.command_line import AnyRobot
from training.common.options import Options, option

SECOND = 1_000_000_000
RUNNING, ENDED = (1, 6), (2, 3, 4, 5)  # actionlib: active, preempting; preempted, succeeded, aborted, rejected
MAX_UNPACKED = 2**28  # bytes of one chunk; rosbag makes chunks of 768 kB
PIECE = 2**20
MAX_DEFINITION, MAX_ELEMENTS = 2**16, 1000  # characters, fixed lengths; MoveBaseActionGoal has 5,000, Odometry 72
# what may have any name
TYPES = {"scan": ("LaserScan",), "odometry": ("Odometry",), "command": ("Twist", "TwistStamped")}
METADATA = "metadata.yaml"  # of a ROS 2 bag


class BagError(ApplrError):
    """A bag that cannot be used as a whole; one line with which and why."""


@dataclass(frozen=True)
class TopicNames:
    """Where a drive was recorded. parameter_updates are found below move_base, whatever the layers are called."""

    scan: str = "/front/scan"  # first: its namespace is the robot's where there are several
    odometry: str = "/odometry/filtered"
    plan: str = "/move_base/NavfnROS/plan"
    move_base: str = "/move_base"
    collision: str = "/sim_bridge/collision"
    applr: str = "/applr"
    command: str = "/cmd_vel"
    demonstration: str = "/demonstration"  # String: JSON of who demonstrated (demonstrate.py)
    tf: str = "/tf"
    tf_static: str = "/tf_static"

    def needs(self, topic: str) -> bool:
        """Whether messages of a topic are read."""
        below = [self.move_base + name for name in ("/status", "/result", "/current_goal", "/goal", "_simple/goal")]
        named = [value for name, value in vars(self).items() if name not in ("move_base", "applr")]
        return topic in (*named, *below, self.applr + "/decision") or bool(self.updates.fullmatch(topic))

    def found(self, connections: Sequence[Any]) -> "TopicNames":
        """These names, and for what is not recorded there the same below a namespace, or else what is of its type.

        Of several it is that in the scan's namespace, or else that with the most messages, whatever its name.
        """
        kinds = {one.topic: one.msgtype.rpartition("/")[2] for one in connections}
        counts: Dict[str, int] = Counter()
        for one in connections:
            counts[one.topic] += one.msgcount
        chosen, space = {}, ""
        for name, wanted in vars(self).items():
            below = re.compile(f"(.*){re.escape(wanted)}(?:/.*)?")
            spaces = {found[1]: count for topic, count in counts.items() if (found := below.fullmatch(topic))}
            typed = {topic: counts[topic] for topic, kind in kinds.items() if kind in TYPES.get(name, ())}
            if "" in spaces or not wanted:
                continue
            best = max(spaces, key=lambda one: (one == space, spaces[one]), default="")
            if best and (best == space or name == "scan" or not typed):
                chosen[name], space = best + wanted, best if name == "scan" else space
            else:
                chosen[name] = max(typed, key=lambda topic: typed[topic], default=space + wanted)
        return replace(self, **chosen)

    @property
    def main(self) -> Tuple[str, ...]:
        """Those without which little can be said of a drive."""
        return self.scan, self.odometry, self.command, self.move_base, self.tf

    @property
    def updates(self) -> "re.Pattern[str]":
        """The topics on which move_base and its layers say new parameters."""
        return re.compile(re.escape(self.move_base) + r"(?:/[^/]+){0,2}/parameter_updates")

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
class Poses:
    """Odometry: at (n,), stamp (n,), pose (n, 3) x, y [m], yaw [rad], twist (n, 2) v [m/s], w [rad/s], its frame."""

    at: np.ndarray
    stamp: np.ndarray
    pose: np.ndarray
    twist: np.ndarray
    frame: str


@dataclass
class Recording:
    """The content of a bag in order of recording.

    Times are int64 nanoseconds. `at` is when a message was recorded, `stamp` is the time in its header.
    """

    path: Path
    topics: TopicNames
    robot: robots.Robot = robots.JACKAL  # which parameters were recorded, and how a policy of it sees a scan
    odometry: Poses = field(init=False)  # this and the next six: set by _fill
    scan_at: np.ndarray = field(init=False)  # (n,)
    scan_stamp: np.ndarray = field(init=False)  # (n,)
    nearest: np.ndarray = field(init=False)  # (n,) smallest range of each scan [m]; NaN where there is none
    plan_at: np.ndarray = field(init=False)  # (m,) plans that are not empty
    plan_stamp: np.ndarray = field(init=False)  # (m,)
    plans: List[Tuple[str, np.ndarray]] = field(init=False)  # m of (frame, (k, 2) points [m])
    # {server as the space names it: [(at, {name: value}), ...]}
    parameters: Dict[str, List[Tuple[int, Dict[str, float]]]] = field(default_factory=dict)
    status: List[Tuple[int, str]] = field(default_factory=list)  # (at, id of the running goal or "")
    results: Dict[str, Tuple[int, int]] = field(default_factory=dict)  # goal id → (at, actionlib status)
    goals: List[tuple] = field(default_factory=list)  # (at, frame, x, y, yaw)
    commands: List[Tuple[int, float, float]] = field(default_factory=list)  # (at, v [m/s], w [rad/s])
    source: Dict[str, Any] = field(default_factory=dict)  # who demonstrated, and where
    collisions: List[int] = field(default_factory=list)  # when a contact was reported
    transforms: Dict[Tuple[str, str], List[Tuple[int, tuple]]] = field(default_factory=dict)
    inverted: Set[Tuple[str, str]] = field(default_factory=set)  # of them those whose child hangs upside down
    decisions: List[dict] = field(default_factory=list)  # see _decision
    cut_short: bool = False  # there is no more of it than its first chunks
    end: int = 0

    def __post_init__(self):
        self.space, self.layout = space_of(self.robot), layout_of(self.robot)

    @property
    def silent(self) -> str:
        """A remark on servers whose parameters the bag does not say, so that the robot's files have to; "" for none."""
        servers = dict(self.space.places()) if not self.decisions else ()
        silent = ", ".join(server or "move_base" for server in servers if server not in self.parameters)
        return f"no parameter_updates of {silent}: values of the robot's files are taken" if silent else ""

    def scans(self, wanted: Iterable[int]) -> Dict[int, Any]:
        """{index: LaserScan} of those wanted. Reads the bag once more, since all scans may be larger than memory."""
        wanted, kept = set(wanted), {}
        with _open(self.path, self.topics) as reader:
            connections = [c for c in reader.connections if c.topic == self.topics.scan]
            for i, (connection, _, raw) in enumerate(reader.messages(connections) if wanted else ()):
                if i in wanted:
                    kept[i] = reader.deserialize(raw, connection.msgtype)
        return kept


def read_bag(path, topics: TopicNames = TopicNames(), robot: robots.Robot = robots.JACKAL) -> Recording:
    """Read a bag of a robot that move_base drove. BagError also where messages that are needed are not in it."""
    recording = read_messages(path, topics, robot)
    if not len(recording.scan_at):
        raise BagError(f"{path}: no scans on {topics.scan}")
    if not len(recording.odometry.stamp):
        raise BagError(f"{path}: no odometry on {topics.odometry}")
    if abs(np.median(recording.scan_at - recording.scan_stamp)) > SECOND:
        raise BagError(f"{path}: recorded on another clock than its messages'; set use_sim_time where you record")
    return recording


def read_messages(path, topics: TopicNames, robot: robots.Robot) -> Recording:
    """Read a bag: everything but the ranges of scans; BagError where it is damaged."""
    recording = Recording(Path(path), topics, robot)
    with refused(path), _open(recording.path, topics) as reader:
        _fill(recording, reader)
    return recording


def topics_in(path: Path, topics: TopicNames) -> TopicNames:
    """TopicNames.found in a bag. BagError where it is damaged."""
    with refused(path), _open(path, topics) as reader:
        return topics.found([connection for inner in reader.readers for connection in vars(inner)["recorded"]])


@contextmanager
def refused(path) -> Iterator[None]:
    """Around what reads a bag: its errors become a BagError that names the bag."""
    try:
        yield
    except ApplrError as error:
        raise BagError(f"{path}: {str(error).removeprefix(f'{path}: ')}") from None
    except Exception as error:  # rosbags raises many kinds for damaged files
        remedy = "; it was not closed: give it the ending .bag" if Path(path).suffix == ".active" else ""
        raise BagError(f"{path}: damaged or not a bag ({reason(error)}){remedy}") from None


def _only_needed(reader: Any, path: Path, topics: TopicNames, is_ros1: bool) -> None:
    """A reader of a bag knows the topics that are needed alone once it is open: definitions of others may be wrong.

    It raises BagError for the definition of a needed topic that cannot be read.
    """
    plain = reader.open

    def opened() -> None:
        try:
            plain()
        except rosbag1.ReaderError as error:
            if not re.search("not indexed|index looks damaged", str(error)):
                raise
            open_cut(reader)
            reader.cut_short = True
        reader.recorded = list(reader.connections)
        reader.connections[:] = [c for c in reader.connections if topics.needs(c.topic)]
        for connection in reader.connections:
            if connection.msgdef.format != MessageDefinitionFormat.NONE and not _is_right(connection, is_ros1):
                what = f"{connection.topic} is {connection.msgtype}, whose message definition in the bag is wrong"
                raise BagError(f"{path}: {what}: record it with another publisher")

    reader.open = opened


def _is_right(connection: Any, is_ros1: bool) -> bool:
    """Whether a message definition can be read, and its checksum is right; one that asks for endless work is wrong.

    rosbags makes a line for each element of an array of fixed length, calculates in IDL, and takes as many elements
    that have no bytes as a message says.
    """
    text = connection.msgdef.data
    elements = sum(int(length) for length in re.findall(r"\[(?:<=)?(\d{1,9})", text))
    if connection.msgdef.format != MessageDefinitionFormat.MSG or len(text) > MAX_DEFINITION or elements > MAX_ELEMENTS:
        return False
    with suppress(Exception):  # of a parser that was not made for what is no definition
        types, store = get_types_from_msg(text, connection.msgtype), get_typestore(Stores.EMPTY)

        def is_empty(kind: Any) -> bool:
            return kind[0] == Nodetype.NAME and kind[1] in types and all(is_empty(k) for _, k in types[kind[1]][1])

        kinds = [kind for _, fields in types.values() for _, kind in fields]
        if not any(kind[0] in (Nodetype.ARRAY, Nodetype.SEQUENCE) and is_empty(kind[1][0]) for kind in kinds):
            store.register(types)
            return not is_ros1 or store.generate_msgdef(connection.msgtype)[1] == connection.digest
    return False


def _open(path: Path, topics: TopicNames) -> AnyReader:
    """A reader of a .bag file, or of a ROS 2 folder (with metadata.yaml) or .mcap file in it."""
    if not path.exists():
        raise BagError(f"{path}: not there")
    if path.is_file() and path.stat().st_size == 0:
        raise BagError(f"{path}: empty file")
    if path.suffix in (".mcap", ".db3") and (path.parent / METADATA).exists():
        path = path.parent
    for file in path.iterdir() if path.is_dir() else [path]:
        if not file.is_file() and not file.is_dir():
            raise BagError(f"{path}: {file.name} is a pipe or device; give a regular file")
        if file.suffix == ".db3":
            with closing(sqlite3.connect(f"{file.absolute().as_uri()}?mode=ro", uri=True)) as database:
                files.check_tables(database, file)
    if path.is_dir():
        about = read_yaml(path / METADATA)["rosbag2_bagfile_information"]
        if about.get("compression_mode", "").lower() not in ("", "none"):
            raise BagError(f"{path}: its files or messages are compressed; rosbags-convert makes a bag that is not")
    # rosbags 0.11.9 (requirements/training.txt) unpacks a chunk of a few kilobytes to any size in one call, and has no
    # option for it: these tables are where it looks for the decompressor of a chunk
    rosbag1.decompressors["bz2"] = lambda data: unpack(bz2.BZ2Decompressor, data)
    rosbag1.decompressors["lz4"] = lambda data: unpack(lz4.frame.LZ4FrameDecompressor, data)
    storage_mcap.DECOMPRESSORS["lz4"] = lambda data, size: unpack(lz4.frame.LZ4FrameDecompressor, data)
    storage_mcap.DECOMPRESSORS["zstd"] = lambda data, size: unpack(storage_mcap.zstd.ZstdDecompressor, data)
    for module in (rosbag2, storage_mcap, storage_sqlite3):  # YAML in YAML, which nothing here needs
        vars(module)["parse_qos"] = lambda text: []
    reader = AnyReader([path], default_typestore=get_typestore(Stores.ROS2_HUMBLE))
    for inner in reader.readers:
        _only_needed(inner, path, topics, not reader.is2)
    return reader


def unpack(make: Callable[[], Any], data: bytes) -> bytes:
    """What `data` unpacks to, one stream after the other, in pieces, so that Ctrl-C is heard.

    Args:
        make: Makes a decompressor of bz2's interface: decompress(data, max_length), eof, unused_data.
        data: The compressed bytes.

    Raises:
        ApplrError: It is more than MAX_UNPACKED bytes.
        EOFError: The data end in the middle of a stream.
    """
    parts, size = [], 0
    while data:
        decompressor = make()
        while not decompressor.eof:
            part = decompressor.decompress(data, PIECE)
            data = b""
            size += len(part)
            if size > MAX_UNPACKED:
                raise ApplrError(f"unpacks to more than {MAX_UNPACKED >> 20} MiB")
            parts.append(part)
            if not part and decompressor.needs_input:
                raise EOFError("compressed data end too early")
        data = decompressor.unused_data
    return b"".join(parts)


def _fill(recording: Recording, reader: AnyReader) -> None:
    topics, base = recording.topics, recording.topics.move_base
    recording.cut_short = any(getattr(inner, "cut_short", False) for inner in reader.readers)
    rows_of: Dict[str, Callable[[Any], Iterable[tuple]]] = {
        topics.scan: _scan,
        topics.odometry: _odometry,
        topics.plan: _plan,
        base + "/status": _status,
        base + "/result": lambda m: [(m.status.goal_id.id, int(m.status.status))],
        base + "/current_goal": _goal,
        base + "/goal": lambda m: _goal(m.goal.target_pose),
        base + "_simple/goal": _goal,
        topics.command: _command,
        topics.demonstration: _demonstrator,
        topics.collision: lambda m: [()] if getattr(m, "data", False) else [],
        topics.tf: _tf,
        topics.tf_static: _tf,
        topics.applr + "/decision": _decision,
    }
    connections = [c for c in reader.connections if topics.needs(c.topic)]
    if not reader.message_count:
        raise BagError(f"{recording.path}: holds no messages")
    rows: Dict[str, List[tuple]] = {topic: [] for topic in rows_of}
    for connection, at, raw in reader.messages(connections) if connections else ():
        recording.end = at
        message = reader.deserialize(raw, connection.msgtype)
        if connection.topic in rows:
            rows[connection.topic] += [(at, *row) for row in rows_of[connection.topic](message)]
        else:
            _parameters(recording, at, message, connection.topic)
    recording.scan_at, recording.scan_stamp = _times(rows[topics.scan])
    recording.nearest = np.array([row[2] for row in rows[topics.scan]], dtype=np.float64)
    recording.plan_at, recording.plan_stamp = _times(rows[topics.plan])
    recording.plans = [row[2:] for row in rows[topics.plan]]
    driven = rows[topics.odometry]
    table = np.array([row[2:7] for row in driven], dtype=np.float64).reshape(-1, 5)
    recording.odometry = Poses(*_times(driven), table[:, :3], table[:, 3:], driven[0][7] if driven else "odom")
    recording.status = [(at, running) for at, running, _ in rows[base + "/status"]]
    ended = [(at, *end) for at, _, ends in reversed(rows[base + "/status"]) for end in ends]  # the first one counts
    recording.results = {goal: (at, status) for at, goal, status in ended + rows[base + "/result"]}
    recording.goals = sorted(rows[base + "/current_goal"] or rows[base + "/goal"] or rows[base + "_simple/goal"])
    recording.commands = rows[topics.command]
    recording.source = next((said for _, said in reversed(rows[topics.demonstration])), {})
    recording.collisions = [at for (at,) in rows[topics.collision]]
    for at, frames, pose, up in sorted(rows[topics.tf] + rows[topics.tf_static], key=lambda row: row[0]):
        recording.transforms.setdefault(frames, []).append((at, pose))
        recording.inverted.update([frames] if up < 0.0 else [])
    recording.decisions = [dict(decision, at=at) for at, decision in rows[topics.applr + "/decision"]]


def _times(rows) -> Tuple[np.ndarray, np.ndarray]:
    """The times at (n,) and stamp (n,), int64, of rows that begin with them."""
    times = np.array([row[:2] for row in rows], dtype=np.int64).reshape(-1, 2)
    return times[:, 0], times[:, 1]


def _scan(message):
    """NaN and 0, by which some lasers mean that nothing returned, are no ranges."""
    ranges = np.where(message.ranges == 0.0, np.nan, message.ranges)
    return [(_stamp(message), np.fmin.reduce(ranges) if len(ranges) else np.inf)]


def _plan(message):
    points = np.array([(p.pose.position.x, p.pose.position.y) for p in message.poses])
    return [(_stamp(message), message.header.frame_id.lstrip("/"), points)] if len(points) else []


def _odometry(message):
    p, q, t = message.pose.pose.position, message.pose.pose.orientation, message.twist.twist
    return [(_stamp(message), p.x, p.y, yaw_of(q), t.linear.x, t.angular.z, message.header.frame_id.lstrip("/"))]


def _status(message):
    """The running goal, and those that have ended, with their status."""
    running = [s.goal_id.id for s in message.status_list if s.status in RUNNING]
    ended = [(s.goal_id.id, int(s.status)) for s in message.status_list if s.status in ENDED]
    return [(running[-1] if running else "", ended)]


def _goal(message):
    p, q = message.pose.position, message.pose.orientation
    return [(message.header.frame_id.lstrip("/"), p.x, p.y, yaw_of(q))]


def _command(message):
    message = getattr(message, "twist", message)  # TwistStamped too
    return [(message.linear.x, message.angular.z)]


def _demonstrator(message):
    try:
        said = json.loads(message.data)
    except (ValueError, RecursionError):
        return []
    if not isinstance(said, dict):
        return []
    return [({str(k)[:40]: v if isinstance(v, (int, float)) else str(v)[:200] for k, v in said.items()},)]


def _tf(message):
    for t in message.transforms:
        frames, p = (t.header.frame_id.lstrip("/"), t.child_frame_id.lstrip("/")), t.transform.translation
        q = t.transform.rotation
        yield frames, (p.x, p.y, yaw_of(q)), 1.0 - 2.0 * (q.x**2 + q.y**2)


def _decision(message):
    """What msg/Decision.msg says: its number and goal, the stamps of what was seen, the observation, and both sets."""
    before, after = (dict(zip(p.names, map(float, p.values))) for p in (message.before, message.after))
    stamps = {name: _nanoseconds(getattr(message, name)) for name in ("scan", "odometry", "plan")}
    seen = np.array(message.observation, dtype=np.float32)
    decision = {"number": int(message.number), "goal": message.goal, "stamp": _stamp(message), **stamps}
    return [(dict(decision, before=before, after=after, observation=seen),)]


def _nanoseconds(time) -> int:
    return int(time.sec) * SECOND + int(time.nanosec)


def _stamp(message) -> int:
    """A header's stamp in nanoseconds."""
    return _nanoseconds(message.header.stamp)


def _parameters(recording, at, message, topic):
    values = {p.name: p.value for kind in ("bools", "ints", "doubles") for p in getattr(message, kind)}
    space = recording.space
    server = topic[len(recording.topics.move_base) : -len("/parameter_updates")].lstrip("/")
    place = server.rpartition("/")[0]
    for wanted in space.servers:  # layers have any name: one in the same place that knows the values
        names = (target.names for _, target in space.targets_of(wanted))
        if wanted.rpartition("/")[0] == place and all(any(n in values for n in known) for known in names):
            recording.parameters.setdefault(wanted, []).append((at, values))


def find(paths) -> List[Path]:
    """The bags among files and folders: .bag files, ROS 2 folders, and lone .mcap files, sorted.

    Raises:
        BagError: A path does not exist, or there are no bags.
    """
    found = []
    for path in map(Path, paths):
        if not path.exists():
            raise BagError(f"{path}: there is no such file or folder; give .bag or .mcap files or ROS 2 bag folders")
        holds_bags = path.is_dir() and not (path / METADATA).exists()
        found += [inside for inside in sorted(path.rglob("*")) if _is_bag(inside)] if holds_bags else [path]
    if not found:
        raise BagError(f"{', '.join(map(str, paths))}: no bags there; give .bag or .mcap files or ROS 2 bag folders")
    return found


def _is_bag(path: Path) -> bool:
    if path.suffix == ".mcap":
        return not (path.parent / METADATA).exists()
    return path.name.endswith((".bag", ".bag.active")) or (path / METADATA).exists()
