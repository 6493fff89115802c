"""Collision monitor: scanner check, scan matching, obstacle memory, observed space and stopping distance combined.

Scans update the state of CollisionMonitor, and this state decides about commands. Training uses the class directly.
"""

import math
from collections import deque
from dataclasses import dataclass, replace
from typing import Any, Deque, Iterable, List, Optional, Sequence, Tuple

import numpy as np

from applr_ros1.common.angles import Pose
from applr_ros1.common.scan import LaserScan
from applr_ros1.monitor import stopping
from applr_ros1.monitor.known_space import ObstacleMemory, SeenSpace
from applr_ros1.monitor.motion import SPAN_S, PoseMotion, Twist
from applr_ros1.monitor.scan_matching import ScanMatcher
from applr_ros1.monitor.scanner import FARTHEST_M, FROZEN_M, FROZEN_RAD, ScannerCheck
from applr_ros1.monitor.settings import MonitorSettings
from applr_ros1.robots import JACKAL

Slips = List[Tuple[float, float, float]]  # possible velocities of the base: v [m/s], w [rad/s], lateral slip [m/s]
PASS, SLOW, STOP = "pass", "slow", "stop"
IMPOSSIBLE_FACTOR = 2.0  # multiple of the fastest command above which a measured speed is rejected
STOP_WITHIN_M = 2.0  # longest stopping distance that is allowed; faster commands are limited [m]
BLOCKED_M_S, BLOCKED_RAD_S = 0.05, 0.15  # velocities below which a limited command counts as blocked [m/s, rad/s]
TINY_SPEED = 1e-6  # speed below which a command counts as zero [m/s, rad/s]
BEATS = 10  # number of latest command intervals that are kept
LATE_S = 0.05  # tolerated delay of a command, and largest delay of a stop on its way to the wheels [s]
BRAKING_S = 0.1  # longest time between two commands to a braking base, whether or not the planner sends one [s]
GRIPPING_S = 0.1  # time within which a braking base must be able to reach its turn rate [s]
AHEAD_OF_CLOCK_S = 0.1  # largest lead of a stamp over the clock; a larger one means that the clock was set back [s]


@dataclass(frozen=True)
class Verdict:
    """Verdict of the monitor on a command.

    Attributes:
        command: (v [m/s], w [rad/s]) for the base.
        action: PASS (unchanged), SLOW (limited) or STOP.
        scale: factor by which the command was scaled, 0 to 1.
        reason: one line that explains the limit; "" if the command passes unchanged.
    """

    command: Twist
    action: str = PASS
    scale: float = 1.0
    reason: str = ""

    @property
    def blocked(self) -> bool:
        """True if the command was limited to almost zero."""
        v, w = self.command
        return self.action != PASS and abs(v) < BLOCKED_M_S and abs(w) < BLOCKED_RAD_S


class _Laser:
    """State of one laser: obstacle memory, fault check, and stamp [s] and fault of its latest scan."""

    def __init__(self, settings: MonitorSettings):
        self.memory = ObstacleMemory(settings.memory_radius, settings.memory_seconds)
        self.check = ScannerCheck()
        self.clear()

    def clear(self) -> None:
        self.memory.clear()
        self.check.clear()
        self.stamp: Optional[float] = None
        self.fault = "no scan has arrived yet"


