"""Reader of ROS 1 and ROS 2 bags: the drive of a robot with move_base, in columns.

rosbags reads the messages. Nothing in a bag is executed: rosbags takes only names, types and
numbers from message definitions.
"""

from __future__ import annotations

import os
from collections import defaultdict
from contextlib import contextmanager
from fnmatch import fnmatchcase
from operator import itemgetter
from pathlib import Path
from typing import (
    Any,
    Collection,
    DefaultDict,
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
from rosbags.highlevel import AnyReader, AnyReaderError
from rosbags.typesys import Stores, get_typestore

from applr_ros1.common.errors import ApplrError
from applr_ros1.common.files import FileError, check_regular, reading
from applr_ros1.drives.drive import (
    Changes,
    Clearances,
    Commands,
    Decision,
    Drive,
    Goal,
    Motion,
    Plans,
    Scans,
    SentGoal,
    Transforms,
)
from applr_ros1.drives.outcome import nearest
from applr_ros1.robots import JACKAL, Robot
from training.bags import SECOND, paths
from training.bags.robot_time import RecordedStamp, RobotTime
from training.bags.topics import CHANNELS, TopicNames, topic_of

SENSORS = ("odometry", "scans")  # channels whose stamps may set the robot's time
METADATA = "metadata.yaml"  # name of the file that marks the folder of a ROS 2 bag


class BagError(ApplrError):
    """Error of a bag that cannot be used at all. Its message is one line with bag and reason."""


class Row(NamedTuple):
    """Message of a bag.

    Attributes:
        time: Robot's time at which it was recorded, since the first message [s].
        topic: Name of its topic.
        fields: What the channel's `unpack` took out of it.
    """

    time: float
    topic: str
    fields: Tuple[Any, ...]


def read(
    path: os.PathLike[str] | str,
    robot: Robot = JACKAL,
    topics: TopicNames = TopicNames(),
    channels: Collection[str] = tuple(CHANNELS),
) -> Drive:
    """Read the drive in a bag.

    Args:
        path: A .bag file, a ROS 2 folder with metadata.yaml, or a single .mcap or .db3 file.
        robot: Robot that drove.
        topics: Names of the recorded topics.
        channels: Channels to read (topics.CHANNELS). Times count from the first message on one of
            their topics.
    """
    rows, begin_time, notes = _rows(Path(path), topics, channels)

    def seconds(nanoseconds: int) -> float:
        return (nanoseconds - begin_time) / SECOND

    drive = Drive(
        name=Path(path).name,
        odometry=_motion(rows["odometry"], seconds),
        scans=_scans(rows["scans"], seconds),
        transforms=_transforms(rows, seconds),
        routes=_routes(rows["routes"]),
        planned=_commands(rows["planned"]),
        commands=_commands(rows["commands"]),
        changes=_changes(rows["changes"], topics),
        decisions=_decisions(rows["decisions"], seconds),
        ends=_decisions(rows["ends"], seconds),
        sent=[SentGoal(row.time, *row.fields) for row in rows["sent"]],
        goals=_goals(rows["status"], rows["results"]),
        contacts=_contacts(rows["contacts"]),
        recoveries=_times(rows["recoveries"]),
        notes=notes,
    )
    # If several planners are recorded, the robot followed the plans of its own.
    by_planner = _by_planner(rows["plans"])
    drive.planners = sorted(by_planner)
    rows["plans"] = by_planner[robot.local_planner]
    if rows["plans"]:
        drive.plans = _plans(rows["plans"])

    for column in ("odometry", "scans", "plans", "routes"):
        if rows[column]:
            _, frames, *_ = _columns(rows[column])  # after the stamps
            drive.frames[column] = list(dict.fromkeys(frames))
        else:
            drive.frames[column] = []
    if rows["odometry"]:
        drive.frame = drive.frames["odometry"][0]
    if rows["scans"]:
        drive.clearances = _clearances(drive.scans, robot)
    if rows["source"]:
        (drive.source,) = rows["source"][-1].fields
    return drive


def topics_in(path: os.PathLike[str] | str) -> Dict[str, str]:
    """Return {topic: type} of the messages in a bag."""
    message_types = {}
    with AnyReader([Path(path)], default_typestore=get_typestore(Stores.ROS2_HUMBLE)) as reader:
        for connection in reader.connections:
            # ROS 2's recorder also lists topics without messages.
            if connection.msgcount:
                message_types[connection.topic] = connection.msgtype
    return message_types


def _rows(
    path: Path, topics: TopicNames, channels: Collection[str]
) -> Tuple[DefaultDict[str, List[Row]], int, List[str]]:
    """Return the messages by channel in order of recording, the time of the first, and notes.

    The time is that of the robot [ns].
    """
    recorded_messages: List[Tuple[int, str, str, Any]] = []
    # A ROS 2 bag without message definitions has those of this release.
    with AnyReader([path], default_typestore=get_typestore(Stores.ROS2_HUMBLE)) as reader:
        channel_of_topic = _channel_of_topic(reader, topics, channels)
        wanted_connections = []
        for connection in reader.connections:
            if connection.topic in channel_of_topic:
                wanted_connections.append(connection)
        # Without connections, rosbags would return every message.
        messages: Iterable[Any] = ()
        if wanted_connections:
            messages = reader.messages(wanted_connections)
        for connection, recording_time, raw_message in messages:
            channel = channel_of_topic[connection.topic]
            fields = None
            if connection.digest == paths.DIGEST:
                fields = paths.path_of(raw_message)
            if fields is None:
                message = reader.deserialize(raw_message, connection.msgtype)
                fields = CHANNELS[channel].unpack(message)
            recorded_messages.append((recording_time, channel, connection.topic, fields))

    robot_time = RobotTime([_stamped(recorded_messages, sensor) for sensor in SENSORS])
    first_time = min((recording_time for recording_time, *_ in recorded_messages), default=0)
    begin_time = robot_time.of(first_time)
    rows: DefaultDict[str, List[Row]] = defaultdict(list)
    for recording_time, channel, topic, fields in recorded_messages:
        elapsed = robot_time.of(recording_time) - begin_time
        rows[channel].append(Row(elapsed / SECOND, topic, fields))
    notes = [robot_time.note] if robot_time.note else []
    return rows, begin_time, notes


def _stamped(
    recorded_messages: Sequence[Tuple[int, str, str, Any]], channel: str
) -> List[RecordedStamp]:
    """Return recording times and stamps [ns] of a channel's messages that have a stamp."""
    stamped = []
    for recording_time, message_channel, _, fields in recorded_messages:
        # The stamp is the first of a sensor's fields.
        if message_channel == channel and fields[0]:
            stamped.append((recording_time, fields[0]))
    return stamped


def _channel_of_topic(
    reader: AnyReader, topics: TopicNames, channels: Collection[str]
) -> Dict[str, str]:
    """Return {topic: channel} of the topics of a bag that are read."""
    patterns = {topic_of(channel, topics): channel for channel in channels}
    channel_of_topic = {}
    for connection in reader.connections:
        for pattern, channel in patterns.items():
            is_named = fnmatchcase(connection.topic, pattern)
            if is_named and CHANNELS[channel].accepts(connection.msgtype):
                channel_of_topic[connection.topic] = channel
    return channel_of_topic


# -- columns ---------------------------------------------------------------------------------------
def _times(rows: Sequence[Row]) -> np.ndarray:
    return np.array([row.time for row in rows], np.float64)


def _stamps(rows: Sequence[Row], seconds: Any) -> np.ndarray:
    """Return the stamps (n,) [s] of a sensor's messages; without a stamp, when they came."""
    stamps = []
    for row in rows:
        stamp = row.fields[0]
        stamps.append(seconds(stamp) if stamp else row.time)
    return np.array(stamps, np.float64)


def _columns(rows: Sequence[Row]) -> List[Tuple[Any, ...]]:
    """Return each field of some messages, at least one, as its channel's `unpack` orders them."""
    return list(zip(*(row.fields for row in rows)))


def _by_planner(rows: Sequence[Row]) -> DefaultDict[str, List[Row]]:
    """Return plans by the name of their planner. Their topics are MOVE_BASE/PLANNER/NAME."""
    by_planner: DefaultDict[str, List[Row]] = defaultdict(list)
    for row in rows:
        planner = row.topic.split("/")[-2]
        by_planner[planner].append(row)
    return by_planner


def _contacts(rows: Sequence[Row]) -> np.ndarray:
    """Return the times (n,) [s] of messages that tell of a contact."""
    contact_times = []
    for row in rows:
        (touches,) = row.fields
        if touches:
            contact_times.append(row.time)
    return np.array(contact_times)


def _motion(rows: Sequence[Row], seconds: Any) -> Optional[Motion]:
    if not rows:
        return None
    _, _, poses, twists = _columns(rows)
    return Motion(
        time=_times(rows),
        stamp=_stamps(rows, seconds),
        pose=np.array(poses, np.float64),
        twist=np.array(twists, np.float64),
    )


def _scans(rows: Sequence[Row], seconds: Any) -> Optional[Scans]:
    if not rows:
        return None
    _, _, fans, ranges = _columns(rows)
    return Scans(
        time=_times(rows),
        stamp=_stamps(rows, seconds),
        fan=np.array(fans, np.float64),
        ranges=list(ranges),
    )


def _clearances(scans: Any, robot: Robot) -> Clearances:
    """Return the smallest range of each scan, in order of the stamps."""
    rows_by_stamp = np.argsort(scans.stamp, kind="stable")
    smallest_ranges = []
    for scan_row in rows_by_stamp:
        ranges = scans.ranges[scan_row]
        if not len(ranges):
            smallest_ranges.append(np.inf)
            continue
        # Some lasers report 0 for beams without a return.
        measured = np.where(ranges == 0.0, np.nan, ranges)
        smallest_ranges.append(nearest(measured, robot.laser.range_min))
    return Clearances(scans.stamp[rows_by_stamp], np.array(smallest_ranges))


def _commands(rows: Sequence[Row]) -> Optional[Commands]:
    if not rows:
        return None
    (twists,) = _columns(rows)
    return Commands(_times(rows), np.array(twists, np.float64))


def _plans(rows: Sequence[Row]) -> Plans:
    _, _, paths = _columns(rows)
    return Plans(_times(rows), list(paths))


def _routes(rows: Sequence[Row]) -> Optional[Plans]:
    """Return the plans of the global planner.

    Navfn publishes each plan twice, first without the goal's pose (navfn_ros.cpp, makePlan). Both
    have one stamp; the second is the one that the local planner gets.
    """
    if not rows:
        return None
    stamps, _, _ = _columns(rows)
    complete_plans = []
    for row_index, row in enumerate(rows):
        is_last_of_stamp = row_index + 1 == len(rows) or stamps[row_index + 1] != stamps[row_index]
        if is_last_of_stamp:
            complete_plans.append(row)
    return _plans(complete_plans)


def _transforms(rows: Mapping[str, Sequence[Row]], seconds: Any) -> Optional[Transforms]:
    """Return the places of frames in tf's messages. Rotations of no length are left out."""
    frame_links: List[Tuple[Any, ...]] = []
    for channel in ("transforms", "static_transforms"):
        is_static = channel == "static_transforms"
        for row in rows[channel]:
            (placed_frames,) = row.fields
            for stamp, parent, child, frame_place in placed_frames:
                quaternion = frame_place[3:]
                if np.isfinite(frame_place).all() and np.linalg.norm(quaternion) > 0.0:
                    link = row.time, seconds(stamp), parent, child, frame_place, is_static
                    frame_links.append(link)
    if not frame_links:
        return None
    # Both channels, in order of recording
    frame_links.sort(key=itemgetter(0))
    times, stamps, parents, children, places, statics = zip(*frame_links)
    return Transforms(
        time=np.array(times, np.float64),
        stamp=np.array(stamps, np.float64),
        parent=list(parents),
        child=list(children),
        place=np.array(places, np.float64),
        is_static=list(statics),
    )


def _changes(rows: Sequence[Row], topics: TopicNames) -> Optional[Changes]:
    if not rows:
        return None
    # A topic is MOVE_BASE/SERVER/parameter_updates, and a server's name may hold slashes.
    prefix, suffix = topic_of("changes", topics).split("*")
    servers = [row.topic[len(prefix) : -len(suffix)] for row in rows]
    (changed_values,) = _columns(rows)
    return Changes(_times(rows), servers, list(changed_values))


def _decisions(rows: Sequence[Row], seconds: Any) -> List[Decision]:
    decisions = []
    for row in rows:
        goal_id, stamp, scan_stamp, values_before, values_after, inputs, cleared = row.fields
        decision = Decision(
            goal=goal_id,
            time=seconds(stamp),
            scan_time=seconds(scan_stamp),
            before=values_before,
            after=values_after,
            seen=inputs,
            cleared=cleared,
        )
        decisions.append(decision)
    return decisions


def _goals(status_rows: Sequence[Row], result_rows: Sequence[Row]) -> List[Goal]:
    """Return the goals that move_base pursued, by the status of its action, with their results."""
    pursued: List[Goal] = []
    previous_id = ""
    for row in status_rows:
        (running_id,) = row.fields
        # The goal was pursued until this message.
        if previous_id:
            pursued[-1] = pursued[-1]._replace(end=row.time)
        if running_id and running_id != previous_id:
            pursued.append(Goal(running_id, row.time, row.time))
        previous_id = running_id
    results_by_goal: Dict[str, Tuple[float, str]] = {}
    for row in result_rows:
        goal_id, end_status = row.fields
        results_by_goal[goal_id] = row.time, end_status
    goals = []
    for goal in pursued:
        result_time, end_status = results_by_goal.get(goal.id, (goal.end, ""))
        goals.append(goal._replace(end=min(goal.end, result_time), status=end_status))
    return goals


# -- files -----------------------------------------------------------------------------------------
@contextmanager
def refused(path: os.PathLike[str] | str) -> Iterator[None]:
    """Convert every error of the block that reads a bag to a BagError that names the bag."""
    try:
        # A bag of ROS 2 is a folder of files.
        for bag_file in (Path(path), *Path(path).glob("*")):
            check_regular(bag_file)
        with reading(path):
            yield
    except FileError as error:
        message = str(error)
        cause = error.__cause__
        if isinstance(cause, AnyReaderError) and "index" in str(cause):
            message += ": if its recording was cut short, run rosbag reindex"
        raise BagError(message) from error


def bags_in(paths: Sequence[os.PathLike[str] | str]) -> List[Path]:
    """Return the bags among files and folders, those of a folder sorted.

    A bag is a .bag file, a ROS 2 folder, or a single .mcap or .db3 file.

    Raises:
        BagError: A path does not exist, or there is no bag.
    """
    remedy = "give .bag, .mcap or .db3 files or ROS 2 bag folders"
    bags: List[Path] = []
    for given_path in map(Path, paths):
        if not given_path.exists():
            raise BagError(f"{given_path}: there is no such file or folder: {remedy}")
        if given_path.is_file() or (given_path / METADATA).exists():
            bags.append(given_path)
        else:
            for inner_path in sorted(given_path.rglob("*")):
                if inner_path.suffix == ".bag" or (inner_path / METADATA).exists():
                    bags.append(inner_path)
    if not bags:
        raise BagError(f"{', '.join(map(str, paths))}: no bags there: {remedy}")
    return bags
