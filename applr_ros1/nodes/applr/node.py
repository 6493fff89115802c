"""The applr node: observation → method → parameters, every period (Algorithm 1 of the paper).

Started by main.py, beside any move_base with TrajectoryPlannerROS or DWAPlannerROS. The node
decides while a goal is active. Between goals the planner has its default parameters theta_0, so
that every course starts with theta_0. docs/reference/topics.md lists the node's topics.
"""

from __future__ import annotations

import math
import threading
from collections import Counter
from contextlib import suppress
from typing import Any, Dict, Optional, Tuple

import numpy as np
import rospy

from applr_ros1.common.errors import ApplrError, one_line, reason, shown
from applr_ros1.nodes.applr.costmaps import Costmaps
from applr_ros1.nodes.applr.inputs import RobotInputs, Snapshot
from applr_ros1.nodes.applr.meter_scoring import AUTO, MeterScoring
from applr_ros1.nodes.applr.reconfigure_client import RESTORE_S, ReconfigureClient, Server
from applr_ros1.nodes.applr.topics import ApplrTopics
from applr_ros1.nodes.sensors import Clock
from applr_ros1.planner.parameters.obstacle_range import mismatch
from applr_ros1.policy.decision import PERIOD, Context, Method
from applr_ros1.policy.layout import ObservationError
from applr_ros1.policy.pilot import LOST_PERIODS, METHOD, Pilot
from applr_ros1.robots import JACKAL, Robot

TICK_S = 0.05  # interval between two readings of the clock, in ROS time [s]
REPORT_S = 1.0  # interval between diagnostics, in ROS time [s]
LATE_SHARE = 0.1  # delay above which a decision counts as late, as a share of the period
GONE = "move_base has stopped publishing its status: check that it is running"
# Counters in /diagnostics
COUNTS = ("decisions", "late", "refused", "unusable", "applied", "failed", "restarts")
DEFAULTS = "the robot's default parameters"
BY_HAND = "the parameters set by hand"


