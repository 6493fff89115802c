"""The goals that were pursued in a Recording: when each began and ended, how, and its decision period.

episodes.py cuts each of them into transitions.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Callable, Dict, List, Optional, Tuple

import numpy as np

from applr_ros1.policy.decision import PERIOD
from training.bags.reader import SECOND, Recording
from training.env.episode import CONTROL_PERIOD

SUCCEEDED, ABORTED = 3, (4, 5)


@dataclass
class Goal:
    """One course as driven: when it began and ended, and how (actionlib status; None: the bag ended first)."""

    id: str
    start: int
    end: int
    status: Optional[int]
    frame: str
    xy: Tuple[float, float]
    period: float  # between two decisions [s]

    @property
    def ended(self) -> bool:
        """Reached or given up: a terminal state. A goal that was cancelled or replaced is merely cut off."""
        return self.status == SUCCEEDED or self.status in ABORTED


def goals(recording: Recording, skip: Callable[[str], None]) -> List[Goal]:
    """The goals that were pursued, from the action's status (or, where that was not recorded, goal and result).

    Args:
        recording: what the bag holds.
        skip: is called with the reason where there is none, or one cannot be used.
    """
    spans: List[List] = []
    if recording.status:
        for at, running in recording.status:
            if spans and spans[-1][3] and spans[-1][0] == running:
                spans[-1][2] = at
            else:
                if spans and spans[-1][3]:
                    spans[-1][2:] = [at, False]
                if running:
                    spans.append([running, at, at, True])
    else:
        for at, goal in recording.sent:
            if spans and spans[-1][3]:
                spans[-1][2:] = [at, False]
            spans.append([goal, at, recording.results.get(goal, (recording.end, 0))[0], goal not in recording.results])
    found = []
    for goal, start, end, _ in spans:
        targets = [g for g in recording.goals if g[0] <= start + SECOND and g[0] >= start - 2 * SECOND] or [
            g for g in recording.goals if g[0] <= end
        ]
        at, status = recording.results.get(goal, (end, None))
        if not targets:
            skip("the goal's position was not recorded")
            continue
        end = end if status is None else min(end, at)
        made = decision_period(recording, goal)
        found.append(Goal(goal, start, end, status, targets[-1][1], targets[-1][2:4], made))
    if not found and not spans:
        skip("no goal was pursued")
    return found


def decision_period(recording: Recording, goal: str) -> float:
    """The decision period [s]: the median interval of a goal's recorded decisions, in whole control cycles.

    Where the goal has fewer than four decisions it is that of all goals, and where nothing was recorded the paper's.
    """
    stamps: Dict[str, List[int]] = {}
    for decision in recording.decisions:
        if 0 <= decision["stamp"] <= recording.end:  # a bag may state anything
            stamps.setdefault(decision["goal"], []).append(decision["stamp"])
    intervals = {name: np.diff(times) for name, times in stamps.items()}
    own = intervals.get(goal, np.zeros(0))
    known = own if len(own) > 2 else np.concatenate([np.zeros(0), *intervals.values()])
    known = known[known > 0]
    if not len(known):
        return PERIOD
    return round(max(1, round(float(np.median(known)) / SECOND / CONTROL_PERIOD)) * CONTROL_PERIOD, 9)
