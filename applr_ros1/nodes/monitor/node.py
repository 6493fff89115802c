"""ROS node `collision_monitor`, between move_base (or any other source of velocity commands) and the base.

Started by guard.py. The node reads commands from cmd_vel_in and publishes them on cmd_vel as the CollisionMonitor
allows. If the next command is overdue, the node itself sends braking commands, and then zeros until the base has stood
still for a second. After an exception, the node stops the base and reports the exception on /diagnostics. With ~escape,
the node makes small escape motions while move_base is stuck or blocked although a goal is active.

Parameters: ~robot (jackal; name or folder of a description), ~tf_prefix, ~more_scans (topics of further lasers;
default: those of the description), ~escape (false), and the fields of monitor/settings.py except body.
"""

from __future__ import annotations

import re
import threading
import time
import traceback
from dataclasses import fields, replace
from typing import Any, Dict, List, Optional

import rospy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from geometry_msgs.msg import Twist
from std_msgs.msg import Bool, String

from applr_ros1.common.errors import ApplrError, run_script
from applr_ros1.common.ros_node import init_node, until_shutdown
from applr_ros1.monitor.monitor import PASS, STOP, CollisionMonitor, Verdict, warm_up
from applr_ros1.monitor.motion import Twist as Velocity
from applr_ros1.monitor.settings import MonitorSettings
from applr_ros1.monitor.stalled_planner import StalledPlanner
from applr_ros1.nodes import conversions
from applr_ros1.nodes.robot_parameters import NAMING, named_robot
from applr_ros1.nodes.sensors import Clock, Sensors
from applr_ros1.robots import Robot
from applr_ros1.stack.supervisor import Supervisor

from .guard import Heartbeat, publish_zeros
from .move_base_progress import MoveBaseProgress

