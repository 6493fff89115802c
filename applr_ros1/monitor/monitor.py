"""Collision monitor: combination of all rules of this package in one class.

Scans update the state of CollisionMonitor, and this state decides about commands. Training uses the
class directly.
"""

import math
from collections import deque
from dataclasses import dataclass, replace
from typing import Deque, Iterable, List, NamedTuple, Optional, Tuple

import numpy as np

from applr_ros1.common.angles import Pose, Twist, transform_point
from applr_ros1.common.arrays import Array
from applr_ros1.common.scan import LaserScan
from applr_ros1.monitor import moving, stopping
from applr_ros1.monitor.known_space import ObstacleMemory, SeenSpace
from applr_ros1.monitor.lasers import Lasers, WatchedLaser
from applr_ros1.monitor.motion import SPAN_S, PoseMotion
from applr_ros1.monitor.moving import (
    NO_DISCS,
    ON_MOVER_M,
    BodyPose,
    Discs,
    tracked_discs,
    without_movers,
)
from applr_ros1.monitor.scan_matching import ScanMatcher
from applr_ros1.monitor.scanner import FARTHEST_M, FROZEN_M, FROZEN_RAD
from applr_ros1.monitor.settings import MonitorSettings
from applr_ros1.monitor.stopping import (
    LAST_SPEED_M_S,
    BaseMotion,
    BodyOutline,
    Braking,
    Delay,
    SafeScale,
    SeenCells,
)
from applr_ros1.robots import JACKAL

PASS = "pass"
BRAKE = "brake"
SLOW = "slow"
STOP = "stop"
BRAKING = "braking within the friction limit"
REVERSING = "braking within the friction limit before the change of direction"
MOVER_COMES = "a moving obstacle may come into the way before the robot stands"
# Multiple of the fastest command above which a measured speed is rejected.
IMPOSSIBLE_FACTOR = 2.0
# Longest stopping distance that is allowed [m]. Faster commands are limited.
STOP_WITHIN_M = 2.0
# Velocities below which a limited command counts as blocked, and a measured one as rest.
BLOCKED_M_S = 0.05
BLOCKED_RAD_S = 0.15
# Body speed that the odometry misses, from which on wheels count as sliding [m/s], and turn rate
# from which on they count as turning [rad/s].
SLIDES_M_S = 0.05
TURNS_RAD_S = 0.15
TINY_SPEED = 1e-6  # speed below which a command counts as zero [m/s, rad/s]
INTERVALS_KEPT = 10  # number of latest command intervals that are kept
# Tolerated delay of a command, and largest delay of a stop on its way to the wheels [s].
LATE_S = 0.05
# Longest time between two commands to a braking base, whether or not the planner sends one [s].
BRAKING_S = 0.1
# Time within which a braking base must be able to reach its turn rate [s].
GRIPPING_S = 0.1
# Largest lead of a stamp over the clock [s]. A larger one means that the clock was set back.
AHEAD_OF_CLOCK_S = 0.1
LONGEST_CHORD = 2.0  # largest displacement in a turn about a point, in multiples of the radius
REACH_SLACK_M = 0.05  # excess of the distance within which points are checked, against rounding [m]


@dataclass(frozen=True)
class Verdict:
    """Verdict of the monitor on a command.

    Attributes:
        command: (v [m/s], w [rad/s]) for the base.
        action: PASS (unchanged), BRAKE (free, but reached only within the friction limit), SLOW
            (limited) or STOP.
        scale: factor by which the command was limited, 0 to 1.
        reason: one line that explains the change; "" if the command passes unchanged.
    """

    command: Twist
    action: str = PASS
    scale: float = 1.0
    reason: str = ""

    @classmethod
    def stop(cls, command: Twist, reason: str) -> "Verdict":
        """Return the verdict that the base has to stop, with the command that brakes it."""
        return cls(command, STOP, scale=0.0, reason=reason)

    @property
    def blocked(self) -> bool:
        """True if the command was limited to almost zero."""
        v, w = self.command
        is_limited = self.action in (SLOW, STOP)
        return is_limited and abs(v) < BLOCKED_M_S and abs(w) < BLOCKED_RAD_S

    @property
    def text(self) -> str:
        """Action and reason in one line, as the node publishes them (action_in() reads it)."""
        return action_text(self.action, self.reason)

    def braked(self, command: Twist) -> "Verdict":
        """Return the verdict with the command (v, w) that brakes the base, if that differs."""
        if self.action != PASS or command == self.command:
            return replace(self, command=command)
        v, _ = command
        reason = REVERSING if v * self.command[0] < 0.0 else BRAKING
        return Verdict(command, BRAKE, reason=reason)


