"""The command that measures how a base brakes and turns, and prints the line `monitor:` of robot.yaml.

`rosrun applr_ros1 measure_braking.py` starts it. It drives the robot itself: --help says how.
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

RATE_HZ = 20.0  # Hz of commands
DRIVING_S = 1.2  # s of each run before it brakes
SHARES = 0.25, 0.5, 1.0  # of the largest speed, one run each; turns go up to half the largest turn rate
BACK_MPS = 0.5  # m/s at most, on the way back
LEAST_WAY_M, ROOM_M = 2.0, 0.5  # m of free way that is asked for; m of it that are never used
STANDING = 0.3  # s over which a speed is averaged before braking, and without motion that count as standing
STILL = 0.02, 0.05  # m/s, rad/s: less is no motion
FELL = 0.9  # of its speed: when it is slower, the base has begun to brake


class Reading(NamedTuple):
    """A message of the odometry: stamp [s], pose, and twist ahead and about z."""

    time: float
    x: float
    y: float
    yaw: float
    v: float
    w: float


class Stop(NamedTuple):
    """Stop of a base: speed [m/s or rad/s], the same over the commanded one, time until it slowed down [s], way."""

    speed: float
    gain: float
    reaction: float
    way: float


def stop_of(samples: List[Reading], braked: float, command: float, turning: bool) -> Stop:
    """Return how a base stopped from `command` [m/s, rad/s if turning], commanded to stop at the time `braked` [s]."""
    motion = [abs(s.w if turning else s.v) for s in samples]
    before = [m for m, s in zip(motion, samples) if braked - STANDING < s.time <= braked]
    after = [(m, s) for m, s in zip(motion, samples) if s.time >= braked]
    if not before or len(after) < 2:
        raise ApplrError("hardly any odometry came while the robot drove: is its clock that of this machine?")
    speed = sum(before) / len(before)
    reaction = next((s.time for m, s in after if m < FELL * speed), after[-1][1].time) - braked
    steps = [(b.x - a.x, b.y - a.y, normalize_angle(b.yaw - a.yaw)) for (_, a), (_, b) in zip(after, after[1:])]
    return Stop(
        speed, speed / abs(command), reaction, sum(abs(c) if turning else math.hypot(a, b) for a, b, c in steps)
    )


def deceleration(stops: List[Stop], reaction: float) -> float:
    """The least a with which every way is at most speed * reaction + speed^2 / (2 a)."""
    return min(s.speed**2 / (2.0 * max(s.way - s.speed * reaction, 1e-3)) for s in stops)


def reaction(straight: List[Stop], turns: List[Stop]) -> float:
    """Return a time [s] until the base brakes, from the median of its stops up.

    It is the one of a stop with which `deceleration` of the straight ones lets the fastest come to rest soonest: one
    stop that began late, as on a busy machine, then does not count as weak brakes.
    """
    times = sorted(s.reaction for s in straight + turns)
    top = max(s.speed for s in straight)

    def way(time: float) -> float:
        return round(top * time + top**2 / (2.0 * deceleration(straight, time)), 3)

    return min(times[len(times) // 2 :], key=way)


class Base:
    """The robot: commands out, odometry in.

    Args:
        command: topic of velocity commands.
        odometry: topic of nav_msgs/Odometry.
        free: way [m] that it may go from where it stands now.
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
        missing = f"nobody takes commands from {rospy.resolve_name(command)}"
        raise ApplrError(missing if self.samples else f"no odometry comes on {rospy.resolve_name(odometry)}")

    def _take(self, message: Odometry) -> None:
        pose, speed = message.pose.pose, message.twist.twist
        stamp = message.header.stamp.to_sec()
        self.samples.append(
            Reading(stamp, pose.position.x, pose.position.y, yaw_of(pose.orientation), speed.linear.x, speed.angular.z)
        )

    def ahead(self) -> float:
        """Return the way [m] ahead of where it stood at first."""
        now, start = self.samples[-1], self.start
        return (now.x - start.x) * math.cos(start.yaw) + (now.y - start.y) * math.sin(start.yaw)

    def drive(self, v: float, w: float, until: Callable[[], bool], seconds: float = 30.0) -> None:
        """Commands v [m/s] and w [rad/s], straight on where w is 0, until the condition holds or so long."""
        end = rospy.get_time() + seconds
        while not until() and rospy.get_time() < end:
            now = self.samples[-1]
            off = math.hypot(now.x - self.start.x, now.y - self.start.y)
            if rospy.is_shutdown() or off > self.free:
                self._out.publish(Twist())
                raise ApplrError(f"stopped: the robot is {off:.2f} m from its start, {self.free:g} m are free")
            steer = w if w or not v else max(-0.5, min(0.5, 2.0 * normalize_angle(self.start.yaw - now.yaw)))
            self._out.publish(twist(v, steer))
            self._rate.sleep()

    def stands(self) -> bool:
        """Return whether it has not moved for STANDING seconds."""
        recent = [s for s in self.samples if s.time > self.samples[-1].time - STANDING]
        return all(abs(s.v) < STILL[0] and abs(s.w) < STILL[1] for s in recent)

    def run(self, v: float, w: float) -> Stop:
        """Drives or turns, brakes, stands. Prints a line."""
        first, over = len(self.samples), rospy.get_time() + DRIVING_S
        farthest = self.free - ROOM_M - v * v / 2.0
        self.drive(v, w, lambda: rospy.get_time() > over or self.ahead() > farthest)
        braked = rospy.get_time()
        self.drive(0.0, 0.0, lambda: rospy.get_time() > braked + STANDING and self.stands(), 6.0)
        stop = stop_of(self.samples[first:], braked, w or v, bool(w))
        units = ("rad/s", "rad") if w else ("m/s", "m")
        line = "%.2f %s commanded, %.2f driven, slower after %.3f s, stops within %.3f %s"
        print(line % (w or v, units[0], stop.speed, stop.reaction, stop.way, units[1]), flush=True)
        return stop


