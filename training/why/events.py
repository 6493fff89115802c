"""Events of a drive: time in which the robot had a goal and stood, crept, turned, swung, or went to and fro.

Events are seen in the measured motion alone, whatever was commanded. Their reasons are found
afterwards (reasons.py, diagnosis.py).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Iterator, List, NamedTuple, Tuple

import numpy as np
from typing_extensions import override

from applr_ros1.drives.drive import Drive, Motion
from training.why.reasons import SILENT_S, STILL_SPEED, STILL_TURN, last_time

# Shares of the top speed below which a robot creeps, and is slow.
CREEPS = 0.25
SLOW = 0.5
# A robot swings if a turn rate above this share of the top one changes its sign at this rate.
SWINGS = 0.25
SWINGS_HZ = 1.0
# A robot goes to and fro if it gains at most this share of its way within this time [s].
FRO_S = 8.0
FRO_SHARE = 0.3
GAP_S = 0.5  # longest gap between two parts of one event [s]
# Events belong to one trap within this distance [m, for the Jackal] and with this gap at most [s].
TRAP_M = 0.5
TRAP_S = 10.0
# A robot at its goal stops and turns to the goal's heading: so long this is usual [s].
AT_GOAL_S = 5.0
AT_GOAL = "turned or stood at the end of its plan"
UNHEARD = "was not heard of"


class Limits(NamedTuple):
    """Limits by which a drive is measured, for each of n odometry messages.

    Attributes:
        speed: (n,) top speed that the planner allows [m/s].
        turn: (n,) top turn rate [rad/s].
        tolerance: Distance from the goal at which the robot has arrived [m].
        scale: Size of the robot relative to the Jackal's.
    """

    speed: np.ndarray
    turn: np.ndarray
    tolerance: float
    scale: float


@dataclass
class Event:
    """Time in which the robot did not drive as it should.

    Attributes:
        kind: What was seen, in words.
        begin: Begin [s].
        end: End [s].
        place: Mean position (x, y) [m] in the odometry frame.
        reason: Why, in words; "" if it is not known yet.
    """

    kind: str
    begin: float
    end: float
    place: Tuple[float, float]
    reason: str = ""

    @property
    def seconds(self) -> float:
        """Duration [s]."""
        return self.end - self.begin

    @override
    def __str__(self) -> str:
        x, y = self.place
        return f"{self.begin:.1f} to {self.end:.1f} s: {self.kind} at ({x:.2f}, {y:.2f})"


def find(drive: Drive, limits: Limits) -> List[Event]:
    """Return the events of a drive in order of time. Those at one place are one event, a trap."""
    drive.require("odometry")
    odometry = drive.odometry
    assert odometry is not None
    at_goal = distances_to_goal(drive, odometry) <= limits.tolerance
    is_pursued = pursued(drive, odometry)
    taken = np.zeros(len(odometry), bool)
    events: List[Event] = []
    for kind, shortest_s, happens in _kinds(odometry, limits):
        for part in _runs(odometry.time, happens & is_pursued & ~at_goal):
            seconds = odometry.time[part][-1] - odometry.time[part][0]
            # An event that lies within one of a more special kind says nothing new.
            if seconds >= shortest_s and taken[part].mean() < 0.5:
                taken[part] = True
                events.append(_event(kind, odometry, part))
    for part in _runs(odometry.time, at_goal & is_pursued):
        if odometry.time[part][-1] - odometry.time[part][0] >= AT_GOAL_S:
            events.append(_event(AT_GOAL, odometry, part))
    events += _unheard(drive, odometry)
    events.sort(key=lambda event: event.begin)
    return list(_traps(events, TRAP_M * limits.scale))


def _kinds(odometry: Motion, limits: Limits) -> Iterator[Tuple[str, float, np.ndarray]]:
    """Yield kinds of events, the special ones first: words, shortest duration [s], rows (n,) in which it is so."""
    v, w = odometry.twist.T
    stands = np.abs(v) < np.minimum(STILL_SPEED, 0.5 * CREEPS * limits.speed)
    turns = np.abs(w) >= STILL_TURN
    yield "went to and fro", FRO_S / 2, _to_and_fro(odometry, limits)
    yield "stood", 1.0, stands & ~turns
    yield "turned on the spot", 2.0, stands & turns
    yield "drove backwards", 2.0, (v < 0) & ~stands
    yield "crept", 1.0, np.abs(v) < CREEPS * limits.speed
    yield "swung from side to side", 2.0, _swings(odometry, limits)
    yield "was slow", 5.0, np.abs(v) < SLOW * limits.speed


def _swings(odometry: Motion, limits: Limits) -> np.ndarray:
    """Return the rows (n,) around which the turn rate changes its sign often."""
    w = odometry.twist[:, 1]
    strong = np.flatnonzero(np.abs(w) > SWINGS * limits.turn)
    changes = odometry.time[strong[1:]][np.diff(np.sign(w[strong])) != 0]
    before = np.searchsorted(changes, odometry.time - 1.0)
    after = np.searchsorted(changes, odometry.time + 1.0)
    often: np.ndarray = (after - before) / 2.0 > SWINGS_HZ
    return often


def _to_and_fro(odometry: Motion, limits: Limits) -> np.ndarray:
    """Return the rows (n,) around which the robot drives forwards and backwards and gains little way."""
    v = odometry.twist[:, 0]
    first = np.searchsorted(odometry.time, odometry.time - FRO_S / 2)
    last = np.searchsorted(odometry.time, odometry.time + FRO_S / 2) - 1
    steps = np.hypot(*np.diff(odometry.pose[:, :2], axis=0).T)
    way = np.concatenate([[0.0], np.cumsum(steps)])
    driven = way[last] - way[first]
    ends = odometry.pose[last, :2] - odometry.pose[first, :2]
    gained = np.hypot(ends[:, 0], ends[:, 1])
    back = np.concatenate([[0], np.cumsum(v < -STILL_SPEED)])
    forth = np.concatenate([[0], np.cumsum(v > STILL_SPEED)])
    drives_both = (back[last] > back[first]) & (forth[last] > forth[first])
    is_long = driven > TRAP_M * limits.scale
    rows: np.ndarray = drives_both & is_long & (gained < FRO_SHARE * driven)
    return rows


def pursued(drive: Drive, odometry: Motion) -> np.ndarray:
    """Return the rows (n,) of the odometry at which the robot had a goal."""
    spans = [(goal.begin, goal.end) for goal in drive.goals]
    if not spans and drive.planned is not None and len(drive.planned):
        # Without move_base's status: the planner commands only while it has a goal.
        moves = np.flatnonzero(drive.planned.twist.any(axis=1))
        if len(moves):
            spans = [(float(drive.planned.time[moves[0]]), float(drive.planned.time[-1]))]
    rows = np.zeros(len(odometry), bool)
    for begin, end in spans:
        rows |= (odometry.time >= begin) & (odometry.time <= end)
    return rows


def distances_to_goal(drive: Drive, odometry: Motion) -> np.ndarray:
    """Return the distance (n,) [m] of each odometry pose to the end of the plan in force; inf without a plan."""
    distances = np.full(len(odometry), np.inf)
    if drive.plans is None:
        return distances
    for row, time in enumerate(odometry.time):
        plan = drive.plans.latest(time)
        if plan >= 0 and len(drive.plans.path[plan]):
            dx, dy = drive.plans.path[plan][-1, :2] - odometry.pose[row, :2]
            distances[row] = np.hypot(dx, dy)
    return distances


def _unheard(drive: Drive, odometry: Motion) -> List[Event]:
    """Return the gaps of the odometry while the robot had a goal."""
    events = []
    times = np.append(odometry.time, last_time(drive))
    is_pursued = pursued(drive, odometry)
    for row in np.flatnonzero(np.diff(times) > SILENT_S):
        if is_pursued[row]:
            x, y, _ = odometry.pose[row].tolist()
            events.append(Event(UNHEARD, float(times[row]), float(times[row + 1]), (x, y)))
    return events


def _runs(times: np.ndarray, happens: np.ndarray) -> List[slice]:
    """Return the parts of the rows in which something happens without a gap of more than GAP_S."""
    rows = np.flatnonzero(happens)
    if not len(rows):
        return []
    breaks = np.flatnonzero(np.diff(times[rows]) > GAP_S) + 1
    return [slice(int(part[0]), int(part[-1]) + 1) for part in np.split(rows, breaks)]


def _event(kind: str, odometry: Motion, part: slice) -> Event:
    x, y = odometry.pose[part, :2].mean(axis=0).tolist()
    return Event(kind, float(odometry.time[part][0]), float(odometry.time[part][-1]), (x, y))


def _traps(events: List[Event], reach: float) -> Iterator[Event]:
    """Yield events, those that follow each other at one place as one, of the kind that lasts longest."""
    while events:
        trap = [events.pop(0)]
        while events and _is_same_place(trap[-1], events[0], reach):
            trap.append(events.pop(0))
        longest = max(trap, key=lambda event: event.seconds)
        end = max(event.end for event in trap)
        yield Event(longest.kind, trap[0].begin, end, longest.place)


def _is_same_place(first: Event, second: Event, reach: float) -> bool:
    """Return whether a second event follows a first one at the same place."""
    if AT_GOAL in (first.kind, second.kind) or UNHEARD in (first.kind, second.kind):
        return False
    distance = np.hypot(second.place[0] - first.place[0], second.place[1] - first.place[1])
    return bool(distance <= reach and second.begin - first.end <= TRAP_S)