LOOK_S = 0.01  # interval between polls for a new scan, in wall time [s]
REPORT_S = 1.0  # interval between diagnostics, in wall time [s]
IDLE_AFTER_S = 2.0  # wall time without a command after which the node counts as idle [s]
POSE_AGE_S = 0.3  # largest usable age of the base's pose in the odometry frame [s]
ZEROS_S = 0.05  # interval between the node's own commands while none arrives, in wall time [s]
LAST_ZEROS = 20  # number of zeros for a base at rest before other publishers may drive it
STALLED_S = 0.5  # wall time without a change of ROS time after which commands are stopped [s]
ESCAPE = "escape"  # action reported while the node drives an escape motion
STANDS_M_S, STANDS_RAD_S = (
    0.01,
    0.02,
)  # speed [m/s] and turn rate [rad/s] below which the base counts as at rest


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
        self._clock = Clock()
        self._verdict = Verdict((0.0, 0.0), STOP, 0.0, "no command has arrived yet")
        self._counts = dict.fromkeys(("pass", "slow", "stop") + (ESCAPE,) * escape, 0)
        self._commanded = rospy.Time(
            0
        )  # ROS time of the latest command; 0 for none since the start or a clock jump
        self._heard = self._zero_due = (
            0.0  # time.monotonic() of the latest command, and when the next zero is due
        )
        self._zeros = 0  # number of zeros sent since the base came to rest without a command
        near = robot.all_parameters()[robot.local_planner]["xy_goal_tolerance"]
        self._supervisor = Supervisor(StalledPlanner(near) if escape else None)
        self._planner = MoveBaseProgress() if escape else None
        topics = robot.topics
        self._scan, self._more_scans = topics.scan, more_scans
        self._frames: Dict[str, str] = {}  # frame of the first laser by topic
        self.sensors = Sensors.of_lasers(robot, prefix, prefix + robot.frames.odom, more_scans)
        self._out = rospy.Publisher(topics.cmd_vel, Twist, queue_size=1, latch=True)
        self._action = rospy.Publisher("~action", String, queue_size=5, latch=True)
        self._held = rospy.Publisher("~held_back", Bool, queue_size=1, latch=True)
        self._diagnostics = rospy.Publisher("/diagnostics", DiagnosticArray, queue_size=1)
        self._out.publish(
            conversions.twist(0.0, 0.0)
        )  # A monitor that died may have left the base in motion.
        warm_up(settings)
        self._in = rospy.Subscriber(
            "cmd_vel_in", Twist, self._take_command, queue_size=1, tcp_nodelay=True
        )

    def spin(self) -> None:
        """Process scans, publish zeros while commands are missing, and report once per second, until shutdown."""
        due, heartbeat = time.monotonic(), Heartbeat()
        while not rospy.is_shutdown():
            with self._lock:
                try:
                    self._take_scans()
                    self._break_silence()
                except Exception as problem:
                    self._fail(problem)
            if not heartbeat.beat():
                with self._lock:  # Held until rospy has shut down: no command may follow the zeros.
                    publish_zeros(self._out, LAST_ZEROS)
                    rospy.signal_shutdown("the guard process has ended")
            if time.monotonic() >= due:
                due = time.monotonic() + REPORT_S
                self._report()
            time.sleep(LOOK_S)

    def _take_scans(self) -> None:
        if self._clock.went_back():
            rospy.logwarn("collision monitor: the clock jumped back; starting anew")
            self.sensors.forget()
            self.monitor.reset()
            self._commanded = rospy.Time(0)
            if self._planner is not None:
                self._planner.forget()
        for topic, scan in self.sensors.observations().items():
            first = scan.frame == self._frames.setdefault(
                topic, scan.frame
            )  # Lasers may share a topic.
            name = "" if topic == self._scan else topic
            self.monitor.add_scan(scan, name if first else f"{topic} of {scan.frame}")

    @property
    def _stalled(self) -> str:
        """Problem in one line if ROS time has stopped, otherwise ""."""
        return f"/clock has not moved for {STALLED_S:g} s" if self._clock.stands(STALLED_S) else ""

    def _break_silence(self) -> None:
        """Brake to zero while commands are missing. After LAST_ZEROS zeros to a base at rest, stop publishing."""
        silence = self.monitor.silence
        if (self._clock.now - self._commanded).to_sec() <= silence and not self._stalled:
            return
        if time.monotonic() < self._zero_due:
            return
        self._zero_due = time.monotonic() + ZEROS_S
        if self._drive((0.0, 0.0), only_escapes=True):
            return
        if self._zeros < LAST_ZEROS:
            stands = all(
                abs(speed) < most
                for speed, most in zip(self.sensors.twist, (STANDS_M_S, STANDS_RAD_S))
            )
            stands &= not self.sensors.odometry_trouble(
                self._clock.now, self.monitor.settings.scan_timeout
            )
            self._zeros = self._zeros + 1 if stands else 0
            self._out.publish(conversions.twist(*self._braked()))
        self._report_verdict(
            Verdict((0.0, 0.0), STOP, 0.0, self._stalled or f"no command for {silence:.2g} s")
        )

    def _braked(self) -> Velocity:
        """Return the (v, w) of a braking base, or zeros if ROS time has stopped."""
        return (
            (0.0, 0.0)
            if self._stalled
            else self.monitor.braked(self._clock.now.to_sec(), self.sensors.twist[0])
        )

    def _report_verdict(self, verdict: Verdict) -> None:
        if (verdict.action, verdict.reason) != (self._verdict.action, self._verdict.reason):
            self._action.publish(verdict.action + (": " + verdict.reason if verdict.reason else ""))
        self._verdict = verdict

    def _take_command(self, message: Twist) -> None:
        with self._lock, until_shutdown():
            if rospy.is_shutdown():
                return
            try:
                self._take_scans()
                self._commanded, self._heard, self._zeros = self._clock.now, time.monotonic(), 0
                self._drive((message.linear.x, message.angular.z))
            except Exception as problem:
                self._fail(problem)

    def _drive(self, command: Velocity, only_escapes: bool = False) -> bool:
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
        verdict = self._supervisor.judged(command, motion, self._judge)
        if motion is not None:
            reason = "move_base makes no progress" + f"; {verdict.reason}" * bool(verdict.reason)
            verdict = replace(verdict, action=ESCAPE, reason=reason)
        self._out.publish(conversions.twist(*verdict.command))
        self._counts[verdict.action] += 1
        self._held.publish(
            verdict.blocked
        )  # Always published: move_base resets its copy with each new goal.
        self._report_verdict(verdict)
        return True

    def _escape(self, command: Velocity) -> Optional[Velocity]:
        """Return the escape motion (v, w) that replaces a command, or None. The first motion is logged."""
        escapes = self._supervisor.escapes
        if escapes is None or self._planner is None or self._stalled:
            return None
        had_stalled = escapes.has_stalled
        progress = self._planner.progress(self._clock.now)
        motion = self._supervisor.escape(self._clock.now.to_sec(), command, progress)
        if escapes.has_stalled and not had_stalled:
            rospy.logwarn(
                "collision monitor: move_base makes no progress; trying small escape motions"
            )
        return motion

    def _fail(self, problem: Exception) -> None:
        """Stop the base and reset the monitor after an exception, because its state is unreliable."""
        if rospy.core.is_shutdown_requested():
            raise problem
        self._out.publish(conversions.twist(0.0, 0.0))
        rospy.logerr_throttle(1.0, f"collision monitor: {traceback.format_exc()}")
        self.monitor.reset()
        self._report_verdict(
            Verdict((0.0, 0.0), STOP, 0.0, f"the monitor failed: {problem!r}; please report it")
        )

    def _judge(self, command: Velocity, creeps: bool) -> Verdict:
        now = rospy.get_rostime()
        pose: Any = self.sensors.pose(now, POSE_AGE_S)
        trouble = self.sensors.pose_trouble if pose is None else self._stalled
        trouble = trouble or self.sensors.odometry_trouble(now, self.monitor.settings.scan_timeout)
        if trouble:
            return Verdict(self._braked(), STOP, 0.0, trouble)
        known = self.sensors.ages(now)  # Static transforms and messages without stamps have no age.
        ages = known.get("pose_age_s", 0.0), known.get("twist_age_s", 0.0)
        verdict = self.monitor.filter(now.to_sec(), pose, self.sensors.twist, command, ages, creeps)
        if verdict.action == STOP and "scan" in verdict.reason:
            named = (
                topic
                for topic in self._more_scans
                if re.search(rf"(^|on ){re.escape(topic)}\b", verdict.reason)
            )
            topic = next(named, self._scan)
            return Verdict(
                verdict.command,
                STOP,
                0.0,
                f"{verdict.reason} ({self.sensors.describe_latest(topic)})",
            )
        return verdict

    def _report(self) -> None:
        verdict = self._verdict
        idle = time.monotonic() - self._heard > IDLE_AFTER_S
        fine = idle or verdict.action == PASS
        message = "idle: no commands" if idle else verdict.reason or "commands pass"
        values = {
            "action": verdict.action,
            "scale": f"{verdict.scale:.2f}",
            "remembered": len(self.monitor.memory.points),
        }
        values.update(self._counts, **self.sensors.ages(rospy.get_rostime()))
        name = (rospy.get_namespace() + "collision_monitor").lstrip("/") + ": commands"
        level = DiagnosticStatus.OK if fine else DiagnosticStatus.WARN
        self._diagnostics.publish(
            conversions.diagnostics(name, level, message, values, rospy.get_rostime())
        )


