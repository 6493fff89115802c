"""The applr node: every second or two of ROS time observation → method → parameters (Algorithm 1 of the paper).

Started by main.py beside any move_base with TrajectoryPlannerROS or DWAPlannerROS. It decides while a goal is
active; between goals the planner has theta_0, on which every course starts. docs/reference/topics.md lists its
topics.
"""

import math
import threading
from collections import Counter
from contextlib import suppress

import numpy as np
import rospy

from applr_ros1.common.errors import ApplrError, one_line
from applr_ros1.nodes.applr.meter_scoring import AUTO, MeterScoring
from applr_ros1.nodes.applr.reconfigure_client import RESTORE_S, ReconfigureClient
from applr_ros1.nodes.sensors import Clock
from applr_ros1.policy.decision import PERIOD, Context
from applr_ros1.policy.observation import ObservationError
from applr_ros1.policy.parameter_space import space_of
from applr_ros1.robots import JACKAL

TICK_S = 0.05  # of ROS time between looks at the clock
REPORT_S = 1.0  # of ROS time between diagnostics
LATE_SHARE = 0.1  # of a period after which a decision counts as late
GONE = "move_base has stopped publishing its status: is it still running?"
COUNTS = ("decisions", "late", "refused", "unusable", "applied", "failed", "restarts")
LOST_PERIODS = 3  # without a usable decision after which the policy counts as lost


