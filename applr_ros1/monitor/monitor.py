"""The collision monitor itself: joins scanner check, scan matching, obstacle memory and stopping distance.

Joins what happens per scan with what happens per command. Episode (training/env/episode.py) calls it in process.
"""

import math
from dataclasses import dataclass, field, replace
from typing import Tuple

import numpy as np

from applr_ros1.monitor.memory import ObstacleMemory
from applr_ros1.monitor.scan_matching import ScanMatcher
from applr_ros1.monitor.scanner import ScannerCheck
from applr_ros1.monitor.settings import MonitorSettings
from applr_ros1.monitor.stopping import half_planes, safe_scale
from applr_ros1.robots import JACKAL

PASS, SLOW, STOP = "pass", "slow", "stop"
IMPOSSIBLE = 2.0  # a measured speed above this many times the fastest command is rejected
AHEAD = 2.0  # [m]: commands from which the base needs a longer way to stop are reduced
HELD_V, HELD_W = 0.05, 0.15  # m/s, rad/s: a command that is slowed to less counts as held back
PATIENCE = 5.0  # [s] for which what is only remembered may hold a robot that stands
CREEP_V, CREEP_W = 0.1, 0.4  # m/s, rad/s: to so much it may slow it from then on


@dataclass(frozen=True)
class Verdict:
    """What the monitor made of a command.

    Attributes:
        command: (v [m/s], w [rad/s]) for the base.
        action: PASS (as it came), SLOW (reduced) or STOP.
        scale: the factor by which the command was reduced, 0 to 1.
        reason: in one line, why it is not the whole command; "" where it is.
    """

    command: Tuple[float, float]
    action: str = PASS
    scale: float = 1.0
    reason: str = field(default="")

    @property
    def held(self) -> bool:
        """Whether next to nothing of a command was let through."""
        return self.action != PASS and _next_to_nothing(*self.command)


def _next_to_nothing(v, w):
    return abs(v) < HELD_V and abs(w) < HELD_W