def fastest(free: float) -> float:
    """Return the speed [m/s] from which a run on `free` metres still ends if the base brakes with 1 m/s^2."""
    return math.sqrt(DRIVING_S**2 + 2.0 * (free - ROOM_M)) - DRIVING_S


def main() -> None:
    """Run the command. Raises ApplrError, one line, without a word that the way is free."""
    parser = argparse.ArgumentParser(
        prog="measure_braking.py",
        description="Drive the robot forwards at several speeds, brake, drive back, turn in place and stop; then print "
        "the line `monitor:` of robot.yaml. Commands go to the base directly, past the collision monitor.",
    )
    add = parser.add_argument
    add("--free", type=float, required=True, metavar="METRES", help="Free way ahead, and half a metre on all sides.")
    add("--yes", action="store_true", help="Needed: the way is free of people, and the emergency stop is at hand.")
    add("--robot", default="jackal", help="Name or folder of its description. Default: %(default)s.")
    truth = "Topic of the true motion (nav_msgs/Odometry), such as a tracking system's. Default: the robot's odometry, "
    add("--odometry", default="", help=truth + "which does not see sliding wheels.")
    add("--repeats", type=int, default=3, help="Runs of each kind. Default: %(default)s.")
    options = parser.parse_args(without_remappings(sys.argv[1:]))
    if not options.yes:
        raise ApplrError("the robot would drive: give --yes when its way is free and the emergency stop is at hand")
    if not options.free >= LEAST_WAY_M or options.repeats < 1:
        wrong = f"--free {options.free:g} --repeats {options.repeats}"
        raise ApplrError(f"{wrong}: give {LEAST_WAY_M:g} m or more, and a run or more")
    robot = load(options.robot)
    init_node("measure_braking", anonymous=True)
    base = Base(robot.topics.cmd_vel, options.odometry or robot.topics.odometry, options.free)
    top = min(robot.base.max_speed, fastest(options.free))
    straight, turns = [], []
    for speed in [share * top for share in SHARES for _ in range(options.repeats)]:
        straight.append(base.run(speed, 0.0))
        base.drive(-min(BACK_MPS, speed), 0.0, lambda: base.ahead() < 0.2)
        base.drive(0.0, 0.0, base.stands, 6.0)
    for share in [sign * 0.5 * share for share in SHARES[1:] for _ in range(options.repeats) for sign in (1.0, -1.0)]:
        turns.append(base.run(0.0, share * robot.base.max_yaw_rate))
    late = reaction(straight, turns)
    brake, turn_brake = deceleration(straight, late), deceleration(turns, late)
    print(f"worst deceleration {brake:.2f} m/s^2, {turn_brake:.2f} rad/s^2 from {late:.3f} s after the command on")
    print(f"turn rate over the commanded one: {min(s.gain for s in turns):.2f} to {max(s.gain for s in turns):.2f}")
    total = late + 1.0 / RATE_HZ + 1.0 / robot.laser.rate  # a command and a scan may be so old
    print(
        f"monitor: {{margin: {robot.monitor.margin:g}, reaction_time: {math.ceil(100.0 * total) / 100.0:.2f}, "
        f"deceleration: {math.floor(10.0 * brake) / 10.0:.1f}, yaw_deceleration: "
        f"{math.floor(10.0 * turn_brake) / 10.0:.1f}}}"
    )
