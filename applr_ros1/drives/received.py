"""Messages of a drive in the order in which they came: from topics and messages to a Drive.

The reader of bags (training/bags) and the black box call it. It needs neither ROS nor rosbags.
"""

from __future__ import annotations

import logging
import math
from collections import Counter, defaultdict
from operator import attrgetter
from typing import (
    Any,
    Callable,
    Collection,
    Dict,
    Iterable,
    Iterator,
    List,
    Mapping,
    NamedTuple,
    Optional,
    Sequence,
    Tuple,
)

import numpy as np

from applr_ros1.common.angles import Pose
from applr_ros1.common.errors import ApplrError
from applr_ros1.common.scan import measured_ranges
from applr_ros1.drives import paths
from applr_ros1.drives.bag import UnpackedRow, drive_of
from applr_ros1.drives.columns import COLUMNS, SECOND, Row, Stamp, TopicNames, column_of, topic_of
from applr_ros1.drives.drive import Clearances, Drive, Scans
from applr_ros1.drives.outcome import nearest
from applr_ros1.drives.robot_time import RecordedStamp, RobotTime
from applr_ros1.robots import Robot

_LOGGER = logging.getLogger(__name__)
SENSORS = ("odometry", "scans")  # columns whose stamps may set the robot's time
BACK_NS = SECOND  # time by which those of a sensor go back if the clock was set [ns]
PAUSE_NS = 2 * SECOND  # time in which no topic has a message if all times jump [ns]
JUMPED_M = 0.5  # distance of the odometry from where it was that shows another drive [m]


class TopicSource(NamedTuple):
    """Source of rows: a topic's key in COLUMNS, and the planner or server in its name, as a field.

    Attributes:
        key: Key of the topic in COLUMNS.
        part: Field of the rows with the name of the planner or server; {} if the column has none.
    """

    key: str
    part: Row


class Received(NamedTuple):
    """Message that was received: when [ns], its topic's key in COLUMNS, and its rows."""

    recording_time: int
    key: str
    rows: List[Row]


def sources_of(
    types: Mapping[str, str], names: TopicNames, columns: Optional[Collection[str]] = None
) -> Dict[str, TopicSource]:
    """Return {topic: its source} of the topics that a drive has.

    Args:
        types: {topic: type} of a bag, or of a running system.
        names: Names of the topics.
        columns: Columns to read; None reads all.
    """
    sources = {}
    for key, column in COLUMNS.items():
        if columns is not None and column_of(key) not in columns:
            continue
        # MOVE_BASE/NAME, or MOVE_BASE/PART/NAME, such as a server's, which may hold slashes
        prefix, slash, name = topic_of(key, names, "").rpartition("/")
        for topic, message_type in types.items():
            part = topic[len(prefix + slash) : -len(name)].rstrip("/")
            middle = f"{part}/" if column.part and part else ""
            if topic == prefix + slash + middle + name and column.accepts(message_type):
                sources[topic] = TopicSource(key, {column.part: part} if column.part else {})
    return sources


def all_received(calls: Iterable[Tuple[str, Callable[[], Received]]], name: str) -> List[Received]:
    """Return messages with their rows. Those that cannot be unpacked are left out and logged.

    Args:
        calls: Topic of each message, and a call of `received`.
        name: Name of the drive, for the log.

    Raises:
        ApplrError: The messages of a topic cannot be read at all.
    """
    messages = []
    left_out: Counter[str] = Counter()
    for topic, receive in calls:
        try:
            messages.append(receive())
        except ApplrError:
            raise
        except Exception:
            # Whatever fails on a message that was cut, the others are whole.
            left_out[topic] += 1
    if left_out:
        counts = [f"{count} on {topic}" for topic, count in left_out.items()]
        _LOGGER.warning("%s: messages cut or damaged, left out: %s", name, ", ".join(counts))
    return messages


def received(
    recording_time: int,
    source: TopicSource,
    raw_message: bytes,
    digest: str,
    deserialized: Callable[[], Any],
) -> Received:
    """Return a message with its rows.

    Args:
        recording_time: When it came [ns].
        source: Its topic.
        raw_message: The serialised message of ROS 1.
        digest: MD5 sum of its definition.
        deserialized: Returns the message as an object, which takes long for a path.
    """
    plan_row = None
    if digest == paths.DIGEST:
        plan_row = paths.path_of(raw_message)
    if plan_row is not None:
        rows = [plan_row]
    else:
        rows = COLUMNS[source.key].unpack(deserialized())
    if source.part:
        for row in rows:
            row.update(source.part)
    return Received(recording_time, source.key, rows)