class CollisionMonitor:
    """Lets through the fastest command after which the base can still stop before it touches anything.

    see() takes the scans, filter() the commands. Time is an argument [s]; nothing here reads a clock. Without a scan
    yet, with an old one, or with one that cannot be believed (ScannerCheck), every command becomes a stop.
    """

    def __init__(self, settings=None):
        self.settings = settings or MonitorSettings.of(JACKAL)
        self._planes = half_planes(self.settings.body)
        self._radius = float(np.hypot(*np.asarray(self.settings.body, dtype=np.float64).T).max())
        self.fastest = self._fastest()
        self.memory = ObstacleMemory(self.settings.memory_radius, self.settings.memory_seconds)
        self.scanner = ScannerCheck()
        self.matcher = ScanMatcher()
        self.reset()

    def _fastest(self):
        """(v [m/s], w [rad/s]) from which the base stops within AHEAD of what is remembered, or within a full turn."""
        s = self.settings
        ways = (s.deceleration, min(AHEAD, s.memory_radius)), (s.yaw_deceleration, 2.0 * math.pi)
        return tuple(a * (math.sqrt(s.reaction_time**2 + 2.0 * way / a) - s.reaction_time) for a, way in ways)

    def reset(self):
        """As a new object: no scan, no memory. To be called when time or odometry jumps."""
        self.memory.clear()
        self.scanner.clear()
        self.matcher.clear()
        self._stamp = None
        self._fault = "no scan has come yet"
        self._held_since = None  # by what is only remembered
        self._doubted = -math.inf  # what was measured last before this time does not hold the robot any more

    def see(self, scan, pose):
        """Takes a scan.

        Args:
            scan: planner.costmap.scan.LaserScan, its sensor_pose and `pose` in the odometry frame.
            pose: the robot's (x, y, yaw) [m, rad] when the scan was measured.

        Returns:
            What is wrong with it in one line, or "".
        """
        if self._stamp is not None and scan.stamp < self._stamp:
            return ""  # out of order: a newer one is known
        self._fault = self.scanner.fault(scan, pose)
        if not self._fault:
            self._stamp = scan.stamp
            if not self.scanner.repeats:  # an old image at a new place would move what is remembered along
                self.matcher.see(scan)
                if self.matcher.lost:
                    self.memory.clear()
                place = self.matcher.corrected
                self.memory.update(replace(scan, sensor_pose=place(scan.sensor_pose)), place(pose))
        return self._fault

    def filter(self, now, pose, twist, command):
        """What of a command the base may be given.

        Args:
            now: time [s] on the scans' clock.
            pose: the robot's (x, y, yaw) [m, rad] in the odometry frame.
            twist: its measured (v, w) [m/s, rad/s].
            command: (v, w) asked for.

        Returns:
            A Verdict. Commands that are not finite become a stop; those faster than `fastest` are reduced to it.
        """
        problem = self._problem(now, pose, twist, command)
        if problem:
            return Verdict((0.0, 0.0), STOP, 0.0, problem)
        v, w = (float(value) for value in command)
        if v == 0.0 and w == 0.0:
            return Verdict((v, w))
        settings = self.settings
        most = min(1.0, *(limit / max(abs(value), limit) for limit, value in zip(self.fastest, (v, w))))
        v, w = most * v, most * w
        speed, turn = max(abs(v), abs(twist[0])), max(abs(w), abs(twist[1]))
        longest = settings.reaction_time + max(speed / settings.deceleration, turn / settings.yaw_deceleration)
        points, stamps = self.memory.around(
            self.matcher.corrected(pose), self._radius + settings.margin + speed * longest + 0.05
        )
        scale, free = self._scale(points, twist, (v, w))
        since = self._believed_since(now, twist, _next_to_nothing(scale * v, scale * w))
        doubted = stamps < since
        if scale < 1.0 and doubted.any():
            by_the_others, free_of_them = self._scale(points[~doubted], twist, (v, w))
            creep = min(by_the_others, CREEP_V / max(abs(v), CREEP_V), CREEP_W / max(abs(w), CREEP_W))
            if not _next_to_nothing(creep * v, creep * w):
                self._doubted = since
            if creep > scale:
                scale, free = creep, free_of_them
        if scale >= 1.0 and most >= 1.0:
            return Verdict((v, w))
        if scale >= 1.0:
            return Verdict(
                (v, w), SLOW, most, f"slowed to what can be stopped within {min(AHEAD, settings.memory_radius):g} m"
            )
        if scale <= 0.0:
            reason = (
                "an obstacle is within the stopping distance" if free else "braking: an obstacle is too near to stop"
            )
            return Verdict((0.0, 0.0), STOP, 0.0, reason)
        return Verdict(
            (scale * v, scale * w), SLOW, most * scale, "slowed for an obstacle within the stopping distance"
        )

    def _scale(self, points, twist, command):
        """safe_scale before points (k, 2) [m] in the robot's frame."""
        s = self.settings
        brake = s.deceleration, s.yaw_deceleration
        twist = float(twist[0]), float(twist[1])
        return safe_scale(points, self._planes, s.margin, twist, command, s.reaction_time, brake)

    def _believed_since(self, now, twist, held):
        """Time [s]; what was measured last before it may slow the robot, and does not hold it."""
        if not held:
            self._held_since = None
        elif self._held_since is None or not _next_to_nothing(*twist):
            self._held_since = now
        elif now - self._held_since > PATIENCE:
            return self._held_since
        return self._doubted

    def _problem(self, now, pose, twist, command):
        if not all(math.isfinite(value) for value in (*pose, *twist, *command)):
            return "the command, the pose or the velocity is not finite"
        if any(abs(value) > IMPOSSIBLE * limit for value, limit in zip(twist, self.fastest)):
            return f"the odometry says {twist[0]:g} m/s and {twist[1]:g} rad/s, which cannot be"
        if self._fault:
            return self._fault
        if not -self.settings.scan_timeout <= now - self._stamp <= self.settings.scan_timeout:
            return f"the newest scan is {now - self._stamp:.2f} s old; the limit is {self.settings.scan_timeout:g} s"
        return ""