def action_text(action: str, reason: str) -> str:
    """Return the action and the reason of a verdict in one line."""
    return f"{action}: {reason}" if reason else action


def action_in(text: str) -> Tuple[str, str]:
    """Return action and reason of a line by action_text()."""
    action, _, reason = text.partition(": ")
    return action, reason


class Ages(NamedTuple):
    """Ages of the latest scan, pose and twist [s]."""

    scan: float
    pose: float
    twist: float


class MonitorOutput(NamedTuple):
    """Command that was given to the base: time [s], v [m/s] and w [rad/s]."""

    time: float
    v: float
    w: float


class CollisionMonitor:
    """Filter that passes the fastest command after which the base can still stop.

    add_scan() takes the scans, filter() the commands. Time is an argument [s], so the class needs
    no clock. Every command becomes a stop if a scan is missing, stale or faulty (ScannerCheck). The
    robot may creep into unobserved space, but never into a remembered obstacle. Each laser has its
    own obstacle memory, because lasers at different heights may see over or under an obstacle.
    Space counts as observed if any laser has observed it.

    The commanded speed never falls faster than `deceleration`, stops included, because this is the
    friction limit of the wheels. Locked wheels slide farther, and odometry does not measure the
    slide. A stop follows the arc of the previous command, because only this arc was checked.

    Args:
        settings: settings of the base; None for the Jackal's.
        more_scans: topics of further lasers. Only the first laser corrects the pose (ScanMatcher).

    Attributes:
        fastest: v [m/s] that stops within STOP_WITHIN_M, and w [rad/s] that stops in a full turn,
            on fresh inputs.
        ages: Ages of the inputs at the last command.
        lasers: the lasers with what each of them sees.
        silence: time after a command at which the base must be braked() unless another command
            arrives [s].
        strays: lasers that the latest scan has let go.
        matcher: the ScanMatcher; planners may drive in the frame of its corrected poses.
    """

    def __init__(self, settings: Optional[MonitorSettings] = None, more_scans: Iterable[str] = ()):
        self.settings = settings or MonitorSettings.of(JACKAL)
        outline = self.settings.body
        self._body = BodyOutline.of(outline, self.settings.margin)
        self._braking = Braking(
            self.settings.deceleration,
            self.settings.yaw_deceleration,
            self.settings.turn_gain,
            self.settings.turn_ahead,
        )
        # Distance of the farthest corner from the origin [m].
        corner_x, corner_y = np.asarray(outline, dtype=np.float64).T
        self._radius = float(np.hypot(corner_x, corner_y).max())
        self.fastest = self._fastest(self.settings.reaction_time)
        self.lasers = Lasers(self.settings, more_scans)
        self.seen = SeenSpace(self.settings.memory_radius)
        self.matcher = ScanMatcher()
        self.motion = PoseMotion()
        self.reset()

    def _fastest(self, reaction: float) -> Twist:
        """Return the fastest v, w [m/s, rad/s] that may be commanded with a reaction time [s]."""
        stop_within = min(STOP_WITHIN_M, self.settings.memory_radius)
        v = _stoppable_speed(self.settings.deceleration, stop_within, reaction)
        w = _stoppable_speed(self.settings.yaw_deceleration, 2.0 * math.pi, reaction)
        return v, w

    def reset(self) -> None:
        """Discard all scans, obstacles and observed space. Call it when time or odometry jumps."""
        self.lasers.clear()
        self.strays: List[WatchedLaser] = []
        self.seen.clear()
        self.matcher.clear()
        self.motion.clear()
        self.ages = Ages(scan=0.0, pose=0.0, twist=0.0)
        self._pose: Optional[Pose] = None  # latest pose of the odometry
        self._pose_stamp = 0.0  # stamp of the last change of the pose [s]
        self._is_braking = False  # whether the friction limit changed v of the last output
        self._last_command: Optional[float] = None  # time of the last command [s]
        # Intervals between the last commands [s].
        self._intervals: Deque[float] = deque(maxlen=INTERVALS_KEPT)
        self.output = MonitorOutput(time=-math.inf, v=0.0, w=0.0)

    @property
    def silence(self) -> float:  # noqa: D102
        reaction = self.settings.reaction_time
        if self._is_braking:
            return min(reaction, BRAKING_S)
        return min(reaction, max(self._intervals, default=reaction) + LATE_S)

    @property
    def memory(self) -> ObstacleMemory:
        """Obstacles that the first laser has seen."""
        return self.lasers.first.memory

    def add_scan(self, scan: LaserScan, topic: str = "") -> str:
        """Check a scan in the odometry frame, add it to the memory, and return its fault.

        The fault is "" if there is none. `topic` is the topic of the scan, "" for that of the first
        laser. An unknown topic or frame adds a laser (Lasers).
        """
        laser = self.lasers.of(scan, topic)
        self.strays = []
        if laser.stamp is not None and scan.stamp < laser.stamp:
            return ""  # The scan is out of order: a newer one was added before.
        laser.latest = scan.stamp
        laser.count += 1
        self._let_go(laser)
        laser.fault = laser.check.fault(scan)
        # Repeated ranges are old data: the stamp stays unchanged.
        if laser.fault or laser.check.repeats:
            return laser.fault
        laser.stamp = scan.stamp
        scan = laser.check.believed(scan)
        # In the odometry's frame, what stands would seem to move while the wheels slip.
        laser.tracker.frame = self.matcher.correction
        movers = laser.tracker.update(scan).certain()
        laser.movers = movers

        # The first laser corrects the pose, before any point of the scan is stored.
        if laser is self.lasers.first:
            self.matcher.add_scan(without_movers(scan, movers))
            if self.matcher.lost:
                self._forget_place()
                laser.fault = (
                    "the scan shows another place than the previous scan: "
                    "check that one robot publishes it"
                )
        scan = scan.placed(self.matcher.corrected(scan.sensor_pose))

        # Forgotten points become unknown cells, unless the scan shows them: hence before the
        # update.
        self.seen.forget(laser.memory.update(scan))
        x, y = transform_point(self.matcher.correction, movers.x, movers.y)
        laser.memory.doubt(x, y, movers.radius + ON_MOVER_M)
        self.seen.update(scan)
        return laser.fault

    def _let_go(self, laser: WatchedLaser) -> None:
        """Let go of strays on a laser's topic. Space that they alone may have seen is unknown."""
        first_laser = self.lasers.first
        self.strays = self.lasers.let_go(laser)
        if self.strays:
            self.seen.clear()
        if self.lasers.first is not first_laser:
            # The references are scans of the stray.
            self.matcher.forget_scans()
            self._forget_place()
            for watched in self.lasers:
                watched.forget_tracks()

    def _forget_place(self) -> None:
        """Discard obstacles, observed space and motion, because the robot is elsewhere."""
        for laser in self.lasers:
            laser.forget_place()
        self.seen.clear()
        self.motion.clear()

    def filter(
        self,
        time: float,
        pose: Pose,
        twist: Twist,
        command: Twist,
        ages: Tuple[float, float] = (0.0, 0.0),
        creeps: bool = True,
    ) -> Verdict:
        """Return the part of a command that is safe for the base.

        Args:
            time: current time on the scans' clock [s].
            pose: latest (x, y, yaw) of the robot in the odometry frame [m, rad].
            twist: latest measured (v, w) [m/s, rad/s].
            command: requested (v, w) [m/s, rad/s].
            ages: ages of pose and twist [s].
            creeps: whether the robot may creep into unobserved space.

        Returns:
            The Verdict. A command that is not finite becomes a stop. A command that needs more than
            STOP_WITHIN_M to stop is limited.
        """
        if self._last_command is not None:
            self._intervals.append(time - self._last_command)
        self._last_command = time
        # A kernel is compiled for each combination of argument types, so all numbers become floats.
        x, y, yaw = map(float, pose)
        v, w = map(float, twist)
        pose = x, y, yaw
        twist = v, w
        command = _without_tiny_speeds(command)
        pose_age, twist_age = ages
        self.ages = Ages(self._scan_age(time), pose_age, twist_age)

        # Whatever the verdict, the base is braked within its friction limit.
        problem = self._problem(pose, twist, command)
        problem = problem or self._frozen(time - pose_age, pose, twist)
        if problem:
            return Verdict.stop(self.braked(time, v), problem)
        discs = self._discs(pose, time - pose_age)
        pose = self.matcher.corrected(pose)
        self.motion.take(time - pose_age, pose, v)
        pose_velocity = self.motion.velocity
        if self._is_impossible(pose_velocity.v, pose_velocity.w):
            speeds = f"{pose_velocity.v:g} m/s and {pose_velocity.w:g} rad/s"
            problem = f"the poses imply {speeds}, which is too fast: check the odometry"
            return Verdict.stop(self.braked(time, v), problem)

        verdict = self._judge(pose, self.motions(twist), discs, command, creeps)
        # Wheels that slip under-report the speed, so the larger of both speeds along the last
        # output counts.
        measured_v = v
        if pose_velocity.v * self.output.v > v * self.output.v:
            measured_v = pose_velocity.v
        # The larger speed counts: the base may not yet have reached the last output.
        is_slow = max(abs(v), abs(self.output.v)) <= LAST_SPEED_M_S
        may_reverse = verdict.action == PASS and is_slow and self._grips(w, verdict.command)
        return verdict.braked(self.braked(time, measured_v, verdict.command, w, may_reverse))

    def _scan_age(self, time: float) -> float:
        """Return the age of the oldest laser's latest scan [s].

        It is 0 if a laser has no scan yet, which is a fault of its own.
        """
        oldest_stamp = math.inf
        for laser in self.lasers:
            if laser.stamp is None:
                return 0.0
            oldest_stamp = min(oldest_stamp, laser.stamp)
        return time - oldest_stamp

    def motions(self, twist: Twist) -> List[BaseMotion]:
        """Return the motion from the odometry, and that from the poses.

        Wheels show a change of speed at once. Poses show it later, but also when the body slides.
        """
        pose_velocity = self.motion.velocity
        slip = self._lateral_slip()
        v, w = twist
        return [
            BaseMotion(v, w, slip, self.output.w),
            BaseMotion(pose_velocity.v, pose_velocity.w, slip, self.output.w),
        ]

    def _lateral_slip(self) -> float:
        """Return the leftward speed [m/s] that a turn about the point at turn_ahead leaves open.

        Both terms come from the poses, so that they have the same age.
        """
        return self.motion.velocity.leftward + self.settings.turn_ahead * self.motion.velocity.w

    def braked(
        self,
        time: float,
        measured_v: float,
        command: Twist = (0.0, 0.0),
        measured_w: Optional[float] = None,
        may_reverse: bool = False,
    ) -> Twist:
        """Return the command (v, w) within the base's friction limit, and record it as output.

        If v must fall more slowly than requested, w keeps the base on the arc of the command that
        safe_scale has checked. w is then at most the larger of the commanded and the previous turn
        rate, and changes gradually, because tyres that turn the body have less friction left for
        braking.

        Args:
            time: current time [s].
            measured_v: measured forward speed [m/s].
            command: requested (v, w) [m/s, rad/s].
            measured_w: measured turn rate [rad/s], None if it is unknown.
            may_reverse: whether the command passes at once if it reverses the base.
        """
        v, w = command
        previous = self.output
        speed = min(abs(previous.v), abs(measured_v))
        reverses_at_once = may_reverse and v * previous.v < 0.0
        # Otherwise the base stands still or already moves the other way.
        is_moving_on = previous.v * measured_v > 0.0 and time >= previous.time
        if is_moving_on and not reverses_at_once:
            # Wheels that are slowed down faster lock, and the body slides farther than was checked.
            deceleration = stopping.deceleration_at(speed, self.settings.deceleration)
            slowest_speed = speed - deceleration * (time - previous.time)
            if slowest_speed > 0.0 and v * math.copysign(1.0, previous.v) < slowest_speed:
                if v == 0.0 and w == 0.0:
                    w = previous.w * slowest_speed / abs(previous.v)
                elif v * previous.v > 0.0:
                    w = stopping.on_arc(slowest_speed, v, w, previous.w)
                v = math.copysign(slowest_speed, previous.v)
                if measured_w is not None:
                    w = self._clamp_turn(w, measured_w)
        self._is_braking = v != command[0]
        self.output = MonitorOutput(time, v, w)
        return v, w

    def _grips(self, measured_w: float, command: Twist) -> bool:
        """Return whether the wheels drive straight on and do not slide.

        Such wheels reverse a slow body at once: 0.15 s from rest to -0.5 m/s in Gazebo. In turns
        and at the ends of hard stops they locked instead, and the body slid on.
        """
        if not self.motion.baseline:
            return False  # Nothing is known about a slide.
        _, command_w = command
        turn_rates = (self.output.w, measured_w, self.motion.velocity.w, command_w)
        slides = (self.motion.slide, self._lateral_slip())
        is_straight = max(map(abs, turn_rates)) < TURNS_RAD_S
        return is_straight and max(map(abs, slides)) < SLIDES_M_S

    def _clamp_turn(self, w: float, measured_w: float) -> float:
        """Clamp w to the turn rates that are reachable within GRIPPING_S. Keep its sign."""
        # Command at the measured turn rate, for a base that exceeds its commands by turn_gain
        current_w = measured_w / self.settings.turn_gain
        largest_change = GRIPPING_S * self.settings.yaw_deceleration
        reachable_w = min(max(w, current_w - largest_change), current_w + largest_change)
        if reachable_w * w > 0.0:
            return reachable_w
        return 0.0

    def _discs(self, pose: Pose, stamp: float) -> Discs:
        """Return where moving obstacles may be.

        Args:
            pose: pose (x, y, yaw) of the robot in the odometry's frame.
            stamp: time of this pose [s].
        """
        discs = []
        for laser in self.lasers:
            if laser.stamp is None:
                continue
            age = stamp - laser.stamp
            if len(laser.movers.x) and self.settings.passive_safety:
                acceleration = self.settings.mover_acceleration
                planes = self._body.planes
                discs.append(tracked_discs(laser.movers, planes, pose, age, acceleration))
        return np.concatenate(discs) if discs else NO_DISCS

    def _judge(
        self, pose: Pose, motions: List[BaseMotion], discs: Discs, command: Twist, creeps: bool
    ) -> Verdict:
        """Return the Verdict on a command, which must be safe for each of the possible motions."""
        self.seen.stand(self._body.planes, self._radius, pose)
        v, w = command
        if v == 0.0 and w == 0.0:
            return Verdict((v, w))
        # The base may reverse at once: it then starts from rest.
        for motion in list(motions):
            if motion.v * v < 0.0:
                motions.append(motion._replace(v=0.0))

        delay = self._delay()
        stoppable_scale = self._stoppable_scale(command, delay.reaction)
        command = stoppable_scale * v, stoppable_scale * w
        points = self._points_in_reach(pose, motions, command, delay)
        corner_i, corner_j = self.seen.corner.tolist()
        x, y, yaw = pose
        robot = BodyPose(x, y, math.cos(yaw), math.sin(yaw))
        seen = SeenCells(self.seen.cells, corner_i, corner_j, robot)
        scene = points, self._body, np.array(motions), command, delay, self._braking
        safe_limit = stopping.safe_scale(*scene, seen, discs)

        # The robot may creep into unobserved space if no known obstacle is in the way.
        creep_scale = self._creep_scale(command)
        if creeps and safe_limit.scale < creep_scale:
            known_limit = stopping.safe_scale(*scene, stopping.EVERYTHING, discs)
            if known_limit.scale > safe_limit.scale:
                scale = min(known_limit.scale, creep_scale)
                reason = "creeping: space within the stopping distance has not been observed"
                return Verdict(_scaled(command, scale), SLOW, stoppable_scale * scale, reason)
            safe_limit = known_limit
        verdict = self._verdict(command, stoppable_scale, safe_limit)
        if safe_limit.scale < 1.0 and len(discs):
            static_limit = stopping.safe_scale(*scene, seen, NO_DISCS)
            if static_limit.scale > safe_limit.scale:
                return replace(verdict, reason=MOVER_COMES)
        return verdict

    def _verdict(self, command: Twist, stoppable_scale: float, safe_limit: SafeScale) -> Verdict:
        """Return the Verdict on a command with the largest scale that is safe.

        `stoppable_scale` is the factor by which the command was limited before.
        """
        if safe_limit.scale >= 1.0 and stoppable_scale >= 1.0:
            return Verdict(command)
        if safe_limit.scale >= 1.0:
            distance = min(STOP_WITHIN_M, self.settings.memory_radius)
            reason = f"limited to the speed that can be stopped within {distance:g} m"
            return Verdict(command, SLOW, stoppable_scale, reason)
        if safe_limit.scale <= 0.0:
            reason = "braking: an obstacle is too near to stop"
            if safe_limit.can_stop:
                reason = "an obstacle is within the stopping distance"
            return Verdict.stop((0.0, 0.0), reason)
        reason = "limited: an obstacle or unobserved space is within the stopping distance"
        return Verdict(
            _scaled(command, safe_limit.scale), SLOW, stoppable_scale * safe_limit.scale, reason
        )

    def _delay(self) -> Delay:
        """Return the times before the base brakes.

        They are longer if inputs are old or commands are rare.
        """
        reaction_time = self.settings.reaction_time
        # A command applies until the next one, or until the base is braked after `silence`.
        command_time = min(reaction_time, max(self._intervals, default=0.0) + LATE_S)
        oldest_age = max(map(abs, self.ages))
        reaction = max(reaction_time, command_time + LATE_S) + oldest_age
        return Delay(max(0.0, self.ages.pose), reaction)

    def _stoppable_scale(self, command: Twist, reaction: float) -> float:
        """Return the factor, at most 1, that limits a command to the fastest one allowed."""
        v, w = command
        fastest_v, fastest_w = self._fastest(reaction)
        scale_v = fastest_v / max(abs(v), fastest_v)
        scale_w = fastest_w / max(abs(w), fastest_w)
        return min(1.0, scale_v, scale_w)

    def _creep_scale(self, command: Twist) -> float:
        """Return the factor, at most 1, at which no point of the body exceeds creep_speed."""
        v, w = command
        return min(1.0, self.settings.creep_speed / stopping.fastest_of(self._body.edge, v, w))

    def _points_in_reach(
        self, pose: Pose, motions: List[BaseMotion], command: Twist, delay: Delay
    ) -> Array:
        """Return the obstacle points (n, 2) [m] that the body can reach until it stops.

        The points are in the robot's frame.
        """
        settings = self.settings
        v, w = command
        speed = abs(v)
        turn_rate = settings.turn_gain * abs(w)
        for motion in motions:
            speed = max(speed, math.hypot(motion.v, motion.slip))
            turn_rate = max(turn_rate, abs(motion.w))
        braking_time = stopping.braking_time(speed, settings.deceleration)
        braking_time = max(braking_time, turn_rate / settings.yaw_deceleration)
        longest_time = delay.pose_age + delay.reaction + braking_time

        # The origin orbits the centre of rotation.
        chord = min(turn_rate * longest_time + stopping.SWING_RAD, LONGEST_CHORD)
        orbit = abs(settings.turn_ahead) * chord
        reach = self._radius + settings.margin + speed * longest_time + orbit + REACH_SLACK_M
        points = []
        for laser in self.lasers:
            points.append(laser.memory.around(pose, reach))
        return np.concatenate(points)

    def _is_impossible(self, v: float, w: float) -> bool:
        fastest_v, fastest_w = self.fastest
        return abs(v) > IMPOSSIBLE_FACTOR * fastest_v or abs(w) > IMPOSSIBLE_FACTOR * fastest_w

    def _frozen(self, stamp: float, pose: Pose, twist: Twist) -> str:
        """Return a fault if the pose stays the same although the velocity is not zero.

        New stamps do not make an old pose fresh.
        """
        v, w = twist
        # The measured velocity of a base at rest is seldom exactly 0.
        is_at_rest = abs(v) < BLOCKED_M_S and abs(w) < BLOCKED_RAD_S
        if pose != self._pose or stamp < self._pose_stamp or is_at_rest:
            self._pose = pose
            self._pose_stamp = stamp
        duration = stamp - self._pose_stamp
        should_have_moved = abs(v) * duration >= FROZEN_M or abs(w) * duration >= FROZEN_RAD
        if not should_have_moved or duration < SPAN_S:
            return ""
        return f"the pose is frozen: it stays the same at a velocity of {v:g} m/s and {w:g} rad/s"

    def _problem(self, pose: Pose, twist: Twist, command: Twist) -> str:
        """Return the first problem of the inputs as one line, or "" if there is none."""
        if not all(map(math.isfinite, (*pose, *twist, *command))):
            return "the command, the pose or the velocity is not finite"
        if max(map(abs, pose)) > FARTHEST_M:
            x, y, yaw = pose
            return f"the pose is ({x:g} m, {y:g} m, {yaw:g} rad), too far away: check the odometry"
        v, w = twist
        if self._is_impossible(v, w):
            speeds = f"{v:g} m/s and {w:g} rad/s"
            return f"the odometry reports {speeds}, which is too fast: check its source"
        for laser in self.lasers:
            if laser.fault and laser is self.lasers.first:
                return laser.fault
            if laser.fault:
                return f"{laser.words}: {laser.fault}"
        return self._age_problem()

    def _age_problem(self) -> str:
        """Return which input is too old, or ahead of the clock, as one line, or "" if none is."""
        oldest_laser = min(self.lasers, key=lambda laser: laser.stamp or 0.0)
        timeout = self.settings.scan_timeout
        for source, age in zip((oldest_laser.words, "pose", "odometry"), self.ages):
            if age > timeout:
                return f"the latest {source} is {age:.2f} s old; the limit is {timeout:g} s"
            if not age >= -AHEAD_OF_CLOCK_S:
                lead = f"{-age:.2f} s ahead of the clock"
                return f"the latest {source} is stamped {lead}: synchronise the clocks"
        return ""


