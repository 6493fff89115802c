"""Drives in simulation: the loop of control cycles to the end of a course.

A drive is a loop of control cycles, and a pilot speaks every n-th cycle. `drive` is that loop to
the end of a course, for evaluations, `why`, check_robot, APPLD and the set-up. The learning
environment advances a CourseDrive by one decision period after the other.
"""

from __future__ import annotations

import math
from functools import cached_property
from typing import Iterator, Optional

import numpy as np

from applr_ros1.common.angles import Twist, inverse
from applr_ros1.common.arrays import Array, Array32
from applr_ros1.common.errors import ApplrError
from applr_ros1.drives.drive import Decision, Drive, Goal, SentGoal
from applr_ros1.drives.end_rules import CourseEnd, Destination, Rules
from applr_ros1.drives.outcome import Leg, Outcome, nearest, outcome_of
from applr_ros1.drives.recorder import Recorder
from applr_ros1.planner.plan_cut import transformed
from applr_ros1.planner.state_machine import NO_PLAN
from applr_ros1.policy.decision import Seen
from applr_ros1.policy.parameter_space import Space, space_of
from applr_ros1.policy.pilot import Pilot
from applr_ros1.policy.stuck import Stall
from applr_ros1.stack.simulated import CONTROL_PERIOD, SimulatedRobot, Tick
from applr_ros1.stack.stack import Stack
from worlds import World

PERIOD_S = 1.0  # period after which a drive without a pilot is judged [s]
LONGEST_CYCLES = 200  # largest number of control cycles in a decision period


def drive(
    simulated: SimulatedRobot,
    world: World,
    seed: int,
    pilot: Optional[Pilot] = None,
    rules: Rules = Rules(),
    *,
    record: bool = False,
) -> Drive:
    """Drive the course of a world to its end, and return the drive.

    Args:
        simulated: Robot that drives.
        world: World with the course.
        seed: Seed of all random draws.
        pilot: Pilot that chooses the parameters; None for those of the robot's files.
        rules: Rules that end the course.
        record: Whether the drive has all columns (CourseDrive).
    """
    period = PERIOD_S
    theta = None
    if pilot is not None:
        pilot.begin(seed)
        period = pilot.period
        theta = pilot.defaults().theta
    course_drive = CourseDrive(
        simulated, world, seed, rules, period=period, theta=theta, record=record
    )
    for _ in course_drive.legs(pilot):
        pass
    return course_drive.drive


def cycles_in(period: float) -> int:
    """Return the number of control cycles in a decision period [s].

    Raises:
        ApplrError: The period is not a whole number of control cycles, or is longer than 10 s.
    """
    cycle_count = round(period / CONTROL_PERIOD)
    is_whole = abs(cycle_count * CONTROL_PERIOD - period) <= 1e-9
    if not 1 <= cycle_count <= LONGEST_CYCLES or not is_whole:
        remedy = f"give a multiple of {CONTROL_PERIOD} s, at most 10 s"
        raise ApplrError(f"decision period is {period:g} s: {remedy}")
    return cycle_count


