"""ROS node `move_base`, with the interface of the C++ move_base around planner.move_base.MoveBase.

Started as `rosrun applr_ros1 move_base.py`. One thread (control_loop.py) steps the planner and
publishes. Subscribers and services use the planner between two cycles, under ControlLoop.lock.
Parameters: ~robot (name or folder of a robot description), ~map and ~tf_prefix (options of this
robot), ~method (the method that will set the parameters, which may need farther obstacles than the
robot's files mark), ~matched (drive in the frame of the collision monitor's matched poses, unless
~map), and the parameters in docs/reference/parameters.md.
"""

from __future__ import annotations

import gc
import logging
import math
import sys
import threading
import time
import traceback
from contextlib import contextmanager
from functools import partial
from typing import Any, Callable, Iterator, List, Optional, Tuple

import numpy as np
import rospy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from geometry_msgs.msg import Polygon, PoseStamped
from map_msgs.msg import OccupancyGridUpdate
from move_base_msgs.msg import MoveBaseActionGoal, MoveBaseFeedback, RecoveryStatus
from nav_msgs.msg import OccupancyGrid, Path
from nav_msgs.srv import GetPlan, GetPlanResponse
from rospy.numpy_msg import numpy_msg
from std_msgs.msg import Bool, Header
from std_msgs.msg import Time as TimeMessage
from std_srvs.srv import Empty, EmptyResponse

from applr_ros1.common.angles import Pose, compose, within_speed
from applr_ros1.common.arrays import Array
from applr_ros1.common.errors import ApplrError
from applr_ros1.common.progress import announced
from applr_ros1.common.ros_node import command_topic, init_node, until_shutdown
from applr_ros1.nodes import conversions
from applr_ros1.nodes.base_commands import BaseCommands
from applr_ros1.nodes.conversions import MessageError
from applr_ros1.nodes.robot_parameters import STARTING, with_robot
from applr_ros1.nodes.sensors import Sensors
from applr_ros1.planner.move_base import INVALID_GOAL, MoveBase
from applr_ros1.planner.parameters.check import check, remarks
from applr_ros1.planner.parameters.declarations import LOCAL_PLANNERS
from applr_ros1.planner.parameters.layers import COSTMAPS, PREDICTED
from applr_ros1.planner.parameters.trees import Tree
from applr_ros1.planner.state_machine import NO_PLAN
from applr_ros1.planner.warm_up import warm_up
from applr_ros1.policy.parameter_space import SPACE, space_of
from applr_ros1.robots import Robot

from .control_loop import ControlLoop
from .displays import CostmapDisplay, PlanDisplay
from .frame_restart import FrameRestart
from .goal_server import GoalServer
from .heartbeat_watchdog import HeartbeatWatchdog, start_up_settings
from .reconfigure_server import ReconfigureServer
from .reports import MoveBaseReports, off_the_map

WENT_BACK = "Aborting because the clock jumped back."