def _stoppable_speed(deceleration: float, distance: float, reaction: float) -> float:
    """Return the speed that stops within a distance.

    It solves v reaction + v^2 / (2 deceleration) = distance.
    """
    return deceleration * (math.sqrt(reaction**2 + 2.0 * distance / deceleration) - reaction)


def _without_tiny_speeds(command: Twist) -> Twist:
    """Return a command as floats, with 0 in place of tiny speeds.

    A division by such a speed could overflow.
    """
    v, w = map(float, command)
    if abs(v) < TINY_SPEED:
        v = 0.0
    if abs(w) < TINY_SPEED:
        w = 0.0
    return v, w


def _scaled(command: Twist, scale: float) -> Twist:
    v, w = command
    return scale * v, scale * w


def warm_up(settings: MonitorSettings) -> None:
    """Compile or load all kernels by running a temporary monitor on two scans.

    One scan has a wide empty sector.
    """
    monitor = CollisionMonitor(settings)
    full_ranges = np.full(8, 0.6)
    half_empty = np.where(np.arange(8) < 4, full_ranges, np.inf)
    for stamp, ranges in ((0.0, full_ranges), (0.1, half_empty)):
        scan = LaserScan(stamp, -1.0, 0.3, 0.1, 10.0, ranges, (0.1, 0.0, 0.0))
        moving.warm_up(scan)
        monitor.add_scan(scan)
        monitor.filter(stamp, (0.0, 0.0, 0.0), (0.5, 0.0), (1.0, 0.1))