class ApplrNode:
    """The node: connects inputs, method and client.

    Args:
        method: Method that chooses the parameters (policy/methods.py).
        inputs: Scan, odometry, plan and goal (inputs.RobotInputs).
        topics: Publishers (topics.ApplrTopics).
        period: ROS time between decisions [s], None for the method's period.
        namespace: Namespace of move_base.
        max_speed: Upper limit of the top speed [m/s] for every method and for the defaults.
        seed: Seed of the random numbers in the first course, of the method and in a stall; further
            courses use seed + 1, seed + 2 ...
        meter_scoring: Whether the planner's distance biases count per metre
            (meter_scoring.CHOICES).
        robot: Description of the robot.
    """

    def __init__(
        self,
        method: Method,
        inputs: RobotInputs,
        topics: ApplrTopics,
        period: Optional[float] = None,
        namespace: str = "/move_base",
        max_speed: float = math.inf,
        seed: int = 0,
        meter_scoring: str = AUTO,
        robot: Robot = JACKAL,
    ):
        self.robot = robot
        self.pilot = Pilot(method, robot, period, max_speed)
        self.inputs = inputs
        self.topics = topics
        self.seed = seed
        self.enabled = True
        # Parameters (n,) set by hand while the method is off
        self._by_hand: Optional[np.ndarray] = None
        self.counts: Dict[str, int] = Counter()
        self.trouble = ""  # latest problem in one line, or ""
        self.degraded = ""  # reason why the requested method is not in use, or ""
        self._goal: Any = None  # id of the present goal
        self._due: Any = None  # ROS time of the next decision
        self._began: Any = None  # ROS time of the start of the course
        self._last: Any = None  # ROS time of the last decision
        self._costmaps = Costmaps(namespace)
        self._has_cleared = False  # whether the last decision cleared the costmaps
        self._is_redrawn = False  # whether the last decision was that of the stall rule
        self._base_set = False  # whether the parameters for the time between goals have been sent
        # Lasers with another range than the method's, in one line; None if it is to be checked
        self._range_line: Optional[str] = None
        self._deciding = threading.Lock()  # guards method, enabled and the state of the course
        self.client = ReconfigureClient(
            namespace, self.pilot.space, self._on_restart, self._on_report, self._note_trouble
        )
        self.client.per_cell = method.per_cell
        self.meter_scoring = MeterScoring(self.client, meter_scoring)

    @property
    def method(self) -> Method:
        """Method in use."""
        return self.pilot.method

    def _begin_course(self, now: rospy.Time) -> None:
        """Reset the method for a new goal. Its first decision is due at once."""
        try:
            self.pilot.begin(self.seed + self.counts["courses"])
        except Exception as problem:  # A method may be user code, as in _choose.
            self._note_trouble(one_line(problem))
        self.counts["courses"] += 1
        self._due = self._began = now

    def spin(self) -> None:
        """Run until shutdown. If the clock jumps back, start anew."""
        self.client.start()
        rospy.on_shutdown(self.shutdown)
        beat_due = report_due = rospy.Time(0)
        clock = Clock()
        while not rospy.is_shutdown():
            try:
                if clock.went_back():
                    self._clock_jumped()
                    beat_due = report_due = rospy.Time(0)
                now = clock.now
                # move_base expects a beat every 2 s, however long the period is.
                if now >= beat_due:
                    self.topics.heartbeat(now)
                    beat_due = now + rospy.Duration(min(self.pilot.period, PERIOD))
                if now >= report_due:
                    self._report(now)
                    report_due = now + rospy.Duration(REPORT_S)
                with self._deciding:
                    self._tick(now)
                rospy.sleep(self._pause(now))
            except rospy.exceptions.ROSTimeMovedBackwardsException:
                continue
            except rospy.exceptions.ROSInterruptException:
                return

    def _pause(self, now: rospy.Time) -> float:
        """Return the time until the next tick [s].

        The last tick before a decision is shorter, so that the decision is on time.
        """
        if self._due is not None:
            seconds_left: float = (self._due - now).to_sec()
            if 0.001 < seconds_left < TICK_S:
                return seconds_left
        return TICK_S

    def _clock_jumped(self) -> None:
        """Drop all inputs and the course, and request theta_0."""
        rospy.logwarn("applr: the clock jumped back; starting anew with theta_0")
        self.inputs.clear()
        with self._deciding:
            self._goal = self._due = self._last = None
            self._base()

    def switch(self, enabled: bool) -> None:
        """Switch the method on or off.

        When it is off, the planner has theta_0 and no decisions are made.
        """
        with self._deciding:
            if enabled != self.enabled:
                rospy.loginfo("applr: switched %s", "on" if enabled else f"off: back to {DEFAULTS}")
            self.enabled = bool(enabled)
            self._base_set = False
            self._by_hand = None

    @property
    def in_force(self) -> str:
        """Whose parameters the planner drives with now, or will as soon as its servers answer."""
        if self._by_hand is not None:
            return BY_HAND
        decides = self._last is not None and not self.pilot.has_lost_method
        if self.enabled and (self.method.static or decides):
            return f"the parameters of method {self.method.name}"
        return DEFAULTS

    def set_by_hand(self, values: Dict[str, float]) -> None:
        """Switch the method off and set {name: value}, clipped to the ranges.

        Other parameters stay as they are.

        Raises ApplrError without changing anything if a name is unknown, if a value is not finite,
        or if the planner's present parameters are not known yet.
        """
        with self._deciding:
            # Two changes may follow each other faster than the servers answer.
            theta = self._by_hand
            if theta is None:
                theta = self.client.theta()
            if theta is None:
                raise ApplrError("the planner's parameters are not known yet")
            space = self.pilot.space
            unknown = sorted(set(values) - set(space.names))
            if unknown:
                advice = f"use {', '.join(space.names)}"
                raise ApplrError(f"unknown parameter {shown(unknown[0])}: {advice}")
            changed = {**space.as_dict(theta), **values}
            self._by_hand = self.pilot.limited(list(changed.values()))
            self.client.request(self._by_hand)
            if self.enabled:
                rospy.loginfo("applr: switched off: parameters are set by hand")
            self.enabled = False

    def change_method(self, method: Method) -> None:
        """Replace the method. In the middle of a course, the new method decides at once."""
        with self._deciding:
            self.pilot.method = method
            self.degraded = ""
            self._range_line = None
            self.client.per_cell = method.per_cell
            if self._goal is None or method.static:
                self._base_set = False
            else:
                self._begin_course(rospy.Time.now())

    def _tick(self, now: rospy.Time) -> None:
        """Begin and end courses, and decide when a decision is due."""
        if not self._base_set and self.client.connected:
            self._base_set = True
            self._base()
        if self._range_line is None and self.client.connected:
            self._range_line = range_mismatch(self.method, self.client.namespace)
            if self._range_line:
                rospy.logwarn("applr: %s", self._range_line)
        goal = self.inputs.goal(now) if self.enabled else None
        if goal != self._goal:
            if goal is None:
                self._note_end(now)
                # The course also ends if the method is switched off or move_base is silent,
                # but then its goal goes on.
                if self.enabled and not self.inputs.has_lost_move_base(now):
                    rospy.loginfo("applr: the goal has ended")
                self._base()
            else:
                self._begin_course(now)
            self._goal = goal
            self._last = None
        if self.client.connected and self.meter_scoring.update(now, goal is not None):
            self.client.reapply()  # The parameters in force were sent with other multipliers.
            self._publish_parameters()
        if goal is not None and now >= self._due:
            self._decide(now, goal)

    def _decide(self, now: rospy.Time, goal: str) -> None:
        """Make the decision that is due, unless its inputs are missing."""
        # Every course starts with theta_0, which may not be in force yet.
        delay: float = (now - self._due).to_sec()
        period = self.pilot.period
        is_first = self._last is None
        is_unsettled = self.client.busy or self.meter_scoring.waits(now)
        if is_first and is_unsettled and delay < period:
            return
        try:
            snapshot, context = self._observe(now)
        except ObservationError as problem:
            if delay >= period:  # The observation has failed for a whole period.
                self._due = now
                self._fail("unusable", str(problem))
            return

        # The first decision waits for the first plan. It sets the time of the later ones, of which
        # a late one does not delay the next one.
        if is_first:
            delay = 0.0
        self.counts["late"] += delay > LATE_SHARE * period
        self.counts["decisions"] += 1
        self._due = now + rospy.Duration(max(period - delay, period / 2))
        self._last = now

        theta, refused = self._choose(context)
        number = self.counts["decisions"]
        cleared = self._has_cleared
        self.topics.decision(number, now, goal, snapshot, context, theta, refused, cleared)
        if refused:
            self._fail("refused", f"decision refused, parameters unchanged: {refused}")

    def _observe(self, now: rospy.Time) -> Tuple[Snapshot, Context]:
        """Return (Snapshot, Context) of a decision.

        Raises:
            ObservationError: An input is missing or invalid.
        """
        theta = self.client.theta()
        if theta is None:
            raise ObservationError("the planner's parameters are not known yet")
        snapshot = self.inputs.snapshot(now, self._began)
        return snapshot, self.pilot.observe(theta, snapshot.seen)

    def _note_end(self, now: rospy.Time) -> None:
        """Publish the observation at the end of a course, for training from recorded drives."""
        if self._last is None:
            return
        number = self.counts["decisions"]
        with suppress(ObservationError):
            self.topics.course_end(number, now, self._goal, *self._observe(now))

    def _choose(self, context: Context) -> Tuple[Optional[np.ndarray], str]:
        """Request the pilot's choice.

        Return (theta, "") as requested, or (None, reason) if the method failed.

        During a course, the choice of a static method is requested only after a stall, because
        other parameters may have been set by hand since.
        """
        self._has_cleared = False
        try:
            choice = self.pilot.decide(context)
        except Exception as problem:  # A method may be user code: the node goes on in any case.
            return None, one_line(problem)
        if choice.clears_costmaps:
            self._costmaps.clear()
            self._has_cleared = True
        is_in_force = self.method.static and choice.why == METHOD and not self._is_redrawn
        self._is_redrawn = choice.why != METHOD
        self.client.per_cell = choice.per_cell
        if not is_in_force:
            self.client.request(choice.theta)
        return choice.theta, ""

    def _fail(self, kind: str, line: str) -> None:
        """Count a period without a decision. After LOST_PERIODS of them, request theta_0."""
        self.counts[kind] += 1
        self._note_trouble(line)
        choice = self.pilot.miss()
        if choice is not None:
            self._note_trouble(f"no decision for {LOST_PERIODS} periods: back to theta_0")
            self.client.request(choice.theta)

    def _base(self) -> None:
        """Request, between goals, those set by hand, a static method's, or theta_0."""
        self._is_redrawn = False
        self.client.per_cell = self.method.per_cell
        if self._by_hand is not None:
            self.client.request(self._by_hand)
            return
        choice = self.pilot.defaults()
        if self.enabled:
            try:
                choice = self.pilot.between_courses()
            except Exception as problem:  # A method may be user code, as in _choose.
                self.degraded = one_line(problem)
        self.client.request(choice.theta)

    def shutdown(self) -> None:
        """Restore theta_0 if this node has set other parameters."""
        client = self.client
        client.stop()
        theta = self.pilot.defaults().theta
        sent = client.sent
        if sent is None:
            return
        is_default = np.array_equal(sent, theta) and (client.multipliers == 1.0).all()
        if is_default and not client.busy:
            return

        # Theta_0 is restored without multipliers, as at the planner's start. In the first attempt a
        # server may still be busy with an earlier call.
        self.meter_scoring.forget()
        problem = client.apply(theta, RESTORE_S)
        if problem:
            client.apply(theta, RESTORE_S)

    def _on_restart(self, server: Server) -> None:
        """Set the parameters again after a server's restart, which lost them."""
        self.counts["restarts"] += 1
        self._range_line = None
        rospy.logwarn_throttle(1.0, f"applr: {server.name} came back; its parameters are set again")
        self.meter_scoring.forget()  # The new process may count in the other unit.
        self.client.reapply()

    def _on_report(self, error: str) -> None:
        """Count an attempt to set parameters. error: reason for its failure, or ""."""
        if error:
            self.counts["failed"] += 1
            self._note_trouble(f"parameters not changed: {error}")
        else:
            self.counts["applied"] += 1
            self._note_trouble("")
            self._publish_parameters()

    def _note_trouble(self, line: str) -> None:
        """Store the present problem, or "" for none, and log it if it is new."""
        if line and line != self.trouble:
            rospy.logwarn(f"applr: {line}")
        self.trouble = line

    def _report(self, now: rospy.Time) -> None:
        """Publish diagnostics, and the parameters in force."""
        theta = self._publish_parameters()
        if self.inputs.has_lost_move_base(now):
            self._note_trouble(GONE)
        elif self.trouble == GONE:
            self._note_trouble("")

        # At the start it is normal that the servers are not there yet.
        trouble = self.trouble or self.degraded or self._range_line or ""
        is_lost = bool(self.degraded) or self.pilot.has_lost_method
        if theta is None:
            is_lost = is_lost or bool(trouble)
            trouble = trouble or "waiting for the parameter servers of move_base"
        decision_age = math.nan
        if self._last is not None:
            decision_age = (now - self._last).to_sec()
        servers = sorted(server.name for server in self.client.servers.values())
        values = {
            **{name: self.counts[name] for name in COUNTS},
            "method": self.method.name if self.enabled else "off",
            "driving": self.in_force,
            "stalls": self.pilot.stalled_decisions,
            "max_speed": f"{self.pilot.max_speed:g}",
            "meter_scoring": self.meter_scoring.line(now) or "not known before the first goal",
            "goal": self._goal or "none",
            "decision_age_s": f"{decision_age:.2f}",
            "servers": ", ".join(servers) or "none",
        }
        self.topics.diagnostics(now, trouble, is_lost, self._doing(), values)

    def _publish_parameters(self) -> Optional[np.ndarray]:
        """Publish the parameters in force and the multipliers.

        Return theta (n,), or None if it is unknown.
        """
        theta = self.client.theta()
        if theta is not None:
            self.topics.parameters(theta, rospy.Time.now(), self.client.multipliers)
        return theta

    def _doing(self) -> str:
        """Return the node's activity in words."""
        if not self.enabled:
            return f"switched off: {self.in_force} drive now"
        if self._goal is None:
            return "idle: no goal"
        return "deciding"


def range_mismatch(method: Method, namespace: str) -> str:
    """Return in one line which lasers mark obstacles up to another range than a method's.

    move_base reads these ranges only at its start, so that the node cannot set them. The line is ""
    if none does, or if the parameters in move_base's namespace cannot be read.
    """
    needed = method.obstacle_range
    if needed is None:
        return ""
    cause = f"method {method.name} was made for {needed:g} m"
    try:
        parameters = rospy.get_param(namespace, {})
        return mismatch(parameters, needed, cause)
    except Exception as problem:
        # Without this line the robot drives on: the master may be gone, and a C++ move_base may
        # have layers that are described otherwise.
        rospy.logdebug("applr: obstacle ranges are not known: %s", reason(problem))
        return ""
