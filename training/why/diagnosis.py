"""Diagnosis of a recorded drive: its events with their reasons, and the changes that were tried."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, Iterable, List, Optional, Sequence, Set, Tuple

import numpy as np

from applr_ros1.common.angles import Pose
from applr_ros1.common.errors import ApplrError
from applr_ros1.common.paths import distances
from applr_ros1.drives.drive import Drive
from applr_ros1.robots import Robot
from training.why import events
from training.why.alternatives import Alternative, best_changes, changes_to_try, together
from training.why.candidates import (
    Candidate,
    escape_candidates,
    file_candidates,
    recorded_changes,
    with_changes,
)
from training.why.events import AT_GOAL, Event
from training.why.explanation import Explanation, at_goal, explain, part_of_robot
from training.why.reasons import (
    Stretch,
    first_of,
    held,
    jumping,
    last_time,
    late,
    no_plan,
    recovering,
    silent,
    silent_planner,
    stopped,
    stuck,
    unmoved,
)
from training.why.replay import Replay, ReplayedCycle
from training.why.seen_world import seen_grid, seen_world
from training.why.whole_drives import ROUND, Course, Trials, limit_of, try_out
from training.workers.pool import Pool

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
CANDIDATES = 12  # number of candidates that are driven
MUCH = 4.0  # factor of a change beyond which a factor of 2 is tried, too
LIVE = 5  # number of candidates among them that the replay ranks
AROUND_S = 0.5  # time around a moment that is asked about [s]
NEAR_GOAL_M = 2.0  # distance of the last pose from the plan's end below which this is the goal [m]
ARRIVED_M = 1.5  # distance from the goal at the end of a drive that arrived [m, for the Jackal]
APART_M = 0.3  # distance from which on two drives differ [m]
ASKED = "the moment asked about"
# Reasons that are seen from outside the planner, causes before what follows from them.
OUTSIDE = (silent, no_plan, silent_planner, jumping, held, stopped, unmoved, stuck, recovering)


@dataclass
class Diagnosis:
    """Events of a drive, their reasons, and the changes that were tried.

    Attributes:
        replay: Replayed drive.
        events: Events in order of time, with their reasons.
        explained: Explanations of some cycles of each event.
        part: Place (x, y) beside the robot where the laser sees a part of it, or None.
        guesses: Alternatives that the replay ranks, the best first. They were not driven.
        trials: Whole drives; None if none were needed or possible.
    """

    replay: Replay
    events: List[Event]
    explained: List[List[Explanation]] = field(default_factory=list)
    part: Optional[Tuple[float, float]] = None
    guesses: List[Alternative] = field(default_factory=list)
    trials: Optional[Trials] = None

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


def diagnose(replay: Replay, at: Optional[float] = None, pool: Optional[Pool] = None) -> Diagnosis:
    """Return the diagnosis of a replayed drive.

    Args:
        replay: Replayed drive.
        at: Time to explain instead of the events [s].
        pool: Workers that drive whole drives; None to leave them out.
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

    # What would help: no parameter, if the robot stops for a part of itself
    if not found_events or diagnosis.part:
        return diagnosis
    diagnosis.guesses = _guesses(replay, found_events)
    if pool is not None and at is None and diagnosis.wants_remedy:
        diagnosis.trials = _trials(diagnosis, pool)
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


# -- whole drives ----------------------------------------------------------------------------------
def _trials(diagnosis: Diagnosis, pool: Pool) -> Optional[Trials]:
    """Drive with the recorded values and with candidates; None if the drive's goal is unknown."""
    replay = diagnosis.replay
    drive = replay.drive
    longest_event = diagnosis.longest
    assert longest_event is not None
    goal = goal_of(drive)
    if goal is None:
        return None
    # The settings at the longest event: if they change on the way, no drive can have all of them.
    settings = replay.history.at(longest_event.begin)
    robot = with_changes(replay.robot, recorded_changes(replay.robot, settings), replay.robot.name)

    # From where the robot was sent to its goal
    odometry = replay.recording.odometry
    is_pursued = events.pursued(drive, odometry)
    first_row = int(np.argmax(is_pursued))
    last_row = int(np.flatnonzero(is_pursued)[-1])
    x, y, yaw = odometry.pose[first_row].tolist()
    seconds = float(odometry.time[last_row] - odometry.time[first_row])
    # A drive that ended on its way does not tell how long the whole way takes.
    dx, dy = odometry.pose[last_row, :2] - goal[:2]
    if np.hypot(dx, dy) > ARRIVED_M * replay.robot.world_scale:
        seconds = np.inf
    course = Course(
        robot=robot,
        world=seen_world(seen_grid(replay.recording), drive.name, (x, y, yaw), goal),
        has_monitor=drive.planned is not drive.commands,
        limit=limit_of(seconds),
        ends_at_tolerance=longest_event.kind != AT_GOAL,
    )
    return try_out(course, candidates(diagnosis, robot), pool)


