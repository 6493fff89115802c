"""Events of a drive: time in which a robot with a goal stood, crept, turned, or went to and fro.

Events are seen in the measured motion alone, whatever was commanded. Their reasons are found
afterwards (reasons.py, diagnosis.py).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, Dict, Iterator, List, NamedTuple, Optional, Sequence, Tuple

import numpy as np

from applr_ros1.common.angles import normalize_angle_modulo
from applr_ros1.common.errors import ApplrError
from applr_ros1.common.paths import distances, travelled
from applr_ros1.drives.drive import Drive, Motion
from applr_ros1.senses.standing import STOOD
from applr_ros1.why.reasons import longest_usual_gap
from applr_ros1.why.stretch import SLOW

CREEPS = 0.25  # share of the top speed below which a robot creeps
# Shortest durations that count as an event [s]. A robot that turns, swings or backs out for a
# moment drives as it should, and even a sound drive is slow for some seconds beside an obstacle.
STOOD_S = 1.0
TURNED_S = 2.0
SLOW_S = 5.0
# A robot swings if a turn rate above this share of the top one changes its sign at this rate.
SWINGS = 0.25
SWINGS_HZ = 1.0
# A robot goes to and fro if it gains at most this share of its way within this time [s].
FRO_S = 8.0
FRO_SHARE = 0.3
# Longest gap between two parts of one event [s], and in usual intervals of the odometry
GAP_S = 0.5
GAP_PERIODS = 1.5
# Events belong to one trap within this distance [m, for the Jackal] and with this gap at most [s].
TRAP_M = 0.5
TRAP_S = 10.0
GOAL_M = 0.1  # distance within which a robot is at its goal at least [m, for the Jackal]
# A robot at its goal stops and turns to the goal's heading: so long this is usual [s].
AT_GOAL_S = 5.0
AT_GOAL = "turned or stood at the end of its plan"
UNHEARD = "was not heard of"
WAS_SLOW = "was slow"
NO_GOAL_S = 3.0  # pause of the commands from which on a robot without a status has no goal [s]
AROUND_S = 0.5  # time around a moment that is asked about [s]
# Kinds of stops of a black box: that somebody asked to save, and the end of a goal
SAVED = "was asked to save"
GAVE_UP = "gave up its goal"


class DriveLimits(NamedTuple):
    """Limits by which a drive is measured, for each of n odometry messages.

    Attributes:
        speed: (n,) top speed that the planner allows [m/s].
        turn: (n,) top turn rate [rad/s].
        tolerance: Distance from the goal at which the robot has arrived [m].
        scale: Size of the robot relative to the Jackal's.
        end: Time of the drive's last message [s].
        yaw_tolerance: Angle from the goal's heading within which it has arrived [rad]; 0 if it is
            unknown.
        rates: Control rate [Hz] from each time [s] on, in order of time; 0 if it is unknown.
    """

    speed: np.ndarray
    turn: np.ndarray
    tolerance: float
    scale: float
    end: float
    yaw_tolerance: float = 0.0
    rates: Sequence[Tuple[float, float]] = ((-np.inf, 0.0),)

    def period_at(self, time: float) -> float:
        """Return the control period at a time [s]; 0 if it is unknown."""
        rates_so_far = [rate for begin_time, rate in self.rates if begin_time <= time]
        rate = rates_so_far[-1]
        return 1.0 / rate if rate else 0.0


@dataclass
class Event:
    """Time in which the robot did not drive as it should.

    Attributes:
        kind: What was seen, in words.
        begin: Begin [s].
        end: End [s].
        place: Mean position (x, y) [m] in the odometry frame.
        reason: Why, in words; "" if it is not known yet.
        is_outside: Whether the reason lies outside the local planner, which could do nothing.
        is_guessed: Whether the reason is that of a replay that explains too little of the event.
        is_asked: Whether it is the time around a moment that somebody asks about.
        is_arrived: Whether the robot was within both tolerances of its goal for half of it.
        lost: Time that it cost: its duration without that of its way at top speed [s].
        cycles: JSON values of its explained cycles, for a page.
    """

    kind: str
    begin: float
    end: float
    place: Tuple[float, float]
    reason: str = ""
    is_outside: bool = False
    is_guessed: bool = False
    is_asked: bool = False
    is_arrived: bool = False
    lost: float = 0.0
    cycles: Sequence[Dict[str, Any]] = ()

    @property
    def seconds(self) -> float:
        """Duration [s]."""
        return self.end - self.begin

    def __str__(self) -> str:
        x, y = self.place
        return f"{self.begin:.1f} to {self.end:.1f} s: {self.kind} at ({x:.2f}, {y:.2f})"


class RobotStop(NamedTuple):
    """Stop that a black box found, or was asked to save.

    Attributes:
        kind: What happened, in words.
        begin: Begin [s].
        end: Time until which it has lasted when it was found [s].
        place: Position (x, y) [m] in the odometry frame.
        number: How many stops there were at this place so far; 1 for one that is to be answered.
    """

    kind: str
    begin: float
    end: float
    place: Tuple[float, float]
    number: int = 1

    def __str__(self) -> str:
        x, y = self.place
        return f"the robot {self.kind} at ({x:.2f}, {y:.2f})"


class Kind(NamedTuple):
    """Kind of event that is seen in the motion.

    Attributes:
        words: What the robot did.
        shortest: Shortest duration that counts [s].
        happens: (n,) whether it is so at each odometry message.
        excused: (n,) whether a row does not count towards this duration; None if all count.
    """

    words: str
    shortest: float
    happens: np.ndarray
    excused: Optional[np.ndarray] = None

    def seconds(self, times: np.ndarray, rows: slice) -> float:
        """Return the duration [s] of some rows that counts, of odometry at times (n,)."""
        durations = np.diff(times[rows])
        if self.excused is not None:
            durations = durations[~self.excused[rows][:-1]]
        return float(durations.sum())


def find(drive: Drive, odometry: Motion, limits: DriveLimits) -> List[Event]:
    """Return the events of a drive in order of time. Those at one place are one event, a trap.

    Args:
        drive: The drive.
        odometry: Motion in which events are seen.
        limits: What it is measured by.
    """
    # A robot circles a goal whose tolerance it cannot meet.
    goal_radius = max(limits.tolerance, GOAL_M * limits.scale)
    goal_distance, goal_angle = offsets_from_goal(drive, odometry).T
    at_goal = goal_distance <= goal_radius
    has_arrived = (goal_distance <= limits.tolerance) & (goal_angle <= limits.yaw_tolerance)
    is_pursued = pursued(drive, odometry)
    is_under_way = is_pursued & ~at_goal

    is_taken = np.zeros(len(odometry), bool)
    found_events: List[Event] = []
    for kind in _kinds(odometry, limits):
        for event_rows in _runs(odometry.time, kind.happens & is_under_way):
            event = _event(kind.words, odometry, event_rows)
            # An event that lies within one of a more special kind says nothing new.
            is_known = is_taken[event_rows].mean() >= 0.5
            is_long = kind.seconds(odometry.time, event_rows) >= kind.shortest
            if is_long and not is_known:
                is_taken[event_rows] = True
                found_events.append(event)

    # At the goal the robot may stop and turn, if it does not take long.
    for event_rows in _runs(odometry.time, at_goal & is_pursued):
        event = _event(AT_GOAL, odometry, event_rows)
        event.is_arrived = bool(has_arrived[event_rows].mean() > 0.5)
        if event.seconds >= AT_GOAL_S:
            found_events.append(event)

    found_events += _unheard(odometry, is_pursued, limits.end)
    found_events.sort(key=lambda event: event.begin)
    traps = list(_traps(found_events, TRAP_M * limits.scale))
    top_speed = float(limits.speed.mean())
    for trap in traps:
        trap.lost = round(_lost_seconds(trap, odometry, top_speed), 2)
    return traps


def _lost_seconds(event: Event, odometry: Motion, top_speed: float) -> float:
    """Return the duration of an event without that of its way at top speed [s]."""
    part = odometry.between(event.begin, event.end)
    if len(part) < 2 or top_speed <= 0.0:
        return event.seconds
    # Not the length of the path: what a robot drives to and fro is lost.
    gained_way = np.hypot(*(part.pose[-1, :2] - part.pose[0, :2]))
    return max(event.seconds - float(gained_way) / top_speed, 0.0)


def around(at: float, odometry: Motion, limits: DriveLimits) -> Event:
    """Return the time around a moment [s] as an event.

    Raises:
        ApplrError: The moment is outside the drive.
    """
    drive_begin = float(odometry.time[0])
    if not drive_begin <= at <= limits.end:
        remedy = f"give {drive_begin:.1f} to {limits.end:.1f} s"
        raise ApplrError(f"--at {at:g}: outside the drive, {remedy}")
    latest_row = max(odometry.latest(at), 0)
    x, y, _ = odometry.pose[latest_row].tolist()
    begin_time = at - AROUND_S
    end_time = at + AROUND_S
    motion = odometry.between(begin_time, end_time)
    # Where the odometry is silent, the latest message is all that is known.
    if not len(motion):
        motion = odometry.part(slice(latest_row, latest_row + 1))
    return Event(_motion_in_words(motion), begin_time, end_time, (x, y), is_asked=True)


def _motion_in_words(motion: Motion) -> str:
    """Return what a robot did on average, with its speed [m/s]."""
    v, w = motion.twist.mean(axis=0).tolist()
    if v <= -STOOD.v:
        return f"drove backwards with {-v:.2f} m/s"
    if v >= STOOD.v:
        return f"drove with {v:.2f} m/s"
    if abs(w) >= STOOD.w:
        return f"turned on the spot with {abs(w):.2f} rad/s"
    return "stood"


def _kinds(odometry: Motion, limits: DriveLimits) -> Iterator[Kind]:
    """Yield kinds of events, the special ones first, because each row belongs to one event."""
    v, w = odometry.twist.T
    speed = np.abs(v)
    # A robot whose top speed is very low drives at speeds at which others stand.
    standing_speed = np.minimum(STOOD.v, 0.5 * CREEPS * limits.speed)
    stands = speed < standing_speed
    turns = np.abs(w) >= STOOD.w
    turns_on_the_spot = stands & turns
    drives_back = (v < 0.0) & ~stands
    yield Kind("went to and fro", FRO_S / 2, _to_and_fro(odometry, limits))
    yield Kind("stood", STOOD_S, stands & ~turns)
    yield Kind("turned on the spot", TURNED_S, turns_on_the_spot)
    yield Kind("drove backwards", TURNED_S, drives_back)
    # A turn on the spot or a way back is slow as well, but is an event of its own if it lasts.
    yield Kind(
        "crept", STOOD_S, speed < CREEPS * limits.speed, excused=turns_on_the_spot | drives_back
    )
    yield Kind("swung from side to side", TURNED_S, _swings(odometry, limits))
    yield Kind(WAS_SLOW, SLOW_S, speed < SLOW * limits.speed)


def _swings(odometry: Motion, limits: DriveLimits) -> np.ndarray:
    """Return the rows (n,) around which the turn rate changes its sign often."""
    w = odometry.twist[:, 1]
    # Slow turns do not count: a robot that drives straight on corrects its heading all the time.
    turning_rows = np.flatnonzero(np.abs(w) > SWINGS * limits.turn)
    is_change = np.diff(np.sign(w[turning_rows])) != 0
    change_times = odometry.time[turning_rows[1:]][is_change]

    # Changes within a second on both sides of each row
    count_until_begin = np.searchsorted(change_times, odometry.time - 1.0)
    count_until_end = np.searchsorted(change_times, odometry.time + 1.0)
    changes_per_second = (count_until_end - count_until_begin) / 2.0
    swings_often: np.ndarray = changes_per_second > SWINGS_HZ
    return swings_often


def _to_and_fro(odometry: Motion, limits: DriveLimits) -> np.ndarray:
    """Return the rows (n,) around which the robot drives to and fro and gains little way."""
    times = odometry.time
    first_rows = np.searchsorted(times, times - FRO_S / 2)
    last_rows = np.searchsorted(times, times + FRO_S / 2) - 1

    # Way along the path, and distance between its ends
    positions = odometry.pose[:, :2]
    way_lengths = travelled(positions)
    driven_way = way_lengths[last_rows] - way_lengths[first_rows]
    gained_distance = distances(positions[last_rows], positions[first_rows])

    # Numbers of rows until each one in which the robot drives backwards, and forwards
    v = odometry.twist[:, 0]
    backward_rows = np.concatenate([[0], np.cumsum(v < -STOOD.v)])
    forward_rows = np.concatenate([[0], np.cumsum(v > STOOD.v)])
    drives_back = backward_rows[last_rows] > backward_rows[first_rows]
    drives_on = forward_rows[last_rows] > forward_rows[first_rows]

    is_long = driven_way > TRAP_M * limits.scale
    is_in_vain = gained_distance < FRO_SHARE * driven_way
    goes_to_and_fro: np.ndarray = drives_back & drives_on & is_long & is_in_vain
    return goes_to_and_fro


def pursued(drive: Drive, odometry: Motion) -> np.ndarray:
    """Return the rows (n,) of the odometry at which the robot had a goal."""
    time_spans = [(goal.begin, goal.end) for goal in drive.goals]
    planned = drive.planned
    if not time_spans and planned:
        # Without move_base's status: the planner commands only while it has a goal.
        moving_rows = np.flatnonzero(planned.twist.any(axis=1))
        if len(moving_rows):
            times = planned.time[moving_rows[0] :]
            pauses = np.flatnonzero(np.diff(times) > NO_GOAL_S) + 1
            for span_times in np.split(times, pauses):
                time_spans.append((float(span_times[0]), float(span_times[-1])))
    is_pursued = np.zeros(len(odometry), bool)
    for begin_time, end_time in time_spans:
        is_pursued |= (odometry.time >= begin_time) & (odometry.time <= end_time)
    return is_pursued


def offsets_from_goal(drive: Drive, odometry: Motion) -> np.ndarray:
    """Return distance [m] and angle [rad] (n, 2) of each odometry pose from the end of the plan.

    They are inf before the first plan. At the goal, DWAPlannerROS publishes plans without poses.
    """
    offsets = np.full((len(odometry), 2), np.inf)
    if drive.plans is None:
        return offsets
    plan_times, goal_poses = drive.plans.ends
    plan_rows = np.searchsorted(plan_times, odometry.time, side="right") - 1
    has_plan = plan_rows >= 0
    if has_plan.any():
        to_goal = np.array(goal_poses)[plan_rows[has_plan]] - odometry.pose[has_plan]
        offsets[has_plan, 0] = np.hypot(to_goal[:, 0], to_goal[:, 1])
        offsets[has_plan, 1] = np.abs(normalize_angle_modulo(to_goal[:, 2]))
    return offsets


def _unheard(odometry: Motion, is_pursued: np.ndarray, drive_end: float) -> List[Event]:
    """Return the silences of the odometry that begin while the robot has a goal.

    The last gap may last from the last odometry message to the end of the drive [s].
    """
    silences = []
    times = np.append(odometry.time, drive_end)
    for row in np.flatnonzero(np.diff(times) > longest_usual_gap(times)):
        # Before its first goal and after its last one, nobody waits for the robot.
        if is_pursued[row]:
            x, y, _ = odometry.pose[row].tolist()
            begin_time = float(times[row])
            end_time = float(times[row + 1])
            silences.append(Event(UNHEARD, begin_time, end_time, (x, y)))
    return silences


def _runs(times: np.ndarray, happens: np.ndarray) -> List[slice]:
    """Return the parts of the rows in which something happens without a long gap."""
    rows = np.flatnonzero(happens)
    if not len(rows):
        return []
    # Odometry may come once a second.
    longest_gap = max(GAP_S, GAP_PERIODS * float(np.median(np.diff(times))))
    is_gap = np.diff(times[rows]) > longest_gap
    breaks = np.flatnonzero(is_gap) + 1
    runs = []
    for rows_of_run in np.split(rows, breaks):
        first_row = int(rows_of_run[0])
        last_row = int(rows_of_run[-1])
        runs.append(slice(first_row, last_row + 1))
    return runs


def _event(kind: str, odometry: Motion, part: slice) -> Event:
    """Return the event of a kind that lasts for some rows of the odometry."""
    x, y = odometry.pose[part, :2].mean(axis=0).tolist()
    times = odometry.time[part]
    return Event(kind, float(times[0]), float(times[-1]), (x, y))


def _traps(events: List[Event], reach: float) -> Iterator[Event]:
    """Yield events. Those at one place are one, of the kind that lasts longest."""
    while events:
        events_of_trap = [events.pop(0)]
        while events and _is_same_place(events_of_trap[-1], events[0], reach):
            events_of_trap.append(events.pop(0))
        longest_event = max(events_of_trap, key=lambda event: event.seconds)
        # Events may overlap, so that the last one to begin need not be the last one to end.
        end_time = max(event.end for event in events_of_trap)
        yield replace(longest_event, begin=events_of_trap[0].begin, end=end_time)


def _is_same_place(first: Event, second: Event, reach: float) -> bool:
    """Return whether a second event follows a first one at the same place."""
    kinds = (first.kind, second.kind)
    # These two have reasons of their own.
    if AT_GOAL in kinds or UNHEARD in kinds:
        return False
    dx = second.place[0] - first.place[0]
    dy = second.place[1] - first.place[1]
    is_near = np.hypot(dx, dy) <= reach
    pause = second.begin - first.end
    return bool(is_near and pause <= TRAP_S)
