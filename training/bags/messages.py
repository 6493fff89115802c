"""Reads the messages of a bag with rosbags. bag.py starts this file as a child process with limits.

A bag is somebody else's: it may unpack to any size or ask for endless work. So nothing else is done here, and what is
answered is arrays and JSON.
"""

from __future__ import annotations

import json
import os
import re
import sys
from array import array
from contextlib import closing
from pathlib import Path
from typing import Any, Callable, Dict, Iterable, List, Sequence, Tuple

import numpy as np
from rosbags import rosbag2
from rosbags.interfaces import MessageDefinitionFormat
from rosbags.rosbag1 import Reader, ReaderError
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from applr_ros1.common import child
from applr_ros1.common.angles import yaw_of
from applr_ros1.common.errors import ApplrError, reason
from training.bags import SECOND
from training.bags.topics import TopicNames
from training.bags.unindexed import UnindexedReader

RUNNING, ENDED = (1, 6), (2, 3, 4, 5)  # actionlib: active, preempting; preempted, succeeded, aborted, rejected


def main() -> None:
    """Answer with the arrays of a bag and, as "about", everything else in JSON; an "error" there is one line."""
    given = child.taken()
    with os.fdopen(os.dup(1), "wb") as answer:
        os.dup2(2, 1)  # what a library prints
        arrays: Dict[str, Any] = {}
        try:
            about, arrays = _read(Path(given["path"]), TopicNames(**given["topics"]), given["ranges"])
        except MemoryError:
            sys.exit(1)  # as where another limit ends this process
        except ApplrError as error:
            about = {"error": str(error)}
        except Exception as error:  # rosbags raises many kinds for damaged files
            about = {"error": f"damaged or not a bag ({reason(error)})"}
        np.savez(answer, about=np.frombuffer(json.dumps(about).encode(), np.uint8), **arrays)


def _read(path: Path, topics: TopicNames, ranges: bool) -> Tuple[Dict[str, Any], Dict[str, np.ndarray]]:
    """Return what _Messages reads."""
    reader = _opened(path)
    with closing(reader):
        if not reader.message_count:
            raise ApplrError("holds no messages")
        return _Messages(topics, ranges).read(reader)


class _Messages:
    """The messages of an open bag, as rows.

    Args:
        topics: Names of what is read.
        ranges: Whether the ranges of scans are kept.
    """

    def __init__(self, topics: TopicNames, ranges: bool):
        self.topics, self.keep_ranges = topics, ranges
        self.frames: Dict[str, str] = {}  # of scans and odometry
        self.ranges, self.seen = array("f"), array("d")  # of scans and of decisions

    def read(self, reader: Any) -> Tuple[Dict[str, Any], Dict[str, np.ndarray]]:
        """Return (what JSON holds, arrays), by the names of fields of Bag and its tables."""
        topics, base, end = self.topics, self.topics.move_base, 0
        make_rows: Dict[str, Callable[[Any], Iterable[tuple]]] = {
            topics.scan: self._scan,
            topics.odometry: self._odometry,
            base + "/status": _status,
            base + "/result": lambda m: [(m.status.goal_id.id, int(m.status.status))],
            base + "/current_goal": _goal,
            base + "/goal": lambda m: _goal(m.goal.target_pose),
            base + "_simple/goal": _goal,
            topics.command: _command,
            topics.demonstration: _demonstrator,
            topics.collision: lambda m: [()] if getattr(m, "data", False) else [],
            topics.decision: self._decision,
            topics.course_end: self._decision,
        }
        rows: Dict[str, List[tuple]] = {topic: [] for topic in make_rows}
        needed = [one for one in reader.connections if one.topic in make_rows]
        unpack = _unpacker(needed, isinstance(reader, Reader))
        for connection, end, raw in reader.messages(needed) if needed else ():
            found = make_rows[connection.topic](unpack(raw, connection.msgtype))
            rows[connection.topic] += [(end, *row) for row in found]
        ended = [(at, *one) for at, _, ends in reversed(rows[base + "/status"]) for one in ends]  # the first one counts
        about = {
            "goals": sorted(rows[base + "/current_goal"] or rows[base + "/goal"] or rows[base + "_simple/goal"]),
            "status": [(at, running) for at, running, _ in rows[base + "/status"]],
            "results": {goal: (at, status) for at, goal, status in ended + rows[base + "/result"]},
            "decisions": rows[topics.decision],
            "ends": rows[topics.course_end],
            "source": next((known for _, known in reversed(rows[topics.demonstration])), {}),
            "collisions": [at for (at,) in rows[topics.collision]],
            "end": end,
            "frame": self.frames.get("odometry", "odom"),
        }
        arrays = {
            **_columns("scan", rows[topics.scan], at=1, stamp=1, nearest=1, geometry=4, count=1),
            **_columns("odometry", rows[topics.odometry], at=1, stamp=1, pose=3, twist=2),
            **_columns("command", rows[topics.command], at=1, command=2),
            "ranges": np.frombuffer(self.ranges, np.float32),
            "seen": np.frombuffer(self.seen),
        }
        return about, arrays

    def _scan(self, m):
        """Return a row; NaN and 0, by which some lasers mean that nothing returned, are no ranges."""
        ranges = np.where(m.ranges == 0.0, np.nan, m.ranges)
        if _frame(m) != self.frames.setdefault("scan", _frame(m)):  # another laser on the same topic
            return []
        if self.keep_ranges:
            self.ranges.frombytes(np.asarray(m.ranges, np.float32).tobytes())
        geometry = m.angle_min, m.angle_increment, m.range_min, m.range_max
        return [(_stamp(m), np.fmin.reduce(ranges) if len(ranges) else np.inf, *geometry, len(ranges))]

    def _odometry(self, m):
        self.frames.setdefault("odometry", _frame(m))
        p, q, t = m.pose.pose.position, m.pose.pose.orientation, m.twist.twist
        return [(_stamp(m), p.x, p.y, yaw_of(q), t.linear.x, t.angular.z)]

    def _decision(self, m):
        """Return what msg/Decision.msg says: number and goal, stamps, both sets, and where in `seen` the rest is."""
        before, after = ([p.names, [float(value) for value in p.values]] for p in (m.before, m.after))
        parts: List[Any] = [[np.nan] * 11, [], [], []]
        if hasattr(m, "ranges"):  # older ones have an observation instead
            single = m.elapsed, m.x, m.y, m.yaw, m.v, m.w, m.goal_x, m.goal_y, m.goal_yaw, m.angle_min
            movers = [getattr(m.movers, name) for name in ("x", "y", "vx", "vy")]
            parts = [[*single, m.angle_increment], m.ranges, [m.plan_x, m.plan_y], movers]
        arrays, begin = [np.array(part, np.float64).ravel() for part in parts], len(self.seen)
        self.seen.frombytes(np.concatenate(arrays).tobytes())
        places = np.cumsum([begin, *map(len, arrays)]).tolist()
        return [(int(m.number), m.goal, _stamp(m), _nanoseconds(m.odometry), before, after, places)]


