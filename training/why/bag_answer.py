"""Answer to one bag of a logbook, with what the common change needs of it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import NamedTuple, Optional

from applr_ros1.common.angles import Pose
from applr_ros1.drives.frames import FrameTree
from applr_ros1.drives.places import route_frame
from applr_ros1.why.answer import Answer, answer_of
from applr_ros1.why.diagnosis import diagnose
from applr_ros1.why.events import Event
from applr_ros1.why.recording import Recording
from training.attempts.trials import DriveConditions
from training.why.recorded import (
    BagAnswerOptions,
    NotReplayedError,
    described_in,
    with_description,
)
from training.why.remedies import course_of, possible_guesses
from training.why.replayed import replay_in


class AnsweredBag(NamedTuple):
    """Answer to a bag, and the conditions of simulated drives there; None if none are wanted."""

    answer: Answer
    conditions: Optional[DriveConditions]


class PlacedFrame(NamedTuple):
    """Frame of a map: its name, and whether drives share it; pose of the drive's frame in it."""

    frame: str
    is_shared: bool
    origin: Pose


def answer_to(path: Path, options: BagAnswerOptions) -> AnsweredBag:
    """Return the answer to the drive in a bag, without driving in simulation.

    Raises:
        ApplrError: The bag cannot be read, or has nothing to answer from.
    """
    options = with_description(path, options)
    try:
        replay = replay_in(path, options)
    except NotReplayedError as problem:
        return AnsweredBag(answer_of(problem.diagnosis), None)
    diagnosis = diagnose(replay, box=described_in(path))
    guesses = possible_guesses(diagnosis)
    placed = placed_frame(replay.recording, diagnosis.told)
    answer = replace(answer_of(diagnosis, guesses), **placed._asdict())
    course = None if options.quick else course_of(diagnosis, guesses)
    if course is None:
        return AnsweredBag(answer, None)
    answer = replace(
        answer,
        candidates=[(one.changes, one.words) for one in course.candidates],
        policy_decides=course.conditions.policy_decides,
    )
    return AnsweredBag(answer, course.conditions)


def placed_frame(recording: Recording, event: Optional[Event]) -> PlacedFrame:
    """Return the frame in which drives are drawn: that of a map, if tf connects it.

    Odometry drifts in a map, so that its pose is that of the longest event.
    """
    drive = recording.drive
    own_frame: Pose = (0.0, 0.0, 0.0)
    if _is_shared(drive.frame, recording):
        return PlacedFrame(drive.frame, True, own_frame)
    route_frames = drive.frames.get("routes")
    if drive.routes is None or not route_frames or not _is_shared(route_frames[0], recording):
        return PlacedFrame(drive.frame, False, own_frame)
    placed_routes = route_frame(drive, FrameTree(drive.transforms), recording.planned)
    if placed_routes is None:
        return PlacedFrame(drive.frame, False, own_frame)
    row = -1
    if event is not None:
        row = max(recording.planned.latest(event.begin), 0)
    x, y, yaw = placed_routes.at_commands[row].tolist()
    return PlacedFrame(route_frames[0], True, (x, y, yaw))


def _is_shared(frame: str, recording: Recording) -> bool:
    """Return whether drives share a frame. Odometry and matched poses begin anew at each start."""
    *_, name = frame.split("/")
    if name == recording.robot.frames.map:
        return True
    drive = recording.drive
    odometry_frames = drive.frames.get("odometry", [drive.frame])
    return name != recording.robot.frames.matched and frame not in odometry_frames
