"""Stack: everything between the sensors and the base of one robot, in one process and without ROS.

One step is one control cycle: moving obstacles are predicted from the scan, the planner plans and
commands, an escape motion may replace the command, and the collision monitor limits it. On the
robot each part is a node of its own.
"""

from typing import Mapping, NamedTuple, Optional, Sequence, Union

import numpy as np

from applr_ros1.common.angles import Pose, Twist, compose
from applr_ros1.common.arrays import Array
from applr_ros1.common.scan import LaserScan, moved
from applr_ros1.common.times import TIME_TOLERANCE_S
from applr_ros1.monitor.monitor import CollisionMonitor, Verdict
from applr_ros1.monitor.settings import MonitorSettings
from applr_ros1.movers.prediction import Prediction
from applr_ros1.movers.tracker import MoverTracker
from applr_ros1.planner.move_base import MoveBase
from applr_ros1.planner.observation_router import Sensed
from applr_ros1.planner.parameters.layers import PREDICTED
from applr_ros1.planner.state_machine import NO_PLAN, Cycle
from applr_ros1.planner.variant import CPP_LIKE
from applr_ros1.robots import Robot
from applr_ros1.stack.command_chain import Progress, StalledPlanner, across, judged

STANDING: Twist = (0.0, 0.0)


class Step(NamedTuple):
    """Result of one control cycle.

    Attributes:
        cycle: Cycle of the planner.
        verdict: Verdict of the monitor; None without a monitor, or without a command or escape
            motion.
        command: (v [m/s], w [rad/s]) for the base; None if it keeps the last one.
    """

    cycle: Cycle
    verdict: Optional[Verdict]
    command: Optional[Twist]


