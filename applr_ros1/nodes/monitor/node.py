"""ROS node `collision_monitor`, between a source of velocity commands and the base.

The source is move_base or any other node. Started by guard.py. The node reads commands from
cmd_vel_in and publishes them on cmd_vel as the CollisionMonitor allows. If the next command is
overdue, the node itself sends braking commands, and then zeros until the base has stood still for a
second. After an exception, the node stops the base and reports the exception on /diagnostics. With
~escape, the node makes small escape motions while move_base is stuck or blocked although a goal is
active. The node broadcasts the frame of its matched poses (frame_broadcaster.py).

Parameters: ~robot (jackal; name or folder of a description), ~map (its files for a map; false),
~tf_prefix, ~more_scans (topics of further lasers; default: those of the description), ~escape
(false), and the fields of monitor/settings.py except OF_ROBOT.
"""

from __future__ import annotations

import threading
import time
import traceback
from dataclasses import fields, replace
from typing import Any, Dict, List, Optional

import rospy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from geometry_msgs.msg import Twist as TwistMessage
from std_msgs.msg import Bool, String

from applr_ros1.common.angles import Twist
from applr_ros1.common.errors import ApplrError, run_script, shown
from applr_ros1.common.messages import twist_of
from applr_ros1.common.ros_node import command_topic, init_node, status_name, until_shutdown
from applr_ros1.monitor.monitor import (
    BRAKE,
    PASS,
    SLOW,
    STOP,
    CollisionMonitor,
    Verdict,
    warm_up,
)
from applr_ros1.monitor.settings import OF_ROBOT, MonitorSettings
from applr_ros1.nodes import conversions
from applr_ros1.nodes.base_commands import BaseCommands
from applr_ros1.nodes.robot_parameters import NAMING, named_robot
from applr_ros1.nodes.sensors import RosClock, Sensors
from applr_ros1.robots import Robot
from applr_ros1.senses.standing import HANDED_OVER, JUDGED_AGE_S
from applr_ros1.stack.command_chain import StalledPlanner, judged

from .frame_broadcaster import FrameBroadcaster
from .guard import Heartbeat
from .move_base_progress import MoveBaseProgress
from .reports import MonitorReports, topic_named

LOOK_S = 0.01  # interval between polls for a new scan, in wall time [s]
REPORT_S = 1.0  # interval between diagnostics, in wall time [s]
ZEROS_S = 0.05  # interval between the node's own commands while none arrives, in wall time [s]
RESTING_ZEROS = 20  # number of zeros for a base at rest before other publishers may drive it
STALLED_S = 0.5  # wall time without a change of ROS time after which commands are stopped [s]
ESCAPE = "escape"  # action reported while the node drives an escape motion


