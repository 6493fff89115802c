"""The collision monitor itself: joins scanner check, scan matching, memory, seen space and stopping distance.

Joins what happens per scan with what happens per command. Episode (training/env/episode.py) calls it in process.
"""

import math
from collections import deque
from dataclasses import dataclass, replace
from typing import Tuple

import numpy as np

from applr_ros1.common.scan import LaserScan
from applr_ros1.monitor.known_space import ObstacleMemory, SeenSpace
from applr_ros1.monitor.motion import SPAN_S, PoseMotion
from applr_ros1.monitor.scan_matching import ScanMatcher
from applr_ros1.monitor.scanner import FARTHEST_M, FROZEN_M, FROZEN_RAD, ScannerCheck
from applr_ros1.monitor.settings import MonitorSettings
from applr_ros1.monitor.stopping import (
    EVERYTHING,
    SWING_RAD,
    braking_time,
    edge_points,
    half_planes,
    on_arc,
    safe_scale,
)
from applr_ros1.robots import JACKAL

PASS, SLOW, STOP = "pass", "slow", "stop"
IMPOSSIBLE_FACTOR = 2.0  # a measured speed above this many times the fastest command is rejected
STOP_WITHIN_M = 2.0  # [m]: commands from which the base needs a longer way to stop are reduced
HELD_M_S, HELD_RAD_S = 0.05, 0.15  # m/s, rad/s: a command that is slowed to less counts as held back
TINY_SPEED = 1e-6  # [m/s, rad/s]: what is slower stands
BEATS = 10  # intervals between commands that are remembered
LATE_S = 0.05  # [s]: a command that comes by so much later than these is silence; a stop reaches the wheels as late
BRAKING_S = 0.1  # [s] after which a base that brakes is braked further, whether or not a command has come
GRIPPING_S = 0.1  # [s] in which a base that brakes can change to the turn rate that it is commanded
AHEAD_OF_CLOCK_S = 0.1  # [s] by which stamps may be ahead of the clock; beyond, the clock was set back


@dataclass(frozen=True)
class Verdict:
    """Verdict of the monitor on a command.

    Attributes:
        command: (v [m/s], w [rad/s]) for the base.
        action: PASS (as it came), SLOW (reduced) or STOP.
        scale: the factor by which the command was reduced, 0 to 1.
        reason: in one line, why it is not the whole command; "" where it is.
    """

    command: Tuple[float, float]
    action: str = PASS
    scale: float = 1.0
    reason: str = ""

    @property
    def blocked(self) -> bool:
        """Whether next to nothing of a command was let through."""
        v, w = self.command
        return self.action != PASS and abs(v) < HELD_M_S and abs(w) < HELD_RAD_S


class _Laser:
    """Memory of one laser: its obstacles, whether it can be believed, and the stamp of its newest scan."""

    def __init__(self, settings):
        self.memory = ObstacleMemory(settings.memory_radius, settings.memory_seconds)
        self.check = ScannerCheck()
        self.clear()

    def clear(self):
        self.memory.clear()
        self.check.clear()
        self.stamp, self.fault = None, "no scan has come yet"