class Stack:
    """Planner, collision monitor, moving obstacles and escape motions of one robot.

    Args:
        robot: Description of the robot.
        move_base: Planner. With its parameter applr/movers, the costmaps receive predicted obstacle
            points. Its costmaps may be in the frame of the monitor's matched poses.
        monitor: Whether the robot's collision monitor stands between the planner and the base.
        escapes: Whether the monitor makes the escape motions that a planner of fidelity cpp-like
            lacks.
    """

    def __init__(self, robot: Robot, move_base: MoveBase, *, monitor: bool, escapes: bool = True):
        self.move_base = move_base
        self.monitor: Optional[CollisionMonitor] = None
        tracker = MoverTracker.of(robot)
        if monitor:
            self.monitor = CollisionMonitor(MonitorSettings.of(robot))
            tracker = self.monitor.lasers.first.tracker
        self.prediction: Optional[Prediction] = None
        if move_base.parameters["applr"]["movers"]:
            self.prediction = Prediction(robot, tracker)
        self.escapes = escapes
        self._matched_frame = robot.frames.matched
        # Detector for a planner that makes no escape motions itself
        self._stalled_planner: Optional[StalledPlanner] = None
        self._progress = Progress()  # the planner's latest plan
        self._command_time: Optional[float] = None  # time of its latest command [s]

    def reset(self, now: float, seed: Union[int, Sequence[int]]) -> None:
        """Forget goal, maps and obstacles at time `now` [s], and restore the parameters."""
        self.move_base.reset(now, seed=seed)
        if self.monitor is not None:
            self.monitor.reset()
        if self.prediction is not None:
            self.prediction.reset()
        self._stalled_planner = None
        self._progress = Progress()
        self._command_time = None

    def set_goal(self, goal: Pose, now: float) -> None:
        """Send a goal (x, y, yaw) in the frame of the global costmap at time `now` [s]."""
        self.move_base.set_goal(goal, now)
        # A detector of an earlier goal would remember how long that one was not approached.
        if self.escapes and self.move_base.variant == CPP_LIKE:
            self._stalled_planner = StalledPlanner(self.move_base.goal_tolerance)

    @property
    def goal_tolerance(self) -> float:
        """Distance to the goal within which the planner counts it as reached [m]."""
        return self.move_base.goal_tolerance

    @property
    def correction(self) -> Optional[Pose]:
        """Pose of the odometry frame in that of the monitor's matched poses.

        None without a monitor, or if the costmaps are in another frame.
        """
        if self.monitor is None or self.move_base.global_frame != self._matched_frame:
            return None
        return self.monitor.matcher.correction

    @property
    def movers(self) -> Array:
        """Tracked moving obstacles (n, 4): x, y [m], vx, vy [m/s] in the odometry frame."""
        if self.prediction is None:
            return np.zeros((0, 4))
        tracked = self.prediction.movers
        return np.column_stack([tracked.x, tracked.y, tracked.vx, tracked.vy])

    def step(
        self,
        now: float,
        pose: Pose,
        twist: Twist,
        scan: Optional[LaserScan] = None,
        local_origin: Optional[Pose] = None,
    ) -> Step:
        """Run one control cycle.

        Args:
            now: Time [s].
            pose: Pose (x, y, yaw) of the robot in the odometry frame.
            twist: Measured velocity (v [m/s], w [rad/s]).
            scan: Scan since the last step, if there is one.
            local_origin: Pose of the odometry frame in the frame of the global costmap; None if
            they are the same.
        """
        planner_pose = pose
        # As on the robot, this scan is matched for the next cycle.
        correction = self.correction
        # The monitor takes every scan, also while the planner commands nothing.
        monitor = self.monitor
        if monitor is not None and scan is not None:
            monitor.add_scan(scan)
        sensed = self._sensed(scan)
        if correction is not None:
            planner_pose = compose(correction, pose)
            sensed = _moved(sensed, correction)
        cycle = self.move_base.step(now, planner_pose, twist, sensed, local_origin)
        if cycle.planned:
            # If planning fails, move_base publishes an empty plan.
            plan = self.move_base.global_plan if cycle.new_plan else NO_PLAN
            self._progress = Progress(plan_time=now, distance=across(plan))
        if monitor is None:
            return Step(cycle, None, cycle.command)
        if cycle.command is None:
            return self._break_silence(monitor, now, pose, twist, cycle)
        self._command_time = now
        motion = self._escape_motion(now, cycle.command)
        verdict = self._judged(monitor, now, pose, twist, cycle.command, motion)
        return Step(cycle, verdict, verdict.command)

    def _break_silence(
        self, monitor: CollisionMonitor, now: float, pose: Pose, twist: Twist, cycle: Cycle
    ) -> Step:
        """Return the step of a cycle in which the planner commands nothing.

        move_base is silent while it looks for a plan. As on the robot (nodes/monitor/node.py), the
        monitor then drives an escape motion, or brakes a base that would keep its last command.
        """
        if self._command_time is None:
            return Step(cycle, None, None)
        silent_time = now - self._command_time + TIME_TOLERANCE_S
        if silent_time < monitor.silence:
            return Step(cycle, None, None)
        motion = self._escape_motion(now, STANDING)
        if motion is not None:
            verdict = self._judged(monitor, now, pose, twist, STANDING, motion)
            return Step(cycle, verdict, verdict.command)
        v, _ = twist
        return Step(cycle, None, monitor.braked(now, v))

    def _sensed(self, scan: Optional[LaserScan]) -> Optional[Sensed]:
        """Return what the costmaps get: the scan, and predicted points of moving obstacles.

        Both are in the odometry frame, in which velocities are measured best.
        """
        if scan is None or self.prediction is None:
            return scan
        # The simulated robot has one laser, whose source comes first.
        scan_topic = next(iter(self.move_base.sources))
        return {scan_topic: scan, PREDICTED: self.prediction.add_scan(scan)}

    def _judged(
        self,
        monitor: CollisionMonitor,
        now: float,
        pose: Pose,
        twist: Twist,
        command: Twist,
        motion: Optional[Twist],
    ) -> Verdict:
        """Return the verdict on a command, or on the escape motion that replaces it."""

        def judge(judged_command: Twist, may_creep: bool) -> Verdict:
            return monitor.filter(now, pose, twist, judged_command, creeps=may_creep)

        verdict = judged(command, motion, judge, self._stalled_planner)
        # A planner that makes its own escape motions must know that it is blocked.
        if self._stalled_planner is None:
            self.move_base.report_held(verdict.blocked)
        return verdict

    def _escape_motion(self, now: float, command: Twist) -> Optional[Twist]:
        """Return the escape motion (v, w) that replaces a command, or None to keep the command."""
        if self._stalled_planner is None:
            return None
        progress = self._progress._replace(goal=self.move_base.goal)
        return self._stalled_planner.escape_motion(now, command, progress)


def _moved(sensed: Optional[Sensed], frame: Pose) -> Optional[Sensed]:
    """Transform what the costmaps get from the frame at the pose `frame` to its parent frame."""
    if sensed is None:
        return None
    if not isinstance(sensed, Mapping):
        return moved(sensed, frame)
    return {topic: moved(observation, frame) for topic, observation in sensed.items()}