def settings_from(parameters: Dict[str, Any], robot: Robot) -> MonitorSettings:
    """Return the robot's MonitorSettings, overridden by the node's private parameters of the same names.

    Raises:
        ApplrError: A parameter is unknown or has an invalid value.
    """
    known = {field.name for field in fields(MonitorSettings)} - {"body"}
    others = {*NAMING, "more_scans", "escape"}
    unknown = ", ".join(sorted(set(parameters) - known - others))
    if unknown:
        raise ApplrError(f"unknown parameter {unknown}: give some of {', '.join(sorted(known))}")
    return replace(
        MonitorSettings.of(robot), **{name: parameters[name] for name in known & set(parameters)}
    )


def main() -> int:
    """Run the node. Raises ApplrError if a parameter is invalid."""
    init_node("collision_monitor")
    parameters = rospy.get_param("~", {})
    robot, prefix = named_robot(parameters)
    more = parameters.get("more_scans", list(robot.topics.more_scans))
    if not isinstance(more, list):
        raise ApplrError(f"more_scans is {more!r}: give a list of topics")
    if robot.topics.scan in more:
        raise ApplrError(f"more_scans has {robot.topics.scan}, the first laser's topic: remove it")
    escape = bool(parameters.get("escape", False))
    node = CollisionMonitorNode(settings_from(parameters, robot), robot, prefix, more, escape)
    with until_shutdown():
        node.spin()
    return 0


if __name__ == "__main__":
    run_script("applr_ros1.nodes.monitor.node", node=True)
