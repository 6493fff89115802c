"""Remedies of a diagnosed drive: which changes are driven, and in which world."""

from __future__ import annotations

from typing import List, NamedTuple, Optional, Sequence

import numpy as np

from applr_ros1.robots import Robot
from applr_ros1.why import events
from applr_ros1.why.alternatives import Alternative, guesses_of, together
from applr_ros1.why.diagnosis import Diagnosis
from applr_ros1.why.events import AT_GOAL
from applr_ros1.why.replay import Replay
from training.why.candidates import (
    Candidate,
    escape_candidates,
    file_candidates,
    recorded_changes,
    with_changes,
)
from training.why.deciding import decides, undecided
from training.why.seen_world import seen_grid, seen_world
from training.why.whole_drives import (
    ROUND,
    DriveConditions,
    WholeDriveTrials,
    course_in,
    limit_of,
    try_out,
)
from training.workers.pool import Pool

CANDIDATES = 12  # number of candidates that are driven
MUCH = 4.0  # factor of a change beyond which a factor of 2 is tried, too
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
    # The settings at the longest event: if they change on the way, no drive can have all of them.
    # What a policy sets, it sets again.
    settings = replay.history.at(longest_event.begin)
    policy_decides = decides(replay.recording)
    changes = recorded_changes(replay.robot, settings)
    if policy_decides:
        changes = undecided(changes, replay.robot)
    robot = with_changes(replay.robot, changes, replay.robot.name)
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
    return RecordedCourse(conditions, candidates(replay, guesses, robot, policy_decides))


def possible_guesses(diagnosis: Diagnosis) -> List[Alternative]:
    """Return alternatives without those of values that the robot's policy sets anew each second."""
    guesses = guesses_of(diagnosis)
    recording = diagnosis.replay.recording
    if not guesses or not decides(recording):
        return guesses
    return [guess for guess in guesses if undecided(guess.changes, recording.robot)]


def candidates(
    replay: Replay, guesses: Sequence[Alternative], robot: Robot, policy_decides: bool
) -> List[Candidate]:
    """Return the candidates that are driven: the replay's first ones, and values of files.

    A value that the robot's policy sets is none.
    """
    live_candidates: List[Candidate] = []
    for guess in guesses[:LIVE]:
        live_candidates += milder(replay, guess)
        live_candidates.append(Candidate(guess.changes))
    live_candidates += escape_candidates(replay.planner.name, replay.settings[replay.planner.name])

    # The replay does not see what values of files would do: unusual ones come before guesses that
    # it ranks low.
    all_candidates = live_candidates[:ROUND] + file_candidates(robot) + live_candidates[ROUND:]
    if policy_decides:
        all_candidates = [
            candidate for candidate in all_candidates if undecided(candidate.changes, robot)
        ]
    # A value may be a candidate for two reasons.
    return list(dict.fromkeys(all_candidates))[:CANDIDATES]


def milder(replay: Replay, guess: Alternative) -> List[Candidate]:
    """Return the change of a guess by a factor of 2, if the guess goes much farther."""
    change = guess.change
    if isinstance(change.before, bool) or change.departure <= MUCH:
        return []
    factor = 2.0 if abs(change.after) > abs(change.before) else 0.5
    milder_change = change._replace(after=type(change.before)(change.before * factor))
    return [Candidate(together(replay.settings, milder_change))]