class MoveBaseNode:
    """The node around a MoveBase.

    Args:
        tree: Tree of the private parameters, which have been checked.
        robot: Robot with the topic of the odometry and the learned parameters, None for the
            defaults.
    """

    def __init__(self, tree: Tree, robot: Optional[Robot] = None):
        self._space = SPACE
        odometry_topic = "odom"
        cmd_vel_topic = "cmd_vel"
        no_return = None
        matched_frame = ""
        odometry_frame = ""
        if robot is not None:
            matched_frame = robot.frames.matched
            odometry_frame = robot.frames.odom
            self._space = space_of(robot)
            odometry_topic = robot.topics.odometry
            cmd_vel_topic = robot.topics.cmd_vel
            no_return = robot.laser.no_return
        self.move_base = MoveBase(tree)
        parameters = self.move_base.parameters
        self.frame = parameters["global_costmap"]["global_frame"].lstrip("/")
        self.local_frame = parameters["local_costmap"]["global_frame"].lstrip("/")
        # The global frame may have the prefix of the robot's frames.
        prefix, slash, name = self.frame.rpartition("/")
        self._awaits_monitor = name == matched_frame
        self._odometry_frame = prefix + slash + odometry_frame
        self._frame_restart = FrameRestart()
        self.loop = ControlLoop(
            self.cycle,
            lambda: self.move_base.frequency,
            self._clock_went_back,
            self._clock_stalled,
            self._cycle_failed,
        )
        base_frame = parameters["global_costmap"]["robot_base_frame"]
        planner_values = tree.get(self.move_base.local_planner_name, {})
        self.sensors = Sensors(
            (self.local_frame, self.frame, base_frame),
            self.move_base.sources,
            self.move_base.ray_origins,
            planner_values.get("odom_topic", odometry_topic),
            no_return,
        )
        self.reports = MoveBaseReports(time.monotonic())
        self._max_speed = parameters["applr"]["max_speed"] or math.inf
        self.watchdog = HeartbeatWatchdog(parameters["applr"]["period"])
        self._command = BaseCommands(command_topic(cmd_vel_topic))
        self._diagnostics = rospy.Publisher("/diagnostics", DiagnosticArray, queue_size=10)
        self._current_goal = rospy.Publisher("~current_goal", PoseStamped, queue_size=1)
        self._recovery = rospy.Publisher("~recovery_status", RecoveryStatus, queue_size=10)
        self._goal_relay = rospy.Publisher("move_base/goal", MoveBaseActionGoal, queue_size=10)
        self.goals = GoalServer()
        self._plans = PlanDisplay(self.move_base)
        self._maps = {}
        for costmap_name in COSTMAPS:
            costmap_display = CostmapDisplay(costmap_name, self.move_base, self.loop.lock)
            self._maps[costmap_name] = costmap_display
        self.servers = {}
        for server_name in self.move_base.servers:
            server = ReconfigureServer(server_name, self.move_base, self.loop.lock)
            self.servers[server_name] = server
        # move_base.cpp sets these parameters, too, and other programs read them.
        for recovery in ("conservative_reset", "aggressive_reset"):
            reset_distance = parameters[recovery]["reset_distance"]
            rospy.set_param(f"~{recovery}/reset_distance", reset_distance)
        self._pose: Any = None  # latest pose (x, y, yaw) of the robot in the global frame

    def serve(self) -> None:
        """Accept goals and requests until the node is shut down."""
        rospy.Subscriber("collision_monitor/held_back", Bool, self._take_held)
        rospy.Subscriber("applr/heartbeat", TimeMessage, self._take_heartbeat)
        for costmap_name in COSTMAPS:
            take_footprint = partial(self._take_footprint, costmap_name)
            rospy.Subscriber(f"~{costmap_name}/footprint", Polygon, take_footprint)
        for map_topic, with_updates in self.move_base.map_topics.items():
            take_map = partial(self._take_map, map_topic)
            rospy.Subscriber(map_topic, numpy_msg(OccupancyGrid), take_map)
            if with_updates:
                take_update = partial(self._take_map_update, map_topic)
                update_type = numpy_msg(OccupancyGridUpdate)
                rospy.Subscriber(map_topic + "_updates", update_type, take_update)
        rospy.Subscriber("move_base_simple/goal", PoseStamped, self._relay_simple_goal)
        rospy.Service("~make_plan", GetPlan, self._ask(self._make_plan))
        rospy.Service("~NavfnROS/make_plan", GetPlan, self._ask(self._navfn_plan))
        rospy.Service("~clear_costmaps", Empty, self._ask(self._clear_costmaps))

        self.goals.start()
        rospy.loginfo(
            "move_base is ready: goals on %s, scans from %s",
            rospy.resolve_name("move_base/goal"),
            ", ".join(map(rospy.resolve_name, self.move_base.sources)) or "no topic",
        )
        with until_shutdown():
            self.loop.run()

    # -- one cycle ---------------------------------------------------------------------------------
    def cycle(self, stamp: rospy.Time) -> None:
        """Run one control cycle at ROS time `stamp`."""
        now = stamp.to_sec()
        move_base = self.move_base
        robot_pose, frame_pose = self._locate(stamp)
        # A goal that is taken after a restart of the monitor is already in its new frame.
        if self._awaits_monitor and robot_pose is not None:
            self._follow_monitor(stamp)
        self._take_goals(stamp, now)
        observations = self.sensors.observations()
        cycle = move_base.step(now, robot_pose, self.sensors.twist, observations, frame_pose)
        self._pose = None if robot_pose is None else move_base.in_global_frame(robot_pose)

        # The command leaves before anything is shown or logged.
        if cycle.command is not None:
            self._send(*cycle.command)
        if cycle.controlled and not self.reports.refusals:
            self.reports.refusals = move_base.local_planner.refusals(move_base.local_costmap)
        if cycle.result is not None:
            outcome, result_text = cycle.result
            reason = f": {result_text}" if result_text else ""
            rospy.loginfo("move_base: goal %s%s", outcome, reason)
            self._finish(outcome, result_text)
        if self.goals.is_active():
            self._report_standstill(robot_pose, cycle)
            if self._pose is not None:
                feedback = conversions.pose_stamped(self._pose, self.frame, stamp)
                self.goals.publish_feedback(MoveBaseFeedback(feedback))
        self._show(cycle, robot_pose, stamp)

        # A server takes its own lock before the loop's lock: in this thread they would deadlock.
        if self.watchdog.is_lost(now):
            threading.Thread(target=self._restore_start_up, daemon=True).start()
        self._report(stamp)

    def _locate(self, stamp: rospy.Time) -> Tuple[Optional[Pose], Optional[Pose]]:
        """Return the robot's pose in the local frame, and the local frame's pose in the global one.

        Both are None if one of them is unknown. The second pose is None if both frames are the
        same.
        """
        move_base = self.move_base
        sensors = self.sensors
        if move_base.missing_map:
            map_topic = rospy.resolve_name(move_base.missing_map)
            advice = "start map_server, or give static_map: false"
            sensors.pose_trouble = f"no map on {map_topic} yet: {advice}"
            return None, None
        local_tolerance = move_base.configuration("local_costmap")["transform_tolerance"]
        robot_pose = sensors.pose(stamp, local_tolerance)
        if robot_pose is None or self.frame == self.local_frame:
            return robot_pose, None
        global_tolerance = move_base.configuration("global_costmap")["transform_tolerance"]
        frame_pose = sensors.frame(stamp, global_tolerance)
        if frame_pose is None:
            return None, None
        return robot_pose, frame_pose

    def _follow_monitor(self, stamp: rospy.Time) -> None:
        """Transform the goal into the frame of a restarted monitor, and clear the costmaps.

        The C++ move_base keeps both, so that its goal and its maps are then off.
        """
        now = stamp.to_sec()
        odometry_pose = self.sensors.place_of(self._odometry_frame)
        if odometry_pose is None:
            return
        change = self._frame_restart.jump(now, odometry_pose)
        if change is None:
            return
        rospy.logwarn(
            "the collision monitor has started again: the goal moves with frame %s by %.2f m, and "
            "the costmaps are cleared",
            self.frame,
            math.hypot(*change[:2]),
        )
        self.move_base.clear_costmaps()
        if self.move_base.goal is not None:
            self._set_goal(compose(change, self.move_base.goal), stamp, now)

    def _set_goal(self, goal_pose: Pose, stamp: rospy.Time, now: float) -> None:
        """Pass a goal in the global frame to the planner, and publish it."""
        self.move_base.set_goal(goal_pose, now)
        self._current_goal.publish(conversions.pose_stamped(goal_pose, self.frame, stamp))

    def _take_goals(self, stamp: rospy.Time, now: float) -> None:
        """Pass a new goal, or the cancellation of the current goal, to the planner."""
        if self.goals.is_new_goal_available() and self._can_take_goals():
            requested_goal = self.goals.accept_new_goal().target_pose
            try:
                goal_pose = self._checked_goal(requested_goal)
                self._set_goal(goal_pose, stamp, now)
                self._warn_of_far_goal(goal_pose)
            except MessageError as problem:
                self.move_base.refuse_goal(str(problem))

        # A new goal also requests preemption. Accepting the new goal ends its predecessor.
        is_cancelled = self.goals.is_active() and self.goals.is_preempt_requested()
        if is_cancelled and not self.goals.is_new_goal_available():
            self.move_base.cancel()

    def _can_take_goals(self) -> bool:
        """Return whether a new goal can be taken now; it waits for the monitor's first transform.

        All nodes start together, and a goal may come before the monitor has begun. The C++
        move_base waits for tf before it takes goals, too.
        """
        sensors = self.sensors
        if not self._awaits_monitor or sensors.place_of(sensors.base) is not None:
            return True
        rospy.logwarn_throttle(
            5.0, f"a goal waits for frame {self.frame} of the collision monitor: start the monitor"
        )
        return False

    def _checked_goal(self, goal: PoseStamped) -> Pose:
        """Return a goal as pose in the global frame.

        Raises:
            MessageError: The goal is invalid, or tf does not know its frame.
        """
        if not conversions.is_upright(goal.pose.orientation):
            raise MessageError(INVALID_GOAL)
        goal_pose = self.sensors.to_global(goal)
        if not all(map(math.isfinite, goal_pose)):
            problem = f"its position {goal_pose[:2]} is not finite"
            raise MessageError(f"Aborting on goal because {problem}")
        return goal_pose

    def _warn_of_far_goal(self, goal_pose: Pose) -> None:
        # Without a pose, a costmap that rolls has not been placed yet.
        if self._pose is None:
            return
        warning = off_the_map(self.move_base.global_costmap, goal_pose)
        if warning:
            rospy.logwarn("move_base: %s", warning)

    def _finish(self, outcome: str, text: str) -> None:
        """End the current goal, if there is one, as "succeeded", "aborted" or "preempted"."""
        if self.goals.is_active():
            getattr(self.goals, f"set_{outcome}")(text=text)

    def _send(self, v: float, w: float) -> None:
        """Publish a command. This is the last guard of the limit, which the Pilot owns.

        Parameters that others set, or that the watchdog restores, may be faster (policy/pilot.py).
        """
        self._command.publish(conversions.twist(*within_speed((v, w), self._max_speed)))

    def _report_standstill(self, pose: Optional[Pose], cycle: Any) -> None:
        """Log why the robot stands although it has a goal, and publish a recovery that begins."""
        sensors = self.sensors
        if pose is None:
            rospy.logerr_throttle(1.0, f"standing still: {sensors.pose_trouble}")
        elif cycle.stale:
            scan_topic, seconds = cycle.silent
            problem = f"no usable scan on {rospy.resolve_name(scan_topic)} for {seconds:g} s"
            latest = sensors.describe_latest(scan_topic)
            rospy.logerr_throttle(1.0, f"standing still: {problem}: {latest}")
        else:
            sensors.clear_errors()
        if cycle.recovery is not None and pose is not None:
            index, recovery_count, recovery = cycle.recovery
            rospy.logwarn("recovery %d of %d: %s", index + 1, recovery_count, recovery)
            stamped_pose = conversions.pose_stamped(self._pose, self.frame, rospy.Time.now())
            self._recovery.publish(RecoveryStatus(stamped_pose, index, recovery_count, recovery))

    def _show(self, cycle: Any, pose: Any, stamp: rospy.Time) -> None:
        """Publish what a cycle has changed, for displays.

        pose: robot's pose in the local frame.
        """
        move_base = self.move_base
        if cycle.planned:
            self._plans.planned(move_base.global_plan if cycle.new_plan else NO_PLAN, stamp)
        if cycle.controlled:
            self._plans.controlled(move_base.local_planner, move_base.local_costmap, stamp)
        local_updated, global_updated = cycle.updated
        if local_updated:
            self._maps["local_costmap"].updated(stamp, pose)
        if global_updated:
            self._maps["global_costmap"].updated(stamp, self._pose)

    def _restore_start_up(self) -> None:
        """Restore the start-up values of the parameters that a dead applr node has set."""
        for server, values in start_up_settings(self.move_base, self._space).items():
            self.servers[server].update_configuration(values)
        problem = f"no heartbeat of the applr node for {self.watchdog.patience:g} s"
        rospy.logwarn("%s: planner parameters are reverted to their start-up values", problem)

    def _report(self, stamp: rospy.Time) -> None:
        """Report missed cycles, inputs, and refusals by critics, once per second."""
        now = time.monotonic()
        if not self.reports.is_due(now):
            return
        sensors = self.sensors
        # The node movers makes this topic of the scans.
        silent_topics = sensors.silent_topics(besides=PREDICTED)
        pose_trouble = sensors.pose_trouble if self._pose is None else ""
        missing = self.reports.missing_inputs(now, silent_topics, pose_trouble)
        if missing:
            rospy.logwarn("move_base: check drivers and names of topics: %s", missing)
        skipped = self.loop.missed
        self.loop.missed = 0
        statuses = self.reports.statuses(
            sensors.ages(stamp), sensors.odometry_problem, skipped, self.move_base.frequency
        )
        _, _, loop_status = statuses
        if loop_status.problem:
            rospy.logwarn(loop_status.problem)
        node_name = rospy.get_name().lstrip("/")
        for subject, problem, values in statuses:
            level = DiagnosticStatus.WARN if problem else DiagnosticStatus.OK
            status_name = f"{node_name}: {subject}"
            message = conversions.diagnostics(status_name, level, problem, values, stamp)
            self._diagnostics.publish(message)

    # -- requests ----------------------------------------------------------------------------------
    def _ask(self, work: Callable[[Any], Any]) -> Callable[[Any], Any]:
        """Return a service callback that calls `work` between two cycles."""

        def call(request: Any) -> Any:
            try:
                with self.loop.lock:
                    return work(request)
            except ApplrError as problem:
                raise rospy.ServiceException(str(problem)) from None

        return call

    def _take_heartbeat(self, _: TimeMessage) -> None:
        self.watchdog.heartbeat(rospy.get_time())

    def _relay_simple_goal(self, message: PoseStamped) -> None:
        """Send a goal of a display to the node's own action server, as move_base.cpp does."""
        action_goal = MoveBaseActionGoal()
        action_goal.header.stamp = rospy.Time.now()
        action_goal.goal.target_pose = message
        self._goal_relay.publish(action_goal)

    def _take_held(self, message: Bool) -> None:
        with self.loop.lock:
            self.move_base.report_held(message.data)

    def _take_footprint(self, name: str, message: Polygon) -> None:
        with self.loop.lock, _refusals_of(f"{name}/footprint"):
            self.move_base.set_footprint(name, [(vertex.x, vertex.y) for vertex in message.points])

    def _take_map(self, topic: str, message: OccupancyGrid) -> None:
        with _refusals_of(topic):
            # The conversion of a large map takes longer than a cycle: it does not hold the lock.
            static_map = conversions.static_map(message)
            with self.loop.lock:
                self.move_base.set_map(static_map, topic)
            info = message.info
            map_size = f"{info.width} x {info.height} cells of {info.resolution:g} m"
            rospy.loginfo("%s: a map of %s", topic, map_size)

    def _take_map_update(self, topic: str, message: OccupancyGridUpdate) -> None:
        with self.loop.lock, _refusals_of(topic + "_updates"):
            cells = np.reshape(message.data, (message.height, message.width))
            self.move_base.update_map(topic, message.x, message.y, cells)

    def _make_plan(self, request: Any) -> GetPlanResponse:
        """Handle the service ~make_plan (MoveBase::planService)."""
        if self.goals.is_active() or self.move_base.goal is not None:
            problem = "move_base must be in an inactive state to make a plan for an external user"
            raise MessageError(problem)
        # A start without frame means the robot's pose.
        start_pose = self._pose
        if request.start.header.frame_id:
            start_pose = self.sensors.to_global(request.start)
        if start_pose is None:
            reason = self.sensors.pose_trouble or "no robot pose"
            raise MessageError(f"move_base cannot make a plan: {reason}")
        goal_pose = self.sensors.to_global(request.goal)
        plan = self.move_base.make_plan(start_pose, goal_pose, request.tolerance)
        return GetPlanResponse(Path(poses=self._poses(plan)))  # C++ leaves the header empty.

    def _navfn_plan(self, request: Any) -> GetPlanResponse:
        """Handle the service ~NavfnROS/make_plan, whose answer to an invalid request is empty."""
        plan = NO_PLAN
        try:
            start_pose = self.sensors.to_global(request.start)
            goal_pose = self.sensors.to_global(request.goal)
            if all(map(math.isfinite, start_pose + goal_pose)):
                plan = self.move_base.plan(start_pose, goal_pose)
        except MessageError as problem:
            rospy.logerr("NavfnROS/make_plan: %s", problem)
        header = Header(0, rospy.Time.now(), self.frame)
        return GetPlanResponse(Path(header, self._poses(plan)))

    def _poses(self, plan: Array) -> List[PoseStamped]:
        stamp = rospy.Time.now()
        return [conversions.pose_stamped(pose, self.frame, stamp) for pose in plan.tolist()]

    def _clear_costmaps(self, request: Any) -> EmptyResponse:
        self.move_base.clear_costmaps()
        return EmptyResponse()

    # -- clock, errors and shutdown ----------------------------------------------------------------
    def _clock_went_back(self) -> None:
        rospy.logwarn("the clock jumped back: maps, plan and goal are dropped")
        self._send(0.0, 0.0)
        self.sensors.forget()
        self._frame_restart.forget()
        self._finish("aborted", WENT_BACK)
        self.goals.forget_stamps()
        self.move_base.reset(rospy.get_time(), restore=False)

    def _clock_stalled(self) -> None:
        if self.goals.is_active():
            problem = "/clock has not moved for a second"
            rospy.loginfo("standing still: %s; the simulation is paused or has ended", problem)
            self._send(0.0, 0.0)

    def _cycle_failed(self, error: Exception) -> None:
        """Stop after an internal error, log it and abort the goal.

        The node keeps running for the next goal.
        """
        if rospy.is_shutdown():
            return
        self._send(0.0, 0.0)
        traceback_lines = traceback.format_exception(type(error), error, error.__traceback__)
        rospy.logerr("a cycle failed: %s", "".join(traceback_lines))
        abort_message = f"Aborting because of an internal error: {type(error).__name__}: {error}"
        self._finish("aborted", abort_message.replace("\n", " "))
        self.move_base.reset(rospy.get_time(), restore=False)


