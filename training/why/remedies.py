"""Remedies of a diagnosed drive: which changes are driven, and in which world."""

from __future__ import annotations

from itertools import chain
from typing import List, NamedTuple, Optional, Sequence

import numpy as np

from applr_ros1.planner.parameters.settings import Change, Settings
from applr_ros1.robots import Robot
from applr_ros1.why import events
from applr_ros1.why.alternatives import Alternative, guesses_of
from applr_ros1.why.diagnosis import Diagnosis
from applr_ros1.why.events import AT_GOAL, Event
from applr_ros1.why.factors import WISHES
from applr_ros1.why.replay import Replay
from training.attempts.candidates import Candidate, CandidateList, candidates_of, with_changes
from training.attempts.trials import (
    DriveConditions,
    WholeDriveTrials,
    course_in,
    limit_of,
    try_out,
)
from training.why.deciding import decides, undecided
from training.why.seen_world import seen_grid, seen_world
from training.workers.pool import Pool

CANDIDATES = 12  # number of candidates that are driven
LIVE = 5  # number of candidates among them that the replay ranks
ARRIVED_M = 1.5  # distance from the goal at the end of a drive that arrived [m, for the Jackal]


class RecordedCourse(NamedTuple):
    """Course of a recorded drive, with the candidates that may help there, the best first."""

    conditions: DriveConditions
    candidates: List[Candidate]


def driven_trials(
    diagnosis: Diagnosis, guesses: Sequence[Alternative], pool: Pool
) -> Optional[WholeDriveTrials]:
    """Drive with the recorded values and with candidates.

    Args:
        diagnosis: Diagnosis of a recorded drive.
        guesses: Alternatives that the replay ranks, the best first.
        pool: Workers that drive.

    Returns:
        The trials; None if no remedy is wanted, or the drive's goal is unknown.
    """
    recorded_course = course_of(diagnosis, guesses)
    if recorded_course is None:
        return None
    course = course_in(recorded_course.conditions, pool)
    return try_out([course], recorded_course.candidates)


def course_of(diagnosis: Diagnosis, guesses: Sequence[Alternative]) -> Optional[RecordedCourse]:
    """Return the course of a recorded drive.

    None if no remedy is wanted, or the drive's goal is unknown.
    """
    replay = diagnosis.replay
    drive = replay.drive
    longest_event = diagnosis.told
    goal = diagnosis.goal
    if longest_event is None or goal is None or not diagnosis.wants_remedy:
        return None
    # No parameter helps a robot that stops for a part of itself, and a moment is no event.
    if diagnosis.part is not None or longest_event.is_asked:
        return None
    policy_decides = decides(replay.recording)
    robot = _recorded_robot(replay, longest_event, policy_decides)
    if robot.frames.matched in drive.frames.get("routes", ()):
        robot = robot.in_matched_frame()

    # From where the robot was sent to its goal
    odometry = replay.recording.odometry
    is_in_time = (odometry.time >= goal.begin) & (odometry.time <= goal.end)
    course_rows = np.flatnonzero(events.pursued(drive, odometry) & is_in_time)
    if not len(course_rows):
        return None
    first_row = course_rows[0]
    last_row = course_rows[-1]
    x, y, yaw = odometry.pose[first_row].tolist()
    seconds = float(odometry.time[last_row] - odometry.time[first_row])
    # A drive that ended on its way does not tell how long the whole way takes.
    dx, dy = odometry.pose[last_row, :2] - goal.pose[:2]
    if np.hypot(dx, dy) > ARRIVED_M * replay.robot.world_scale:
        seconds = np.inf
    straight_m = float(np.hypot(goal.pose[0] - x, goal.pose[1] - y))
    conditions = DriveConditions(
        robot=robot,
        world=seen_world(seen_grid(replay.recording), drive.name, (x, y, yaw), goal.pose),
        has_monitor=drive.planned is not drive.commands,
        limit=limit_of(seconds, straight_m / replay.top_speed),
        ends_at_tolerance=longest_event.kind != AT_GOAL,
        policy_decides=policy_decides,
    )
    return RecordedCourse(conditions, candidates(robot, guesses, policy_decides))


def _recorded_robot(replay: Replay, event: Event, policy_decides: bool) -> Robot:
    """Return the robot with the settings of a drive at an event in its files.

    If they change on the way, no drive can have all of them. What a policy sets, it sets again.
    """
    changes = recorded_changes(replay.robot, replay.history.at(event.begin))
    if policy_decides:
        changes = undecided(changes, replay.robot)
    return with_changes(replay.robot, changes, replay.robot.name)


def recorded_changes(robot: Robot, settings: Settings) -> List[Change]:
    """Return what makes the robot's files equal to the settings of a drive."""
    in_files = Settings.from_tree(robot.all_parameters())
    changes = []
    for change in in_files.differences(settings):
        # A server that the drive does not tell about keeps the files' values, and so do texts,
        # such as frames: they are not set while a robot drives.
        if change.after is not None and not isinstance(change.after, str):
            changes.append(change)
    return changes


def possible_guesses(diagnosis: Diagnosis) -> List[Alternative]:
    """Return alternatives among the candidates, those with which the planner drives on fastest."""
    replay = diagnosis.replay
    if diagnosis.told is None:
        return []
    policy_decides = decides(replay.recording)
    robot = _recorded_robot(replay, diagnosis.told, policy_decides)
    # The replay runs the local planner alone, with what it reads after its start.
    live_values = replay.settings.only(replay.planner.tunable_servers)
    attempts = []
    for candidate in chain(*possible_candidates(robot, policy_decides)):
        change = candidate.changes[0]
        if change.name in live_values.get(change.server, ()):
            attempts.append(candidate.changes)
    return guesses_of(diagnosis, attempts)


def possible_candidates(robot: Robot, policy_decides: bool) -> CandidateList:
    """Return what else could be set in a robot, without what its owner or its policy decides."""

    def is_possible(candidate: Candidate) -> bool:
        for change in candidate.changes:
            if change.name in WISHES and abs(change.after) > abs(change.before):
                return False
        return not policy_decides or bool(undecided(candidate.changes, robot))

    unusual, others = candidates_of(robot)
    return CandidateList(list(filter(is_possible, unusual)), list(filter(is_possible, others)))


def candidates(
    robot: Robot, guesses: Sequence[Alternative], policy_decides: bool
) -> List[Candidate]:
    """Return the candidates that are driven, in their order.

    They are usual values in place of unusual ones, and what the replay ranks first of the others:
    another value in place of a usual one may help by chance, and explains nothing.

    Args:
        robot: Robot with the values of the recorded drive in its files.
        guesses: Alternatives that the replay ranks, the best first.
        policy_decides: Whether the robot's policy decides, as it did in the recorded drive.
    """
    unusual, others = possible_candidates(robot, policy_decides)
    # A replay may know other values before the changes.
    ranked = [Candidate(guess.changes).new_values for guess in guesses[:LIVE]]
    likely = [candidate for candidate in others if candidate.new_values in ranked]
    return [*unusual[: CANDIDATES - len(likely)], *likely]