class CollisionMonitor:
    """Lets through the fastest command after which the base can still stop before it touches anything.

    see() takes the scans, filter() the commands. Time is an argument [s]; nothing here reads a clock. Without a scan
    yet, with an old one, or with one that cannot be believed (ScannerCheck), every command becomes a stop. Into space
    that no scan has shown the robot may creep; into what is remembered it never may. Each laser remembers what it has
    seen itself, since others at another height see through it; space counts as seen that any of them has shown.

    What the base is given falls no faster than at `deceleration`, stops included: its wheels give that much without
    locking. Locked wheels slide farther than that, and farther than odometry sees. A stop keeps the arc of the
    command before it, which was found free: straight on out of a turn is another way.

    Args:
        settings: of the base; None: the Jackal's.
        more_scans: names of further lasers. The first one alone tells where the robot is (ScanMatcher).

    Attributes:
        fastest: (v [m/s], w [rad/s]) from which the base stops within STOP_WITHIN_M, or a full turn, if all is fresh.
        ages: of the newest scan, pose and twist at the last command [s].
        silence: time [s] after a command at which the base is to be braked() if no other has come.
    """

    def __init__(self, settings=None, more_scans=()):
        self.settings = settings or MonitorSettings.of(JACKAL)
        self._planes, self._edge = half_planes(self.settings.body), edge_points(self.settings.body)
        self._radius = float(np.hypot(*np.asarray(self.settings.body, dtype=np.float64).T).max())
        self.fastest = self._fastest(self.settings.reaction_time)
        self._lasers = {name: _Laser(self.settings) for name in ("", *more_scans)}
        self.memory = self._lasers[""].memory
        self.seen = SeenSpace(self.settings.memory_radius)
        self.matcher = ScanMatcher()
        self.motion = PoseMotion()
        self.reset()

    def _fastest(self, reaction):
        s = self.settings
        ways = (s.deceleration, min(STOP_WITHIN_M, s.memory_radius)), (s.yaw_deceleration, 2.0 * math.pi)
        return tuple(a * (math.sqrt(reaction**2 + 2.0 * way / a) - reaction) for a, way in ways)

    def reset(self):
        """Begin anew: no scan, no memory, nothing seen. To be called when time or odometry jumps."""
        for laser in self._lasers.values():
            laser.clear()
        self.seen.clear()
        self.matcher.clear()
        self.motion.clear()
        self.ages = (0.0, 0.0, 0.0)
        self._pose = 0.0, None  # the odometry's newest pose, and its stamp [s] when it first was so
        self._brakes = False  # whether what was given last falls more slowly than asked
        self._asked, self._beats = None, deque(maxlen=BEATS)  # when the last command came, and between these [s]
        self._given = -math.inf, 0.0, 0.0  # when the base was last given a command [s], and that (v, w)

    @property
    def silence(self):  # noqa: D102
        reaction = self.settings.reaction_time
        return min(reaction, BRAKING_S if self._brakes else max(self._beats, default=reaction) + LATE_S)

    def add_scan(self, scan, name=""):
        """Takes a scan (common.scan.LaserScan in the odometry frame) and says what is wrong with it, or "".

        name: of the laser; "" for the first. One that is not among more_scans is a further laser from then on.
        """
        laser = self._lasers.get(name) or self._lasers.setdefault(name, _Laser(self.settings))
        if laser.stamp is not None and scan.stamp < laser.stamp:
            return ""  # out of order: a newer one is known
        laser.fault = laser.check.fault(scan)
        if laser.fault or laser.check.repeats:  # an old image stays as old as it is, and at its old place
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
                laser.fault = "the scan shows another place than the one before"  # so do those of two robots in turns
        scan = replace(scan, sensor_pose=self.matcher.corrected(scan.sensor_pose))
        self.seen.forget(laser.memory.update(scan))  # what is not remembered is not known to be free either
        self.seen.update(scan)
        return laser.fault

    def filter(self, now, pose, twist, command, ages=(0.0, 0.0), creeps=True):
        """Return the part of a command that the base may be given.

        Args:
            now: time [s] on the scans' clock.
            pose: the robot's newest (x, y, yaw) [m, rad] in the odometry frame.
            twist: its newest measured (v, w) [m/s, rad/s].
            command: (v, w) asked for.
            ages: of pose and twist [s].
            creeps: whether it may creep into space that no scan has shown.

        Returns:
            A Verdict. Commands that are not finite become a stop; those faster than what can be stopped within
            STOP_WITHIN_M are reduced to it.
        """
        if self._asked is not None:
            self._beats.append(now - self._asked)
        self._asked = now
        pose, twist, command = (tuple(map(float, numbers)) for numbers in (pose, twist, command))
        command = tuple(0.0 if abs(value) < TINY_SPEED else value for value in command)
        stamps = [laser.stamp for laser in self._lasers.values()]
        self.ages = (0.0 if None in stamps else now - min(stamps), *ages)
        problem = self._problem(pose, twist, command) or self._freezing(now - ages[0], pose, twist)
        if problem:
            return Verdict(self.braked(now, twist[0]), STOP, 0.0, problem)
        pose = self.matcher.corrected(pose)
        self.motion.take(now - ages[0], pose)
        moved = self.motion.velocity
        if self._is_impossible(moved):
            problem = f"the poses say {moved[0]:g} m/s and {moved[1]:g} rad/s, which cannot be"
            return Verdict(self.braked(now, twist[0]), STOP, 0.0, problem)
        verdict = self._judge(pose, self._twists(twist), command, creeps)
        # wheels that slip say too little; the base is where it is going by the faster of both
        measured = max(twist[0], moved[0], key=lambda v: v * self._given[1])
        return replace(verdict, command=self.braked(now, measured, verdict.command, twist[1]))

    def _twists(self, twist):
        """[(v, w, slide), ...]: the measured velocity, and that of the poses where it contradicts.

        slide: how fast it moves to the left [m/s] beyond what a turn about the stated point makes it. Both parts are
        of the poses: their turn is as old as their motion aside.
        """
        v, w, aside = self.motion.velocity
        slide = aside + self.settings.turn_ahead * w
        return [(*twist, slide)] + [(v, w, slide)] * self.motion.contradicts(twist)

    def braked(self, now, measured, command=(0.0, 0.0), turning=None):
        """Return the (v, w) given to the base at `now` [s] instead of `command`.

        Where v falls more slowly than asked, w stays with it on the command's arc, as safe_scale has judged it; but the
        base turns no faster for that than it was commanded before, and changes its turn gradually: tyres that are to
        turn the body by much do not brake it.

        measured: its wheels' speed [m/s]. turning: its turn rate [rad/s] as measured; None where nobody knows.
        """
        (then, was, turned), (v, w) = self._given, command
        if was * measured > 0.0 and now >= then:  # else it stands, is already on its way back, or is not known
            left = min(abs(was), abs(measured)) - self.settings.deceleration * (now - then)
            if left > 0.0 and v * math.copysign(1.0, was) < left:
                if v == 0.0 and w == 0.0:
                    w = turned * left / abs(was)
                elif v * was > 0.0:
                    w = on_arc(left, v, w, turned)
                v, w = math.copysign(left, was), w if turning is None else self._gradual(w, turning)
        self._brakes = v != command[0]
        self._given = now, v, w
        return v, w

    def _gradual(self, w, turning):
        """Return what is nearest to the turn rate w of those that the base can soon have, and not the other way."""
        turning, change = turning / self.settings.turn_gain, GRIPPING_S * self.settings.yaw_deceleration
        soon = min(max(w, turning - change), turning + change)
        return soon if soon * w > 0.0 else 0.0

    def _judge(self, pose, twists, command, creeps=True):
        """Return the Verdict on a command; it must be safe from each of the velocities (v, w, slide)."""
        v, w = command
        self.seen.stand(self._planes, self._radius, pose)
        if v == 0.0 and w == 0.0:
            return Verdict((v, w))
        twists = twists + [(0.0, *rest) for was, *rest in twists if was * v < 0.0]  # it may go the other way at once
        settings = self.settings
        since = max(0.0, self.ages[1])
        held = min(settings.reaction_time, max(self._beats, default=0.0) + LATE_S)  # a rare command stays longer
        reaction = max(settings.reaction_time, held + LATE_S) + max(map(abs, self.ages))
        most = min(1.0, *(limit / max(abs(value), limit) for limit, value in zip(self._fastest(reaction), (v, w))))
        v, w = most * v, most * w
        speed = max(abs(v), *(math.hypot(twist[0], twist[2]) for twist in twists))
        turn = max(settings.turn_gain * abs(w), *(abs(twist[1]) for twist in twists))
        longest = since + reaction + max(braking_time(speed, settings.deceleration), turn / settings.yaw_deceleration)
        aside = abs(settings.turn_ahead) * min(turn * longest + SWING_RAD, 2.0)  # of the origin, about the point ahead
        reach = self._radius + settings.margin + speed * longest + aside + 0.05
        points = np.concatenate([laser.memory.around(pose, reach) for laser in self._lasers.values()])
        seen = self.seen.cells, *self.seen.corner.tolist(), self._edge, pose
        scale, free = self._scale(points, twists, (v, w), (since, reaction), seen)
        creep = min(1.0, settings.creep_speed / max(abs(v), self._radius * abs(w)))
        if creeps and scale < creep:  # into what has not been seen it may creep, if nothing is known to stand there
            known, free = self._scale(points, twists, (v, w), (since, reaction), EVERYTHING)
            if known > scale:
                scale = min(known, creep)
                reason = "creeping: no scan has shown the space within the stopping distance"
                return Verdict((scale * v, scale * w), SLOW, most * scale, reason)
        if scale >= 1.0 and most >= 1.0:
            return Verdict((v, w))
        if scale >= 1.0:
            reason = f"slowed to what can be stopped within {min(STOP_WITHIN_M, settings.memory_radius):g} m"
            return Verdict((v, w), SLOW, most, reason)
        if scale <= 0.0:
            near = "an obstacle is within the stopping distance", "braking: an obstacle is too near to stop"
            return Verdict((0.0, 0.0), STOP, 0.0, near[0] if free else near[1])
        reason = "slowed for an obstacle, or space not seen, within the stopping distance"
        return Verdict((scale * v, scale * w), SLOW, most * scale, reason)

    def _scale(self, points, twists, command, times, seen):
        """Return the least safe_scale of all the velocities, before points (k, 2) [m] in the robot's frame."""
        s, scales = self.settings, []
        brake = s.deceleration, s.yaw_deceleration
        for v, w, slide in twists:
            turns = self._given[2], s.turn_gain, s.turn_ahead, slide
            scales.append(safe_scale(points, self._planes, s.margin, (v, w), command, times, brake, seen, turns))
        return min(scales)

    def _is_impossible(self, twist):
        return any(abs(value) > IMPOSSIBLE_FACTOR * limit for value, limit in zip(twist, self.fastest))

    def _freezing(self, stamp, pose, twist):
        """Return what is wrong where the poses stand, whatever their stamps, while the velocity says otherwise."""
        # the stated velocity of a base at rest is seldom just 0
        stands = abs(twist[0]) < HELD_M_S and abs(twist[1]) < HELD_RAD_S
        if pose != self._pose[1] or stamp < self._pose[0] or stands:
            self._pose = stamp, pose
        since = stamp - self._pose[0]
        moved = abs(twist[0]) * since >= FROZEN_M or abs(twist[1]) * since >= FROZEN_RAD
        sentence = f"the pose is frozen: the velocity is {twist[0]:g} m/s and {twist[1]:g} rad/s, and it stands"
        return sentence if moved and since >= SPAN_S else ""

    def _problem(self, pose, twist, command):
        if not all(map(math.isfinite, (*pose, *twist, *command))):
            return "the command, the pose or the velocity is not finite"
        if max(map(abs, pose)) > FARTHEST_M:
            return f"the pose is ({pose[0]:g} m, {pose[1]:g} m, {pose[2]:g} rad), which cannot be"
        if self._is_impossible(twist):
            return f"the odometry says {twist[0]:g} m/s and {twist[1]:g} rad/s, which cannot be"
        for name, laser in self._lasers.items():
            if laser.fault:
                return f"{name}: {laser.fault}" if name else laser.fault
        oldest = min(self._lasers, key=lambda name: self._lasers[name].stamp)
        for what, age in zip((f"scan on {oldest}" if oldest else "scan", "pose", "odometry"), self.ages):
            if age > self.settings.scan_timeout:
                return f"the newest {what} is {age:.2f} s old; the limit is {self.settings.scan_timeout:g} s"
            if not age >= -AHEAD_OF_CLOCK_S:
                return f"the newest {what} is stamped {-age:.2f} s ahead of the clock"
        return ""


def warm_up(settings: MonitorSettings) -> None:
    """Compile or load all kernels: a throw-away monitor takes two scans, a wide sector of the second without return."""
    monitor = CollisionMonitor(settings)
    ranges = np.full(8, 0.6)
    for stamp in (0.0, 0.1):
        monitor.add_scan(LaserScan(stamp, -1.0, 0.3, 0.1, 10.0, ranges, (0.1, 0.0, 0.0)))
        ranges = np.where(np.arange(8) < 4, ranges, np.inf)
        monitor.filter(stamp, (0.0, 0.0, 0.0), (0.5, 0.0), (1.0, 0.1))
