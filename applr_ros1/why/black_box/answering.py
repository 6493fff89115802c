"""Answers why a robot stopped, from the messages around the stop, without a desk.

What is seen from outside the planner is said first, because it is known at once and for every local
planner. The planner's own reason and the guess follow from a replay.
"""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from typing import Any, Callable, Dict, Iterator, Sequence

import numpy as np

from applr_ros1.common.errors import ApplrError
from applr_ros1.drives.drive import Drive, Motion
from applr_ros1.drives.received import all_received, drive_from, received, sources_of
from applr_ros1.robots import Robot
from applr_ros1.why.alternatives import guesses_of
from applr_ros1.why.answer import Answer, answer_of
from applr_ros1.why.black_box.bag_file import Publication, RawMessage
from applr_ros1.why.black_box.description import (
    TOPIC,
    DescribedRobot,
    described_by,
    nobody_publishes,
)
from applr_ros1.why.diagnosis import Diagnosis, diagnose
from applr_ros1.why.events import Event, RobotStop
from applr_ros1.why.explanation import has_turned
from applr_ros1.why.outside import (
    seen_from_outside,
    unknown_to_replay,
)
from applr_ros1.why.recorded import CHANNELS, recording_from, with_planned
from applr_ros1.why.replay import replay_of
from applr_ros1.why.rerun import RerunPlanner

NO_STOP = "it has not stopped"  # what is said if somebody asks too early
# Returns a message as an object.
Deserialize = Callable[[Publication, bytes], Any]


def answers_of(messages: Sequence[RawMessage], deserialize: Deserialize) -> Iterator[Answer]:
    """Yield what is known of a stop at once, then with the planner's reason, then with its guess.

    Args:
        messages: Messages around the stop, with the description of the robot and its stop.
        deserialize: Returns a message as an object.

    Raises:
        ApplrError: The messages have no description of a robot and its stop.
    """
    box = _description(messages, deserialize)
    stop = box.stop
    if stop is None:
        raise ApplrError(f"no stop on {TOPIC}: ask about a bag of the black box")
    robot = box.robot
    drive = _drive(messages, box, deserialize)
    if drive.odometry is None:
        diagnosis = _unseen(stop, drive, robot)
        no_odometry = f"there is no odometry on {box.topics.odometry}"
        diagnosis.events[0].reason = nobody_publishes(box.unpublished) or no_odometry
    else:
        diagnosis = seen_from_outside(drive, drive.odometry, robot, box=box)
    told = diagnosis.told
    if told is None:
        diagnosis = _unseen(stop, drive, robot)
        diagnosis.note = NO_STOP
    else:
        diagnosis.note = unknown_to_replay(drive, robot, _types(messages))
    outside_answer = replace(answer_of(diagnosis), first_kind=stop.kind)
    yield outside_answer
    if told is None or drive.odometry is None or diagnosis.note or box.unpublished:
        return
    # Of a reason outside the planner, a replay tells only whether the laser sees the robot itself.
    if told.is_outside and not has_turned(diagnosis.motion):
        return

    try:
        planner = RerunPlanner(robot)
        recording = recording_from(drive, box.topics, _types(messages), planner, robot)
        replay = replay_of(recording, planner)
    except ApplrError as problem:
        if not told.is_outside:
            yield replace(outside_answer, note=str(problem))
        return
    diagnosis = diagnose(replay, box=box)
    yield replace(answer_of(diagnosis), first_kind=stop.kind)
    if diagnosis.told is None or diagnosis.told.is_outside:
        return
    answer = replace(answer_of(diagnosis, guesses_of(diagnosis)), first_kind=stop.kind)
    if answer.guess:
        yield answer


def _unseen(stop: RobotStop, drive: Drive, robot: Robot) -> Diagnosis:
    """Return the diagnosis of a stop that no motion shows."""
    begin = stop.begin - drive.recorded_at
    event = Event(stop.kind, begin, stop.end - drive.recorded_at, stop.place)
    motion = Motion(np.empty(0), np.empty(0), np.empty((0, 3)), np.empty((0, 2)))
    return Diagnosis(drive, robot, motion, 0.0, [event])


def _description(messages: Sequence[RawMessage], deserialize: Deserialize) -> DescribedRobot:
    for message in messages:
        if message.publication.topic == TOPIC:
            text = deserialize(message.publication, message.data).data
            return described_by(text, "stop")
    raise ApplrError(f"no message on {TOPIC}: start the black box beside move_base")


def _drive(
    messages: Sequence[RawMessage], described_robot: DescribedRobot, deserialize: Deserialize
) -> Drive:
    """Return the drive in messages."""
    sources = sources_of(_types(messages), described_robot.topics, CHANNELS)
    calls = []
    for time, publication, data in messages:
        source = sources.get(publication.topic)
        if source is not None:
            deserialized = partial(deserialize, publication, data)
            receive = partial(received, time, source, data, publication.md5sum, deserialized)
            calls.append((publication.topic, receive))
    received_messages = all_received(calls, "stop")
    drive = drive_from(received_messages, described_robot.robot, is_one=True)
    drive.name = "stop"
    drive.topics = {topic: source.key for topic, source in sources.items()}
    return with_planned(drive, described_robot.robot)


def _types(messages: Sequence[RawMessage]) -> Dict[str, str]:
    """Return {topic: type} of messages."""
    return {message.publication.topic: message.publication.type for message in messages}
