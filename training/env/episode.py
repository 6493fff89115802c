"""Episode: a robot drives one course while its parameters change once per decision period.

Episode connects MoveBase to a Simulator, without ROS. The environment (env.py), evaluation (evaluate.py) and the
parameter searches all drive with Episode.
"""

from __future__ import annotations

import math
import zlib
from dataclasses import replace
from functools import partial
from typing import Any, Dict, Optional, Sequence, Tuple, Union

import numpy as np

from applr_ros1.common.angles import Pose, compose, inverse, transform_point
from applr_ros1.common.errors import ApplrError
from applr_ros1.common.scan import LaserScan
from applr_ros1.monitor.monitor import CollisionMonitor
from applr_ros1.monitor.settings import MonitorSettings
from applr_ros1.monitor.stalled_planner import FRESH_S, StalledPlanner
from applr_ros1.movers.prediction import Prediction
from applr_ros1.planner.costmap.static_layer import StaticMap
from applr_ros1.planner.move_base import MoveBase
from applr_ros1.planner.observation_router import Sensed
from applr_ros1.planner.parameters.layers import PREDICTED
from applr_ros1.planner.state_machine import Cycle
from applr_ros1.planner.variant import CPP_LIKE
from applr_ros1.policy.actor import Stall
from applr_ros1.policy.decision import Context, Seen
from applr_ros1.policy.observation import layout_of
from applr_ros1.policy.parameter_space import send, space_of
from applr_ros1.robots import JACKAL, Robot
from applr_ros1.robots.robot import Laser
from sim_bridge.simulator import RobotState, Simulator
from training.env.outcome import CLEAR, Outcome, Trace
from worlds import World

CONTROL_PERIOD = 0.05  # duration of a control cycle [s], 20 Hz as on the Jackal; slower parts of MoveBase skip cycles
TIME_LIMIT = 100.0  # duration after which a trial counts as failed [s]


def counting_cells(parameters: Dict[str, Any]) -> Dict[str, Any]:
    """Return move_base's parameter tree with `meter_scoring` false: distance biases learned here are per costmap cell.

    The applr node rescales them for a planner that needs biases per metre (applr_ros1/nodes/applr/meter_scoring.py).
    """
    planner = dict(parameters.get("TrajectoryPlannerROS", {}), meter_scoring=False)
    return dict(parameters, TrajectoryPlannerROS=planner)


