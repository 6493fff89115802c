"""The applr node: observation → method → parameters, every period (Algorithm 1 of the paper).

Started by main.py, beside any move_base with TrajectoryPlannerROS or DWAPlannerROS. The node
brings goals and inputs to a Supervisor (policy/supervisor.py), and requests what that decides.
docs/reference/topics.md lists the node's topics.
"""

from __future__ import annotations

import math
import threading
from collections import Counter
from contextlib import suppress
from typing import Dict, Optional, Tuple

import rospy

from applr_ros1.common.arrays import Array
from applr_ros1.common.errors import reason
from applr_ros1.nodes.applr.costmaps import Costmaps
from applr_ros1.nodes.applr.inputs import RobotInputs, Snapshot
from applr_ros1.nodes.applr.meter_scoring import AUTO, MeterScoring
from applr_ros1.nodes.applr.reconfigure_client import RESTORE_S, ReconfigureClient, ServerClient
from applr_ros1.nodes.applr.topics import ApplrTopics
from applr_ros1.nodes.sensors import RosClock
from applr_ros1.planner.parameters.obstacle_range import mismatch
from applr_ros1.policy.decision import Context, Method
from applr_ros1.policy.layout import ObservationError
from applr_ros1.policy.pilot import BY_HAND, DEFAULTS, Choice, Pilot
from applr_ros1.policy.supervisor import DEFAULT_PARAMETERS, Supervisor
from applr_ros1.robots import JACKAL, Robot

TICK_S = 0.05  # interval between two readings of the clock, in ROS time [s]
REPORT_S = 1.0  # interval between diagnostics, in ROS time [s]
GONE = "move_base has stopped publishing its status: check that it is running"
# Counters in /diagnostics
COUNTS = ("decisions", "late", "refused", "unusable", "applied", "failed", "restarts")