def _opened(path: Path) -> Any:
    """Return an open reader of a .bag file, a ROS 2 folder with metadata.yaml, or an .mcap file."""
    if not path.exists():
        raise ApplrError("not there")
    if path.is_file() and path.stat().st_size == 0:
        raise ApplrError("empty file")
    for file in path.iterdir() if path.is_dir() else [path]:
        if not file.is_file() and not file.is_dir():
            raise ApplrError(f"{file.name} is a pipe or device; give a regular file")
    reader: Any = Reader(path) if path.suffix == ".bag" else rosbag2.Reader(path)
    try:
        reader.open()
    except ReaderError as error:
        if not re.search("not indexed|index looks damaged", str(error)):
            raise
        reader = UnindexedReader(path)
        reader.open()
    return reader


def _unpacker(connections: Sequence[Any], is_ros1: bool) -> Callable[[bytes, str], Any]:
    """Return what unpacks messages. Raises ApplrError for a definition that is not as its checksum says."""
    types: Dict[Any, Any] = {}
    for one in connections:
        if one.msgdef.format == MessageDefinitionFormat.NONE:
            continue
        try:
            if one.msgdef.format != MessageDefinitionFormat.MSG:
                raise ValueError(one.msgdef.format)
            alone, found = get_typestore(Stores.EMPTY), get_types_from_msg(one.msgdef.data, one.msgtype)
            alone.register(found)
            digest = alone.generate_msgdef(one.msgtype)[1] if is_ros1 else alone.hash_rihs01(one.msgtype)
            if one.digest and digest != one.digest:
                raise ValueError(one.digest)
        except Exception:  # of a parser that was not made for what is no definition
            what = f"{one.topic} is {one.msgtype}, whose message definition in the bag is wrong"
            raise ApplrError(f"{what}: record it with another publisher") from None
        types.update(found)
    store = get_typestore(Stores.EMPTY if types else Stores.ROS2_HUMBLE)
    store.register(types)
    return store.deserialize_ros1 if is_ros1 else store.deserialize_cdr


def _columns(name: str, rows: Sequence[tuple], **widths: int) -> Dict[str, np.ndarray]:
    """Return {"name_column": array} of rows; times and numbers are int64."""
    found, first = {}, 0
    for column, width in widths.items():
        kind = np.int64 if column in ("at", "stamp", "count") else np.float64
        values = np.array([row[first : first + width] for row in rows], dtype=kind).reshape(-1, width)
        found[f"{name}_{column}"] = values[:, 0] if width == 1 else values
        first += width
    return found


def _status(m):
    """Return the running goal, and those that have ended, with their status."""
    running = [s.goal_id.id for s in m.status_list if s.status in RUNNING]
    ended = [(s.goal_id.id, int(s.status)) for s in m.status_list if s.status in ENDED]
    return [(running[-1] if running else "", ended)]


def _goal(m):
    p, q = m.pose.position, m.pose.orientation
    return [(_frame(m), p.x, p.y, yaw_of(q))]


def _command(m):
    m = getattr(m, "twist", m)  # TwistStamped too
    return [(m.linear.x, m.angular.z)]


def _demonstrator(m):
    try:
        known = json.loads(m.data)
    except (ValueError, RecursionError):
        return []
    if not isinstance(known, dict):
        return []
    return [({str(k)[:40]: v if isinstance(v, (int, float)) else str(v)[:200] for k, v in known.items()},)]


def _frame(m) -> str:
    return m.header.frame_id.lstrip("/")


def _stamp(m) -> int:
    """Return a header's stamp in nanoseconds."""
    return _nanoseconds(m.header.stamp)


def _nanoseconds(time) -> int:
    return int(time.sec) * SECOND + int(time.nanosec)


if __name__ == "__main__":
    main()
