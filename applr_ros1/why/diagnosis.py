"""Diagnosis of a recorded drive: its events with their reasons, and changes that may help."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import List, Optional, Sequence, Set, Tuple

import numpy as np

from applr_ros1.common.errors import ApplrError
from applr_ros1.drives.drive import Drive
from applr_ros1.why import events
from applr_ros1.why.alternatives import Alternative, best_changes, changes_to_try
from applr_ros1.why.events import AT_GOAL, Event
from applr_ros1.why.explanation import Explanation, at_goal, explain, part_of_robot
from applr_ros1.why.reasons import (
    held,
    jumping,
    late,
    no_plan,
    recovering,
    silent,
    silent_planner,
    stopped,
    stuck,
    unmoved,
)
from applr_ros1.why.replay import Replay, ReplayedCycle
from applr_ros1.why.stretch import Stretch, first_of, last_time

# Alternatives drive on from so many cycles of all events, and at least so many of each event.
CYCLES = 8
LEAST = 3
LEAD_S = 2.0  # time before an event from which these cycles begin: the way into it shows most [s]
EARLY = 2.0  # how much early ones among them are preferred, see some()
EXPLAINED = 5  # number of explained cycles of an event; the middle one stands for the event
EVENT_SHARE = 0.5  # share of an event from which on an observation is its reason
LOST_SHARE = 0.1  # share of a drive that events take from which on remedies are sought
# A drive that takes less than this ratio of a straight drive at top speed needs no remedy.
FAST = 1.25
AROUND_S = 0.5  # time around a moment that is asked about [s]
ASKED = "the moment asked about"
# Reasons that are seen from outside the planner, causes before what follows from them.
OUTSIDE = (silent, no_plan, silent_planner, jumping, held, stopped, unmoved, stuck, recovering)


@dataclass
class Diagnosis:
    """Events of a drive, their reasons, and changes that may help.

    Attributes:
        replay: Replayed drive.
        events: Events in order of time, with their reasons.
        explained: Explanations of some cycles of each event.
        part: Place (x, y) beside the robot where the laser sees a part of it, or None.
        guesses: Alternatives that the replay ranks, the best first. They were not driven.
    """

    replay: Replay
    events: List[Event]
    explained: List[List[Explanation]] = field(default_factory=list)
    part: Optional[Tuple[float, float]] = None
    guesses: List[Alternative] = field(default_factory=list)

    @property
    def drive(self) -> Drive:
        """The recorded drive."""
        return self.replay.drive

    @property
    def longest(self) -> Optional[Event]:
        """Event that took most time."""
        return max(self.events, key=lambda event: event.seconds, default=None)

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


def diagnose(replay: Replay, at: Optional[float] = None) -> Diagnosis:
    """Return the diagnosis of a replayed drive.

    Args:
        replay: Replayed drive.
        at: Time to explain instead of the events [s].
    """
    # What happened
    if at is None:
        found_events = events.find(replay.drive, replay.limits)
    else:
        found_events = [_moment(replay, at)]
    diagnosis = Diagnosis(replay, found_events)

    # Why it happened
    for event in found_events:
        explained = _explanations(replay, event)
        event.reason = _reason(replay, event, explained)
        diagnosis.explained.append(explained)
    if found_events:
        diagnosis.part = part_of_robot(replay)

    # What may help: no parameter, if the robot stops for a part of itself
    if not found_events or diagnosis.part:
        return diagnosis
    diagnosis.guesses = _guesses(replay, found_events)
    return diagnosis


def _moment(replay: Replay, at: float) -> Event:
    """Return the time around a moment as an event."""
    odometry = replay.recording.odometry
    drive_begin = float(odometry.time[0])
    drive_end = last_time(replay.drive)
    if not drive_begin <= at <= drive_end:
        remedy = f"give {drive_begin:.1f} to {drive_end:.1f} s"
        raise ApplrError(f"--at {at:g}: outside the drive, {remedy}")
    x, y, _ = odometry.pose[max(odometry.latest(at), 0)].tolist()
    return Event(ASKED, at - AROUND_S, at + AROUND_S, (x, y))


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


def _reason(replay: Replay, event: Event, explained: Sequence[Explanation]) -> str:
    """Return in words why an event happened, or ""."""
    stretch = Stretch(replay.drive, event.begin, event.end, EVENT_SHARE, replay.planner.period)
    outside_reason = first_of(OUTSIDE, stretch)
    if outside_reason:
        return outside_reason
    if not explained:
        if event.kind == AT_GOAL:
            return ""
        return late(stretch)
    # The middle one of the explained cycles stands for the event.
    middle_explanation = explained[len(explained) // 2]
    if event.kind == AT_GOAL and not middle_explanation.is_blocked:
        cycles = replay.between(event.begin, event.end)
        return at_goal(replay.planner, cycles[-1].settings)
    return middle_explanation.words or late(stretch)


def _guesses(replay: Replay, found: Sequence[Event]) -> List[Alternative]:
    """Return alternatives, those with which the planner drives on fastest first."""
    cycle_counts = []
    cycles_of_events: Set[int] = set()
    for event in found:
        cycles = replay.between(event.begin, event.end)
        cycle_counts.append(len(cycles))
        cycles_of_events.update(map(id, cycles))
    cycle_total = sum(cycle_counts)
    if not cycle_total:
        return []
    other_cycles = []
    for cycle in replay.cycles:
        if id(cycle) not in cycles_of_events:
            other_cycles.append(cycle)

    # Longer events count more, but each of them a little.
    tried_from: List[ReplayedCycle] = []
    for event, cycle_count in zip(found, cycle_counts):
        time_share = cycle_count / cycle_total
        cycles_with_lead = replay.between(event.begin - LEAD_S, event.end)
        tried_from += some(cycles_with_lead, max(LEAST, round(CYCLES * time_share)), EARLY)
    return best_changes(replay, changes_to_try(replay), tried_from, some(other_cycles, CYCLES))


def some(cycles: Sequence[ReplayedCycle], count: int, power: float = 1.0) -> List[ReplayedCycle]:
    """Return at most `count` cycles, only reproduced ones if there are any.

    With a power of 1 they are evenly spread; a larger one prefers early cycles.
    """
    reproduced = [cycle for cycle in cycles if cycle.reproduced]
    # A replay that reproduces nothing still shows what the planner may have weighed.
    preferred = reproduced or list(cycles)
    if not preferred:
        return []
    shares = np.linspace(0.0, 1.0, count) ** power
    rows = (shares * (len(preferred) - 1)).round().astype(int)
    return [preferred[row] for row in np.unique(rows)]
