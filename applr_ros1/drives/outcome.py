"""Outcome of a trial: what a drive has come to after a decision.

Rewards, evaluations and datasets read it. arrived_cleanly() says what counts as an arrival.

outcome_of() makes it from a Drive, whether the drive was simulated or recorded in a bag.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, NamedTuple, Sequence, Tuple

import numpy as np

from applr_ros1.common.arrays import Array, Array32
from applr_ros1.drives.contact import contact_speed
from applr_ros1.drives.drive import ABORTED, FLIPPED, REACHED, TIMED_OUT, Drive, Goal

CLEAR = 3.0  # cap on the distance to the nearest obstacle in mean_clearance_m [widths of the body]


@dataclass
class Outcome:
    """State of a trial after a decision (or after reset, when most fields are zero).

    The fields from progress to seconds describe the last decision, the fields from success on the
    whole trial.

    Attributes:
        theta: (n,) current parameters of the planner.
        progress: Distance driven towards the goal [m] (the paper's R_p).
        progress_y: Distance driven along y [m].
        last_scan_min: Smallest range of the last scan [m], never below range_min.
        decision_min: Smallest range of all scans [m].
        contact: Whether the robot touched anything.
        seconds: Simulated duration [s]: the decision period, or less if the course ended.
        success: Whether the robot has arrived, even if it has touched something (arrived_cleanly).
        flipped: Whether the robot lies on its side.
        collided: Whether the robot has touched anything.
        aborted: Whether the planner gave up, or stopped away from the goal.
        timeout: Whether the time limit has passed. Also set after an abort, because the robot would
            stand until then.
        time_s: Time since the goal was sent [s]; the full limit after a timeout.
        decisions: Number of decisions.
        path_length_m: Length of the driven path [m].
        min_clearance_m: Smallest range [m].
        mean_clearance_m: Mean over time of the smallest range [m], capped at CLEAR widths of the
            body.
        mean_jerk: Mean magnitude of the jerk [m/s^3].
        mean_turn: Mean magnitude of the yaw acceleration [rad/s^2].
        reason: Why the trial is over, in words.
        contact_speed: True speed at the first contact of the trial [m/s]; NaN without one.
    """

    theta: Array
    progress: float = 0.0
    progress_y: float = 0.0
    last_scan_min: float = math.inf
    decision_min: float = math.inf
    contact: bool = False
    seconds: float = 0.0
    success: bool = False
    flipped: bool = False
    collided: bool = False
    aborted: bool = False
    timeout: bool = False
    time_s: float = 0.0
    decisions: int = 0
    path_length_m: float = 0.0
    min_clearance_m: float = math.inf
    mean_clearance_m: float = 0.0
    mean_jerk: float = 0.0
    mean_turn: float = 0.0
    reason: str = ""
    contact_speed: float = math.nan

    @property
    def over(self) -> bool:
        """Return whether the trial has ended, for any reason."""
        return self.success or self.flipped or self.aborted or self.timeout or bool(self.reason)


class Leg(NamedTuple):
    """Part of a drive between two decisions.

    Attributes:
        begin: Time of the first decision [s].
        end: Time of the next decision, or of the end of the course [s].
        goal: Goal (x, y) [m] of the course.
        start_place: Position (x, y) [m] of the robot at the beginning, in the frame of the goal.
        end_place: Position at the end.
    """

    begin: float
    end: float
    goal: Sequence[float]
    start_place: Sequence[float]
    end_place: Sequence[float]


def outcome_of(
    drive: Drive,
    goal: Goal,
    leg: Leg,
    theta: Array,
    decisions: int,
    *,
    body_width: float,
    time_limit: float = math.inf,
) -> Outcome:
    """Return the outcome of a trial at the end of a leg.

    Args:
        drive: Drive until the end of the leg.
        goal: Goal of the trial, with its end if the trial is over.
        leg: Latest part of the drive.
        theta: (n,) parameters that were set at the beginning of the leg.
        decisions: Number of decisions so far.
        body_width: Width of the robot [m].
        time_limit: Time that a failed trial counts [s].
    """
    outcome = Outcome(theta, decisions=decisions, reason=goal.reason)
    _measure_leg(outcome, drive, leg)
    _measure_clearance(outcome, drive, goal, leg, body_width)
    _measure_motion(outcome, drive, goal, leg)
    outcome.collided = bool((drive.contacts > goal.begin).any())
    outcome.contact_speed = contact_speed(drive, goal.begin)
    outcome.success = goal.status == REACHED
    outcome.flipped = goal.status == FLIPPED
    outcome.aborted = goal.status == ABORTED
    # After an abort, the robot would stand until the time limit.
    outcome.timeout = goal.status in (TIMED_OUT, ABORTED)
    outcome.time_s = leg.end - goal.begin
    if outcome.timeout:
        outcome.time_s = time_limit
    return outcome


def _measure_leg(outcome: Outcome, drive: Drive, leg: Leg) -> None:
    """Set the fields that describe the last decision."""
    outcome.seconds = leg.end - leg.begin
    outcome.progress, outcome.progress_y = progress(leg.goal, leg.start_place, leg.end_place)
    # A contact at the very beginning belongs to the leg before.
    is_in_leg = (drive.contacts > leg.begin) & (drive.contacts <= leg.end)
    outcome.contact = bool(is_in_leg.any())


def _measure_clearance(
    outcome: Outcome, drive: Drive, goal: Goal, leg: Leg, body_width: float
) -> None:
    """Set the smallest ranges of the leg and of the trial, and their mean."""
    if drive.clearances is None:
        return
    in_leg = drive.clearances.between(leg.begin, leg.end)
    in_trial = drive.clearances.between(goal.begin, leg.end)
    # The scan that the next decision sees may have been taken for it alone, with other noise.
    observed = drive.observed if drive.observed is not None else in_trial
    seen_in_leg = observed.between(leg.begin, leg.end)
    seen_in_trial = observed.between(goal.begin, leg.end)
    if len(seen_in_leg):
        outcome.last_scan_min = float(seen_in_leg.nearest[-1])
    outcome.decision_min = float(in_leg.nearest.min(initial=outcome.last_scan_min))
    smallest = in_trial.nearest.min(initial=math.inf)
    outcome.min_clearance_m = float(seen_in_trial.nearest.min(initial=smallest))
    if len(in_trial):
        # Open space, where the laser sees far, must not hide narrow places.
        capped = np.minimum(in_trial.nearest, CLEAR * body_width)
        outcome.mean_clearance_m = float(capped.mean())


def _measure_motion(outcome: Outcome, drive: Drive, goal: Goal, leg: Leg) -> None:
    """Set length and smoothness of the path, from the true motion, one row per control cycle."""
    if drive.truth is None:
        return
    motion = drive.truth.between(goal.begin, leg.end)
    intervals = np.diff(motion.time)
    if not len(intervals):
        return
    outcome.path_length_m = motion.length
    # Accelerations from row to row, and the jerk between two of them
    acceleration, yaw_acceleration = np.diff(motion.twist, axis=0).T / intervals
    jerks = np.diff(acceleration) / intervals[1:]
    outcome.mean_jerk = float(np.abs(jerks).sum() / len(intervals))
    outcome.mean_turn = float(np.abs(yaw_acceleration).mean())


def arrived_cleanly(has_arrived: Any, has_touched: Any) -> Any:
    """Return whether trials (n,) or one arrived, and touched nothing on their way.

    Choices between methods, parameter sets and policies count no other arrival.
    """
    return np.logical_and(has_arrived, np.logical_not(has_touched))


def progress(
    goal: Sequence[float], start: Sequence[float], end: Sequence[float]
) -> Tuple[float, float]:
    """Return the paper's R_p from p to q, and its simplification q_y - p_y [m].

    R_p is (q - p) . (goal - p) / |goal - p| [m].

    Args:
        goal: Goal (x, y) [m].
        start: Position p (x, y) [m].
        end: Position q (x, y) [m].
    """
    driven_x = end[0] - start[0]
    driven_y = end[1] - start[1]
    goal_x = goal[0] - start[0]
    goal_y = goal[1] - start[1]
    distance = math.hypot(goal_x, goal_y)
    progress_to_goal = 0.0  # On the goal itself, no direction leads to it.
    if distance > 0.0:
        progress_to_goal = (driven_x * goal_x + driven_y * goal_y) / distance
    return progress_to_goal, driven_y


def nearest(ranges: Array32, lowest: float) -> float:
    """Return d(o), the smallest range [m], or inf if there is no return.

    It is at least `lowest`: a range of -inf is too near to measure.
    """
    # fmin skips NaN, the range of a beam that measures nothing. It is left only if all beams do so,
    # or if there are none.
    smallest = float(np.fmin.reduce(ranges, initial=np.nan))
    if math.isnan(smallest):
        return math.inf
    return max(lowest, smallest)
