"""Comparison of two recorded drives: which parameters differ, and which of them explains why."""

from __future__ import annotations

from typing import List

import numpy as np

from applr_ros1.common.paths import distances
from applr_ros1.why import events
from applr_ros1.why.alternatives import CYCLES, best_changes, together
from applr_ros1.why.answer import under
from applr_ros1.why.replay import Replay, ReplayedCycle, some

APART_M = 0.3  # distance from which on two drives differ [m]


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
    attempts = [together(first.settings, change) for change in changes]
    slow_cycles: List[ReplayedCycle] = []
    for event in events.find(first.drive, first.recording.odometry, first.limits):
        slow_cycles += first.between(event.begin, event.end)
    alternatives = best_changes(first, attempts, some(slow_cycles or first.cycles, CYCLES))

    changes_in_words = ", ".join(map(str, changes)) or "none"
    lines = [f"{second}; {_parting(first, second)}; differing parameters: {changes_in_words}"]
    return lines + under("Changes of the first drive to a value of the second", alternatives)


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
