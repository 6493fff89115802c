"""Reasons why a robot does not drive, read from the columns of a drive, whether it was simulated or recorded in a bag.

Causes come before what follows from them: without a plan nothing is commanded, and a command that the collision monitor
stops moves nothing.
"""

from __future__ import annotations

from collections import Counter
from typing import Optional, TypeVar

import numpy as np

from applr_ros1.drives.drive import ABORTED, REACHED, Drive, Rows

STANDS = "it turns or stands"  # beginning of the reason if no column shows another one
SomeRows = TypeVar("SomeRows", bound=Rows)
REASON_SHARE = 0.1  # share of a drive above which an event counts as the reason of its failure
SLIP_RATIO, SLIP_M = (
    2.0,
    1.0,
)  # commanded distance above this ratio of the driven one, by this much [m]: wheels slip


def failure_of(drive: Drive) -> str:
    """Return in words why the last goal of a drive was not reached without a contact, or "" if it was.

    The drive needs truth, routes, refusals and commands.
    """
    drive.require("goals", "truth")
    goal = drive.goals[-1]
    touches = "it touches something" if len(drive.contacts) else ""
    if goal.status == REACHED:
        return touches
    reason = _cause(drive, goal.begin, goal.end)
    if not reason and goal.status == ABORTED:
        reason = "move_base ends with " + goal.reason.partition(": ")[2]
    if not reason:
        reason = f"{STANDS}, and has not arrived after {goal.end - goal.begin:.0f} s"
    return f"{touches}, and {reason}" if touches else reason


def _cause(drive: Drive, begin: float, end: float) -> str:
    """Return what kept the robot from driving between two times [s], or "" if no column shows it."""
    for find in (no_plan, refused, held, slipping):
        words = find(drive, begin, end)
        if words:
            return words
    return ""


def no_plan(drive: Drive, begin: float, end: float) -> str:
    """Return that the global planner had no plan until a time [s], or ""."""
    if drive.routes is None or drive.routes.latest(end) >= 0:
        return ""
    return "the global planner finds no path"


def refused(drive: Drive, begin: float, end: float) -> str:
    """Return the critic that rejected most velocities in cycles in which the local planner rejected all, or ""."""
    cycles = _part(drive.refusals, begin, end)
    if cycles is None:
        return ""
    empty_handed = [critics for critics in cycles.critics if critics]
    share = len(empty_handed) / len(cycles)
    if share <= REASON_SHARE:
        return ""
    rejected: Counter[str] = Counter()
    for critics in empty_handed:
        rejected.update(critics)
    del rejected["samples"]  # It counts the velocities themselves.
    critic = rejected.most_common(1)[0][0]
    return f"the planner rejects every velocity in {100 * share:.0f} % of its cycles, mostly by {critic}"


def held(drive: Drive, begin: float, end: float) -> str:
    """Return why the collision monitor held the robot, or ""."""
    verdicts = _part(drive.verdicts, begin, end)
    if verdicts is None:
        return ""
    seconds = _durations(verdicts, end)
    blocked_s: Counter[str] = Counter()
    for duration, reason, is_blocked in zip(seconds, verdicts.reason, verdicts.blocked):
        if is_blocked:
            blocked_s[reason] += duration
    share = sum(blocked_s.values()) / (end - begin)
    if share <= REASON_SHARE:
        return ""
    reason = blocked_s.most_common(1)[0][0]
    return f"the collision monitor intervenes {100 * share:.0f} % of the time: {reason}"


def slipping(drive: Drive, begin: float, end: float) -> str:
    """Return that the robot moved much less than was commanded, or "". Wheels that slip turn without moving it."""
    commands = _part(drive.commands, begin, end)
    motion = _part(drive.truth, begin, end)
    if commands is None or motion is None:
        return ""
    commanded = float(np.abs(commands.twist[:, 0]) @ _durations(commands, end))
    driven = motion.length
    if commanded <= SLIP_M + SLIP_RATIO * driven:
        return ""
    return f"it moves {driven:.1f} m although {commanded:.1f} m are commanded"


def _part(rows: Optional[SomeRows], begin: float, end: float) -> Optional[SomeRows]:
    """Return the rows between two times [s], or None if there are none."""
    if rows is None:
        return None
    part = rows.between(begin, end)
    return part if len(part) else None


def _durations(rows: Rows, end: float) -> np.ndarray:
    """Return how long each row holds [s]: until the next one, the last one until `end`."""
    return np.diff(rows.time, append=end)