@contextmanager
def _refusals_of(topic: str) -> Iterator[None]:
    """Log a ValueError of the block in one line, and ignore the message on `topic`."""
    try:
        yield
    except ValueError as problem:
        rospy.logerr("message on %s ignored: %s", topic, problem)


def _is_not_of_footprint(record: logging.LogRecord) -> bool:
    """Filter out rospy's warning that ~*_costmap/footprint has two types.

    The C++ move_base uses the same name for a publisher and a subscriber, so this node must, too.
    """
    log_message = record.getMessage()
    footprint_words = ("inbound connection", "Polygon", repr(rospy.get_name()))
    return not all(word in log_message for word in footprint_words)


def main() -> int:
    """Run the node.

    Return exit status 1 if parameters are invalid, after a line for each problem.
    """
    init_node("move_base")
    parameters = rospy.get_param("~", {})
    tree, robot = with_robot(parameters)
    problems = check(tree)
    for problem in problems:
        print(f"move_base: parameter {problem}", file=sys.stderr)
    if problems:
        return 1
    for logger_name in ("rosout", "rospy.internal"):
        logging.getLogger(logger_name).addFilter(_is_not_of_footprint)
    for remark in remarks(tree):
        rospy.logwarn("parameter %s", remark)
    activity = "loading the planner's kernels (a minute or two if they have to be compiled)"
    with announced(activity, rospy.loginfo):
        warm_up(tree.get("base_local_planner", LOCAL_PLANNERS[0]))
    # Other programs, such as rqt and the applr node, read the parameters of the robot's files here.
    if robot is not None:
        naming = {name: parameters[name] for name in STARTING if name in parameters}
        rospy.set_param("~", {**tree, **naming})
    node = MoveBaseNode(tree, robot)

    # Another thread may keep Python's interpreter lock for this long [s], instead of 5 ms. A
    # garbage collection of the permanent objects would delay a cycle by 100 ms.
    sys.setswitchinterval(1e-3)
    gc.collect()
    gc.freeze()
    node.serve()
    return 0
