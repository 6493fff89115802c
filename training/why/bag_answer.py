"""Answer to one bag of a logbook: its stops, with what a map and the common change need of them.

It has plain values only, so that a JSON file can keep it (answer_file.py).
"""

from __future__ import annotations

from pathlib import Path
from typing import Any, Dict, List, NamedTuple, Optional, Tuple

import numpy as np
from pydantic import BaseModel, ConfigDict

from applr_ros1.common.angles import Pose, compose, transform_point
from applr_ros1.drives.drive import Motion
from applr_ros1.drives.frames import Tree
from applr_ros1.drives.places import route_frame
from applr_ros1.planner.parameters.settings import Change
from applr_ros1.robots import Robot
from applr_ros1.robots.geometry import bounding_box
from applr_ros1.why.answer import best_guess
from applr_ros1.why.diagnosis import Diagnosis, diagnose
from applr_ros1.why.events import Event
from applr_ros1.why.outside import seen_from_outside
from applr_ros1.why.recording import Recording
from training.attempts.candidates import Candidate
from training.attempts.trials import DriveConditions
from training.why.answer import Answer, outside_lines
from training.why.recorded import BagAnswerOptions, NotReplayedError, with_description
from training.why.remedies import course_of, possible_guesses
from training.why.replayed import check_cycles, replay_in
from training.why.values import outside_values, thinned, values_of

TRACK_S = 0.5  # interval between the positions of a driven path on a logbook's map [s]
PART_SEEN = "the laser sees a part of the robot"


class Stored(BaseModel):
    """Base class of what a file keeps."""

    model_config = ConfigDict(frozen=True, extra="forbid")


class StoredStop(Stored):
    """Event of a drive.

    Attributes:
        kind: What the robot did, in words.
        begin: Begin [s, from the drive's begin].
        end: End [s].
        x: Place [m] in the frame of the answer.
        y: Place [m].
        reason: Why, in words; "" if it is not known.
        is_outside: Whether the reason lies outside the local planner.
        lost: Time that it cost: its duration without that of its way at top speed [s].
    """

    kind: str
    begin: float
    end: float
    x: float
    y: float
    reason: str
    is_outside: bool
    lost: float


class StoredCandidate(Stored):
    """Candidate for a remedy.

    Attributes:
        changes: Server, name, value before and value after of each change.
        words: Words for people, if they are not those of the changes.
    """

    changes: List[Tuple[str, str, Any, Any]]
    words: str = ""

    @classmethod
    def of(cls, candidate: Candidate) -> StoredCandidate:
        """Return a candidate as plain values."""
        return cls(changes=list(map(tuple, candidate.changes)), words=candidate.words)

    @property
    def candidate(self) -> Candidate:
        """The candidate."""
        return Candidate(tuple(Change(*change) for change in self.changes), self.words)


class BagAnswer(Stored):
    """Answer to the drive in one bag.

    Attributes:
        robot: Name of the robot.
        length: Length of the robot [m].
        scale: Size of the robot relative to the Jackal's.
        begin: Time at which the drive begins [s, by the clock of its recorder].
        frame: Frame of all places.
        is_shared: Whether drives share the frame, as a map's. Odometry begins anew at each start.
        origin: Pose (x, y, yaw) of the drive's own frame in this one.
        stops: Events in order of time.
        parameter: Parameter that the replay's best guess changes, as SERVER/NAME; "" without one.
        guess: The guess in words; "" without one.
        commands: Number of recorded commands.
        reproduced: Number of those that the replay reproduces.
        is_doubtful: Whether the planner's reasons in the replay are not to be trusted.
        track: Time [s] and place x, y [m] of the robot.
        seen: Places x, y [m] of what the laser saw.
        values: Values of the bag's own page; without "track" if the bag has none.
        candidates: Candidates for a remedy, the best first; empty if nothing is to be driven.
        policy_decides: Whether the robot's policy decides in its simulated drives.
    """

    robot: str
    length: float
    scale: float
    begin: float
    frame: str
    is_shared: bool
    origin: Tuple[float, float, float]
    stops: List[StoredStop]
    parameter: str = ""
    guess: str = ""
    commands: int = 0
    reproduced: int = 0
    is_doubtful: bool = False
    track: List[List[float]]
    seen: List[List[float]] = []
    values: Dict[str, Any]
    candidates: List[StoredCandidate] = []
    policy_decides: bool = False

    @property
    def has_page(self) -> bool:
        """True if the drive was replayed, so that its page can be drawn."""
        return "track" in self.values


class AnsweredBag(NamedTuple):
    """Answer to a bag, and the conditions of simulated drives there; None if none are wanted."""

    answer: BagAnswer
    conditions: Optional[DriveConditions]


