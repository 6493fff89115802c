"""Episode: a robot drives one course while its parameters change once per decision period.

Episode connects MoveBase to a Simulator, without ROS. The environment (env.py), evaluation
(evaluate.py) and the parameter searches all drive with Episode.
"""

from __future__ import annotations

import math
import zlib
from typing import Optional, Tuple, Union

import numpy as np

from applr_ros1.common.angles import Pose, compose, inverse
from applr_ros1.common.errors import ApplrError
from applr_ros1.common.scan import LaserScan
from applr_ros1.drives.drive import (
    ABORTED,
    FLIPPED,
    REACHED,
    STALLED,
    TIMED_OUT,
    TOUCHED,
    Decision,
    Drive,
    Goal,
    SentGoal,
)
from applr_ros1.drives.ending import ended_early
from applr_ros1.drives.recorder import Recorder
from applr_ros1.planner.costmap.static_layer import StaticMap
from applr_ros1.planner.move_base import MoveBase
from applr_ros1.planner.state_machine import Cycle
from applr_ros1.policy.decision import Context, Seen
from applr_ros1.policy.observation import layout_of
from applr_ros1.policy.parameter_space import space_of
from applr_ros1.policy.stall import Stall
from applr_ros1.robots import JACKAL, Robot
from applr_ros1.stack.stack import Stack, Step
from sim_bridge.simulator import RobotState, Simulator
from training.env.outcome import Leg, Outcome, nearest, outcome_of
from worlds import World

# Duration of a control cycle [s], 20 Hz as on the Jackal; slower parts of MoveBase skip cycles
CONTROL_PERIOD = 0.05
TIME_LIMIT = 100.0  # duration after which a trial counts as failed [s]


