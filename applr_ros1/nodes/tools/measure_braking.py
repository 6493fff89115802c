"""Measurement of how a base brakes, turns and ignores small commands, for `monitor:` and `dead_band` in robot.yaml.

Started as `rosrun applr_ros1 measure_braking.py`. The program drives the robot; see --help.
"""

from __future__ import annotations

import argparse
import math
import sys
import time
from typing import Callable, List, NamedTuple

import rospy
from geometry_msgs.msg import Twist
from nav_msgs.msg import Odometry

from applr_ros1.common.angles import normalize_angle, yaw_of
from applr_ros1.common.arguments import without_remappings
from applr_ros1.common.errors import ApplrError
from applr_ros1.common.ros_node import init_node
from applr_ros1.nodes.conversions import twist
from applr_ros1.robots import load

RATE_HZ = 20.0  # rate of commands [Hz]
DRIVING_S = 1.2  # duration of each run before braking [s]
SHARES = (
    0.25,
    0.5,
    1.0,
)  # speeds of the runs as shares of the largest speed, or of half the largest turn rate
BACK_MPS = 0.5  # largest speed on the way back [m/s]
LEAST_WAY_M, ROOM_M = (
    2.0,
    0.5,
)  # smallest free distance ahead, and the part of it that is kept in reserve [m]
STANDING = (
    0.3  # time over which the speed before braking is averaged, and time without motion at rest [s]
)
STILL = 0.02, 0.05  # speed [m/s] and turn rate [rad/s] below which the base counts as at rest
STEPS, MOST_STEPS = (
    (0.01, 0.03),
    30,
)  # steps of the dead band's measurement [m/s, rad/s], and their largest number
FELL = 0.9  # share of the speed below which the base counts as braking


class Reading(NamedTuple):
    """One odometry message: stamp [s], pose [m, m, rad], forward speed [m/s] and turn rate [rad/s]."""

    time: float
    x: float
    y: float
    yaw: float
    v: float
    w: float


class Stop(NamedTuple):
    """One stop: speed [m/s or rad/s], its ratio to the command, time until braking began [s], distance [m or rad]."""

    speed: float
    gain: float
    reaction: float
    way: float


def stop_of(samples: List[Reading], braked: float, command: float, turning: bool) -> Stop:
    """Return the Stop of a run at `command` [m/s, or rad/s if turning] that was braked at the time `braked` [s]."""
    motion = [abs(s.w if turning else s.v) for s in samples]
    before = [m for m, s in zip(motion, samples) if braked - STANDING < s.time <= braked]
    after = [(m, s) for m, s in zip(motion, samples) if s.time >= braked]
    if not before or len(after) < 2:
        raise ApplrError(
            "too few odometry messages during the run: check that the robot's clock is synchronised"
        )
    speed = sum(before) / len(before)
    reaction = next((s.time for m, s in after if m < FELL * speed), after[-1][1].time) - braked
    steps = [
        (b.x - a.x, b.y - a.y, normalize_angle(b.yaw - a.yaw))
        for (_, a), (_, b) in zip(after, after[1:])
    ]
    return Stop(
        speed,
        speed / abs(command),
        reaction,
        sum(abs(c) if turning else math.hypot(a, b) for a, b, c in steps),
    )


def deceleration(stops: List[Stop], reaction: float) -> float:
    """Return the worst deceleration a: distance <= speed * reaction + speed^2 / (2 a) for every stop."""
    return min(s.speed**2 / (2.0 * max(s.way - s.speed * reaction, 1e-3)) for s in stops)


