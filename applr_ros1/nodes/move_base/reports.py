"""Reports of the move_base node about itself: /diagnostics, and warnings of its log.

Nothing here needs rospy: the node passes what it knows, and publishes what it gets.
"""

from __future__ import annotations

import math
from typing import Any, Dict, List, Mapping, NamedTuple, Sequence

from applr_ros1.common.angles import Pose
from applr_ros1.planner.costmap.costmap import Costmap

SKIPPED = "skipped_cycles"  # counter in /diagnostics of control cycles that were skipped
PERIOD_S = 1.0  # wall time from one report to the next [s]
MISSING_S = 5.0  # wall time after the start from which inputs that never arrived are missing [s]


class Status(NamedTuple):
    """Status for /diagnostics.

    Attributes:
        subject: Subject of the status.
        problem: What is wrong; "" if nothing is.
        values: Values for people.
    """

    subject: str
    problem: str
    values: Mapping[str, Any]


class MoveBaseReports:
    """Reports of what has happened since the last one.

    Args:
        now: Wall time at the start of the node [s].

    Attributes:
        refusals: Samples refused by each critic in the first blocked cycle since the last report;
            empty if there was none.
    """

    def __init__(self, now: float):
        self.refusals: Dict[str, int] = {}
        self._skipped_count = 0  # number of cycles skipped since the start
        self._due = now  # wall time from which the next report is due [s]
        # Wall time from which missing inputs are named, once [s]
        self._missing_from = now + MISSING_S

    def is_due(self, now: float) -> bool:
        """Return whether a report is due at a wall time [s], and wait for the next one."""
        if now < self._due:
            return False
        self._due = now + PERIOD_S
        return True

    def statuses(
        self, ages: Mapping[str, Any], odometry_problem: str, skipped: int, frequency: float
    ) -> List[Status]:
        """Return the statuses of a report.

        Args:
            ages: Ages of the inputs.
            odometry_problem: How the odometry contradicts itself; "" if it does not.
            skipped: Number of control cycles skipped since the last report.
            frequency: Rate of the control loop [Hz].
        """
        refusals = self.refusals
        self.refusals = {}
        self._skipped_count += skipped
        skipped_problem = ""
        if skipped:
            rate = f"control loop missed its rate of {frequency:g} Hz"
            skipped_problem = f"{rate}: {skipped} cycles skipped"
        return [
            Status("ages of the inputs", odometry_problem, ages),
            Status(
                "samples that critics refused", "no legal command" if refusals else "", refusals
            ),
            Status("control loop", skipped_problem, {SKIPPED: self._skipped_count}),
        ]

    def missing_inputs(self, now: float, silent_topics: Sequence[str], pose_trouble: str) -> str:
        """Return once, MISSING_S after the start, what the robot may lack; "" otherwise.

        Drivers that are down, and topics of other names, would show only at the first goal.

        Args:
            now: Wall time [s].
            silent_topics: Topics on which no message has arrived.
            pose_trouble: Why the pose is unknown; "" if it is known.
        """
        if now < self._missing_from:
            return ""
        self._missing_from = math.inf
        problems = []
        if silent_topics:
            problems.append(f"no message has arrived on {', '.join(silent_topics)}")
        if pose_trouble:
            problems.append(pose_trouble)
        return "; ".join(problems)


def off_the_map(costmap: Costmap, goal: Pose) -> str:
    """Return a warning of a goal off the global costmap, or "", as in navfn_ros.cpp.

    No plan can lead there.
    """
    if costmap.world_to_map(*goal[:2]) != (-1, -1):
        return ""
    columns, rows = costmap.size
    map_size = f"{columns * costmap.resolution:g} x {rows * costmap.resolution:g} m"
    remedy = "send a nearer goal, or enlarge the costmap"
    return f"the goal is off the global costmap of {map_size}: {remedy}"
