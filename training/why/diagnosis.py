"""Diagnosis of a replayed drive: its events, each explained, and the changes of one parameter that remedy them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Dict, List, Optional, Sequence

import numpy as np

from applr_ros1.common.errors import ApplrError
from training.why import events
from training.why.alternatives import Alternative, best_changes, changes_to_try
from training.why.events import Event
from training.why.explanation import explain, part_of_robot
from training.why.replay import Cycle, Replay

CYCLES, LEAST = (
    8,
    3,
)  # numbers of cycles from which alternatives drive on, of all events and of each event at least
LEAD_S = 2.0  # time before an event from which these cycles begin, because the way into it shows most [s]
EARLY = 2.0  # how much early ones among them are preferred, see some()
EXPLAINED = (
    5  # number of cycles of an event that are explained; the middle one stands for the event
)
REMEDY = 0.2  # share of a drive's time that a remedy saves at least
POOR = 0.8  # share of reproduced commands below which a replay is not to be trusted
LISTED = 4  # number of events, and of alternatives, that a terminal shows
APART_M = 0.3  # distance from which on two drives differ [m]
SCANS, CELL_M = 60, 0.05  # number of scans in a page's map, and distance of its points [m]


@dataclass
class Diagnosis:
    """Events of a replay, cycles outside of them, and alternatives, the best first."""

    replay: Replay
    events: List[Event]
    others: List[Cycle]
    tried: List[Alternative]

    @property
    def remedies(self) -> List[Alternative]:
        """Alternatives that would have saved enough of the drive's time, and with which the robot does not creep."""
        slow, top = 1.0 - len(self.others) / len(self.replay.cycles), self.top_speed()
        fast = [one for one in self.tried if one.after.speed >= events.STANDS * top]
        return [
            one
            for one in fast
            if slow * (1.0 - max(one.before.speed, 0.0) / one.after.speed) >= REMEDY
        ]

    def top_speed(self) -> float:
        """Return the mean max_vel_x in force [m/s]."""
        return float(
            np.mean(
                [cycle.settings[self.replay.server]["max_vel_x"] for cycle in self.replay.cycles]
            )
        )

    def lines(self) -> List[str]:
        """Return the diagnosis for a terminal, the answer first."""
        longest = sorted(self.events, key=lambda event: -len(event.cycles))[:LISTED]
        own = part_of_robot(self.replay) if longest else None
        if own:
            answer = "The laser sees a part of the robot, {:.1f} m ahead and {:.1f} m left of its centre.".format(
                *own
            )
        elif self.remedies:
            answer = f"Try {self.remedies[0]}."
        elif longest:
            answer = (
                f"No change of one parameter would save much. {longest[0]}. {longest[0].why[0]}"
            )
        else:
            mean, top = (
                np.mean([cycle.command[0] for cycle in self.replay.cycles]),
                self.top_speed(),
            )
            answer = f"The robot did not stop: its mean command is {mean:.2f} m/s, max_vel_x {top:.2f} m/s."
        doubt = "Few commands are reproduced: parameters of the folder differ, or topics or scans are missing."
        lines = [*[doubt] * (self.replay.share < POOR), answer, str(self.replay)]
        for event in (event for event in self.events if event in longest):
            lines += [f"{event}:", *(f"   {line}" for line in event.why)]
        tried = [f"   {one}" for one in self.tried[:LISTED]]
        return lines + ["Changes of one parameter:", *tried] * bool(tried)

    def values(self) -> Dict[str, Any]:
        """Return the diagnosis without its lines as JSON values, for the page and for programs."""
        assert self.replay.drive.scans is not None
        scans = np.linspace(0, len(self.replay.drive.scans) - 1, SCANS).astype(int)
        points = np.concatenate([self.replay.cloud(index).points[:, :2] for index in scans])
        return {
            "reproduced": self.replay.share,
            "remedies": [str(one.change) for one in self.remedies],
            "alternatives": [str(one) for one in self.tried],
            "values": [(*one.change, one.gain) for one in self.tried],
            "events": [
                dict(title=str(one), place=one.place, cycles=one.explained) for one in self.events
            ],
            "map": (np.unique(np.rint(points / CELL_M), axis=0) * CELL_M).round(2).tolist(),
            "path": [
                [*np.round(cycle.pose[:2], 2).tolist(), cycle.command[0]]
                for cycle in self.replay.cycles
            ],
            "footprint": self.replay.costmap.footprint.round(3).tolist(),
        }


def some(cycles: Sequence[Cycle], count: int, power: float = 1.0) -> List[Cycle]:
    """Return at most `count` cycles, only reproduced ones if there are any; a power above 1 prefers early ones."""
    cycles = [cycle for cycle in cycles if cycle.reproduced] or list(cycles)
    shares = np.linspace(0.0, 1.0, count if cycles else 0) ** power
    return [cycles[i] for i in np.unique((shares * (len(cycles) - 1)).round().astype(int))]


def diagnose(replay: Replay, at: Optional[float] = None) -> Diagnosis:
    """Return the diagnosis of a replay, or of the second around a time [s]."""
    around = [cycle for cycle in replay.cycles if at is not None and abs(cycle.at - at) <= 0.5]
    if at is not None and not around:
        begin, end = replay.cycles[0].at, replay.cycles[-1].at
        raise ApplrError(f"--at {at:g}: no command near, give {begin:.1f} to {end:.1f} s")
    found = [Event("the moment asked about", around)] if around else events.find(replay)
    slow = {id(cycle) for event in found for cycle in event.cycles}
    others, cycles = [cycle for cycle in replay.cycles if at is None and id(cycle) not in slow], []
    for event in found:
        lead = [
            one
            for one in replay.cycles
            if event.cycles[0].at - LEAD_S <= one.at <= event.cycles[-1].at
        ]
        cycles += some(lead, max(LEAST, round(CYCLES * len(event.cycles) / len(slow))), EARLY)
        middle = np.median([cycle.command[0] for cycle in event.cycles])
        slowest = [cycle for cycle in event.cycles if cycle.command[0] <= middle]
        event.explained = [explain(replay, cycle) for cycle in some(slowest, EXPLAINED)]
    tried = best_changes(replay, changes_to_try(replay), cycles, some(others, CYCLES))
    return Diagnosis(replay, found, others, tried)


def compared(first: Replay, second: Replay) -> List[str]:
    """Return lines about a second drive: where it differs, and what its parameters would have done in the first."""
    track = np.array([cycle.pose[:2] for cycle in second.cycles])
    apart = [
        cycle for cycle in first.cycles if np.hypot(*(track - cycle.pose[:2]).T).min() > APART_M
    ]
    changes = []
    for change in first.settings.differences(second.settings):
        if not change.server.startswith("global_costmap") and not isinstance(change.before, str):
            changes.append(change)
    slow = [cycle for event in events.find(first) for cycle in event.cycles]
    tried = best_changes(first, changes, some(slow or first.cycles, CYCLES), [])
    routes = "routes diverge at {:.1f} s".format(apart[0].at) if apart else "same route"
    lines = [f"{second}; {routes}; differing parameters: {', '.join(map(str, changes)) or 'none'}"]
    return lines + [
        "Changes of the first drive to a value of this one:",
        *(f"   {one}" for one in tried),
    ] * bool(tried)