class ApplrNode:
    """The node: joins inputs, method and client.

    Args:
        method: Chooses the parameters (policy/methods.py).
        inputs: Scan, odometry, plan and goal.
        topics: What is published.
        period: Time [s] of ROS between decisions; None: the method's own.
        namespace: Of move_base.
        max_speed: Largest max_vel_x [m/s] that is set, whatever the method chooses.
        seed: Of what a method draws; the courses have seed, seed + 1 ...
        meter_scoring: Whether the planner's distance biases count per metre (meter_scoring.CHOICES).
        robot: Description of the robot that is driven.
    """

    def __init__(
        self,
        method,
        inputs,
        topics,
        period=None,
        namespace="/move_base",
        max_speed=math.inf,
        seed=0,
        meter_scoring=AUTO,
        robot=JACKAL,
    ):
        self.robot, self.space = robot, space_of(robot)
        self.method, self.inputs, self.topics, self.seed = method, inputs, topics, seed
        self._given_period = period
        self.enabled = True
        self._by_hand = None  # (n,) that a person has set; the method is off then
        self._max_speed = max_speed
        self.counts = Counter()
        self.trouble = ""  # newest line about what is wrong; "" when nothing is
        self.degraded = ""  # why the chosen method is not the one that drives
        self._goal, self._due, self._failures, self._began = None, None, 0, None
        self._last = None  # ROS time of the last decision
        self._base_set = False  # whether what a goal-less planner should have has been sent
        self._deciding = threading.Lock()  # of method, enabled and the course's state
        space = self.space.below("max_vel_x", max_speed)
        self.client = ReconfigureClient(namespace, space, self._on_restart, self._on_report, self._say)
        self.meter_scoring = MeterScoring(self.client, meter_scoring)

    @property
    def period(self):
        """Time [s] of ROS between decisions: as asked for, else the method's."""
        return self.method.period if self._given_period is None else self._given_period

    def _begin_course(self, now):
        self.method.period = self.period  # what it sees may depend on it
        try:
            self.method.reset(self.seed + self.counts["courses"])
        except Exception as e:  # as in _choose
            self._say(one_line(e))
        self.counts["courses"] += 1
        self._due, self._failures, self._began = now, 0, now

    def spin(self):
        """Run until shutdown. A clock that jumps back starts afresh."""
        self.client.start()
        rospy.on_shutdown(self.shutdown)
        beat = report = rospy.Time(0)
        clock = Clock()
        while not rospy.is_shutdown():
            try:
                if clock.went_back():
                    self._clock_jumped()
                    beat = report = rospy.Time(0)
                now = clock.now
                if now >= beat:
                    self.topics.heartbeat(now)
                    beat = now + rospy.Duration(min(self.period, PERIOD))  # move_base expects one every 2 s
                if now >= report:
                    self._report(now)
                    report = now + rospy.Duration(REPORT_S)
                self.tick(now)
                rospy.sleep(self._nap(now))
            except rospy.exceptions.ROSTimeMovedBackwardsException:
                continue
            except rospy.exceptions.ROSInterruptException:
                return

    def _clock_jumped(self):
        """Start afresh on theta_0; a clock that jumps all the time is reported now and then only."""
        rospy.logwarn("applr: the clock jumped back; starting afresh on theta_0")
        self.inputs.clear()
        with self._deciding:
            self._goal = self._due = self._last = None
            self._base()

    def switch(self, enabled):
        """Switch the method on or off. Off, the planner is put on theta_0 and no decision is made."""
        with self._deciding:
            if enabled != self.enabled:
                rospy.loginfo("applr: switched %s", "on" if enabled else "off: theta_0")
            self.enabled, self._base_set, self._by_hand = bool(enabled), False, None

    def set_by_hand(self, values):
        """Switch the method off and set {name: value}, clipped to the ranges; other parameters stay as they are.

        Raises ApplrError, and changes nothing, for an unknown name, a value that is not finite, and where it is not
        known yet what the planner has.
        """
        with self._deciding:
            theta = self.client.theta() if self._by_hand is None else self._by_hand
            if theta is None:
                raise ApplrError("the planner's parameters are not known yet")
            unknown = sorted(set(values) - set(self.space.names))
            if unknown:
                raise ApplrError(f"unknown parameter {unknown[0]!r}: use {', '.join(self.space.names)}")
            wanted = [values.get(name, value) for name, value in zip(self.space.names, theta)]
            self._by_hand = self.client.request(np.array(wanted))
            if self.enabled:
                rospy.loginfo("applr: switched off: parameters are set by hand")
            self.enabled = False

    def change_method(self, method):
        """Let another method decide from now on; in the middle of a course it decides at once."""
        with self._deciding:
            self.method, self.degraded = method, ""
            if self.client.connected:
                self.meter_scoring.look(rospy.Time.now(), self._goal is not None, method.per_cell)
            if self._goal is None or method.static:
                self._base_set = False
            else:
                self._begin_course(rospy.Time.now())

    def _nap(self, now):
        left = TICK_S if self._due is None else (self._due - now).to_sec()
        return left if 0.001 < left < TICK_S else TICK_S

    def tick(self, now):
        """Look at the clock: begin and end courses, and decide when a decision is due."""
        with self._deciding:
            self._tick(now)

    def _tick(self, now):
        if not self._base_set and self.client.connected:
            self._base_set = True
            self._base()
        goal = self.inputs.goal(now) if self.enabled else None
        if goal != self._goal:
            if goal is None:
                self._note_end(now)
                rospy.loginfo("applr: no goal any more")
                self._base()
            else:
                self._begin_course(now)
            self._goal, self._last = goal, None
        if self.client.connected and self.meter_scoring.look(now, goal is not None, self.method.per_cell):
            self.client.reapply()  # what the planner has was sent before it was known what its weights count
            self._publish_parameters()
        if goal is not None and now >= self._due:
            self._decide(now, goal)

    def _decide(self, now, goal):
        unsettled = self.client.busy or self.meter_scoring.waits(now)
        if self._last is None and unsettled and (now - self._due).to_sec() < self.period:
            return  # every course starts on theta_0, which is still on its way
        try:
            snapshot, context = self._look(now)
        except ObservationError as e:
            if (now - self._due).to_sec() >= self.period:  # tried for a whole period
                self._due = now
                self._fail("unusable", str(e))
            return
        if self._last is None:
            self._due = now  # a course's first decision waits for its first plan, and the others count from it
        late = (now - self._due).to_sec()
        self.counts["late"] += late > LATE_SHARE * self.period
        self.counts["decisions"] += 1
        self._due = now + rospy.Duration(max(self.period - late, self.period / 2))
        self._last = now
        theta, refused = self._choose(context)
        self.topics.decision(self.counts["decisions"], now, goal, snapshot, context, theta, refused)
        if refused:
            self._fail("refused", f"decision refused, parameters stay: {refused}")
            return
        self._failures = 0

    def _look(self, now):
        """Return (Snapshot, Context) of a decision. Raises ObservationError where none can be made."""
        theta = self.client.theta()
        if theta is None:
            raise ObservationError("the planner's parameters are not known yet")
        snapshot = self.inputs.snapshot(now, self._began)
        return snapshot, Context.of(theta, snapshot.seen, self.space, self.method.layout)

    def _note_end(self, now):
        """Publish what came of the last decision of a course, for those who learn from it."""
        if self._last is not None:
            with suppress(ObservationError):
                self.topics.course_end(self.counts["decisions"], now, self._goal, *self._look(now))

    def _choose(self, context):
        """Request what the method chooses: (theta, "") as requested, (None, one line) where it must not be sent.

        What a static method says in a course is not requested: a person may have set something else since.
        """
        try:
            theta = self.method.theta(context)
            sent = context is None or not self.method.static
            return self.client.request(theta) if sent else self.client.space.clip(theta), ""
        except Exception as e:  # a method is exchangeable: whatever it does, the planner drives on
            return None, one_line(e)

    def _fail(self, kind, line):
        """Count a period without a decision. After several the policy counts as lost: theta_0."""
        self.counts[kind] += 1
        self._failures += 1
        self._say(line)
        if self._failures == LOST_PERIODS and not self.method.static:
            self._say(f"no decision for {LOST_PERIODS} periods: back to theta_0")
            self.client.request(self.space.theta0)

    def _base(self):
        """Request what the planner has between goals: theta_0, or the one set of a static method or a person."""
        if self._by_hand is not None:
            self.client.request(self._by_hand)
            return
        theta = None
        if self.enabled and self.method.static:
            theta, refused = self._choose(None)
            self.degraded = refused or self.degraded
        if theta is None:
            self.client.request(self.space.theta0)

    def shutdown(self):
        """Leave the planner on theta_0 where this node has set something else: the policy is gone now."""
        self.client.stop()
        client, theta = self.client, self.client.space.clip(self.space.theta0)
        only = np.array_equal(client.sent, theta) and (client.multipliers == 1.0).all()
        if client.sent is None or (only and not client.busy):
            return
        self.meter_scoring.forget()  # as the planner was before this node came
        if client.apply(theta, RESTORE_S):  # again if a former call was still to be answered
            client.apply(theta, RESTORE_S)

    def _on_restart(self, server):
        self.counts["restarts"] += 1
        rospy.logwarn_throttle(1.0, f"applr: {server.name} came back; its parameters are set again")
        self.meter_scoring.forget()  # another process may count otherwise
        self.client.reapply()

    def _on_report(self, error):
        self.counts["failed" if error else "applied"] += 1
        self._say(error and f"parameters not changed: {error}")
        if not error:
            self._publish_parameters()

    def _say(self, line):
        """Keep what is wrong now, "" for nothing, and log it when it is news."""
        fresh, self.trouble = line != self.trouble, line
        if line and fresh:
            rospy.logwarn(f"applr: {line}")

    def _report(self, now):
        theta = self._publish_parameters()
        age = math.nan if self._last is None else (now - self._last).to_sec()
        if self.inputs.has_lost_move_base(now):
            self._say(GONE)
        elif self.trouble == GONE:
            self._say("")
        trouble = self.trouble or self.degraded
        lost = bool(self.degraded) or self._failures >= LOST_PERIODS or bool(theta is None and trouble)
        if theta is None:
            trouble = trouble or "waiting for the parameter servers of move_base"
        self.topics.diagnostics(
            now,
            trouble,
            lost,
            self._doing(),
            dict(
                {name: self.counts[name] for name in COUNTS},
                method=self.method.name if self.enabled else "off",
                stalls=self.method.stalls,
                max_speed=f"{self._max_speed:g}",
                meter_scoring=self.meter_scoring.line(now) or "not known before the first goal",
                goal=self._goal or "none",
                decision_age_s=f"{age:.2f}",
                servers=", ".join(sorted(self.client.servers.values())) or "none",
            ),
        )

    def _publish_parameters(self):
        """Publish what the planner has, and by what it gets the parameters multiplied; returns theta."""
        theta = self.client.theta()
        if theta is not None:
            self.topics.parameters(theta, rospy.Time.now(), self.client.multipliers)
        return theta

    def _doing(self):
        if not self.enabled:
            return "switched off: " + ("theta_0" if self._by_hand is None else "set by hand")
        return "idle: no goal" if self._goal is None else "deciding"