class CollisionMonitorNode:
    """Node that passes scans and commands to a CollisionMonitor and publishes its verdicts.

    Args:
        settings: Settings of the monitor.
        robot: Description of the robot, with its topics and frames.
        prefix: Prefix of the robot's frames.
        more_scans: Topics of further lasers.
        escape: Whether to make escape motions, for a move_base that makes none itself.
    """

    def __init__(
        self,
        settings: MonitorSettings,
        robot: Robot,
        prefix: str,
        more_scans: List[str],
        escape: bool,
    ):
        self.monitor = CollisionMonitor(settings, more_scans)
        self._lock = threading.Lock()
        self._clock = RosClock()
        self._verdict = Verdict.stop((0.0, 0.0), "no command has arrived yet")
        # ROS time of the latest command; 0 if there is none since the start or a clock jump.
        self._commanded = rospy.Time(0)
        # time.monotonic() of the latest command, and of the next zero.
        self._commanded_wall = 0.0
        self._zero_due = 0.0
        self._zeros = 0  # number of zeros sent since the base came to rest without a command

        # Escape motions are for the C++ move_base. This package's planner makes its own.
        actions = [PASS, BRAKE, SLOW, STOP]
        self._planner: Optional[MoveBaseProgress] = None
        self._stalled_planner: Optional[StalledPlanner] = None
        if escape:
            actions.append(ESCAPE)
            self._planner = MoveBaseProgress()
            tolerance = robot.all_parameters()[robot.local_planner]["xy_goal_tolerance"]
            self._stalled_planner = StalledPlanner(tolerance)
        self._reports = MonitorReports(actions)

        self._scan_topic = robot.topics.scan
        self._more_scans = more_scans
        odometry_frame = prefix + robot.frames.odom
        self.sensors = Sensors.of_lasers(robot, prefix, odometry_frame, more_scans)
        self._broadcaster = FrameBroadcaster(odometry_frame, prefix + robot.frames.matched)
        topic = command_topic(robot.topics.cmd_vel)
        self._commands = BaseCommands(topic, latch=True)
        self._action = rospy.Publisher("~action", String, queue_size=5, latch=True)
        self._held = rospy.Publisher("~held_back", Bool, queue_size=1, latch=True)
        self._diagnostics = rospy.Publisher("/diagnostics", DiagnosticArray, queue_size=1)

        # A monitor that died may have left the base in motion. Commands are taken only after the
        # kernels have been compiled, which may take a minute.
        self._commands.publish(conversions.twist(0.0, 0.0))
        warm_up(settings)
        rospy.Subscriber(
            "cmd_vel_in", TwistMessage, self._take_command, queue_size=1, tcp_nodelay=True
        )

    def spin(self) -> None:
        """Run until shutdown.

        Process scans, publish zeros while commands are missing, and report once per second.
        """
        report_due = time.monotonic()
        heartbeat = Heartbeat(self._commands.resolved_name)
        while not rospy.is_shutdown():
            with self._lock:
                try:
                    self._take_scans()
                    self._broadcaster.broadcast(self._clock.now, self.monitor.matcher.correction)
                    self._break_silence()
                except Exception as problem:
                    self._fail(problem)
            # Without heartbeats the guard process takes over, and publishes zeros itself.
            guard_lives = heartbeat.beat()
            if not guard_lives:
                rospy.signal_shutdown("the guard process has ended")
            if time.monotonic() >= report_due:
                report_due = time.monotonic() + REPORT_S
                self._report()
            time.sleep(LOOK_S)

    def _take_scans(self) -> None:
        """Pass the new scans to the monitor, which starts anew if the clock jumped back."""
        if self._clock.went_back():
            rospy.logwarn("collision monitor: the clock jumped back; starting anew")
            self.sensors.forget()
            self.monitor.reset()
            self._broadcaster.forget()
            self._commanded = rospy.Time(0)
            if self._planner is not None:
                self._planner.forget()
        for topic, scan in self.sensors.observations().items():
            # The monitor knows the topic of the robot's first laser as "".
            self.monitor.add_scan(scan, "" if topic == self._scan_topic else topic)
            for stray in self.monitor.strays:
                assert stray.frame is not None
                publisher = self.sensors.publisher_of(topic, stray.frame)
                resolved_topic = rospy.resolve_name(topic)
                now = time.monotonic()
                line = self._reports.let_go(stray, publisher, resolved_topic, now)
                rospy.logerr(f"collision monitor: {line}")

    @property
    def _stalled(self) -> str:
        """Problem in one line if ROS time has stopped, otherwise ""."""
        return f"/clock has not moved for {STALLED_S:g} s" if self._clock.stands(STALLED_S) else ""

    def _break_silence(self) -> None:
        """Brake to zero while commands are missing.

        After RESTING_ZEROS zeros to a base at rest, nothing is published: another node, such as a
        joystick's, may then drive the base.
        """
        silence = self.monitor.silence
        # A wall clock may be set back a little.
        since_command = (self._clock.now - self._commanded).to_sec()
        if 0.0 <= since_command <= silence and not self._stalled:
            return
        if time.monotonic() < self._zero_due:
            return
        self._zero_due = time.monotonic() + ZEROS_S
        # A silent move_base may be stuck. An escape motion then takes the place of the zero.
        if self._drive((0.0, 0.0), only_escapes=True):
            return
        if self._zeros < RESTING_ZEROS:
            self._zeros = self._zeros + 1 if self._is_at_rest() else 0
            self._commands.publish(conversions.twist(*self._braked()))
        reason = self._stalled or f"no command for {silence:.2g} s"
        self._report_verdict(Verdict.stop((0.0, 0.0), reason))

    def _is_at_rest(self) -> bool:
        """Return whether fresh odometry says that the base stands still."""
        v, w = self.sensors.twist
        timeout = self.monitor.settings.scan_timeout
        if self.sensors.odometry_trouble(self._clock.now, timeout):
            return False
        return HANDED_OVER.holds(v, w)

    def _braked(self) -> Twist:
        """Return the (v, w) of a braking base, or zeros if ROS time has stopped."""
        # Without time, the monitor's ramp would not end.
        if self._stalled:
            return (0.0, 0.0)
        return self.monitor.braked(self._clock.now.to_sec(), self.sensors.twist[0])

    def _report_verdict(self, verdict: Verdict) -> None:
        """Publish action and reason of a verdict if they have changed."""
        if verdict.text != self._verdict.text:
            self._action.publish(verdict.text)
        self._verdict = verdict

    def _take_command(self, message: TwistMessage) -> None:
        """Judge a command of the planner at once, and send what may pass of it."""
        with self._lock, until_shutdown():
            if rospy.is_shutdown():
                return
            # The scans come first, so that the command is judged by the latest ones.
            try:
                self._take_scans()
                self._commanded = self._clock.now
                self._commanded_wall = time.monotonic()
                self._drive(twist_of(message))
            except Exception as problem:
                self._fail(problem)

    def _drive(self, command: Twist, only_escapes: bool = False) -> bool:
        """Filter and publish the planner's command, or an escape motion in its place.

        Args:
            command: (v [m/s], w [rad/s]) of the planner; zeros if it is silent.
            only_escapes: Whether to publish nothing unless an escape motion is due.

        Returns:
            Whether something was published.
        """
        motion = self._escape(command)
        if only_escapes and motion is None:
            return False
        self._zeros = 0
        verdict = judged(command, motion, self._judge, self._stalled_planner)
        if motion is not None:
            reason = "move_base makes no progress"
            if verdict.reason:
                reason += f"; {verdict.reason}"
            verdict = replace(verdict, action=ESCAPE, reason=reason)
        self._commands.publish(conversions.twist(*verdict.command))
        self._reports.counts[verdict.action] += 1
        # Always published: move_base resets its copy with each new goal.
        self._held.publish(verdict.blocked)
        self._report_verdict(verdict)
        return True

    def _escape(self, command: Twist) -> Optional[Twist]:
        """Return the escape motion (v, w) that replaces a command, or None.

        The first motion is logged.
        """
        stalled_planner = self._stalled_planner
        if stalled_planner is None or self._planner is None or self._stalled:
            return None
        had_stalled = stalled_planner.has_stalled
        progress = self._planner.progress(self._clock.now)
        motion = stalled_planner.escape_motion(self._clock.now.to_sec(), command, progress)
        if stalled_planner.has_stalled and not had_stalled:
            problem = "collision monitor: move_base makes no progress"
            rospy.logwarn("%s; trying small escape motions", problem)
        return motion

    def _fail(self, problem: Exception) -> None:
        """Stop the base and reset the monitor after an exception: its state is unreliable."""
        if rospy.core.is_shutdown_requested():
            raise problem
        self._commands.publish(conversions.twist(0.0, 0.0))
        rospy.logerr_throttle(1.0, f"collision monitor: {traceback.format_exc()}")
        # The frame must not jump for a planner that drives in it.
        correction = self.monitor.matcher.correction
        self.monitor.reset()
        self.monitor.matcher.correction = correction
        reason = f"the monitor failed: {problem!r}; please report it"
        self._report_verdict(Verdict.stop((0.0, 0.0), reason))

    def _judge(self, command: Twist, creeps: bool) -> Verdict:
        """Return the monitor's verdict on a command, a stop if an input is missing.

        creeps: whether the monitor may slow the command to a creep instead of blocking it.
        """
        now = rospy.get_rostime()
        pose: Any = self.sensors.pose(now, JUDGED_AGE_S)
        trouble = self.sensors.pose_trouble if pose is None else self._stalled
        trouble = trouble or self.sensors.odometry_trouble(now, self.monitor.settings.scan_timeout)
        if trouble:
            return Verdict.stop(self._braked(), trouble)

        # Static transforms and messages without stamps have no age.
        known_ages = self.sensors.ages(now)
        ages = (known_ages.get("pose_age_s", 0.0), known_ages.get("twist_age_s", 0.0))
        verdict = self.monitor.filter(now.to_sec(), pose, self.sensors.twist, command, ages, creeps)
        if verdict.action == STOP and "scan" in verdict.reason:
            topic = topic_named(verdict.reason, self._scan_topic, self._more_scans)
            latest = self.sensors.describe_latest(topic)
            return Verdict.stop(verdict.command, f"{verdict.reason} ({latest})")
        return verdict

    def _report(self) -> None:
        """Publish diagnostics."""
        verdict = self._verdict
        wall_now = time.monotonic()
        silence = wall_now - self._commanded_wall
        odometry_problem = self.sensors.odometry_problem
        has_problem, message = self._reports.status(verdict, silence, odometry_problem, wall_now)
        level = DiagnosticStatus.WARN if has_problem else DiagnosticStatus.OK
        now = rospy.get_rostime()
        values = {
            "action": verdict.action,
            "scale": f"{verdict.scale:.2f}",
            "matching": self.monitor.matcher.report,
            "remembered": len(self.monitor.memory.points),
            **self._reports.counts,
            **self.sensors.ages(now),
        }
        name = status_name("collision_monitor", "commands")
        self._diagnostics.publish(conversions.diagnostics(name, level, message, values, now))