class Episode:
    """Drives courses, one after the other, with one stack in one simulator.

    The goal is sent once, as in the runners of the authors and of BARN. If the planner aborts the
    goal, the robot would stand until the time limit. The trial therefore ends at once, as a failure
    that took the whole time limit.

    Args:
        simulator: Simulator of the robot.
        move_base: Planner, or planners for worlds without and with a map. A planner with a static
            layer gets the map and the robot's true pose; others explore. If its fidelity is random,
            each reset draws the fidelity. With its parameter applr/movers, the costmaps receive
            predicted obstacle points.
        robot: Description of the robot. Its laser scans at its own rate, at most once per control
            cycle.
        period: Decision period [s]; 2 in the paper.
        time_limit: Time after which a trial counts as failed [s].
        end_on_collision: Whether a collision ends the trial, as under the BARN Challenge's
            protocol.
        monitor: Whether the robot's collision monitor stands between the planner and the base.
        end_on_stall: Whether a stall (policy/stall.py) ends the trial as a failure.
        escapes: Whether the monitor makes the escape motions that a planner of fidelity cpp-like
            lacks.
        ends_at_tolerance: Whether a course ends as soon as the robot is within the planner's goal
            tolerance, or only when the planner reports its goal as reached, after it has also
            turned to the goal's heading.
        record: Whether `drive` has all columns. Without it, a drive has what outcomes and pictures
            need.
    """

    def __init__(
        self,
        simulator: Simulator,
        move_base: Union[MoveBase, Tuple[MoveBase, MoveBase]],
        robot: Robot = JACKAL,
        *,
        period: float,
        time_limit: float = TIME_LIMIT,
        end_on_collision: bool = False,
        monitor: bool = False,
        end_on_stall: bool = False,
        escapes: bool = True,
        ends_at_tolerance: bool = True,
        record: bool = False,
    ):
        planners = move_base if isinstance(move_base, tuple) else (move_base,)
        # The last stack is for worlds with a map.
        self._stacks = [
            Stack(robot, planner, monitor=monitor, escapes=escapes) for planner in planners
        ]
        self.stack = self._stacks[0]
        self.simulator = simulator
        # Pose of the world's frame in the map's, if the planner has the map
        self._to_map: Optional[Pose] = None
        self.robot = robot
        self.space = space_of(robot)
        # Beams of the policy's scans; may be replaced between two trials
        self.layout = layout_of(robot)
        # Scan interval [s]; 0: one scan per cycle
        self._scan_period = robot.laser.period_in(CONTROL_PERIOD)
        self.end_on_collision = end_on_collision
        self.end_on_stall = end_on_stall
        self.ends_at_tolerance = ends_at_tolerance
        self.stall = Stall(robot.world_scale)
        self.set_period(period)
        self.time_limit = time_limit
        self.outcome: Optional[Outcome] = None
        self._record = record
        self._courses = 0  # number of courses so far
        self._recorder = Recorder()

    def set_period(self, period: float) -> None:
        """Change the decision period [s] from the next decision on.

        Raises:
            ApplrError: The period is not a whole number of control cycles, or is longer than 10 s.
        """
        cycle_count = round(period / CONTROL_PERIOD)
        if not 1 <= cycle_count <= 200 or abs(cycle_count * CONTROL_PERIOD - period) > 1e-9:
            remedy = f"give a multiple of {CONTROL_PERIOD} s, at most 10 s"
            raise ApplrError(f"decision period is {period:g} s: {remedy}")
        self.period = float(period)
        self.cycles = cycle_count

    @property
    def limit(self) -> int:
        """Number of decisions after which a trial times out."""
        return max(1, round(self.time_limit / self.period))

    @property
    def move_base(self) -> MoveBase:
        """Planner of the present world."""
        return self.stack.move_base

    @property
    def drive(self) -> Drive:
        """Drive since the goal was sent, with times from then on."""
        return self._recorder.drive

    @property
    def place(self) -> Pose:
        """Pose of the robot in the frame of plan and goal.

        It is the true pose on a map, or the odometry's without a map.
        """
        state = self.simulator.state
        if self._to_map is None:
            return state.odom_pose
        return compose(self._to_map, state.pose)

    # -- the trial ---------------------------------------------------------------------------------
    def reset(self, world: World, seed: int, theta: Optional[np.ndarray] = None) -> Outcome:
        """Reset robot, maps and planner, set theta_0 (or `theta`), observe once and send the goal.

        The order is that of the authors' reset: robot and odometry to the start, costmaps cleared,
        theta_0, goal. A cycle without a goal fills the map for the first observation and plan. Time
        counts from the sending of the goal.
        """
        self.world = world
        self.stack = self._stacks[0]
        if world.map is not None:
            self.stack = self._stacks[-1]
        self._to_map = None
        if world.map is not None and self.move_base.map_topics:
            self._to_map = inverse(world.map.origin)
            cells, resolution, _ = world.map
            self.move_base.set_map(StaticMap(cells, resolution, (0.0, 0.0), self.robot.frames.map))
        state = self.simulator.reset(world, seed)
        # Because the seed includes the name, a random planner fidelity differs from world to world.
        self.stack.reset(state.time, seed=[seed, zlib.crc32(world.name.encode())])
        self._scan_due = state.time
        self._ranges = np.empty(0, np.float32)  # latest scan of the control cycles
        self._recorder = Recorder(world, self._record)
        self.began = state.time + CONTROL_PERIOD  # time at which the goal is sent [s]
        if theta is None:
            theta = self.space.theta0
        theta = self.apply(theta)
        self._tolerance = self.move_base.goal_tolerance
        self._cycle()
        return self._send_goal(theta)

    def _send_goal(self, theta: np.ndarray) -> Outcome:
        """Send the goal of the course, and return the outcome before the first decision."""
        sent_goal = self.world.course.sent_goal
        if self._to_map is None:
            self.goal = self.simulator.to_odom(sent_goal)
            frame = self.robot.frames.odom
        else:
            self.goal = compose(self._to_map, sent_goal)
            frame = self.robot.frames.map
        state = self.simulator.state
        self._courses += 1
        self.began = state.time
        self.stall.reset()
        self.stall.update(0.0, *state.pose[:2], state.twist[0])
        self.stack.set_goal(self.goal, state.time)
        self._recorder.moved(0.0, state.pose, state.twist)
        self._recorder.sent.append(SentGoal(0.0, self.goal, frame))
        goal_name = f"course {self._courses} in {self.world.name}"
        self._recorder.goals.append(Goal(goal_name, 0.0, math.inf))
        # Plan of the next decision
        self._plan = self.move_base.make_plan(self.place, self.goal, tolerance=0.0)
        self._scanned = self.simulator.scan()
        smallest_range = self._observe()
        self.outcome = Outcome(
            theta,
            last_scan_min=smallest_range,
            decision_min=smallest_range,
            min_clearance_m=smallest_range,
        )
        return self.outcome

    def decide(self, theta: np.ndarray, clears_costmaps: bool = False) -> Outcome:
        """Drive one decision period with parameters theta (n,), and return the outcome.

        The drive is shorter if the course ends.

        Args:
            theta: Parameters (n,).
            clears_costmaps: Whether both costmaps are cleared before.
        """
        if self.outcome is None or self.outcome.over:
            raise RuntimeError("the trial is over: call reset() before decide()")
        if clears_costmaps:
            self.move_base.clear_costmaps()
        begin_time = self.seconds
        start_place = tuple(self.simulator.state.pose)
        inputs = self.seen()
        theta_before = self.outcome.theta
        theta = self.apply(theta)
        values_before = self.space.as_dict(theta_before)
        values_after = self.space.as_dict(theta)
        decision = Decision(
            goal=self._goal.id,
            time=begin_time,
            scan_time=begin_time,
            before=values_before,
            after=values_after,
            seen=inputs,
            cleared=clears_costmaps,
        )
        self._recorder.decisions.append(decision)
        for _ in range(self.cycles):
            self._drive_one()
            if self._goal.status:
                break
        state = self.simulator.state
        decision_count = len(self._recorder.decisions)
        has_stalled = self.stall.update(self.seconds, *state.pose[:2], state.twist[0])
        if has_stalled and self.end_on_stall and not self._goal.status:
            self._end(STALLED, "stalled")
        if not self._goal.status and decision_count >= self.limit:
            self._end(TIMED_OUT, "time limit")
        self._scanned = self._ranges if self._scan_period else self.simulator.scan()
        self._plan = self.move_base.global_plan
        self._observe()
        leg = Leg(begin_time, self.seconds, self.world.course.goal, start_place, state.pose)
        self.outcome = outcome_of(
            self._recorder.course,
            self._goal,
            leg,
            theta,
            decision_count,
            body_width=self.robot.body.size[1],
            time_limit=self.time_limit,
        )
        if self.outcome.over:
            end_decision = Decision(
                self._goal.id, self.seconds, self.seconds, values_after, {}, self.seen()
            )
            self._recorder.ends.append(end_decision)
        return self.outcome

    def context(self) -> Context:
        """Return the context in which a method makes the next decision."""
        assert self.outcome is not None, "reset() comes first"
        return Context.of(self.outcome.theta, self.seen(), self.space, self.layout)

    def seen(self) -> Seen:
        """Return the inputs of the next decision."""
        assert self.outcome is not None, "reset() comes first"
        laser = self.robot.laser
        scan = self._scanned, laser.first_angle + laser.pose[2], laser.increment
        twist = self.simulator.state.odom_twist
        return Seen(
            scan, self.outcome.time_s, self.place, twist, self.goal, self._plan, self.stack.movers
        )

    @property
    def seconds(self) -> float:
        """Time since the goal was sent [s]."""
        return self.simulator.state.time - self.began

    # -- parameters --------------------------------------------------------------------------------
    def apply(self, theta: np.ndarray) -> np.ndarray:
        """Set parameters theta (n,), and return the resulting values.

        They go through the same reconfigure servers as over ROS.
        """
        in_force = self.move_base.put_in_force(self.space.settings(theta))
        if self._record:
            for server, values in in_force.items():
                self._recorder.changed(self.seconds, server, values)
        return self.space.read_back(in_force)

    # -- one control cycle of 50 ms ----------------------------------------------------------------
    def _cycle(self) -> Tuple[Cycle, RobotState]:
        """Scan, plan, command and drive; return the planner's cycle and the new state."""
        state = self.simulator.state
        scan: Optional[LaserScan] = None
        if state.time + 1e-6 >= self._scan_due:
            scan = self._scan()
        # Pose of the odometry's frame in the map's
        origin: Optional[Pose] = None
        if self._to_map is not None:
            origin = compose(self.place, inverse(state.odom_pose))
        stack_step = self.stack.step(state.time, state.odom_pose, state.odom_twist, scan, origin)
        if self._record:
            self._record_step(state, scan, stack_step)
        if stack_step.command is not None:
            self.simulator.command(*stack_step.command)
        return stack_step.cycle, self.simulator.advance(CONTROL_PERIOD)

    def _record_step(self, state: RobotState, scan: Optional[LaserScan], step: Step) -> None:
        """Record what a training episode does not need."""
        recorder = self._recorder
        seconds = self.seconds
        recorder.localised(seconds, state.odom_pose, state.odom_twist)
        if scan is not None:
            recorder.scanned(seconds, scan)
        if step.cycle.recovery is not None:
            recorder.recovered(seconds)
        if step.cycle.new_plan:
            recorder.routed(seconds, np.array(self.move_base.global_plan))
        if step.cycle.controlled:
            planner = self.move_base.local_planner
            recorder.refused(seconds, planner.refusals(self.move_base.local_costmap))
        if step.cycle.command is not None and step.cycle.controlled:
            followed = np.array(self.move_base.local_planner.cropped_plan)
            recorder.planned(seconds, step.cycle.command, followed)
        if step.verdict is not None:
            recorder.judged(seconds, step.verdict)
        if step.command is not None:
            recorder.commanded(seconds, step.command)

    def _scan(self) -> LaserScan:
        """Take a new scan of the simulated laser."""
        self._scan_due += self._scan_period
        scan = self.simulator.laser_scan()
        self._ranges = scan.ranges
        return scan

    def _observe(self) -> float:
        """Record the scan of the next decision, and return its smallest range [m]."""
        smallest_range = nearest(self._scanned, self.robot.laser.range_min)
        self._recorder.observed(self.seconds, smallest_range)
        return smallest_range

    def _drive_one(self) -> None:
        """Drive one control cycle, and end the goal if the course has ended."""
        begin_time = self.seconds
        cycle, state = self._cycle()
        self._recorder.measured(begin_time, nearest(self._ranges, self.robot.laser.range_min))
        self._recorder.moved(self.seconds, state.pose, state.twist)
        if state.contact:
            self._recorder.touched(self.seconds)
        self._judge(cycle, state)

    def _judge(self, cycle: Cycle, state: RobotState) -> None:
        """End the goal if the course has ended (Course.arrived).

        The planner has reached the goal if it reports success, or with `ends_at_tolerance` if
        `place` is within the tolerance although the robot has still to stop and turn. If the goal
        is occupied (default_tolerance), only the report counts.
        """
        x, y, _ = self.place
        goal_x, goal_y, _ = self.goal
        distance = math.hypot(goal_x - x, goal_y - y)
        is_reached = self.ends_at_tolerance and distance <= self._tolerance
        is_reported = cycle.result is not None and cycle.result[0] == "succeeded"
        tolerance: Optional[float] = None
        if is_reached or is_reported:
            tolerance = self._tolerance
        true_x, true_y, _ = state.pose
        if self.world.course.arrived(true_x, true_y, tolerance):
            self._end(REACHED, "finished")
        elif state.flipped:
            self._end(FLIPPED, "flipped")
        elif self.end_on_collision and state.contact:
            self._end(TOUCHED, "contact")
        elif cycle.result is not None:
            _, message = cycle.result
            sent_x, sent_y, _ = self.world.course.sent_goal
            reason = ended_early(
                has_succeeded=is_reported,
                text=message,
                left_by_odometry=distance,
                left_in_truth=math.hypot(sent_x - true_x, sent_y - true_y),
                tolerance=self._tolerance,
            )
            self._end(ABORTED, reason)

    @property
    def _goal(self) -> Goal:
        """Goal of the course."""
        return self._recorder.goals[-1]

    def _end(self, status: str, reason: str) -> None:
        """End the goal."""
        self._recorder.goals[-1] = self._goal._replace(
            end=self.seconds, status=status, reason=reason
        )