class ApplrNode:
    """The node: connects inputs, supervisor and client.

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
        pilot = Pilot(method, robot, period, max_speed)
        self.supervisor = Supervisor(pilot, seed, self._note_trouble)
        self.inputs = inputs
        self.topics = topics
        # Numbers of requests that were applied or failed, and of servers that came back
        self.counts: Dict[str, int] = Counter()
        self.trouble = ""  # latest problem in one line, or ""
        self._costmaps = Costmaps(namespace)
        # Lasers with another range than the method's, in one line; None if it is to be checked
        self._range_line: Optional[str] = None
        self._deciding = threading.Lock()  # guards the supervisor
        self.client = ReconfigureClient(
            namespace, pilot.space, self._on_restart, self._on_report, self._note_trouble
        )
        self.meter_scoring = MeterScoring(self.client, meter_scoring)

    @property
    def method(self) -> Method:
        """Method in use."""
        return self.supervisor.pilot.method

    def spin(self) -> None:
        """Run until shutdown. If the clock jumps back, start anew."""
        self.client.start()
        rospy.on_shutdown(self.shutdown)
        report_due = rospy.Time(0)
        clock = RosClock()
        while not rospy.is_shutdown():
            try:
                if clock.went_back():
                    self._clock_jumped()
                    report_due = rospy.Time(0)
                now = clock.now
                if self.supervisor.is_beat_due(now.to_sec()):
                    self.topics.heartbeat(now)
                    if self.supervisor.beat(now.to_sec()):
                        self.client.reapply()
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
        seconds_left: float = self.supervisor.due - now.to_sec()
        if 0.001 < seconds_left < TICK_S:
            return seconds_left
        return TICK_S

    def _clock_jumped(self) -> None:
        """Drop all inputs and the course, and request theta_0."""
        rospy.logwarn("applr: the clock jumped back; starting anew with theta_0")
        self.inputs.drop_messages()
        with self._deciding:
            self._request(self.supervisor.forget_course())

    def switch(self, enabled: bool) -> None:
        """Switch the method on or off.

        When it is off, the planner has theta_0 and no decisions are made.
        """
        with self._deciding:
            if enabled != self.supervisor.enabled:
                state = "on" if enabled else f"off: back to {DEFAULT_PARAMETERS}"
                rospy.loginfo("applr: switched %s", state)
            self.supervisor.switch(bool(enabled))

    def set_by_hand(self, values: Dict[str, float]) -> None:
        """Switch the method off and set {name: value}, as Supervisor.set_by_hand."""
        with self._deciding:
            was_enabled = self.supervisor.enabled
            self._request(self.supervisor.set_by_hand(values, self.client.theta()))
            if was_enabled:
                rospy.loginfo("applr: switched off: parameters are set by hand")

    def change_method(self, method: Method) -> None:
        """Replace the method. In the middle of a course, the new method decides at once."""
        with self._deciding:
            self.supervisor.change_method(method, rospy.Time.now().to_sec())
            self._range_line = None

    def _request(self, choice: Optional[Choice]) -> None:
        """Request the parameters of a choice; None changes nothing."""
        if choice is None:
            return
        settings = self.supervisor.pilot.space.settings(choice.theta)
        if choice.why == BY_HAND:
            self.client.request(settings, self.client.is_per_cell)
        else:
            self.client.request(settings, per_cell=choice.why != DEFAULTS)

    def _tick(self, now: rospy.Time) -> None:
        """Begin and end courses, and decide when a decision is due."""
        supervisor = self.supervisor
        if not supervisor.has_rested and self.client.connected:
            self._request(supervisor.rest())
        if self._range_line is None and self.client.connected:
            self._range_line = range_mismatch(self.method, self.client.namespace)
            if self._range_line:
                rospy.logwarn("applr: %s", self._range_line)
        goal = self.inputs.goal(now) if supervisor.enabled else None
        if goal is None and supervisor.goal is not None:
            self._note_end(now)
            # The course also ends if the method is switched off or move_base is silent, but then
            # its goal goes on.
            if supervisor.enabled and not self.inputs.has_lost_move_base(now):
                rospy.loginfo("applr: the goal has ended")
        self._request(supervisor.pursue(goal, now.to_sec()))
        if self.client.connected and self.meter_scoring.detect(now, goal is not None):
            self.client.reapply()  # The parameters in force were sent with other multipliers.
            self._publish_parameters()
        is_settled = not self.client.busy and not self.meter_scoring.waits(now)
        if supervisor.is_due(now.to_sec(), is_settled):
            self._decide(now)

    def _decide(self, now: rospy.Time) -> None:
        """Make the decision that is due, unless its inputs are missing."""
        try:
            snapshot, context = self._observe(now)
        except ObservationError as problem:
            self._request(self.supervisor.miss_inputs(now.to_sec(), str(problem)))
            return
        ruling = self.supervisor.decide(now.to_sec(), context)
        if ruling.clears_costmaps:
            self._costmaps.request_clearing()
        self._request(ruling.request)
        self.topics.decision(ruling, now, self.supervisor.goal, snapshot, context)

    def _observe(self, now: rospy.Time) -> Tuple[Snapshot, Context]:
        """Return (Snapshot, Context) of a decision.

        Raises:
            ObservationError: An input is missing or invalid.
        """
        # In the unit of all methods, whatever was sent last
        theta = self.client.theta(per_cell=True)
        if theta is None:
            raise ObservationError("the planner's parameters are not known yet")
        snapshot = self.inputs.snapshot(now, self.supervisor.began)
        return snapshot, self.supervisor.pilot.observe(theta, snapshot.seen)

    def _note_end(self, now: rospy.Time) -> None:
        """Publish the observation at the end of a course, for training from recorded drives."""
        supervisor = self.supervisor
        if supervisor.last is None:
            return
        number = supervisor.counts["decisions"]
        with suppress(ObservationError):
            self.topics.course_end(number, now, supervisor.goal, *self._observe(now))

    def shutdown(self) -> None:
        """Restore theta_0 if this node has set other parameters."""
        client = self.client
        client.stop()
        sent = client.sent
        if sent is None:
            return
        # Theta_0 in the planner's own unit, as at its start
        pilot = self.supervisor.pilot
        start = pilot.space.settings(pilot.defaults().theta)
        if sent == start and not client.busy:
            return

        # In the first attempt a server may still be busy with an earlier call.
        problem = client.apply(start, seconds=RESTORE_S)
        if problem:
            client.apply(start, seconds=RESTORE_S)

    def _on_restart(self, server: ServerClient) -> None:
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
        # At shutdown, a move_base that ends first does not answer any more, which is no problem.
        is_ending = rospy.core.is_shutdown_requested()
        if line and line != self.trouble and not is_ending:
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
        supervisor = self.supervisor
        trouble = self.trouble or supervisor.degraded or self._range_line or ""
        is_lost = supervisor.is_degraded
        if theta is None:
            is_lost = is_lost or bool(trouble)
            trouble = trouble or "waiting for the parameter servers of move_base"
        decision_age = math.nan
        if supervisor.last is not None:
            decision_age = now.to_sec() - supervisor.last
        servers = sorted(server.name for server in self.client.servers.values())
        counts = {**supervisor.counts, **self.counts}
        values = {
            **{name: counts.get(name, 0) for name in COUNTS},
            "method": self.method.name if supervisor.enabled else "off",
            "driving": supervisor.in_force,
            "stalls": supervisor.pilot.stall_rule.count,
            "max_speed": f"{supervisor.pilot.max_speed:g}",
            "meter_scoring": self.meter_scoring.line(now) or "not known before the first goal",
            "goal": supervisor.goal or "none",
            "decision_age_s": f"{decision_age:.2f}",
            "servers": ", ".join(servers) or "none",
        }
        self.topics.diagnostics(now, trouble, is_lost, supervisor.activity, values)

    def _publish_parameters(self) -> Optional[Array]:
        """Publish the parameters in force and the multipliers.

        Return theta (n,), or None if it is unknown.
        """
        theta = self.client.theta()
        if theta is not None:
            self.topics.parameters(theta, rospy.Time.now(), self.client.multipliers)
        return theta


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