class CourseDrive:
    """Drive of a simulated robot along one course, which goes on until its rules end it.

    The goal is sent once, as in the runners of the authors and of BARN. The order is that of the
    authors' reset: robot and odometry to the start, costmaps cleared, parameters set, goal. A cycle
    without a goal fills the map for the first plan. Time counts from the sending of the goal.

    Args:
        simulated: Robot that drives.
        world: World with the course.
        seed: Seed of all random draws.
        rules: Rules that end the course.
        period: Decision period [s].
        theta: Parameters (n,) until the first decision; None for a drive without decisions, with
            those of the robot's files.
        record: Whether `drive` has all columns. Without it, a drive has what outcomes and pictures
            need.

    Attributes:
        theta: Parameters (n,) in force; empty without decisions.
        stall: Detector of a stall, which sees the robot once per decision period.
        leg: Latest part of the drive between two decisions; of no length before the first one.

    Raises:
        ApplrError: The period is none (cycles_in).
    """

    def __init__(
        self,
        simulated: SimulatedRobot,
        world: World,
        seed: int,
        rules: Rules = Rules(),
        *,
        period: float = PERIOD_S,
        theta: Optional[Array] = None,
        record: bool = False,
    ):
        self.simulated = simulated
        self.world = world
        self.rules = rules
        self.period = period
        self.stall = Stall(simulated.robot.world_scale)
        self._cycles = cycles_in(period)
        self._recorder = Recorder(world, record)
        self._period_count = 0
        # Scan (beams,) [m] and plan (k, >= 2) of the next decision
        self._scanned = np.empty(0, np.float32)
        self._plan = NO_PLAN
        # Robot, planner and maps as at the start
        simulated.reset(world, seed)
        if simulated.correction is not None:
            self._recorder.frame = simulated.frame
        self._began = simulated.state.time + CONTROL_PERIOD  # time at which the goal is sent [s]
        self.theta = np.empty(0)
        self._is_decided = theta is not None
        # The laser's noise must not depend on whether somebody decides: with a planner, the scan of
        # a decision is taken in any case.
        self._has_planner = isinstance(simulated.driver, Stack)
        if theta is not None:
            self.theta = self.apply(theta)
        self._destination = self._send_goal()
        place = simulated.state.pose
        self.leg = Leg(0.0, 0.0, world.course.goal, place, place)

    def _send_goal(self) -> Destination:
        """Fill the map, and send the goal of the course."""
        simulated = self.simulated
        tolerance = simulated.driver.goal_tolerance
        self._record_planner(simulated.cycle())
        state = simulated.state
        self._began = state.time
        self.stall.add_position(0.0, *state.pose[:2], state.twist[0])
        simulated.send_goal()
        recorder = self._recorder
        recorder.moved(0.0, state.pose, state.twist)
        recorder.sent.append(SentGoal(0.0, simulated.goal, simulated.frame))
        goal_name = f"course {simulated.goal_count} in {self.world.name}"
        recorder.goals.append(Goal(goal_name, 0.0, math.inf))
        if self._has_planner:
            planner = simulated.stack.move_base
            plan = planner.make_plan(simulated.place, simulated.goal, tolerance=0.0)
            self._look(simulated.simulator.scan(), plan)
        return Destination(self.world.course, simulated.goal, tolerance)

    # -- state -------------------------------------------------------------------------------------
    @property
    def has_ended(self) -> bool:
        """True if the course has ended."""
        return bool(self._goal.status)

    @property
    def seconds(self) -> float:
        """Time since the goal was sent [s]."""
        return self.simulated.state.time - self._began

    @property
    def drive(self) -> Drive:
        """Drive since the goal was sent, with times from then on."""
        return self._recorder.drive

    @property
    def limit(self) -> int:
        """Number of decisions after which the course times out."""
        return self.rules.periods(self.period)

    @property
    def outcome(self) -> Outcome:
        """Outcome of the drive so far, and of its latest leg."""
        return outcome_of(
            self._recorder.course,
            self._goal,
            self.leg,
            self.theta,
            len(self._recorder.decisions),
            body_width=self.simulated.robot.body.size[1],
            time_limit=self.rules.limit,
        )

    @property
    def seen(self) -> Seen:
        """Inputs of the next decision."""
        laser = self.simulated.robot.laser
        return Seen(
            scan=(self._scanned, laser.first_angle + laser.pose[2], laser.increment),
            time=self.seconds,
            pose=self.simulated.place,
            twist=self.simulated.state.odom_twist,
            goal=self.simulated.goal,
            plan=self._plan,
            movers=self.simulated.movers,
        )

    # -- driving -----------------------------------------------------------------------------------
    def legs(self, pilot: Optional[Pilot] = None) -> Iterator[Leg]:
        """Drive to the end of the course, and yield each part of it between two decisions."""
        while not self.has_ended:
            if pilot is not None:
                choice = pilot.decide(pilot.observe(self.theta, self.seen))
                self.decide(choice.theta, choice.clears_costmaps)
            yield self.advance()

    def decide(self, theta: Array, clears_costmaps: bool = False) -> None:
        """Set parameters theta (n,) for the next decision period.

        Args:
            theta: Parameters (n,).
            clears_costmaps: Whether both costmaps are cleared before.
        """
        self._check_on_its_way()
        if clears_costmaps:
            self.simulated.stack.move_base.clear_costmaps()
        inputs = self._inputs()
        self.theta = self.apply(theta)
        values = self._space.as_dict(self.theta)
        self._recorder.decisions.append(inputs._replace(after=values, cleared=clears_costmaps))

    def advance(self) -> Leg:
        """Drive one decision period, or less if the course ends, and return this part."""
        self._check_on_its_way()
        begin_time = self.seconds
        begin_place = self.simulated.state.pose
        for _ in range(self._cycles):
            self._cycle()
            if self.has_ended:
                break
        self._period_count += 1
        state = self.simulated.state
        has_stalled = self.stall.add_position(self.seconds, *state.pose[:2], state.twist[0])
        if not self.has_ended:
            self._end(self.rules.judge_period(self.period, self._period_count, has_stalled))
        goal = self.world.course.goal
        self.leg = Leg(begin_time, self.seconds, goal, begin_place, state.pose)
        if self._has_planner:
            self._look(self.simulated.look(), self.simulated.stack.move_base.global_plan)
        if self.has_ended and self._is_decided:
            self._recorder.ends.append(self._inputs())
        return self.leg

    def _check_on_its_way(self) -> None:
        if self.has_ended:
            raise RuntimeError("the course has ended: begin another drive")

    def _cycle(self) -> None:
        """Drive one control cycle, and end the goal if the course has ended."""
        begin_time = self.seconds
        tick = self.simulated.cycle()
        self._record_planner(tick)
        recorder = self._recorder
        smallest_range = nearest(self.simulated.ranges, self.simulated.robot.laser.range_min)
        recorder.add_row("clearances", begin_time, nearest=smallest_range)
        recorder.moved(self.seconds, tick.after.pose, tick.after.twist)
        if tick.after.contact:
            recorder.contacts.append(self.seconds)
        self._end(self.rules.judge(tick, self._destination))

    def apply(self, theta: Array) -> Array:
        """Set parameters theta (n,), and return the resulting values.

        They go through the same reconfigure servers as over ROS.
        """
        in_force = self.simulated.stack.move_base.put_in_force(self._space.settings(theta))
        if self._recorder.everything:
            for server, values in in_force.items():
                self._recorder.add_row("changes", self.seconds, server=server, values=dict(values))
        return self._space.read_back(in_force)

    @cached_property
    def _space(self) -> Space:
        """Space of the decisions; without decisions, the robot's values may lie outside it."""
        return space_of(self.simulated.robot)

    # -- rows of the drive -------------------------------------------------------------------------
    @property
    def _goal(self) -> Goal:
        """Goal of the course."""
        return self._recorder.goals[-1]

    def _end(self, course_end: Optional[CourseEnd]) -> None:
        """End the goal if a rule says so."""
        if course_end is None:
            return
        self._recorder.goals[-1] = self._goal._replace(
            end=self.seconds, status=course_end.status, reason=course_end.reason
        )

    def _look(self, ranges: Array32, plan: Array) -> None:
        """Take the scan (beams,) [m] and the plan of the next decision."""
        self._scanned = ranges
        self._plan = plan
        smallest_range = nearest(ranges, self.simulated.robot.laser.range_min)
        self._recorder.add_row("observed", self.seconds, nearest=smallest_range)

    def _inputs(self) -> Decision:
        """Return what a decision sees now, without what it decides."""
        return Decision(
            goal=self._goal.id,
            time=self.seconds,
            scan_time=self.seconds,
            before=self._space.as_dict(self.theta),
            after={},
            seen=self.seen,
        )

    def _record_planner(self, tick: Tick) -> None:
        """Record what outcomes and pictures do not need."""
        if not self._recorder.everything:
            return
        recorder = self._recorder
        before = tick.before
        step = tick.step
        seconds = before.time - self._began
        recorder.localised(seconds, tick.planner_pose, before.odom_twist)
        if tick.scan is not None:
            scan = tick.scan
            fan = (scan.angle_min, scan.angle_increment, scan.range_min, scan.range_max)
            recorder.add_row("scans", seconds, stamp=seconds, fan=fan, ranges=scan.ranges)
        if step.cycle.recovery is not None:
            recorder.recoveries.append(seconds)
        if step.cycle.new_plan:
            self._record_route(seconds)
        if step.cycle.controlled:
            self._record_control(seconds, step.cycle.command)
        if step.verdict is not None:
            verdict = step.verdict
            recorder.add_row("verdicts", seconds, action=verdict.action, reason=verdict.reason)
        if step.command is not None:
            recorder.add_row("commands", seconds, twist=step.command)

    def _record_route(self, seconds: float) -> None:
        """Record the global plan in the frame of the odometry, as the other columns."""
        move_base = self.simulated.stack.move_base
        route = np.array(move_base.global_plan)
        if move_base.local_origin is not None:
            route = transformed(route, inverse(move_base.local_origin))
        self._recorder.add_row("routes", seconds, path=route)

    def _record_control(self, seconds: float, command: Optional[Twist]) -> None:
        """Record what the local planner rejected, and its command if it has one."""
        move_base = self.simulated.stack.move_base
        planner = move_base.local_planner
        refusals = planner.refusals(move_base.local_costmap)
        self._recorder.add_row("refusals", seconds, critics=refusals)
        if command is not None:
            self._recorder.add_row("planned", seconds, twist=command)
            self._recorder.add_row("plans", seconds, path=np.array(planner.cropped_plan))