def reaction(straight: List[Stop], turns: List[Stop]) -> float:
    """Return the reaction time [s] with the shortest predicted stop from the largest speed.

    Candidates are the reaction times of the stops from their median up. A single late stop, as on a busy machine, is
    then not mistaken for weak brakes.
    """
    times = sorted(s.reaction for s in straight + turns)
    top = max(s.speed for s in straight)

    def way(time: float) -> float:
        return round(top * time + top**2 / (2.0 * deceleration(straight, time)), 3)

    return min(times[len(times) // 2 :], key=way)


class Base:
    """Interface to the robot: publishes commands and records odometry.

    Args:
        command: Topic of velocity commands.
        odometry: Topic of the odometry (nav_msgs/Odometry).
        free: Largest distance from the start that the robot may drive [m].
    """

    def __init__(self, command: str, odometry: str, free: float):
        self.free = free
        self.samples: List[Reading] = []
        self._out = rospy.Publisher(command, Twist, queue_size=1)
        rospy.Subscriber(odometry, Odometry, self._take, queue_size=50, tcp_nodelay=True)
        rospy.on_shutdown(lambda: self._out.publish(Twist()))
        for _ in range(300):
            if self.samples and self._out.get_num_connections():
                self.start, self._rate = self.samples[-1], rospy.Rate(RATE_HZ)
                return
            time.sleep(0.1)
        missing = (
            f"no subscriber to commands on {rospy.resolve_name(command)}: start the robot's driver"
        )
        raise ApplrError(
            missing if self.samples else f"no odometry on {rospy.resolve_name(odometry)}"
        )

    def _take(self, message: Odometry) -> None:
        pose, speed = message.pose.pose, message.twist.twist
        stamp = message.header.stamp.to_sec()
        self.samples.append(
            Reading(
                stamp,
                pose.position.x,
                pose.position.y,
                yaw_of(pose.orientation),
                speed.linear.x,
                speed.angular.z,
            )
        )

    def ahead(self) -> float:
        """Return the distance from the start along the initial heading [m]."""
        now, start = self.samples[-1], self.start
        return (now.x - start.x) * math.cos(start.yaw) + (now.y - start.y) * math.sin(start.yaw)

    def drive(self, v: float, w: float, until: Callable[[], bool], seconds: float = 30.0) -> None:
        """Publish commands v [m/s] and w [rad/s] until a condition holds or `seconds` have passed.

        If only v is nonzero, the initial heading is kept. Raises ApplrError if the robot leaves the free way.
        """
        end = rospy.get_time() + seconds
        while not until() and rospy.get_time() < end:
            now = self.samples[-1]
            off = math.hypot(now.x - self.start.x, now.y - self.start.y)
            if rospy.is_shutdown() or off > self.free:
                self._out.publish(Twist())
                raise ApplrError(
                    f"stopped: the robot is {off:.2f} m from its start; only {self.free:g} m are free"
                )
            steer = (
                w
                if w or not v
                else max(-0.5, min(0.5, 2.0 * normalize_angle(self.start.yaw - now.yaw)))
            )
            self._out.publish(twist(v, steer))
            self._rate.sleep()

    def stands(self) -> bool:
        """Return whether the base has been at rest for STANDING seconds."""
        recent = [s for s in self.samples if s.time > self.samples[-1].time - STANDING]
        return all(abs(s.v) < STILL[0] and abs(s.w) < STILL[1] for s in recent)

    def run(self, v: float, w: float) -> Stop:
        """Drive or turn, brake to rest, and print a line about the stop."""
        first, over = len(self.samples), rospy.get_time() + DRIVING_S
        farthest = self.free - ROOM_M - v * v / 2.0
        self.drive(v, w, lambda: rospy.get_time() > over or self.ahead() > farthest)
        braked = rospy.get_time()
        self.drive(0.0, 0.0, lambda: rospy.get_time() > braked + STANDING and self.stands(), 6.0)
        stop = stop_of(self.samples[first:], braked, w or v, bool(w))
        units = ("rad/s", "rad") if w else ("m/s", "m")
        line = "%.2f %s commanded, %.2f driven, brakes after %.3f s, stops within %.3f %s"
        print(line % (w or v, units[0], stop.speed, stop.reaction, stop.way, units[1]), flush=True)
        return stop


def dead_band(base: Base, turning: bool) -> float:
    """Return the smallest command [m/s, or rad/s if turning] that moves the base; 0 if the first step already does."""
    step = STEPS[turning]
    for command in (step * number for number in range(1, MOST_STEPS + 1)):
        before = base.samples[-1]
        base.drive(0.0 if turning else command, command * turning, lambda: False, DRIVING_S)
        now = base.samples[-1]
        way = (
            normalize_angle(now.yaw - before.yaw)
            if turning
            else math.hypot(now.x - before.x, now.y - before.y)
        )
        if way > 0.5 * command * DRIVING_S:
            break
    return command if command > step else 0.0


def fastest(free: float) -> float:
    """Return the largest speed [m/s] of a run within `free` metres if the base brakes at 1 m/s^2."""
    return math.sqrt(DRIVING_S**2 + 2.0 * (free - ROOM_M)) - DRIVING_S


def main() -> None:
    """Run the command. Raises ApplrError unless --yes confirms that the robot may drive."""
    parser = argparse.ArgumentParser(
        prog="measure_braking.py",
        description="Command rising speeds until the robot moves, drive forwards at several speeds, brake, drive back, "
        "turn in place and stop; then print `dead_band` and the line `monitor:` of robot.yaml. Commands bypass the "
        "collision monitor.",
    )
    add = parser.add_argument
    add(
        "--free",
        type=float,
        required=True,
        metavar="METRES",
        help="Free distance ahead. On all other sides, half a metre must be free.",
    )
    add(
        "--yes",
        action="store_true",
        help="Required: confirms a way free of people, and an emergency stop at hand.",
    )
    add(
        "--robot",
        default="jackal",
        help="Name or folder of the robot's description. Default: %(default)s.",
    )
    truth = "Topic of the true motion (nav_msgs/Odometry), such as a tracking system's. Default: the robot's odometry, "
    add("--odometry", default="", help=truth + "which cannot detect wheel slip.")
    add("--repeats", type=int, default=3, help="Number of runs of each kind. Default: %(default)s.")
    options = parser.parse_args(without_remappings(sys.argv[1:]))
    if not options.yes:
        raise ApplrError(
            "the robot will drive: give --yes once its way is free and an emergency stop is at hand"
        )
    if not options.free >= LEAST_WAY_M or options.repeats < 1:
        wrong = f"--free {options.free:g} --repeats {options.repeats}"
        raise ApplrError(f"{wrong}: give at least {LEAST_WAY_M:g} m and one run")
    robot = load(options.robot)
    init_node("measure_braking", anonymous=True)
    base = Base(robot.topics.cmd_vel, options.odometry or robot.topics.odometry, options.free)
    top = min(robot.base.max_speed, fastest(options.free))
    ignored = [dead_band(base, turning) for turning in (False, True)]
    base.drive(0.0, 0.0, base.stands, 6.0)
    print("  dead_band: [{:g}, {:g}]  # in the section base".format(*ignored), flush=True)
    straight, turns = [], []
    for speed in [share * top for share in SHARES for _ in range(options.repeats)]:
        straight.append(base.run(speed, 0.0))
        base.drive(-min(BACK_MPS, speed), 0.0, lambda: base.ahead() < 0.2)
        base.drive(0.0, 0.0, base.stands, 6.0)
    for share in [
        sign * 0.5 * share
        for share in SHARES[1:]
        for _ in range(options.repeats)
        for sign in (1.0, -1.0)
    ]:
        turns.append(base.run(0.0, share * robot.base.max_yaw_rate))
    late = reaction(straight, turns)
    brake, turn_brake = deceleration(straight, late), deceleration(turns, late)
    print(
        f"worst deceleration {brake:.2f} m/s^2, {turn_brake:.2f} rad/s^2, starting {late:.3f} s after the command"
    )
    print(
        f"turn rate over commanded turn rate: {min(s.gain for s in turns):.2f} to {max(s.gain for s in turns):.2f}"
    )
    total = (
        late + 1.0 / RATE_HZ + 1.0 / robot.laser.rate
    )  # The last command and scan may be a period old.
    print(
        f"monitor: {{margin: {robot.monitor.margin:g}, reaction_time: {math.ceil(100.0 * total) / 100.0:.2f}, "
        f"deceleration: {math.floor(10.0 * brake) / 10.0:.1f}, yaw_deceleration: "
        f"{math.floor(10.0 * turn_brake) / 10.0:.1f}}}"
    )