class CollisionMonitor:
    """Filter that passes the fastest command after which the base can still stop before it touches anything.

    add_scan() takes the scans, filter() the commands. Time is an argument [s], so the class needs no clock. Every
    command becomes a stop if a scan is missing, stale or faulty (ScannerCheck). The robot may creep into unobserved
    space, but never into a remembered obstacle. Each laser has its own obstacle memory, because lasers at different
    heights may see over or under an obstacle. Space counts as observed if any laser has observed it.

    The commanded speed never falls faster than `deceleration`, stops included, because this is the friction limit of
    the wheels. Locked wheels slide farther, and odometry does not measure the slide. A stop follows the arc of the
    previous command, because only this arc was checked.

    Args:
        settings: settings of the base; None for the Jackal's.
        more_scans: names of further lasers. Only the first laser corrects the pose (ScanMatcher).

    Attributes:
        fastest: v [m/s] that stops within STOP_WITHIN_M, and w [rad/s] that stops in a full turn, on fresh inputs.
        ages: ages of the latest scan, pose and twist at the last command [s].
        silence: time after a command at which the base must be braked() unless another command arrives [s].
    """

    def __init__(self, settings: Optional[MonitorSettings] = None, more_scans: Iterable[str] = ()):
        self.settings = settings or MonitorSettings.of(JACKAL)
        self._planes, self._edge = stopping.half_planes(self.settings.body), stopping.edge_points(self.settings.body)
        self._radius = float(np.hypot(*np.asarray(self.settings.body, dtype=np.float64).T).max())
        self.fastest = self._fastest(self.settings.reaction_time)
        self._lasers = {name: _Laser(self.settings) for name in ("", *more_scans)}
        self.memory = self._lasers[""].memory
        self.seen = SeenSpace(self.settings.memory_radius)
        self.matcher = ScanMatcher()
        self.motion = PoseMotion()
        self.reset()

    def _fastest(self, reaction: float) -> Twist:
        s = self.settings
        ways = (s.deceleration, min(STOP_WITHIN_M, s.memory_radius)), (s.yaw_deceleration, 2.0 * math.pi)
        v, w = (a * (math.sqrt(reaction**2 + 2.0 * way / a) - reaction) for a, way in ways)
        return v, w

    def reset(self) -> None:
        """Discard all scans, obstacles and observed space. Call it when time or odometry jumps."""
        for laser in self._lasers.values():
            laser.clear()
        self.seen.clear()
        self.matcher.clear()
        self.motion.clear()
        self.ages = (0.0, 0.0, 0.0)
        self._pose: Tuple[float, Optional[Pose]] = 0.0, None  # stamp [s] of the last change of the pose, and the pose
        self._brakes = False  # whether the friction limit changed v of the last output
        self._asked: Optional[float] = None  # time of the last command [s]
        self._beats: Deque[float] = deque(maxlen=BEATS)  # intervals between the last commands [s]
        self._given = -math.inf, 0.0, 0.0  # time [s], v and w of the last output

    @property
    def silence(self) -> float:  # noqa: D102
        reaction = self.settings.reaction_time
        return min(reaction, BRAKING_S if self._brakes else max(self._beats, default=reaction) + LATE_S)

    def add_scan(self, scan: LaserScan, name: str = "") -> str:
        """Check a scan in the odometry frame, add it to the memory, and return its fault, or "" if it has none.

        `name` is the name of the scan's laser, "" for the first. An unknown name registers a further laser.
        """
        laser = self._lasers.get(name) or self._lasers.setdefault(name, _Laser(self.settings))
        if laser.stamp is not None and scan.stamp < laser.stamp:
            return ""  # The scan is out of order: a newer one was added before.
        laser.fault = laser.check.fault(scan)
        if laser.fault or laser.check.repeats:  # Repeated ranges are old data: the stamp stays unchanged.
            return laser.fault
        laser.stamp = scan.stamp
        scan = laser.check.believed(scan)
        if not name:
            self.matcher.add_scan(scan)
            if self.matcher.lost:
                for each in self._lasers.values():
                    each.memory.clear()
                self.seen.clear()
                self.motion.clear()
                laser.fault = "the scan shows another place than the previous scan: check that one robot publishes it"
        scan = replace(scan, sensor_pose=self.matcher.corrected(scan.sensor_pose))
        self.seen.forget(laser.memory.update(scan))  # Forgotten points become unknown cells.
        self.seen.update(scan)
        return laser.fault

    def filter(
        self, now: float, pose: Pose, twist: Twist, command: Twist, ages: Twist = (0.0, 0.0), creeps: bool = True
    ) -> Verdict:
        """Return the part of a command that is safe for the base.

        Args:
            now: time on the scans' clock [s].
            pose: latest (x, y, yaw) of the robot in the odometry frame [m, rad].
            twist: latest measured (v, w) [m/s, rad/s].
            command: requested (v, w) [m/s, rad/s].
            ages: ages of pose and twist [s].
            creeps: whether the robot may creep into unobserved space.

        Returns:
            The Verdict. A command that is not finite becomes a stop. A command that needs more than STOP_WITHIN_M to
            stop is limited.
        """
        if self._asked is not None:
            self._beats.append(now - self._asked)
        self._asked = now
        x, y, yaw, v0, w0, v, w = map(float, (*pose, *twist, *command))
        pose, twist = (x, y, yaw), (v0, w0)
        command = 0.0 if abs(v) < TINY_SPEED else v, 0.0 if abs(w) < TINY_SPEED else w
        stamps = [laser.stamp for laser in self._lasers.values() if laser.stamp is not None]
        self.ages = (now - min(stamps) if len(stamps) == len(self._lasers) else 0.0, *ages)
        problem = self._problem(pose, twist, command) or self._frozen(now - ages[0], pose, twist)
        if problem:
            return Verdict(self.braked(now, twist[0]), STOP, 0.0, problem)
        pose = self.matcher.corrected(pose)
        self.motion.take(now - ages[0], pose)
        moved = self.motion.velocity
        if self._is_impossible(moved):
            problem = f"the poses imply {moved[0]:g} m/s and {moved[1]:g} rad/s, which is too fast: check the odometry"
            return Verdict(self.braked(now, twist[0]), STOP, 0.0, problem)
        verdict = self._judge(pose, self._twists(twist), command, creeps)
        # Wheels that slip under-report the speed, so the larger of both speeds counts.
        measured = max(twist[0], moved[0], key=lambda v: v * self._given[1])
        return replace(verdict, command=self.braked(now, measured, verdict.command, twist[1]))

    def _twists(self, twist: Twist) -> Slips:
        """Return the possible velocities (v, w, slip): from the odometry, and from the poses if these contradict it.

        slip is the lateral slip [m/s], positive to the left: the sideways velocity that a turn about the point at
        turn_ahead does not explain. Both terms of the slip come from the poses, so that they have the same age.
        """
        v, w, aside = self.motion.velocity
        slip = aside + self.settings.turn_ahead * w
        return [(*twist, slip)] + [(v, w, slip)] * self.motion.contradicts(twist)

    def braked(self, now: float, measured: float, command: Twist = (0.0, 0.0), turning: Any = None) -> Twist:
        """Return the command (v, w) within the friction limit of the base, and record it as the last output.

        If v must fall more slowly than requested, w keeps the base on the arc of the command that safe_scale has
        checked. w is then at most the larger of the commanded and the previous turn rate, and changes gradually,
        because tyres that turn the body have less friction left for braking.

        Args:
            now: time [s].
            measured: measured forward speed [m/s].
            command: requested (v, w) [m/s, rad/s].
            turning: measured turn rate [rad/s], None if it is unknown.
        """
        (then, was, turned), (v, w) = self._given, command
        if was * measured > 0.0 and now >= then:  # Otherwise the base stands still or already moves the other way.
            left = min(abs(was), abs(measured)) - self.settings.deceleration * (now - then)
            if left > 0.0 and v * math.copysign(1.0, was) < left:
                if v == 0.0 and w == 0.0:
                    w = turned * left / abs(was)
                elif v * was > 0.0:
                    w = stopping.on_arc(left, v, w, turned)
                v, w = math.copysign(left, was), w if turning is None else self._clamp_turn(w, turning)
        self._brakes = v != command[0]
        self._given = now, v, w
        return v, w

    def _clamp_turn(self, w: float, turning: float) -> float:
        """Clamp w to the turn rates that are reachable within GRIPPING_S, without changing its sign."""
        turning, change = turning / self.settings.turn_gain, GRIPPING_S * self.settings.yaw_deceleration
        soon = min(max(w, turning - change), turning + change)
        return soon if soon * w > 0.0 else 0.0

    def _judge(self, pose: Pose, twists: Slips, command: Twist, creeps: bool) -> Verdict:
        """Return the Verdict on a command, which must be safe from each of the velocities (v, w, slip)."""
        v, w = command
        self.seen.stand(self._planes, self._radius, pose)
        if v == 0.0 and w == 0.0:
            return Verdict((v, w))
        twists = twists + [(0.0, w0, slip) for v0, w0, slip in twists if v0 * v < 0.0]  # The base may reverse at once.
        settings = self.settings
        since = max(0.0, self.ages[1])
        lasts = min(settings.reaction_time, max(self._beats, default=0.0) + LATE_S)  # time for which a command applies
        reaction = max(settings.reaction_time, lasts + LATE_S) + max(map(abs, self.ages))
        most = min(1.0, *(limit / max(abs(value), limit) for limit, value in zip(self._fastest(reaction), (v, w))))
        v, w = most * v, most * w
        speed = max(abs(v), *(math.hypot(twist[0], twist[2]) for twist in twists))
        turn = max(settings.turn_gain * abs(w), *(abs(twist[1]) for twist in twists))
        braking = max(stopping.braking_time(speed, settings.deceleration), turn / settings.yaw_deceleration)
        longest = since + reaction + braking
        # The origin orbits the centre of rotation.
        aside = abs(settings.turn_ahead) * min(turn * longest + stopping.SWING_RAD, 2.0)
        reach = self._radius + settings.margin + speed * longest + aside + 0.05
        points = np.concatenate([laser.memory.around(pose, reach) for laser in self._lasers.values()])
        seen = self.seen.cells, *self.seen.corner.tolist(), self._edge, pose
        scale, free = self._scale(points, twists, (v, w), (since, reaction), seen)
        creep = min(1.0, settings.creep_speed / max(abs(v), self._radius * abs(w)))
        if creeps and scale < creep:  # The robot may creep into unobserved space if no known obstacle is in the way.
            known, free = self._scale(points, twists, (v, w), (since, reaction), stopping.EVERYTHING)
            if known > scale:
                scale = min(known, creep)
                reason = "creeping: space within the stopping distance has not been observed"
                return Verdict((scale * v, scale * w), SLOW, most * scale, reason)
        if scale >= 1.0 and most >= 1.0:
            return Verdict((v, w))
        if scale >= 1.0:
            reason = f"limited to the speed that can be stopped within {min(STOP_WITHIN_M, settings.memory_radius):g} m"
            return Verdict((v, w), SLOW, most, reason)
        if scale <= 0.0:
            near = "an obstacle is within the stopping distance", "braking: an obstacle is too near to stop"
            return Verdict((0.0, 0.0), STOP, 0.0, near[0] if free else near[1])
        reason = "limited: an obstacle or unobserved space is within the stopping distance"
        return Verdict((scale * v, scale * w), SLOW, most * scale, reason)

    def _scale(self, points: Any, twists: Slips, command: Twist, times: Twist, seen: Any) -> Tuple[float, bool]:
        """Return the smallest safe_scale over all velocities, for points (k, 2) [m] in the robot's frame."""
        s, scales = self.settings, []
        for v, w, slip in twists:
            brake, turns = (s.deceleration, s.yaw_deceleration), (self._given[2], s.turn_gain, s.turn_ahead, slip)
            given = points, self._planes, s.margin, (v, w), command, times, brake, seen, turns
            scales.append(stopping.safe_scale(*given))
        least: Tuple[float, bool] = min(scales)
        return least

    def _is_impossible(self, twist: Sequence[float]) -> bool:
        return any(abs(value) > IMPOSSIBLE_FACTOR * limit for value, limit in zip(twist, self.fastest))

    def _frozen(self, stamp: float, pose: Pose, twist: Twist) -> str:
        """Return a fault if the pose does not change, even with new stamps, although the velocity is not zero."""
        # The measured velocity of a base at rest is seldom exactly 0.
        stands = abs(twist[0]) < BLOCKED_M_S and abs(twist[1]) < BLOCKED_RAD_S
        if pose != self._pose[1] or stamp < self._pose[0] or stands:
            self._pose = stamp, pose
        since = stamp - self._pose[0]
        moved = abs(twist[0]) * since >= FROZEN_M or abs(twist[1]) * since >= FROZEN_RAD
        sentence = f"the pose is frozen: it stays the same at a velocity of {twist[0]:g} m/s and {twist[1]:g} rad/s"
        return sentence if moved and since >= SPAN_S else ""

    def _problem(self, pose: Pose, twist: Twist, command: Twist) -> str:
        if not all(map(math.isfinite, (*pose, *twist, *command))):
            return "the command, the pose or the velocity is not finite"
        if max(map(abs, pose)) > FARTHEST_M:
            return f"the pose is ({pose[0]:g} m, {pose[1]:g} m, {pose[2]:g} rad), too far away: check the odometry"
        if self._is_impossible(twist):
            return f"the odometry reports {twist[0]:g} m/s and {twist[1]:g} rad/s, which is too fast: check its source"
        for name, laser in self._lasers.items():
            if laser.fault:
                return f"{name}: {laser.fault}" if name else laser.fault
        oldest = min(self._lasers, key=lambda name: self._lasers[name].stamp or 0.0)
        for source, age in zip((f"scan on {oldest}" if oldest else "scan", "pose", "odometry"), self.ages):
            if age > self.settings.scan_timeout:
                return f"the latest {source} is {age:.2f} s old; the limit is {self.settings.scan_timeout:g} s"
            if not age >= -AHEAD_OF_CLOCK_S:
                return f"the latest {source} is stamped {-age:.2f} s ahead of the clock: synchronise the clocks"
        return ""


def warm_up(settings: MonitorSettings) -> None:
    """Compile or load all kernels by running a temporary monitor on two scans, one with a wide empty sector."""
    monitor = CollisionMonitor(settings)
    ranges = np.full(8, 0.6)
    for stamp in (0.0, 0.1):
        monitor.add_scan(LaserScan(stamp, -1.0, 0.3, 0.1, 10.0, ranges, (0.1, 0.0, 0.0)))
        ranges = np.where(np.arange(8) < 4, ranges, np.inf)
        monitor.filter(stamp, (0.0, 0.0, 0.0), (0.5, 0.0), (1.0, 0.1))