class Episode:
    """Drives courses, one after the other, with one planner in one simulator.

    The goal is sent once, as in the runners of the authors and of BARN. If the planner aborts the goal, the robot would
    stand until the time limit. The trial therefore ends at once, as a failure that took the whole time limit.

    Args:
        simulator: Simulator of the robot.
        move_base: Planner, or planners for worlds without and with a map. A planner with a static layer gets the map
            and the robot's true pose; others explore. If its fidelity is random, each reset draws the fidelity. With
            its parameter applr/movers, the costmaps receive predicted obstacle points.
        robot: Description of the robot. Its laser scans at its own rate, at most once per control cycle.
        period: Decision period [s]; 2 in the paper.
        time_limit: Time after which a trial counts as failed [s].
        end_on_collision: Whether a collision ends the trial, as under the BARN Challenge's protocol.
        monitor: Whether the robot's collision monitor stands between the planner and the base.
        end_on_stall: Whether a stall (policy/actor.py) ends the trial as a failure.
        escapes: Whether the monitor makes the escape motions that a planner of fidelity cpp-like lacks.
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
    ):
        self._planners = move_base if isinstance(move_base, tuple) else (move_base, move_base)
        self.simulator, self.move_base = simulator, self._planners[0]
        self._to_map: Optional[Pose] = None  # pose of the world's frame in the map's, if the planner has the map
        self.monitor = CollisionMonitor(MonitorSettings.of(robot)) if monitor else None
        self.prediction = Prediction(robot) if self.move_base.parameters["applr"]["movers"] else None
        self.robot, self.space = robot, space_of(robot)
        self.nearest = partial(nearest, lowest=robot.laser.range_min)
        self.layout = layout_of(robot)  # beams of the policy's scans; may be replaced between two trials
        self._scan_period = robot.laser.period_in(CONTROL_PERIOD)  # scan interval [s]; 0: one scan per cycle
        self.end_on_collision, self.escapes = end_on_collision, escapes
        self.end_on_stall, self.stall = end_on_stall, Stall(robot.world_scale)
        self.set_period(period)
        self.time_limit = time_limit
        self.outcome: Optional[Outcome] = None
        self.trace = Trace()

    def set_period(self, period: float) -> None:
        """Change the decision period [s], a whole number of control cycles, from the next decision on.

        Raises:
            ApplrError: The period is not a whole number of control cycles, or is longer than 10 s.
        """
        cycles = round(period / CONTROL_PERIOD)
        if not 1 <= cycles <= 200 or abs(cycles * CONTROL_PERIOD - period) > 1e-9:
            raise ApplrError(f"decision period is {period:g} s: give a multiple of {CONTROL_PERIOD} s, at most 10 s")
        self.period, self.cycles = float(period), cycles

    @property
    def limit(self) -> int:
        """Number of decisions after which a trial times out."""
        return max(1, round(self.time_limit / self.period))

    @property
    def place(self) -> Pose:
        """Pose of the robot in the frame of plan and goal: the true pose on a map, or the odometry's without a map."""
        state = self.simulator.state
        return state.odom_pose if self._to_map is None else compose(self._to_map, state.pose)

    # -- the trial ---------------------------------------------------------------------------------
    def reset(self, world: World, seed: int, theta: Optional[np.ndarray] = None) -> Outcome:
        """Reset robot, maps and planner, set theta_0 (or `theta`), observe once and send the goal.

        The order is that of the authors' reset: robot and odometry to the start, costmaps cleared, theta_0, goal. A
        cycle without a goal fills the map for the first observation and plan. Time counts from the sending of the goal.
        """
        self.world, self.move_base, self._to_map = world, self._planners[world.map is not None], None
        if world.map is not None and self.move_base.map_topics:
            self._to_map = inverse(world.map.origin)
            self.move_base.set_map(StaticMap(*world.map[:2], (0.0, 0.0), self.robot.frames.map))
        state = self.simulator.reset(world, seed)
        # Because the seed includes the name, a random planner fidelity differs from world to world.
        self.move_base.reset(state.time, seed=[seed, zlib.crc32(world.name.encode())])
        if self.monitor is not None:
            self.monitor.reset()
        if self.prediction is not None:
            self.prediction.reset()
        self.trace = Trace()
        self._acceleration: Optional[float] = None
        self._jerks = self._turns = self._clearances = 0.0
        self._cycles = 0
        self._scan_due = state.time
        self._ranges = np.empty(0, np.float32)  # latest scan of the control cycles
        theta = self.apply(self.space.theta0 if theta is None else theta)
        self._tolerance = self.move_base.goal_tolerance
        lacks = self.escapes and self.move_base.variant == CPP_LIKE
        self._stalled = StalledPlanner(self._tolerance) if lacks else None
        self._planned = -math.inf  # time of the latest plan [s]
        self._cycle()
        sent = world.course.sent_goal
        self.goal = self.simulator.to_odom(sent) if self._to_map is None else compose(self._to_map, sent)
        state = self.simulator.state
        self.began = state.time
        self.stall.reset()
        self.stall.update(0.0, *state.pose[:2])
        self.move_base.set_goal(self.goal, state.time)
        self._plan = self.move_base.make_plan(self.place, self.goal, 0.0)  # plan of the next decision
        self._scanned = self.simulator.scan()
        near = self.nearest(self._scanned)
        self.outcome = Outcome(theta, last_scan_min=near, decision_min=near, min_clearance_m=near)
        return self.outcome

    def decide(self, theta: np.ndarray) -> Outcome:
        """Drive one decision period, or less if the course ends, with parameters theta (n,); return the outcome."""
        was = self.outcome
        if was is None or was.over:
            raise RuntimeError("the trial is over: call reset() before decide()")
        theta = self.apply(theta)
        self.trace.theta.append(theta)
        self.trace.decided.append(self.simulator.state.time - self.began)
        since, came_from = self.simulator.state.time, tuple(self.simulator.state.pose)
        now = replace(was, theta=theta, decisions=was.decisions + 1, contact=False, decision_min=math.inf)
        for _ in range(self.cycles):
            self._drive_one(now)
            if now.over:
                break
        state = self.simulator.state
        now.seconds = state.time - since
        now.time_s = state.time - self.began
        if self.stall.update(now.time_s, *state.pose[:2]) and self.end_on_stall and not now.over:
            now.reason = "stalled"
        if not now.over and now.decisions >= self.limit:
            now.timeout, now.reason = True, "time limit"
        if now.aborted:
            now.timeout = True
        if now.timeout:
            now.time_s = self.time_limit
        self._scanned = self._ranges if self._scan_period else self.simulator.scan()
        self._plan = self.move_base.global_plan
        now.last_scan_min = self.nearest(self._scanned)
        now.decision_min = min(now.decision_min, now.last_scan_min)
        now.min_clearance_m = min(was.min_clearance_m, now.decision_min)
        now.progress, now.progress_y = progress(self.world.course.goal, came_from, state.pose)
        now.mean_jerk, now.mean_turn = self._jerks / self._cycles, self._turns / self._cycles
        now.mean_clearance_m = self._clearances / self._cycles
        self.outcome = now
        return now

    def context(self) -> Context:
        """Return the context in which a method makes the next decision."""
        assert self.outcome is not None, "reset() comes first"
        return Context.of(self.outcome.theta, self.seen(), self.space, self.layout)

    def seen(self) -> Seen:
        """Return the inputs of the next decision."""
        state, laser = self.simulator.state, self.robot.laser
        assert self.outcome is not None, "reset() comes first"
        scan = self._scanned, laser.first_angle + laser.pose[2], laser.increment
        movers = np.zeros((0, 4))
        if self.prediction is not None:
            tracked = self.prediction.movers
            movers = np.column_stack([tracked.x, tracked.y, tracked.vx, tracked.vy])
        motion = self.place, state.odom_twist, self.goal, self._plan, movers
        return Seen(scan, self.outcome.time_s, *motion)

    # -- parameters --------------------------------------------------------------------------------
    def apply(self, theta: np.ndarray) -> np.ndarray:
        """Set parameters theta (n,) through the same reconfigure servers as over ROS; return the resulting values."""
        has = send(self.space.requests(theta), self.move_base)
        return np.array([has[server][name] for server, name in self.space.places()], dtype=np.float64)

    # -- one control cycle of 50 ms ----------------------------------------------------------------
    def _cycle(self) -> Tuple[Cycle, RobotState]:
        """Scan, plan, command and drive; return the planner's cycle and the new state."""
        simulator, state = self.simulator, self.simulator.state
        scan = self._scan(state) if state.time + 1e-6 >= self._scan_due else None
        sensed: Optional[Sensed] = scan
        if self.prediction is not None and scan is not None:
            sensed = {next(iter(self.move_base.sources)): scan, PREDICTED: self.prediction.add_scan(scan)}
        origin = None if self._to_map is None else compose(self.place, inverse(state.odom_pose))
        cycle = self.move_base.step(state.time, state.odom_pose, state.odom_twist, sensed, origin)
        command = cycle.command
        if self.monitor is not None:
            if scan is not None:
                self.monitor.add_scan(scan)
            self._planned = state.time if cycle.new_plan else self._planned
            if command is not None:
                motion = self._escape(state, command)
                given = state.time, state.odom_pose, state.odom_twist, motion or command
                verdict = self.verdict = self.monitor.filter(*given, creeps=motion is None)
                command = verdict.command
                (self._stalled or self.move_base).report_held(verdict.blocked)
        if command is not None:
            simulator.command(*command)
        return cycle, simulator.advance(CONTROL_PERIOD)

    def _escape(self, state: RobotState, command: Tuple[float, float]) -> Optional[Tuple[float, float]]:
        """Return the escape motion that replaces the command of a cpp-like planner, or None to keep the command."""
        if self._stalled is None:
            return None
        (x, y, _), (end_x, end_y, _) = self.move_base.global_plan[[0, -1]]
        left = math.hypot(end_x - x, end_y - y) if state.time - self._planned <= FRESH_S else None
        return self._stalled.instead(state.time, command, self.move_base.goal, left)

    def _scan(self, state: RobotState) -> LaserScan:
        """Take a new scan of the simulated laser."""
        self._scan_due += self._scan_period
        self._ranges = self.simulator.scan()
        laser, pose = self.robot.laser, laser_pose(state.odom_pose, self.robot.laser)
        angles = laser.first_angle, laser.increment
        return LaserScan(state.time, *angles, laser.range_min, laser.range_max, self._ranges, pose, laser.height)

    def _drive_one(self, now: Outcome) -> None:
        before = self.simulator.state
        x, y, _ = before.pose
        v, w = before.twist
        cycle, state = self._cycle()
        near = self.nearest(self._ranges)
        now.decision_min = min(now.decision_min, near)
        self._clearances += min(near, CLEAR * self.robot.body.size[1])
        now.path_length_m += math.hypot(state.pose[0] - x, state.pose[1] - y)
        now.contact |= bool(state.contact)
        now.collided |= now.contact
        acceleration = (state.twist[0] - v) / CONTROL_PERIOD
        if self._acceleration is not None:
            self._jerks += abs(acceleration - self._acceleration) / CONTROL_PERIOD
        self._acceleration = acceleration
        self._turns += abs(state.twist[1] - w) / CONTROL_PERIOD
        self._cycles += 1
        self.trace.time.append(state.time - self.began)
        self.trace.pose.append(tuple(state.pose))
        self.trace.twist.append(tuple(state.twist))
        self._judge(now, cycle, state)

    def _judge(self, now: Outcome, cycle: Cycle, state: RobotState) -> None:
        """Set success, failure and reason in the outcome if the course has ended (Course.arrived).

        The planner has reached the goal if it reports success, or if `place` is within the tolerance although the robot
        has still to stop and turn. If the goal is occupied (default_tolerance), only the report counts.
        """
        left = math.hypot(self.goal[0] - self.place[0], self.goal[1] - self.place[1])
        reached = left <= self._tolerance or (cycle.result is not None and cycle.result[0] == "succeeded")
        if self.world.course.arrived(state.pose[0], state.pose[1], self._tolerance if reached else None):
            now.success, now.reason = True, "finished"
        elif state.flipped:
            now.flipped, now.reason = True, "flipped"
        elif self.end_on_collision and state.contact:
            now.reason = "contact"
        elif cycle.result is not None:
            status, text = cycle.result
            now.aborted, now.reason = True, "planner %s: %s" % (status, text)


def progress(goal: Sequence[float], p: Sequence[float], q: Sequence[float]) -> Tuple[float, float]:
    """Return the paper's R_p from p to q, (q - p) . (goal - p) / |goal - p|, and its simplification q_y - p_y [m]."""
    gx, gy = goal[0] - p[0], goal[1] - p[1]
    distance = math.hypot(gx, gy)
    along = ((q[0] - p[0]) * gx + (q[1] - p[1]) * gy) / distance if distance > 0.0 else 0.0
    return along, q[1] - p[1]


def laser_pose(pose: Pose, laser: Laser) -> Pose:
    """Return the pose of the laser of a robot at pose (x, y, yaw)."""
    return (*transform_point(pose, *laser.pose[:2]), pose[2] + laser.pose[2])


def nearest(ranges: np.ndarray, lowest: float) -> float:
    """Return d(o), the smallest range [m]: at least `lowest` (-inf is too near to measure), or inf without a return."""
    low = float(np.fmin.reduce(ranges))
    return math.inf if math.isnan(low) else max(lowest, low)