def drive_from(messages: Sequence[Received], robot: Robot, is_one: bool = False) -> Drive:
    """Return the drive of messages in the order in which they came. Times count from the first one.

    Args:
        messages: The messages.
        robot: Robot that drove.
        is_one: Whether they are to be one drive by one clock (by_one_clock).
    """
    notes: List[str] = []
    if is_one:
        messages, notes = by_one_clock(messages)
    messages = sorted(messages, key=attrgetter("recording_time"))
    # The robot's time at which each message was recorded, since the first one
    robot_time = RobotTime([_stamped(messages, sensor) for sensor in SENSORS])
    first_time = min((message.recording_time for message in messages), default=0)
    begin_time = robot_time.of(first_time)
    unpacked = defaultdict(list)
    for message in messages:
        elapsed = (robot_time.of(message.recording_time) - begin_time) / SECOND
        column = column_of(message.key)
        for row in message.rows:
            unpacked[column].append(UnpackedRow(elapsed, row))

    drive = drive_of(unpacked, begin_time, robot)
    drive.recorded_at = first_time / SECOND
    if robot_time.note:
        notes.append(robot_time.note)
    drive.notes += notes
    if drive.scans is not None:
        # A bag has the ranges as the laser's driver publishes them.
        no_return = robot.laser.no_return
        drive.scans.ranges = [measured_ranges(row, no_return) for row in drive.scans.ranges]
        drive.clearances = _clearances(drive.scans, robot)
    return drive


def by_one_clock(messages: Sequence[Received]) -> Tuple[List[Received], List[str]]:
    """Return messages in order of time by the clock at the end, and what is to be said of it.

    A clock that is set, a simulation that begins anew, and a recording that pauses all look alike:
    it is one drive if the odometry goes on where it was. Else the longer one counts.

    Args:
        messages: The messages in the order in which they came.
    """
    drive: List[Received] = []
    notes = []
    for part in _parts(messages):
        poses_before = _poses(drive)
        poses_after = _poses(part)
        # What comes before the first measurement and after the last one pauses as it likes.
        if not poses_before or not poses_after:
            drive = drive + part
            continue
        step = part[0].recording_time - drive[-1].recording_time
        driven = drive[-1].recording_time - drive[0].recording_time
        note = f"all times jump by {step / SECOND:,.0f} s after {driven / SECOND:.1f} s: "
        if math.dist(poses_before[-1][:2], poses_after[0][:2]) <= JUMPED_M:
            notes.append(f"{note}the clock was set, or the recording paused")
            later_part = [_set_later(message, -step, step) for message in part]
            drive = [_set_later(message, 0, step) for message in drive] + later_part
        else:
            notes.append(f"{note}the longer of two drives is read")
            drive = max(drive, part, key=len)
    return drive, notes


def _parts(messages: Sequence[Received]) -> Iterator[List[Received]]:
    """Yield the parts in which no time jumps, each in order of time."""
    starts = [0]
    latest_times: Dict[str, int] = {}
    for number, message in enumerate(messages):
        time = message.recording_time
        # Topics may be written one after the other: only the times of one topic show a jump back.
        if message.key in SENSORS and latest_times.get(message.key, time) - time > BACK_NS:
            start = number
            while messages[start - 1].recording_time <= time:
                start -= 1
            starts.append(start)
            latest_times.clear()
        latest_times[message.key] = time
    for start, end in zip(starts, [*starts[1:], len(messages)]):
        part = sorted(messages[start:end], key=attrgetter("recording_time"))
        pauses = np.diff([message.recording_time for message in part]) > PAUSE_NS
        edges = [0, *(np.flatnonzero(pauses) + 1), len(part)]
        for first, last in zip(edges, edges[1:]):
            yield part[first:last]


def _poses(messages: Sequence[Received]) -> List[Pose]:
    """Return the poses of the odometry in messages."""
    poses = []
    for message in messages:
        if message.key == "odometry":
            poses += [row["pose"] for row in message.rows]
    return poses


def _set_later(message: Received, since: int, step: int) -> Received:
    """Return a message around a jump of the clock by the clock after it.

    Args:
        message: The message. One that came after the jump may have been stamped before it.
        since: Jump of the clock until it came, with the other sign [ns].
        step: The jump [ns].
    """
    clock = message.recording_time + since
    rows = []
    for row in message.rows:
        set_row = dict(row)
        for name, value in row.items():
            # The stamps of a simulation are not by the clock of the recorder.
            if isinstance(value, Stamp) and abs(value - clock) < abs(step) / 2:
                set_row[name] = Stamp(value + step)
        rows.append(set_row)
    return message._replace(recording_time=clock + step, rows=rows)


def _stamped(messages: Sequence[Received], column: str) -> List[RecordedStamp]:
    """Return recording times and stamps [ns] of a sensor's messages that have a stamp."""
    stamped = []
    for message in messages:
        if message.key != column:
            continue
        for row in message.rows:
            if row["stamp"]:
                stamped.append((message.recording_time, row["stamp"]))
    return stamped


def _clearances(scans: Scans, robot: Robot) -> Clearances:
    """Return the smallest range of each scan, in order of the stamps."""
    rows_by_stamp = np.argsort(scans.stamp, kind="stable")
    smallest_ranges = []
    for scan_row in rows_by_stamp:
        smallest_ranges.append(nearest(scans.distances(scan_row), robot.laser.range_min))
    return Clearances(scans.stamp[rows_by_stamp], np.array(smallest_ranges))