def candidates(diagnosis: Diagnosis, robot: Robot) -> List[Candidate]:
    """Return the candidates that are driven: the replay's first ones, and values of files."""
    replay = diagnosis.replay
    live_candidates: List[Candidate] = []
    for guess in diagnosis.guesses[:LIVE]:
        live_candidates += milder(replay, guess)
        live_candidates.append(Candidate(guess.changes))
    live_candidates += escape_candidates(replay.planner.name, replay.settings[replay.planner.name])

    # The replay does not see what values of files would do: unusual ones come before guesses that
    # it ranks low.
    all_candidates = live_candidates[:ROUND] + file_candidates(robot) + live_candidates[ROUND:]
    return all_candidates[:CANDIDATES]


def milder(replay: Replay, guess: Alternative) -> List[Candidate]:
    """Return the change of a guess by a factor of 2, if the guess goes much farther."""
    change = guess.change
    if isinstance(change.before, bool) or change.departure <= MUCH:
        return []
    factor = 2.0 if abs(change.after) > abs(change.before) else 0.5
    milder_change = change._replace(after=type(change.before)(change.before * factor))
    return [Candidate(together(replay.settings, milder_change))]


def goal_of(drive: Drive) -> Optional[Pose]:
    """Return the last goal (x, y, yaw) of a drive in the odometry frame, or None if unknown."""
    for plans in (drive.routes, drive.plans):
        if plans is None:
            continue
        not_empty = [plan_path for plan_path in plans.path if len(plan_path)]
        if not not_empty:
            continue
        plan_end = not_empty[-1][-1]
        is_whole = plans is drive.routes
        if not is_whole and drive.odometry is not None:
            # The followed part of a plan ends at the goal only near it.
            dx, dy = plan_end[:2] - drive.odometry.pose[-1, :2]
            is_whole = bool(np.hypot(dx, dy) <= NEAR_GOAL_M)
        if is_whole:
            x, y, yaw = plan_end.tolist()
            return x, y, yaw
    # Goals are sent in any frame, often that of a map.
    for sent in reversed(drive.sent):
        if sent.frame == drive.frame:
            return sent.pose
    return None


# -- two drives ------------------------------------------------------------------------------------
def compared(first: Replay, second: Replay) -> List[str]:
    """Return lines about a second drive: where its route differs, and whether its parameters help.

    The first line begins with the share of the second drive that is reproduced.
    """
    # The replay runs the local planner alone, which does not read the global costmap. Texts, such
    # as names of frames, are no values that slow a robot.
    changes = []
    for change in first.settings.differences(second.settings):
        is_text = isinstance(change.before, str)
        if not is_text and not change.server.startswith("global_costmap"):
            changes.append(change)
    slow_cycles: List[ReplayedCycle] = []
    for event in events.find(first.drive, first.limits):
        slow_cycles += first.between(event.begin, event.end)
    alternatives = best_changes(first, changes, some(slow_cycles or first.cycles, CYCLES), [])

    changes_in_words = ", ".join(map(str, changes)) or "none"
    lines = [f"{second}; {_parting(first, second)}; differing parameters: {changes_in_words}"]
    if alternatives:
        lines.append("Changes of the first drive to a value of the second:")
        lines += indented(alternatives)
    return lines


def indented(items: Iterable[Any]) -> List[str]:
    """Return a line for each item, to be printed below a heading."""
    return [f"   {item}" for item in items]


def _parting(first: Replay, second: Replay) -> str:
    """Return in words when the first drive leaves the route of the second one.

    The cycles lie close enough on a route for distances between points. Both drives have the same
    odometry frame only if they began at the same place.
    """
    route = np.array([cycle.pose[:2] for cycle in second.cycles])
    for cycle in first.cycles:
        position = np.array(cycle.pose[:2])
        if distances(route, position).min() > APART_M:
            return f"routes diverge at {cycle.at:.1f} s"
    return "same route"