def settings_from(parameters: Dict[str, Any], robot: Robot) -> MonitorSettings:
    """Return the robot's MonitorSettings, overridden by private parameters of the same names.

    Raises:
        ApplrError: A parameter is unknown or has an invalid value.
    """
    known_settings = {field.name for field in fields(MonitorSettings)} - OF_ROBOT
    other_parameters = {*NAMING, "more_scans", "escape"}
    unknown = ", ".join(sorted(set(parameters) - known_settings - other_parameters))
    if unknown:
        names = ", ".join(sorted(known_settings))
        raise ApplrError(f"unknown parameter {unknown}: give some of {names}")
    overrides = {name: parameters[name] for name in known_settings & set(parameters)}
    return replace(MonitorSettings.of(robot), **overrides)


def main() -> int:
    """Run the node.

    Raises:
        ApplrError: A parameter is invalid.
    """
    init_node("collision_monitor")
    parameters = rospy.get_param("~", {})
    robot, prefix = named_robot(parameters)
    more_scans = parameters.get("more_scans", list(robot.topics.more_scans))
    if not isinstance(more_scans, list):
        raise ApplrError(f"more_scans is {shown(more_scans)}: give a list of topics")
    if robot.topics.scan in more_scans:
        raise ApplrError(f"more_scans has {robot.topics.scan}, the first laser's topic: remove it")
    settings = settings_from(parameters, robot)
    escape = bool(parameters.get("escape", False))
    node = CollisionMonitorNode(settings, robot, prefix, more_scans, escape)
    with until_shutdown():
        node.spin()
    return 0


if __name__ == "__main__":
    run_script("applr_ros1.nodes.monitor.node", node=True)
