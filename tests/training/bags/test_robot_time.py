"""Tests of the time of recorded messages: it is that of the stamps."""

import numpy as np
import pytest
from rosbags.rosbag1 import Reader, Writer
from rosbags.typesys import Stores, get_typestore

from applr_ros1.drives.columns import SECOND
from applr_ros1.drives.robot_time import RobotTime
from tests.support.bags import read
from tests.support.drives import Messages

DAY_S = 86_400.0


def times_of(stamps, recording_times, of=None, other=()):
    """Return the robot's times [s] of some recording times [s], and the note.

    Args:
        stamps: Stamps [s] of a sensor.
        recording_times: Recording times [s] of the same messages.
        of: Recording times [s] to convert. Default: those of the messages.
        other: Messages of another sensor.
    """
    messages = list(zip(in_nanoseconds(recording_times), in_nanoseconds(stamps)))
    robot_time = RobotTime([messages, other])
    converted = in_nanoseconds(recording_times if of is None else of)
    return np.array([robot_time.of(time) for time in converted]) / SECOND, robot_time.note


def in_nanoseconds(seconds):
    """Return times [s] in whole nanoseconds."""
    return [round(time * SECOND) for time in seconds]


def test_times_of_a_recording_at_half_speed_are_those_of_the_stamps():
    stamps = 5.0 + 0.05 * np.arange(401)
    recording_times = 1e9 + 2.0 * (stamps - 5.0)
    times, note = times_of(stamps, recording_times)
    assert times == pytest.approx(stamps, abs=1e-6)
    assert note == (
        "the recording took 40.0 s, the drive 20.0 s by its stamps: times are those of the stamps"
    )
    # Messages without stamps lie between those around them, before and after the others, too.
    times, _ = times_of(stamps, recording_times, of=1e9 + np.array([-1.0, 0.03, 20.01, 42.0]))
    assert times == pytest.approx([4.5, 5.015, 15.005, 26.0], abs=1e-6)


def test_a_speed_that_changes_on_the_way_is_followed():
    stamps = 0.05 * np.arange(401)
    # Ten seconds at full speed, ten at a fourth
    recording_times = DAY_S + np.where(stamps < 10.0, stamps, 10.0 + 4.0 * (stamps - 10.0))
    times, _ = times_of(stamps, recording_times)
    assert times == pytest.approx(stamps, abs=1e-3)


def test_recording_times_that_are_the_robots_stay_as_they_are():
    stamps = 1e9 + 0.05 * np.arange(401)
    rng = np.random.default_rng(0)
    recording_times = stamps + rng.uniform(0.0, 0.2, 401)
    # One message came late.
    recording_times[-1] += 3.0
    times, note = times_of(stamps, recording_times)
    assert in_nanoseconds(times) == in_nanoseconds(recording_times)
    assert note == ""


def test_a_recorder_whose_clock_is_set_otherwise_is_no_longer_drive():
    stamps = 1e9 + 0.05 * np.arange(401)
    times, note = times_of(stamps, stamps + 7.0)
    assert times == pytest.approx(stamps, abs=1e-3)
    assert note == ""


def test_one_sensor_with_a_clock_of_its_own_sets_no_time():
    """Scans, or odometry, in seconds since the start of their device."""
    recording_times = 1e9 + 0.05 * np.arange(401)
    agreeing = list(zip(in_nanoseconds(recording_times), in_nanoseconds(recording_times)))
    times, note = times_of(recording_times - 1e9, recording_times, other=agreeing)
    assert in_nanoseconds(times) == in_nanoseconds(recording_times)
    assert note == ""


def test_without_stamps_recording_times_are_all_there_is():
    assert RobotTime([[], []]).of(5) == 5


def rewritten(source, target, recording_time=lambda time: time, has_stamps=True):
    """Write a bag again, with other recording times [s] or without stamps; return its path."""
    store = get_typestore(Stores.ROS1_NOETIC)
    with Reader(source) as reader, Writer(target) as writer:
        connections = {}
        for old, time, raw in reader.messages():
            if old.topic not in connections:
                connections[old.topic] = writer.add_connection(
                    old.topic, old.msgtype, msgdef=old.msgdef.data, md5sum=old.digest
                )
            if not has_stamps and old.msgtype.endswith(("Odometry", "LaserScan")):
                message = store.deserialize_ros1(raw, old.msgtype)
                message.header.stamp.sec = 0
                message.header.stamp.nanosec = 0
                raw = store.serialize_ros1(message, old.msgtype)
            new_time = round(recording_time(time / SECOND) * SECOND)
            writer.write(connections[old.topic], new_time, raw)
    return target


@pytest.fixture
def bag(bag_path):
    """Return the bag of a drive of ten seconds along x."""
    with Messages(bag_path) as messages:
        messages.status(10.0, "a goal")
        for step in range(201):
            time = 10.0 + 0.05 * step
            messages.odometry(time, (0.3 * (time - 10.0), 0.0, 0.0), (0.3, 0.0))
            messages.message("commands", time + 0.01, twist=(0.3, 0.0))
            messages.message(
                "changes", time + 0.02, "TrajectoryPlannerROS", values={"sim_time": time}
            )
            if step % 4 == 0:
                messages.scan(time, np.ones(720, np.float32))
        messages.status(20.0, "", running=False)
    return bag_path


@pytest.mark.heavy
@pytest.mark.parametrize("rate", [0.5, 3.0])
def test_a_drive_takes_its_time_however_fast_it_was_played_while_recording(bag, tmp_path, rate):
    played = rewritten(bag, tmp_path / "played.bag", lambda time: DAY_S + time / rate)
    original_drive = read(bag)
    played_drive = read(played)
    for column in ("odometry", "scans", "commands", "changes"):
        original_rows = getattr(original_drive, column)
        played_rows = getattr(played_drive, column)
        assert played_rows.time == pytest.approx(original_rows.time, abs=1e-3), column
    assert played_drive.odometry.stamp == pytest.approx(original_drive.odometry.stamp, abs=1e-3)
    assert played_drive.scans.stamp == pytest.approx(original_drive.scans.stamp, abs=1e-3)
    (goal,) = played_drive.goals
    assert goal.end - goal.begin == pytest.approx(10.0, abs=1e-3)
    assert original_drive.notes == []
    (note,) = played_drive.notes
    assert "the drive 10.0 s by its stamps" in note


def test_messages_without_stamps_hold_for_the_time_at_which_they_came(bag, tmp_path):
    """As in C++, which takes the latest transform for them."""
    drive = read(rewritten(bag, tmp_path / "unstamped.bag", has_stamps=False))
    assert np.array_equal(drive.odometry.stamp, drive.odometry.time)
    assert np.array_equal(drive.scans.stamp, drive.scans.time)
