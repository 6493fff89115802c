"""Events of a replayed drive: where the robot found no trajectory, turned on the spot, swung, stood or was slow."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, Dict, List, Sequence

import numpy as np
from typing_extensions import override

from training.why.replay import Cycle, Replay

STANDS, SLOW = 0.25, 0.5  # shares of max_vel_x below which a robot stands or creeps, and is slow
STILL = 1e-3  # speed below which a robot does not drive [m/s], and turn rate below which it does not turn [rad/s]
SWINGS, SWINGS_HZ = (
    0.25,
    1.0,
)  # share of max_vel_theta and rate of its changes of sign above which a robot swings
GAP_S = 0.5  # longest gap between two parts of one event [s]


@dataclass
class Event:
    """Part of a drive."""

    kind: str
    cycles: Sequence[Cycle]
    explained: List[Dict[str, Any]] = field(
        default_factory=list
    )  # explanations of some cycles, see explain()

    @property
    def place(self) -> List[float]:
        """Mean position (x, y) [m] in the odometry frame."""
        place: List[float] = np.mean([cycle.pose[:2] for cycle in self.cycles], axis=0).tolist()
        return place

    @property
    def why(self) -> List[str]:
        """Explanation of the middle one of the explained cycles."""
        lines: List[str] = self.explained[len(self.explained) // 2]["lines"]
        return lines

    @override
    def __str__(self) -> str:
        x, y = self.place
        return f"{self.cycles[0].at:.1f} to {self.cycles[-1].at:.1f} s: {self.kind} at ({x:.2f}, {y:.2f})"


def find(replay: Replay) -> List[Event]:
    """Return the events of a replay in order of time, without those that lie within an event of a more special kind."""
    cycles = replay.cycles
    limits = [
        (c.settings[replay.server]["max_vel_x"], c.settings[replay.server]["max_vel_theta"])
        for c in cycles
    ]
    at, (v, w), (top, widest) = (
        np.array(x).T for x in ([c.at for c in cycles], [c.command for c in cycles], limits)
    )
    to_go = np.array([np.hypot(*(cycle.plan[-1, :2] - cycle.pose[:2])) for cycle in cycles])
    turns, stands = np.abs(w) > STILL, np.abs(v) < STILL
    swings = np.flatnonzero(np.abs(w) > SWINGS * widest)
    changes = at[swings[1:]][np.diff(np.sign(w[swings])) != 0]
    rate = (np.searchsorted(changes, at + 1.0) - np.searchsorted(changes, at - 1.0)) / 2.0
    kinds = {  # the shortest event of each kind [s], and the cycles in which it happens
        "found no valid trajectory": (0.5, stands & ~turns),
        "was commanded to turn on the spot": (2.0, stands & turns),
        "drove backwards": (2.0, v < -STILL),
        "stood or crept": (1.0, v < STANDS * top),
        "was slow": (5.0, v < SLOW * top),
        "swung from side to side": (2.0, rate > SWINGS_HZ),
    }
    events, taken = [], np.zeros(len(cycles), bool)
    for kind, (least, mask) in kinds.items():
        rows = np.flatnonzero(mask & (to_go > replay.move_base.goal_tolerance))
        for part in (
            np.split(rows, np.flatnonzero(np.diff(at[rows]) > GAP_S) + 1) if len(rows) else ()
        ):
            a, b = int(part[0]), int(part[-1]) + 1
            if at[b - 1] - at[a] >= least and taken[a:b].mean() < 0.5:
                taken[a:b] = True
                events.append(Event(kind, cycles[a:b]))
    for time in replay.drive.recoveries:
        after = [cycle for cycle in cycles if 0.0 <= cycle.at - time < 1.0]
        events += [Event("began a recovery behaviour", after)] if after else []
    return sorted(events, key=lambda event: event.cycles[0].at)
