"""Measurement of how a base brakes, turns and ignores small commands.

It gives `monitor:` and `dead_band` of robot.yaml. Started as `rosrun applr_ros1
measure_braking.py`. The program drives the robot; see --help.
"""

from __future__ import annotations

import argparse
import math
import sys
import time
from typing import Callable, List, NamedTuple

import rospy
from geometry_msgs.msg import Twist as TwistMessage
from nav_msgs.msg import Odometry

from applr_ros1.common.angles import normalize_angle
from applr_ros1.common.arguments import without_remappings
from applr_ros1.common.errors import ApplrError
from applr_ros1.common.ros_node import command_topic, init_node
from applr_ros1.nodes.base_commands import BaseCommands
from applr_ros1.nodes.conversions import Reading, reading_of, twist
from applr_ros1.robots import load
from applr_ros1.senses.standing import SILENT_WHILE_BRAKING_S, STANDS

RATE_HZ = 20.0  # rate of commands [Hz]
START_S = 30.0  # longest wall time until odometry and base are connected [s]
DRIVING_S = 1.2  # duration of each run before braking [s]
BRAKING_S = 6.0  # longest time for a base to come to rest [s]
# Speeds of the runs as shares of the largest speed, or of half the largest turn rate
SHARES = (0.25, 0.5, 1.0)
BACK_MPS = 0.5  # largest speed on the way back [m/s]
BACK_M = 0.2  # distance ahead of the start at which the way back ends [m]
LEAST_WAY_M = 2.0  # smallest free distance ahead [m]
ROOM_M = 0.5  # part of the free distance that is kept in reserve [m]
# Time over which the speed before braking is averaged, and time without motion at rest [s]
STANDING_S = 0.3
# Steps of the dead band's measurement, and their largest number
STEP_M_S = 0.01
STEP_RAD_S = 0.03
MOST_STEPS = 30
MOVED_SHARE = 0.5  # share of a commanded motion from which the base counts as moving
FELL = 0.9  # share of the speed below which the base counts as braking
KEEP_GAIN = 2.0  # turn rate per error of the heading, to drive straight [1/s]
KEEP_RAD_S = 0.5  # largest turn rate to drive straight [rad/s]


class MeasuredStop(NamedTuple):
    """One stop of a run or turn.

    Attributes:
        speed: Speed before braking [m/s or rad/s].
        gain: Ratio of this speed to the command.
        reaction: Time from the command to the begin of braking [s].
        way: Distance from the command to rest [m or rad].
    """

    speed: float
    gain: float
    reaction: float
    way: float


def stop_of(
    readings: List[Reading], brake_time: float, command: float, is_turn: bool
) -> MeasuredStop:
    """Return the MeasuredStop of a run.

    Args:
        readings: Odometry of the run.
        brake_time: Time of the command to stop [s].
        command: Speed that was commanded before [m/s, or rad/s in a turn].
        is_turn: Whether the base turned in place.

    Raises:
        ApplrError: There are too few readings.
    """
    speeds_before = []
    readings_after = [reading for reading in readings if reading.time >= brake_time]
    for reading in readings:
        if brake_time - STANDING_S < reading.time <= brake_time:
            speeds_before.append(_speed(reading, is_turn))
    if not speeds_before or len(readings_after) < 2:
        problem = "too few odometry messages during the run"
        raise ApplrError(f"{problem}: check that the robot's clock is synchronised")
    speed = sum(speeds_before) / len(speeds_before)

    # A base that never slowed down reacts at the end of the readings.
    slowed_time = readings_after[-1].time
    for reading in readings_after:
        if _speed(reading, is_turn) < FELL * speed:
            slowed_time = reading.time
            break

    # The sum of the steps, not the distance of the ends: a wheel slips, and a turn may exceed pi.
    distance = 0.0
    for previous, reading in zip(readings_after, readings_after[1:]):
        distance += _distance(previous, reading, is_turn)
    return MeasuredStop(speed, speed / abs(command), slowed_time - brake_time, distance)


