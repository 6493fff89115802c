"""Tests of the table of columns: what is packed is unpacked, by messages of rosbags and of ROS."""

import dataclasses
import io

import numpy as np
import pytest

from applr_ros1.drives.bag import rows_of
from applr_ros1.drives.columns import (
    COLUMNS,
    SECOND,
    SUCCEEDED,
    Sender,
    Stamp,
    column_of,
)
from applr_ros1.drives.drive import KIND_OF_COLUMN, Drive, DriveError, Rows
from applr_ros1.drives.received import Received, drive_from
from applr_ros1.planner.parameters.trees import merged
from applr_ros1.robots import JACKAL
from applr_ros1.senses.standing import ACTIVE, PREEMPTING
from applr_ros1.why.black_box.ring import HOLDING
from applr_ros1.why.black_box.stops import StopDetector
from applr_ros1.why.recorded import CHANNELS
from tests.support.drives import whole_drive
from training.bags.maker import Maker


def packed_rows(key):
    """Return rows of a topic, each with the fields of its message. Plans are routes, too."""
    drive = whole_drive(JACKAL)
    if key == "routes":
        drive.routes = drive.plans
        drive.plans = None
    sender = Sender(JACKAL, drive.frame, begin=5.0)
    rows = []
    for row in rows_of(drive, JACKAL):
        if row.key == key:
            rows.append((row.values, COLUMNS[key].pack(row.values, sender)))
    assert rows
    return rows


@pytest.mark.parametrize("key", COLUMNS)
def test_each_topic_belongs_to_a_column_of_the_drive(key):
    assert column_of(key) in {column.name for column in dataclasses.fields(Drive)}


def test_the_black_box_keeps_each_topic_but_those_that_why_does_not_read():
    assert {column_of(key) for key in COLUMNS} - set(CHANNELS) == {"source", "contacts", "ends"}
    assert set(HOLDING) <= set(COLUMNS)


@pytest.mark.parametrize("key", COLUMNS)
def test_a_message_has_all_that_the_columns_class_has(key):
    column = COLUMNS[key]
    kind = KIND_OF_COLUMN.get(column_of(key))
    if kind is None:
        return
    names = [field.name for field in dataclasses.fields(kind)] if issubclass(kind, Rows) else []
    names = names or list(kind._fields)
    for row, fields in packed_rows(key):
        (unpacked_row,) = column.unpack(Maker().make(column.type, fields))
        # The reader adds the time at which the message came, and the part of its topic.
        unpacked_row = {"time": row["time"], column.part: row.get(column.part), **unpacked_row}
        assert set(names) <= set(unpacked_row)


def filled(message, fields):
    """Fill a message of ROS with fields by name, times in seconds."""
    import genpy

    for name, value in fields.items():
        slot = getattr(message, name)
        if isinstance(slot, genpy.Time):
            setattr(message, name, genpy.Time.from_sec(value))
        elif isinstance(value, dict):
            filled(slot, value)
        elif isinstance(value, list) and value and isinstance(value[0], dict):
            element_type = message._slot_types[message.__slots__.index(name)].replace("[]", "")
            setattr(message, name, [filled(ros_message(element_type), entry) for entry in value])
        else:
            setattr(message, name, value)
    return message


def ros_message(message_type):
    """Return an empty message of ROS."""
    from roslib.message import get_message_class

    message_class = get_message_class(message_type.replace("/msg/", "/"))
    if message_class is None:
        pytest.skip(f"{message_type} is not installed")
    return message_class()


@pytest.mark.parametrize("key", COLUMNS)
def test_a_message_of_ros_gives_the_row_of_rosbags(key):
    pytest.importorskip("roslib")
    column = COLUMNS[key]
    maker = Maker()
    for _, fields in packed_rows(key):
        # A message as a node gets it: of bytes
        serialised = io.BytesIO()
        filled(ros_message(column.type), fields).serialize(serialised)
        received = ros_message(column.type)
        received.deserialize(serialised.getvalue())

        assert maker.make(column.type, fields)  # This package's types are registered with use.
        rosbags_message = maker.store.deserialize_ros1(serialised.getvalue(), column.type)
        np.testing.assert_equal(column.unpack(received), column.unpack(rosbags_message))


@pytest.mark.parametrize(
    ("no_return", "ranges"),
    [
        pytest.param(0.0, [1.0, np.inf, np.inf], id="zero"),
        pytest.param(8.0, [1.0, 0.0, np.inf], id="another range"),
        pytest.param(None, [1.0, 0.0, np.inf], id="infinity alone"),
    ],
)
def test_the_robots_range_for_no_return_is_infinite_in_the_scans_of_a_bag(no_return, ranges):
    laser = JACKAL.laser.model_copy(update={"no_return": no_return})
    robot = dataclasses.replace(JACKAL, laser=laser)
    published = np.array([1.0, 0.0, np.inf if no_return is None else no_return], np.float32)
    row, _ = packed_rows("scans")[0]
    scan_row = {**row, "stamp": Stamp(SECOND), "frame": "laser", "ranges": published}
    drive = drive_from([Received(SECOND, "scans", [scan_row])], robot)
    assert drive.scans.ranges[0].tolist() == ranges
    assert drive.clearances.nearest.tolist() == [1.0]


@pytest.mark.parametrize(
    "changes",
    [
        {"pose": {"pose": {"position": {"x": np.nan}}}},
        {"pose": {"pose": {"orientation": {"w": np.nan}}}},
        {"twist": {"twist": {"angular": {"z": np.inf}}}},
    ],
)
def test_odometry_that_is_not_finite_is_left_out(changes):
    column = COLUMNS["odometry"]
    _, fields = packed_rows("odometry")[0]
    (finite_row,) = column.unpack(Maker().make(column.type, fields))
    assert column.unpack(Maker().make(column.type, merged(fields, changes))) == []

    times = np.arange(1, 4) * SECOND
    messages = [Received(int(time), "odometry", [finite_row]) for time in times]
    messages[1] = Received(int(times[1]), "odometry", [])
    assert len(drive_from(messages, JACKAL).odometry) == 2
    detector = StopDetector(JACKAL)
    for message in messages:
        detector.take(message)


def test_only_a_message_that_says_so_is_a_contact():
    unpack = COLUMNS["contacts"].unpack
    message_type = COLUMNS["contacts"].type
    assert unpack(Maker().make(message_type, {"data": True})) == [{}]
    assert unpack(Maker().make(message_type, {"data": False})) == []


def test_of_two_goals_that_run_the_one_that_replaces_the_other_is_pursued():
    column = COLUMNS["goals"]
    statuses = []
    for goal_id, status in (("old", PREEMPTING), ("new", ACTIVE), ("before", SUCCEEDED)):
        statuses.append({"goal_id": {"id": goal_id}, "status": status})
    message = Maker().make(column.type, {"status_list": statuses})
    assert column.unpack(message) == [{"running": "new"}]


def test_a_decision_without_its_inputs_is_not_written():
    drive = whole_drive(JACKAL)
    decision = drive.decisions[0]._replace(seen=None)
    with pytest.raises(DriveError, match="without its inputs"):
        COLUMNS["decisions"].pack(decision._asdict(), Sender(JACKAL, "odom"))


def test_a_field_that_a_message_lacks_is_an_error():
    with pytest.raises(KeyError, match="has no speed"):
        Maker().make("geometry_msgs/msg/Twist", {"speed": 1.0})
