"""Reports of the collision monitor's node about itself: /diagnostics, and lines of its log.

Nothing here needs rospy: the node passes what it knows, and publishes what it gets.
"""

from __future__ import annotations

import re
from typing import Iterable, Sequence, Tuple

from applr_ros1.monitor.lasers import LET_GO_S, WatchedLaser
from applr_ros1.monitor.monitor import BRAKE, PASS, Verdict

STRAY_S = 60.0  # wall time for which a stray laser is a problem in /diagnostics [s]
IDLE_AFTER_S = 2.0  # wall time without a command after which the node counts as idle [s]


class MonitorReports:
    """Reports of what has happened since the start.

    Args:
        actions: Actions that are counted.

    Attributes:
        counts: Number of commands by action since the start.
    """

    def __init__(self, actions: Iterable[str]):
        self.counts = dict.fromkeys(actions, 0)
        self._stray_problem = ""  # problem of the latest stray laser
        self._stray_until = 0.0  # time until which it is a problem [s]

    def let_go(self, stray: WatchedLaser, publisher: str, topic: str, now: float) -> str:
        """Return the line about a laser that the monitor has let go, and keep it for status().

        Args:
            stray: The laser.
            publisher: Name of the node that published its scans.
            topic: Their topic.
            now: time.monotonic().
        """
        problem = (
            f"{publisher} has sent no scan of frame {stray.frame!r} on {topic} for {LET_GO_S:g} s "
            f"({stray.count} before)"
        )
        remedy = "stop this publisher, or give its laser a topic of its own in more_scans"
        self._stray_problem = f"{problem}: its scans no longer count; {remedy}"
        self._stray_until = now + STRAY_S
        return self._stray_problem

    def status(
        self, verdict: Verdict, silence: float, odometry_problem: str, now: float
    ) -> Tuple[bool, str]:
        """Return whether there is a problem, and the message of /diagnostics.

        Args:
            verdict: Latest verdict.
            silence: Wall time since the latest command [s].
            odometry_problem: How the odometry contradicts itself; "" if it does not.
            now: time.monotonic().
        """
        is_idle = silence > IDLE_AFTER_S
        # A base that brakes as its planner asks is no problem.
        if not is_idle and verdict.action not in (PASS, BRAKE):
            return True, verdict.reason
        if odometry_problem:
            return True, odometry_problem
        if now < self._stray_until:
            return True, self._stray_problem
        if is_idle:
            return False, "idle: no commands"
        return False, verdict.reason or "commands pass"


def topic_named(reason: str, first_topic: str, more_topics: Sequence[str]) -> str:
    """Return the topic of the laser that a reason of the monitor names, by default the first."""
    for topic in more_topics:
        if re.search(rf"on {re.escape(topic)}[ :]", reason):
            return topic
    return first_topic
