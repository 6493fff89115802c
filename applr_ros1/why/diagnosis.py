"""Diagnosis of a recorded drive: its events, and their reasons."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import List, Optional, Sequence, Tuple

import numpy as np

from applr_ros1.drives.drive import Drive
from applr_ros1.robots import Robot
from applr_ros1.why import events
from applr_ros1.why.events import AT_GOAL, Event
from applr_ros1.why.explanation import Explanation, at_goal, explain, part_of_robot
from applr_ros1.why.occupied_goal import is_goal_occupied
from applr_ros1.why.reasons import (
    NO_PATH,
    blocked,
    jumping,
    late,
    no_plan,
    recovering,
    silent,
    silent_planner,
    stuck,
    unmoved,
)
from applr_ros1.why.recording import PursuedGoal
from applr_ros1.why.replay import Replay, some
from applr_ros1.why.stretch import Stretch, first_of
from applr_ros1.why.touch import FirstContact, touch_of

EXPLAINED = 5  # number of explained cycles of an event; the middle one stands for the event
EVENT_SHARE = 0.5  # share of an event from which on an observation is its reason
LOST_SHARE = 0.1  # share of a drive that events take from which on remedies are sought
# A drive that takes less than this ratio of a straight drive at top speed needs no remedy.
FAST = 1.25
# Reasons that are seen from outside the planner, causes before what follows from them.
OUTSIDE = (silent, jumping, no_plan, silent_planner, blocked, unmoved, stuck, recovering)
OCCUPIED = ": the goal is occupied, or right behind an obstacle"
# Reason of a wait at the goal that no tolerance explains
NOT_ENDED = "move_base does not end its goal, although the robot is within both tolerances"


@dataclass
class Diagnosis:
    """Events of a drive, and their reasons.

    Attributes:
        replay: Replayed drive.
        events: Events in order of time, with their reasons.
        explained: Explanations of some cycles of each event.
        part: Place (x, y) beside the robot where the laser sees a part of it, or None.
        touch: First contact, or None.
    """

    replay: Replay
    events: List[Event]
    explained: List[List[Explanation]] = field(default_factory=list)
    part: Optional[Tuple[float, float]] = None
    touch: Optional[FirstContact] = None

    @property
    def drive(self) -> Drive:
        """The recorded drive."""
        return self.replay.drive

    @property
    def longest(self) -> Optional[Event]:
        """Event that took most time."""
        return events.longest(self.events)

    @property
    def goal(self) -> Optional[PursuedGoal]:
        """Goal that the robot pursued in the longest event, or its last one; None if unknown."""
        event = self.longest
        # An event may begin before the first route to its goal.
        time = 0.5 * (event.begin + event.end) if event is not None else math.inf
        return self.replay.recording.goal_at(time)

    @property
    def wants_remedy(self) -> bool:
        """True if events took much of the drive, and it was not nearly as fast as possible."""
        odometry = self.replay.recording.odometry
        pursued_rows = np.flatnonzero(events.pursued(self.drive, odometry))
        if len(pursued_rows) < 2:
            return False
        first_row = pursued_rows[0]
        last_row = pursued_rows[-1]
        seconds = float(odometry.time[last_row] - odometry.time[first_row])

        # Time that a straight drive at top speed would take
        dx, dy, _ = odometry.pose[last_row] - odometry.pose[first_row]
        top_speed = self.replay.limits.speed[pursued_rows].mean()
        shortest_time = float(np.hypot(dx, dy) / top_speed)

        lost_time = sum(event.seconds for event in self.events)
        return lost_time >= LOST_SHARE * seconds and seconds > FAST * shortest_time


def give_outside_reason(event: Event, drive: Drive, robot: Robot, period: float) -> None:
    """Set the reason of an event that is seen from outside the planner, if there is one.

    It needs no replay, so that it is known for every local planner.

    Args:
        event: The event.
        drive: Its drive.
        robot: Robot that drove.
        period: Control period of the planner [s]; 0 if it is unknown.
    """
    stretch = Stretch(drive, event.begin, event.end, EVENT_SHARE, period)
    event.reason = first_of(OUTSIDE, stretch)
    if event.reason == NO_PATH and is_goal_occupied(stretch, robot):
        event.reason += OCCUPIED
    if not event.reason and event.is_arrived:
        event.reason = NOT_ENDED
    event.is_outside = bool(event.reason)
    if not event.reason and event.kind != AT_GOAL:
        event.reason = late(stretch)


def diagnose(replay: Replay, at: Optional[float] = None) -> Diagnosis:
    """Return the diagnosis of a replayed drive.

    Args:
        replay: Replayed drive.
        at: Time to explain instead of the events [s].
    """
    # What happened
    odometry = replay.recording.odometry
    if at is None:
        found_events = events.find(replay.drive, odometry, replay.limits)
        touch = touch_of(replay.recording)
    else:
        found_events = [events.around(at, odometry, replay.limits)]
        touch = None  # Somebody asks about another moment.
    diagnosis = Diagnosis(replay, found_events, touch=touch)

    # Why it happened
    for event in found_events:
        diagnosis.explained.append(explain_event(replay, event))
    if found_events:
        diagnosis.part = part_of_robot(replay)
    return diagnosis


def explain_event(replay: Replay, event: Event) -> List[Explanation]:
    """Set the reason of an event of a replayed drive, and return explanations of its cycles."""
    explained = _explanations(replay, event)
    give_outside_reason(event, replay.drive, replay.robot, replay.planner.period)
    if event.is_outside or not explained:
        return explained
    middle_explanation = middle_of(explained)
    if event.kind == AT_GOAL and not middle_explanation.is_blocked:
        cycles = replay.between(event.begin, event.end)
        event.reason = at_goal(replay.planner, cycles[-1].settings)
    elif middle_explanation.words:
        event.reason = middle_explanation.words
    return explained


def middle_of(explained: Sequence[Explanation]) -> Explanation:
    """Return the middle one of the explained cycles of an event, which stands for the event."""
    return explained[len(explained) // 2]


def _explanations(replay: Replay, event: Event) -> List[Explanation]:
    """Return explanations of some of the slow cycles of an event."""
    cycles = replay.between(event.begin, event.end)
    if not cycles:
        return []
    # The fast cycles of an event, as when a robot swings, do not show what slows it.
    median_speed = np.median([cycle.command[0] for cycle in cycles])
    slow_cycles = []
    for cycle in cycles:
        if cycle.command[0] <= median_speed:
            slow_cycles.append(cycle)
    return [explain(replay, cycle) for cycle in some(slow_cycles, EXPLAINED)]
