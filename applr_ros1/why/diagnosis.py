"""Diagnosis of a recorded drive: its events, and their reasons."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from typing import Any, List, Mapping, Optional, Sequence, Tuple

import numpy as np

from applr_ros1.drives.drive import Drive, Motion
from applr_ros1.robots import Robot
from applr_ros1.why import events
from applr_ros1.why.black_box.description import DescribedRobot, nobody_publishes
from applr_ros1.why.events import AT_GOAL, SAVED, DriveLimits, Event
from applr_ros1.why.explanation import at_goal, beside, explain, part_of_robot
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
from applr_ros1.why.replay import Replay, ReplayedCycle, some
from applr_ros1.why.stretch import Stretch, first_of

POOR = 0.8  # share of reproduced cycles below which a replay is not to be trusted
EXPLAINED = 5  # number of explained cycles of an event
EVENT_SHARE = 0.5  # share of an event from which on an observation is its reason
LOST_SHARE = 0.1  # share of a drive that events take from which on remedies are sought
# A drive that takes less than this ratio of a straight drive at top speed needs no remedy.
FAST = 1.25
# Reasons that are seen from outside the planner, causes before what follows from them.
OUTSIDE = (silent, jumping, no_plan, silent_planner, blocked, unmoved, stuck, recovering)
OCCUPIED = ": the goal is occupied, or right behind an obstacle"
# Reason of a wait at the goal that no tolerance explains
NOT_ENDED = "move_base does not end its goal, although the robot is within both tolerances"

PART_SEEN = "the laser sees a part of the robot"
NUMBER = re.compile(r"-?\d+(\.\d+)?")
# Where an obstacle is, and which scan shows it, differs from cycle to cycle.
OBSTACLE = re.compile(r"meets the obstacle .*")


@dataclass
class Diagnosis:
    """Events of a drive, and their reasons.

    Attributes:
        drive: The drive.
        robot: Robot that drove.
        motion: Motion in which the events are seen.
        top_speed: Mean top speed that the planner allows [m/s].
        events: Events in order of time, with their reasons.
        asked: The event that somebody, or the black box, asks about; None for the longest one.
        replayed: The replayed drive; None for what is seen from outside alone.
        note: Why it is not replayed, or what else limits the diagnosis; "" if nothing does.
        part: Place (x, y) beside the robot where the laser sees a part of it, or None.
    """

    drive: Drive
    robot: Robot
    motion: Motion
    top_speed: float
    events: List[Event]
    asked: Optional[Event] = None
    replayed: Optional[Replay] = None
    note: str = ""
    part: Optional[Tuple[float, float]] = None

    @classmethod
    def of(cls, replay: Replay, found_events: List[Event], **found: Any) -> Diagnosis:
        """Return the diagnosis of a replayed drive.

        Args:
            replay: Replayed drive.
            found_events: Its events.
            found: Other attributes.
        """
        return cls(
            drive=replay.drive,
            robot=replay.robot,
            motion=replay.recording.odometry,
            top_speed=replay.top_speed,
            events=found_events,
            replayed=replay,
            **found,
        )

    @property
    def replay(self) -> Replay:
        """The replayed drive, if there is one."""
        assert self.replayed is not None
        return self.replayed

    @property
    def told(self) -> Optional[Event]:
        """Event that is told: the one that is asked about, else the one that took most time."""
        if self.asked is not None:
            return self.asked
        return max(self.events, key=lambda event: event.seconds, default=None)

    @property
    def goal(self) -> Optional[PursuedGoal]:
        """Goal that the robot pursued in the event that is told, or its last one.

        None if it is unknown.
        """
        event = self.told
        # An event may begin before the first route to its goal.
        time = 0.5 * (event.begin + event.end) if event is not None else math.inf
        return self.replay.recording.goal_at(time)

    @property
    def certainty(self) -> str:
        """How far the replay agrees with the drive, and with the event that is told."""
        words = str(self.replay)
        if self.told is not None:
            words += f"; {reproduced_share(self.replay, self.told):.0%} in this event"
        return f"{words}; {self.doubt}" if self.doubt else words

    @property
    def doubt(self) -> str:
        """Why the planner's reasons in this replay are not to be trusted; "" if they are.

        What is reproduced elsewhere proves nothing of the event that is told. Stops of move_base
        itself say nothing about the replay of the local planner.
        """
        share = reproduced_share(self.replay, self.told)
        if share >= POOR:
            return ""
        return (
            f"only {share:.0%} of the planner's commands are reproduced, so its reasons are not to "
            "be trusted: its parameters differ, topics or scans are missing, or the computer was "
            "busy"
        )

    @property
    def wants_remedy(self) -> bool:
        """True if events took much of the drive, and it was not nearly as fast as possible."""
        odometry = self.motion
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


def reproduced_share(replay: Replay, event: Optional[Event]) -> float:
    """Return the share of the cycles of an event, if it has some, that a replay reproduces."""
    cycles = replay.cycles
    if event is not None:
        cycles = replay.between(event.begin, event.end) or cycles
    return sum(cycle.reproduced for cycle in cycles) / len(cycles)


def is_explained(replay: Replay, event: Event) -> bool:
    """Return whether a replay explains an event: it reproduces its cycles, which are most of it.

    While DWAPlannerROS has found no command yet, or a recovery behaviour runs, there is no plan to
    replay.
    """
    cycles = replay.between(event.begin, event.end)
    commands = replay.recording.planned.between(event.begin, event.end)
    are_most = len(cycles) >= EVENT_SHARE * len(commands)
    return are_most and reproduced_share(replay, event) >= POOR


def give_outside_reason(event: Event, drive: Drive, limits: DriveLimits) -> None:
    """Set the reason of an event that is seen from outside the planner, if there is one.

    It needs no replay, so that it is known for every local planner.

    Args:
        event: The event.
        drive: Its drive.
        limits: Limits by which the drive is measured.
    """
    if event.is_outside:
        return  # The description of its bag says why.
    period = limits.period_at(event.end)
    stretch = Stretch(drive, event.begin, event.end, EVENT_SHARE, period)
    event.reason = first_of(OUTSIDE, stretch)
    if event.reason == NO_PATH and is_goal_occupied(stretch, limits.scale):
        event.reason += OCCUPIED
    if not event.reason and event.is_arrived:
        event.reason = NOT_ENDED
    event.is_outside = bool(event.reason)
    if not event.reason and event.kind != AT_GOAL:
        event.reason = late(stretch)


def diagnose(
    replay: Replay, at: Optional[float] = None, box: Optional[DescribedRobot] = None
) -> Diagnosis:
    """Return the diagnosis of a replayed drive.

    Args:
        replay: Replayed drive.
        at: Time to explain instead of the events [s].
        box: Description of a black box's bag, or None.
    """
    # What happened
    drive = replay.drive
    odometry = replay.recording.odometry
    limits = replay.limits
    if at is None:
        found_events = events.find(drive, odometry, limits)
        asked = find_stop(found_events, drive, box)
    else:
        asked = events.around(at, odometry, limits)
        found_events = [asked]

    # Why it happened, causes before what follows from them
    part = part_of_robot(replay) if found_events else None
    for event in found_events:
        if part is not None:
            # Whatever else the planner or the monitor says follows from that.
            event.reason = f"{PART_SEEN}, {beside(*part, digits=1)} of its centre"
            event.is_outside = True
        give_outside_reason(event, drive, limits)
        explain_event(replay, event)
        event.is_guessed = not event.is_outside and not is_explained(replay, event)
    return Diagnosis.of(replay, found_events, asked=asked, part=part)


def find_stop(
    found_events: List[Event], drive: Drive, box: Optional[DescribedRobot]
) -> Optional[Event]:
    """Return the event that is the stop of a black box's bag.

    None if the bag has no stop, or if somebody asked to save it and nothing happened.

    Args:
        found_events: Events of the drive. A stop that is none of them, as the end of a goal of a
            robot that drives, is added.
        drive: The drive.
        box: Description of the bag, or None.
    """
    if box is None or box.stop is None:
        return None
    stop = box.stop
    if stop.kind == SAVED and not found_events:
        return None
    begin = stop.begin - drive.recorded_at - events.AROUND_S
    end = stop.end - drive.recorded_at

    def overlap(event: Event) -> float:
        # Somebody who asks to save asks about the latest event.
        if stop.kind == SAVED:
            return event.end
        return min(event.end, end) - max(event.begin, begin)

    if not any(overlap(event) > 0.0 for event in found_events):
        found_events.append(Event(stop.kind, begin, end, stop.place))
        found_events.sort(key=lambda event: event.begin)
    event_of_stop = max(found_events, key=overlap)
    # Whatever else stops a robot without its laser follows from that.
    event_of_stop.reason = nobody_publishes(box.unpublished)
    event_of_stop.is_outside = bool(event_of_stop.reason)
    return event_of_stop


def explain_event(replay: Replay, event: Event) -> None:
    """Set the explained cycles of an event, and the planner's reason unless it lies outside."""
    cycles = replay.between(event.begin, event.end)
    if not cycles:
        return
    explained = []
    for cycle in _slow(cycles):
        moment = replay.at(cycle)
        explained.append(explain(moment))
    # In a cycle without a choice, the planner shows nothing of what it prefers.
    with_choice = [entry for entry in explained if entry.words or not entry.is_blocked]
    explained = with_choice or explained
    event.cycles = [explanation.values() for explanation in explained]
    if event.is_outside:
        return
    explanation = explained[usual_row(event.cycles)]
    if event.kind == AT_GOAL and not explanation.is_blocked:
        event.reason = at_goal(replay.planner, cycles[-1].settings)
    elif explanation.words:
        event.reason = explanation.words


def usual_row(cycles: Sequence[Mapping[str, Any]]) -> int:
    """Return the row of the explained cycle that stands for an event.

    It has the reason that most of the cycles have, whatever was measured in each. Of these cycles
    it is the middle one.
    """
    reasons = [general(cycle["words"]) for cycle in cycles]
    middle_reason = reasons[len(reasons) // 2]
    usual = max(reasons, key=lambda it: (reasons.count(it), it == middle_reason))
    rows = [row for row, reason in enumerate(reasons) if reason == usual]
    return rows[len(rows) // 2]


def general(reason: str) -> str:
    """Return a reason without what was measured in one cycle or stop."""
    return NUMBER.sub("…", OBSTACLE.sub("meets an obstacle", reason))


def _slow(cycles: Sequence[ReplayedCycle]) -> List[ReplayedCycle]:
    """Return some of the slow cycles of an event."""
    # The fast cycles of an event, as when a robot swings, do not show what slows it.
    median_speed = np.median([cycle.command[0] for cycle in cycles])
    slow_cycles = []
    for cycle in cycles:
        if cycle.command[0] <= median_speed:
            slow_cycles.append(cycle)
    return some(slow_cycles, EXPLAINED)