def _speed(reading: Reading, is_turn: bool) -> float:
    """Return the magnitude of the forward speed [m/s], or of the turn rate [rad/s] in a turn."""
    v, w = reading.twist
    return abs(w if is_turn else v)


def _distance(previous: Reading, reading: Reading, is_turn: bool) -> float:
    """Return the distance between two readings [m], or the angle between them [rad] in a turn."""
    if is_turn:
        return abs(normalize_angle(reading.pose[2] - previous.pose[2]))
    return math.dist(reading.pose[:2], previous.pose[:2])


def deceleration(stops: List[MeasuredStop], reaction: float) -> float:
    """Return the worst deceleration of some stops [m/s^2 or rad/s^2].

    With it, distance <= speed * reaction + speed^2 / (2 deceleration) for every stop.

    reaction: time until braking begins [s].
    """
    decelerations = []
    for stop in stops:
        braking_way = max(stop.way - stop.speed * reaction, 1e-3)
        decelerations.append(stop.speed**2 / (2.0 * braking_way))
    return min(decelerations)


def reaction(straight: List[MeasuredStop], turns: List[MeasuredStop]) -> float:
    """Return the reaction time [s] with the shortest predicted stop from the largest speed.

    Candidates are the reaction times of the stops from their median up. A single late stop, as on a
    busy machine, is then not mistaken for weak brakes.
    """
    reaction_times = sorted(stop.reaction for stop in straight + turns)
    top_speed = max(stop.speed for stop in straight)

    def predicted_way(time: float) -> float:
        """Return the way of a stop from the largest speed [m]. Less than a mm is noise."""
        return round(top_speed * time + top_speed**2 / (2.0 * deceleration(straight, time)), 3)

    return min(reaction_times[len(reaction_times) // 2 :], key=predicted_way)


class MeasuredBase:
    """Interface to the robot: publishes commands and records odometry.

    Args:
        command: Topic of velocity commands.
        odometry: Topic of the odometry (nav_msgs/Odometry).
        free: Largest distance from the start that the robot may drive [m].

    Raises:
        ApplrError: There is no odometry, or nobody listens to the commands.
    """

    def __init__(self, command: str, odometry: str, free: float):
        self.free = free
        self.readings: List[Reading] = []
        self._arrived = 0.0  # time.monotonic() of the latest reading
        self._commands = BaseCommands(command)
        rospy.Subscriber(odometry, Odometry, self._take, queue_size=50, tcp_nodelay=True)
        deadline = time.monotonic() + START_S
        while not (self.readings and self._commands.get_num_connections()):
            if time.monotonic() > deadline:
                if not self.readings:
                    raise ApplrError(f"no odometry on {rospy.resolve_name(odometry)}")
                problem = f"no subscriber to commands on {rospy.resolve_name(command)}"
                raise ApplrError(f"{problem}: start the robot's driver")
            time.sleep(0.1)
        self.start = self.readings[-1].pose
        self._rate = rospy.Rate(RATE_HZ)

    def _take(self, message: Odometry) -> None:
        self._arrived = time.monotonic()
        self.readings.append(reading_of(message))

    def ahead(self) -> float:
        """Return the distance from the start along the initial heading [m]."""
        x, y, _ = self.readings[-1].pose
        start_x, start_y, heading = self.start
        return (x - start_x) * math.cos(heading) + (y - start_y) * math.sin(heading)

    def drive(self, v: float, w: float, until: Callable[[], bool], seconds: float = 30.0) -> None:
        """Publish commands v [m/s] and w [rad/s] until a condition holds or `seconds` have passed.

        If only v is nonzero, the initial heading is kept.

        Raises:
            ApplrError: The robot leaves the free way, or the odometry falls silent.
        """
        end_time = rospy.get_time() + seconds
        while not until() and rospy.get_time() < end_time:
            silence = time.monotonic() - self._arrived
            if silence > SILENT_WHILE_BRAKING_S:
                self._commands.publish(TwistMessage())
                raise ApplrError(f"stopped: no odometry for {silence:.1f} s")
            pose = self.readings[-1].pose
            distance = math.dist(pose[:2], self.start[:2])
            if rospy.is_shutdown() or distance > self.free:
                self._commands.publish(TwistMessage())
                problem = f"stopped: the robot is {distance:.2f} m from its start"
                raise ApplrError(f"{problem}; only {self.free:g} m are free")
            turn_rate = w
            if v and not w:
                heading_error = normalize_angle(self.start[2] - pose[2])
                turn_rate = max(-KEEP_RAD_S, min(KEEP_RAD_S, KEEP_GAIN * heading_error))
            self._commands.publish(twist(v, turn_rate))
            self._rate.sleep()

    def is_at_rest(self) -> bool:
        """Return whether the base has stood still for STANDING_S seconds."""
        begin_time = self.readings[-1].time - STANDING_S
        recent_twists = [reading.twist for reading in self.readings if reading.time > begin_time]
        return all(STANDS.holds(v, w) for v, w in recent_twists)

    def stop(self) -> None:
        """Brake until the base stands still."""
        self.drive(0.0, 0.0, self.is_at_rest, BRAKING_S)

    def run(self, v: float, w: float) -> MeasuredStop:
        """Drive or turn, brake to rest, and print a line about the stop."""
        first_index = len(self.readings)
        end_time = rospy.get_time() + DRIVING_S
        farthest_ahead = self.free - ROOM_M - v * v / 2.0  # It brakes with at least 1 m/s^2.
        self.drive(v, w, lambda: rospy.get_time() > end_time or self.ahead() > farthest_ahead)

        # A base that the command did not move would count as stopped before the first reading.
        brake_time = rospy.get_time()
        settled_time = brake_time + STANDING_S

        def has_settled() -> bool:
            return rospy.get_time() > settled_time and self.is_at_rest()

        self.drive(0.0, 0.0, has_settled, BRAKING_S)
        command = w or v
        is_turn = bool(w)
        stop = stop_of(self.readings[first_index:], brake_time, command, is_turn)
        _print_stop(stop, command, is_turn)
        return stop


def _print_stop(stop: MeasuredStop, command: float, is_turn: bool) -> None:
    speed_unit = "rad/s" if is_turn else "m/s"
    way_unit = "rad" if is_turn else "m"
    print(
        f"{command:.2f} {speed_unit} commanded, {stop.speed:.2f} driven, brakes after "
        f"{stop.reaction:.3f} s, stops within {stop.way:.3f} {way_unit}",
        flush=True,
    )


def dead_band(base: MeasuredBase, is_turn: bool) -> float:
    """Return the smallest command that moves the base [m/s, or rad/s in a turn].

    It is 0 if the first step already moves the base.

    Raises:
        ApplrError: The base does not move at the largest command either.
    """
    step = STEP_RAD_S if is_turn else STEP_M_S
    command = 0.0
    for step_number in range(1, MOST_STEPS + 1):
        command = step * step_number
        v, w = (0.0, command) if is_turn else (command, 0.0)
        start_reading = base.readings[-1]
        base.drive(v, w, lambda: False, DRIVING_S)
        way = _distance(start_reading, base.readings[-1], is_turn)
        if way > MOVED_SHARE * command * DRIVING_S:
            return command if step_number > 1 else 0.0
    unit = "rad/s" if is_turn else "m/s"
    raise ApplrError(
        f"the base does not move at {command:g} {unit}: release its emergency stop and its brakes"
    )


def fastest(room: float) -> float:
    """Return the largest speed [m/s] of a run within `room` metres, if it brakes at 1 m/s^2."""
    return math.sqrt(DRIVING_S**2 + 2.0 * (room - ROOM_M)) - DRIVING_S


def parser() -> argparse.ArgumentParser:
    """Return the parser of the command line."""
    arguments = argparse.ArgumentParser(
        prog="measure_braking.py",
        description="Command rising speeds until the robot moves, drive forwards at several "
        "speeds, brake, drive back, turn in place and stop; then print `dead_band` and the line "
        "`monitor:` of robot.yaml. Commands bypass the collision monitor.",
    )
    arguments.add_argument(
        "--free",
        type=float,
        required=True,
        metavar="METRES",
        help="Free distance ahead. On all other sides, half a metre must be free.",
    )
    arguments.add_argument(
        "--yes",
        action="store_true",
        help="Required: confirms a way free of people, and an emergency stop at hand.",
    )
    arguments.add_argument(
        "--robot",
        default="jackal",
        help="Name or folder of the robot's description. Default: %(default)s.",
    )
    arguments.add_argument(
        "--odometry",
        default="",
        help="Topic of the true motion (nav_msgs/Odometry), such as a tracking system's. Default: "
        "the robot's odometry, which cannot detect wheel slip.",
    )
    arguments.add_argument(
        "--repeats", type=int, default=3, help="Number of runs of each kind. Default: %(default)s."
    )
    return arguments


def main() -> None:
    """Run the command.

    Raises:
        ApplrError: --yes does not confirm that the robot may drive, or the measurement failed.
    """
    options = parser().parse_args(without_remappings(sys.argv[1:]))
    if not options.yes:
        advice = "give --yes once its way is free and an emergency stop is at hand"
        raise ApplrError(f"the robot will drive: {advice}")
    if not options.free >= LEAST_WAY_M or options.repeats < 1:
        invalid_options = f"--free {options.free:g} --repeats {options.repeats}"
        raise ApplrError(f"{invalid_options}: give at least {LEAST_WAY_M:g} m and one run")
    robot = load(options.robot)
    init_node("measure_braking", anonymous=True)
    commands = command_topic(robot.topics.cmd_vel)
    base = MeasuredBase(commands, options.odometry or robot.topics.odometry, options.free)
    top_speed = min(robot.base.max_speed, fastest(options.free))

    ignored_v = dead_band(base, is_turn=False)
    ignored_w = dead_band(base, is_turn=True)
    base.stop()
    print(f"  dead_band: [{ignored_v:g}, {ignored_w:g}]  # in the section base", flush=True)

    straight = []
    for share in SHARES:
        for _ in range(options.repeats):
            speed = share * top_speed
            straight.append(base.run(speed, 0.0))
            base.drive(-min(BACK_MPS, speed), 0.0, lambda: base.ahead() < BACK_M)
            base.stop()
    # Slow turns stop within the noise of the odometry.
    turns = []
    for share in SHARES[1:]:
        for _ in range(options.repeats):
            turn_rate = 0.5 * share * robot.base.max_yaw_rate
            turns.append(base.run(0.0, turn_rate))
            turns.append(base.run(0.0, -turn_rate))

    reaction_s = reaction(straight, turns)
    brake = deceleration(straight, reaction_s)
    turn_brake = deceleration(turns, reaction_s)
    limits = f"{brake:.2f} m/s^2, {turn_brake:.2f} rad/s^2"
    print(f"worst deceleration {limits}, starting {reaction_s:.3f} s after the command")
    gains = [stop.gain for stop in turns]
    print(f"turn rate over commanded turn rate: {min(gains):.2f} to {max(gains):.2f}")

    # The last command and scan may be a period old. All limits are rounded to the safe side.
    total_s = reaction_s + 1.0 / RATE_HZ + 1.0 / robot.laser.rate
    safe_time = math.ceil(100.0 * total_s) / 100.0
    safe_brake = math.floor(10.0 * brake) / 10.0
    safe_turn_brake = math.floor(10.0 * turn_brake) / 10.0
    safe_gain = math.ceil(100.0 * max(1.0, *gains)) / 100.0
    measured = {
        "reaction_time": safe_time,
        "deceleration": safe_brake,
        "yaw_deceleration": safe_turn_brake,
        "turn_gain": safe_gain,
    }
    # The line replaces that of robot.yaml, so it has the settings that were not measured, too.
    settings = {**robot.monitor.model_dump(), **measured}
    listed = ", ".join(f"{name}: {value:g}" for name, value in settings.items())
    print(f"monitor: {{{listed}}}")
