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
from training.bags.topics import TopicNames
from training.bags.unindexed import UnindexedReader

SECOND = 1_000_000_000
RUNNING, ENDED = (1, 6), (2, 3, 4, 5)  # actionlib: active, preempting; preempted, succeeded, aborted, rejected


def main() -> None:
    """Answer with the arrays of a bag and, as "about", everything else in JSON; an "error" there is one line."""
    given = child.taken()
    with os.fdopen(os.dup(1), "wb") as answer:
        os.dup2(2, 1)  # what a library prints
        arrays: Dict[str, Any] = {}
        try:
            about, arrays = _Messages(Path(given["path"]), TopicNames(**given["topics"]), **given["how"]).read()
        except MemoryError:
            sys.exit(1)  # as where another limit ends this process
        except ApplrError as error:
            about = {"error": str(error)}
        except Exception as error:  # rosbags raises many kinds for damaged files
            about = {"error": f"damaged or not a bag ({reason(error)})"}
        np.savez(answer, about=np.frombuffer(json.dumps(about).encode(), np.uint8), **arrays)


class _Messages:
    """What is read of a bag, row by row.

    Args:
        path: A .bag file, a ROS 2 folder with metadata.yaml, or an .mcap file.
        topics: Names of what is read.
        search: Whether topics that are not recorded are looked for under other names.
        ranges: Whether the ranges of scans are kept.
    """

    def __init__(self, path: Path, topics: TopicNames, search: bool, ranges: bool):
        self.path, self.topics, self.search, self.keep_ranges = path, topics, search, ranges
        self.frames: Dict[str, str] = {}  # of scans and odometry
        self.pairs: Dict[Tuple[str, str], int] = {}  # of frames in tf, numbered
        self.inverted: List[Tuple[str, str]] = []
        self.ranges, self.observations = array("f"), array("f")

    def read(self) -> Tuple[Dict[str, Any], Dict[str, np.ndarray]]:
        """Return (what JSON holds, arrays); bag.py names them."""
        reader, cut_short = _opened(self.path)
        with closing(reader):
            if self.search:
                self.topics = self.topics.found(reader.connections)
            if not reader.message_count:
                raise ApplrError("holds no messages")
            needed = [one for one in reader.connections if self.topics.needs(one.topic)]
            is_ros1 = isinstance(reader, Reader)
            store = _types(needed, is_ros1)
            unpack = store.deserialize_ros1 if is_ros1 else store.deserialize_cdr
            make_rows, end = self._makers(), 0
            rows: Dict[str, List[tuple]] = {topic: [] for topic in make_rows}
            updates: List[tuple] = []
            for connection, end, raw in reader.messages(needed) if needed else ():
                message = unpack(raw, connection.msgtype)
                make = make_rows.get(connection.topic)
                if make:
                    rows[connection.topic] += [(end, *row) for row in make(message)]
                else:
                    updates.append((end, connection.topic, _values(message)))
        base = self.topics.move_base
        goals = rows[base + "/current_goal"] or rows[base + "/goal"] or rows[base + "_simple/goal"]
        transforms = sorted(rows[self.topics.tf] + rows[self.topics.tf_static], key=lambda row: row[0])
        about = {
            **{"topics": vars(self.topics), "cut_short": cut_short, "end": end, "frames": self.frames},
            **{"updates": updates, "goals": sorted(goals), "decisions": rows[self.topics.decision]},
            **{"status": rows[base + "/status"], "results": rows[base + "/result"]},
            **{"source": rows[self.topics.demonstration][-1:], "collisions": rows[self.topics.collision]},
            **{"pairs": list(self.pairs), "inverted": self.inverted},
        }
        arrays = {
            **_columns("scan", rows[self.topics.scan], at=1, stamp=1, nearest=1, geometry=4, count=1),
            **_columns("odometry", rows[self.topics.odometry], at=1, stamp=1, pose=3, twist=2),
            **_columns("command", rows[self.topics.command], at=1, command=2),
            **_columns("tf", transforms, at=1, pair=1, pose=3),
            **{name: np.frombuffer(getattr(self, name), np.float32) for name in ("ranges", "observations")},
        }
        return about, arrays

    def _makers(self) -> Dict[str, Callable[[Any], Iterable[tuple]]]:
        """By topic what makes the rows of a message; of all other topics it is parameters."""
        topics, base = self.topics, self.topics.move_base
        return {
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
        }

    def _scan(self, m):
        """NaN and 0, by which some lasers mean that nothing returned, are no ranges."""
        ranges = np.where(m.ranges == 0.0, np.nan, m.ranges)
        self.frames.setdefault("scan", _frame(m))
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
        """What msg/Decision.msg says: number and goal, stamps, both sets, and how long the observation is."""
        before, after = ([p.names, [float(value) for value in p.values]] for p in (m.before, m.after))
        observation = np.asarray(m.observation, np.float32)
        self.observations.frombytes(observation.tobytes())
        stamps = _stamp(m), _nanoseconds(m.scan), _nanoseconds(m.odometry)
        return [(int(m.number), m.goal, *stamps, before, after, len(observation))]


def _opened(path: Path) -> Tuple[Any, bool]:
    """A reader of a bag, open, and whether the bag is cut short."""
    if not path.exists():
        raise ApplrError("not there")
    if path.is_file() and path.stat().st_size == 0:
        raise ApplrError("empty file")
    for file in path.iterdir() if path.is_dir() else [path]:
        if not file.is_file() and not file.is_dir():
            raise ApplrError(f"{file.name} is a pipe or device; give a regular file")
    if path.suffix != ".bag":
        reader: Any = rosbag2.Reader(path)
        reader.open()
        return reader, False
    try:
        reader = Reader(path)
        reader.open()
        return reader, False
    except ReaderError as error:
        if not re.search("not indexed|index looks damaged", str(error)):
            raise
    reader = UnindexedReader(path)
    reader.open()
    return reader, True


def _types(connections: Sequence[Any], is_ros1: bool) -> Any:
    """A store of the types of messages. Raises ApplrError for a definition that is not what its checksum says."""
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
    if not types:
        return get_typestore(Stores.ROS2_HUMBLE)
    store = get_typestore(Stores.EMPTY)
    store.register(types)
    return store


def _columns(name: str, rows: Sequence[tuple], **widths: int) -> Dict[str, np.ndarray]:
    """{"name_column": array} of rows; times and numbers are int64."""
    found, first = {}, 0
    for column, width in widths.items():
        kind = np.int64 if column in ("at", "stamp", "count", "pair") else np.float64
        values = np.array([row[first : first + width] for row in rows], dtype=kind).reshape(-1, width)
        found[f"{name}_{column}"] = values[:, 0] if width == 1 else values
        first += width
    return found


def _status(m):
    """The running goal, and those that have ended, with their status."""
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


def _values(m):
    """The parameters {name: value} of a dynamic_reconfigure/Config."""
    return {p.name: p.value for kind in ("bools", "ints", "doubles") for p in getattr(m, kind)}


def _frame(m) -> str:
    return m.header.frame_id.lstrip("/")


def _stamp(m) -> int:
    """A header's stamp in nanoseconds."""
    return _nanoseconds(m.header.stamp)


def _nanoseconds(time) -> int:
    return int(time.sec) * SECOND + int(time.nanosec)


if __name__ == "__main__":
    main()
