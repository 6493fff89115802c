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
from typing import Any, Callable, Dict, Iterable, List, Sequence, Set, Tuple

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
            about, arrays = _read(Path(given["path"]), TopicNames(**given["topics"]), given["search"], given["ranges"])
        except MemoryError:
            sys.exit(1)  # as where another limit ends this process
        except ApplrError as error:
            about = {"error": str(error)}
        except Exception as error:  # rosbags raises many kinds for damaged files
            about = {"error": f"damaged or not a bag ({reason(error)})"}
        np.savez(answer, about=np.frombuffer(json.dumps(about).encode(), np.uint8), **arrays)


def _read(path: Path, topics: TopicNames, search: bool, ranges: bool) -> Tuple[Dict[str, Any], Dict[str, np.ndarray]]:
    """Return what _Messages reads; with `search` topics that are not recorded are looked for under other names."""
    reader = _opened(path)
    with closing(reader):
        if not reader.message_count:
            raise ApplrError("holds no messages")
        found = topics.found(reader.connections) if search else topics
        about, arrays = _Messages(found, ranges).read(reader)
    return {**about, "cut_short": isinstance(reader, UnindexedReader)}, arrays


class _Messages:
    """The messages of an open bag, as rows.

    Args:
        topics: Names of what is read.
        ranges: Whether the ranges of scans are kept.
    """

    def __init__(self, topics: TopicNames, ranges: bool):
        self.topics, self.keep_ranges = topics, ranges
        self.frames: Dict[str, str] = {}  # of scans and odometry
        self.pairs: Dict[Tuple[str, str], int] = {}  # of frames in tf, numbered
        self.inverted: List[Tuple[str, str]] = []
        self.further: Set[str] = set()  # frames of other lasers on the topic of the scans
        self.ranges, self.seen = array("f"), array("d")  # of scans and of decisions

    def read(self, reader: Any) -> Tuple[Dict[str, Any], Dict[str, np.ndarray]]:
        """Return (what JSON holds, arrays), by the names of fields of Bag and its tables."""
        topics, base, end = self.topics, self.topics.move_base, 0
        needed = [one for one in reader.connections if topics.needs(one.topic)]
        unpack = _unpacker(needed, isinstance(reader, Reader))
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
            topics.tf: self._tf,
            topics.tf_static: self._tf,
            topics.decision: self._decision,
            topics.course_end: self._decision,
        }
        rows: Dict[str, List[tuple]] = {one.topic: [] for one in needed}
        rows.update((topic, []) for topic in make_rows)
        for connection, end, raw in reader.messages(needed) if needed else ():
            found = make_rows.get(connection.topic, _parameters)(unpack(raw, connection.msgtype))
            rows[connection.topic] += [(end, *row) for row in found]
        ended = [(at, *one) for at, _, ends in reversed(rows[base + "/status"]) for one in ends]  # the first one counts
        about = {
            "topics": vars(topics),
            "goals": sorted(rows[base + "/current_goal"] or rows[base + "/goal"] or rows[base + "_simple/goal"]),
            "status": [(at, running) for at, running, _ in rows[base + "/status"]],
            "results": {goal: (at, status) for at, goal, status in ended + rows[base + "/result"]},
            "updates": {topic: made for topic, made in rows.items() if topic not in make_rows},
            "decisions": rows[topics.decision],
            "ends": rows[topics.course_end],
            "source": next((known for _, known in reversed(rows[topics.demonstration])), {}),
            "collisions": [at for (at,) in rows[topics.collision]],
            "end": end,
            "frames": {"scan": "", "odometry": "odom", **self.frames},
            "pairs": list(self.pairs),
            "inverted": self.inverted,
            "further": sorted(self.further),
        }
        transforms = sorted(rows[topics.tf] + rows[topics.tf_static], key=lambda row: row[0])
        arrays = {
            **_columns("scan", rows[topics.scan], at=1, stamp=1, nearest=1, geometry=4, count=1),
            **_columns("odometry", rows[topics.odometry], at=1, stamp=1, pose=3, twist=2),
            **_columns("command", rows[topics.command], at=1, command=2),
            **_columns("tf", transforms, at=1, pair=1, pose=3),
            "ranges": np.frombuffer(self.ranges, np.float32),
            "seen": np.frombuffer(self.seen),
        }
        return about, arrays

    def _scan(self, m):
        """Return a row; NaN and 0, by which some lasers mean that nothing returned, are no ranges."""
        ranges = np.where(m.ranges == 0.0, np.nan, m.ranges)
        if _frame(m) != self.frames.setdefault("scan", _frame(m)):  # another laser on the same topic
            self.further.add(_frame(m))
            return []
        if self.keep_ranges:
            self.ranges.frombytes(np.asarray(m.ranges, np.float32).tobytes())
        geometry = m.angle_min, m.angle_increment, m.range_min, m.range_max
        return [(_stamp(m), np.fmin.reduce(ranges) if len(ranges) else np.inf, *geometry, len(ranges))]

    def _odometry(self, m):
        self.frames.setdefault("odometry", _frame(m))
        p, q, t = m.pose.pose.position, m.pose.pose.orientation, m.twist.twist
        return [(_stamp(m), p.x, p.y, yaw_of(q), t.linear.x, t.angular.z)]

    def _tf(self, m):
        for t in m.transforms:
            frames, p, q = (_frame(t), t.child_frame_id.lstrip("/")), t.transform.translation, t.transform.rotation
            if 1.0 - 2.0 * (q.x**2 + q.y**2) < 0.0:
                self.inverted.append(frames)
            yield self.pairs.setdefault(frames, len(self.pairs)), p.x, p.y, yaw_of(q)

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
        kind = np.int64 if column in ("at", "stamp", "count", "pair") else np.float64
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


def _parameters(m):
    """Return {name: value} of a dynamic_reconfigure/Config."""
    return [({p.name: p.value for kind in ("bools", "ints", "doubles") for p in getattr(m, kind)},)]


def _frame(m) -> str:
    return m.header.frame_id.lstrip("/")


def _stamp(m) -> int:
    """Return a header's stamp in nanoseconds."""
    return _nanoseconds(m.header.stamp)


def _nanoseconds(time) -> int:
    return int(time.sec) * SECOND + int(time.nanosec)


if __name__ == "__main__":
    main()