class PlacedFrame(NamedTuple):
    """Frame of a map: its name, and whether drives share it; pose of the drive's frame in it."""

    name: str
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
        return AnsweredBag(_outside_answer(problem, options.robot), None)
    check_cycles(path, replay)
    diagnosis = diagnose(replay)
    return _replayed_answer(diagnosis, options.quick)


def _replayed_answer(diagnosis: Diagnosis, is_quick: bool) -> AnsweredBag:
    """Return the answer to a replayed drive.

    Args:
        diagnosis: Its diagnosis.
        is_quick: Whether nothing is to be driven in simulation.
    """
    replay = diagnosis.replay
    recording = replay.recording
    odometry = recording.odometry
    guesses = possible_guesses(diagnosis)
    values = values_of(Answer(diagnosis, guesses))
    placed = placed_frame(recording, diagnosis.longest)
    stops = []
    for event in diagnosis.events:
        lost = _lost_seconds(event, odometry, replay.top_speed)
        stop = _stop(event, lost, placed.origin)
        if diagnosis.part is not None:
            stop = stop.model_copy(update={"reason": PART_SEEN, "is_outside": True})
        stops.append(stop)
    guess = best_guess(guesses, replay)
    course = None if is_quick else course_of(diagnosis, guesses)
    footprint_x = replay.planner.footprint(replay.settings)[:, 0]
    answer = BagAnswer(
        robot=replay.robot.name,
        length=float(np.ptp(footprint_x)),
        scale=replay.robot.world_scale,
        begin=recording.drive.recorded_at,
        frame=placed.name,
        is_shared=placed.is_shared,
        origin=placed.origin,
        stops=stops,
        parameter=guess.change.path if guess else "",
        guess=str(guess.change) if guess else "",
        commands=replay.commands,
        reproduced=replay.reproduced,
        is_doubtful=replay.is_poor,
        track=_track(odometry, placed.origin),
        seen=_placed(np.array(values["map"]), placed.origin),
        values=values,
        candidates=list(map(StoredCandidate.of, course.candidates)) if course else [],
        policy_decides=course.conditions.policy_decides if course else False,
    )
    return AnsweredBag(answer, course.conditions if course else None)


def _outside_answer(problem: NotReplayedError, robot: Robot) -> BagAnswer:
    """Return what is known of a drive that is not replayed.

    Args:
        problem: The drive, and why it is not replayed.
        robot: Robot that drove.
    """
    drive = problem.drive
    view = seen_from_outside(drive, problem.odometry, robot)
    top_speed = float(view.limits.speed.mean())
    own_frame: Pose = (0.0, 0.0, 0.0)
    stops = []
    for event in view.events:
        stops.append(_stop(event, _lost_seconds(event, view.motion, top_speed), own_frame))
    box = bounding_box(robot)
    return BagAnswer(
        robot=robot.name,
        length=box.front - box.back,
        scale=robot.world_scale,
        begin=drive.recorded_at,
        frame=drive.frame,
        is_shared=False,
        origin=own_frame,
        stops=stops,
        track=_track(view.motion, own_frame),
        values=outside_values(drive, view.events, outside_lines(view.events, problem.note)),
    )


def _stop(event: Event, lost: float, origin: Pose) -> StoredStop:
    """Return an event as plain values.

    Args:
        event: The event.
        lost: Time that it cost [s].
        origin: Pose of its frame in that of the logbook.
    """
    x, y, _ = compose(origin, (*event.place, 0.0))
    return StoredStop(
        kind=event.kind,
        begin=round(event.begin, 2),
        end=round(event.end, 2),
        x=round(x, 3),
        y=round(y, 3),
        reason=event.reason,
        is_outside=event.is_outside,
        lost=round(lost, 2),
    )


def _lost_seconds(event: Event, odometry: Motion, top_speed: float) -> float:
    """Return the duration of an event without that of its way at top speed [s]."""
    part = odometry.between(event.begin, event.end)
    if len(part) < 2 or top_speed <= 0.0:
        return event.seconds
    # Not the length of the path: what a robot drives to and fro is lost.
    gained_way = np.hypot(*(part.pose[-1, :2] - part.pose[0, :2]))
    return max(event.seconds - float(gained_way) / top_speed, 0.0)


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
    placed_routes = route_frame(drive, Tree(drive.transforms), recording.planned)
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


def _track(odometry: Motion, origin: Pose) -> List[List[float]]:
    """Return time [s] and place [m] of a robot, in the frame of a logbook."""
    x, y = transform_point(origin, *odometry.pose[:, :2].T)
    return thinned(np.column_stack([odometry.time, x, y]), TRACK_S)


def _placed(points: np.ndarray, origin: Pose) -> List[List[float]]:
    """Return points (n, 2) [m] in the frame of a logbook."""
    if not len(points):
        return []
    x, y = transform_point(origin, *points.T)
    placed_points: List[List[float]] = np.column_stack([x, y]).round(2).tolist()
    return placed_points
