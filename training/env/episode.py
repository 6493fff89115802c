"""One trial: a robot drives one course while parameters change once per decision period.

The loop that joins MoveBase and a Simulator, without ROS. The environment (env.py), evaluation (evaluate.py) and the
searches all drive through it.
"""

from __future__ import annotations

import math
import zlib
from dataclasses import replace
from functools import partial
from typing import Any, Dict, Optional, Tuple

import numpy as np

from applr_ros1.common.angles import transform_point
from applr_ros1.common.errors import ApplrError
from applr_ros1.common.scan import LaserScan
from applr_ros1.monitor.monitor import CollisionMonitor
from applr_ros1.monitor.settings import MonitorSettings
from applr_ros1.monitor.stalled_planner import FRESH_S, StalledPlanner
from applr_ros1.movers.prediction import Prediction
from applr_ros1.planner.observation_router import Sensed
from applr_ros1.planner.parameters.layers import PREDICTED
from applr_ros1.planner.variant import CPP_LIKE
from applr_ros1.policy.actor import Stall
from applr_ros1.policy.decision import Context, Seen
from applr_ros1.policy.observation import layout_of
from applr_ros1.policy.parameter_space import send, space_of
from applr_ros1.robots import JACKAL, Robot
from applr_ros1.robots.robot import Laser
from training.env.outcome import CLEAR, Outcome, Trace

CONTROL_PERIOD = 0.05  # of one cycle [s]: the Jackal's 20 Hz; parts of MoveBase that are slower skip cycles
TIME_LIMIT = 100.0  # [s] after which a trial counts as failed


def counting_cells(parameters: Dict[str, Any]) -> Dict[str, Any]:
    """A parameter tree of move_base with `meter_scoring` false, whatever it says: what is learned here counts per cell.

    The applr node rescales what it sends to a planner that counts per metre (applr_ros1/nodes/applr/meter_scoring.py).
    """
    planner = dict(parameters.get("TrajectoryPlannerROS", {}), meter_scoring=False)
    return dict(parameters, TrajectoryPlannerROS=planner)


class Episode:
    """Drives courses, one after the other, with one planner in one simulator.

    simulator       sim_bridge.Simulator
    move_base       applr_ros1.planner.move_base.MoveBase; what it draws, it draws at each reset; with its parameter
                    applr/movers it gets where moving obstacles will be
    limit           decisions until a time-out; None: as many as fit into TIME_LIMIT
    period          decision period [s]; the paper's is 2 s
    end_on_collision  a collision ends the trial (BARN Challenge's protocol; the paper's goes on)
    end_on_stall    a robot that has hardly moved for a while has failed (policy/actor.py)
    robot           the robot that both are for; its laser scans at its own rate, at most once a cycle
    monitor         whether the robot's collision monitor stands between the planner and the base
    escapes         whether that monitor makes the motions of escape that a C++-like planner lacks

    The goal is sent once, as the authors' and the BARN runner do. A planner that aborts it leaves the robot standing
    until the limit: that cannot change any more, so the trial ends at once as a failure that took the whole limit.
    """

    def __init__(
        self,
        simulator,
        move_base,
        robot: Robot = JACKAL,
        *,
        period: float,
        limit: Optional[int] = None,
        end_on_collision: bool = False,
        monitor: bool = False,
        end_on_stall: bool = False,
        escapes: bool = True,
    ):
        self.simulator, self.move_base = simulator, move_base
        self.monitor = CollisionMonitor(MonitorSettings.of(robot)) if monitor else None
        self.prediction = Prediction(robot) if move_base.parameters["applr"]["movers"] else None
        self.robot, self.space = robot, space_of(robot)
        self.nearest = partial(nearest, lowest=robot.laser.range_min)
        self.layout = layout_of(robot)  # how the policy sees a scan; can be set anew between two trials
        self._scan_period = robot.laser.period_in(CONTROL_PERIOD)  # 0: a scan in every cycle
        self.end_on_collision, self.escapes = end_on_collision, escapes
        self.end_on_stall, self.stall = end_on_stall, Stall(robot.world_scale)
        self.set_period(period)
        self.time_limit = TIME_LIMIT if limit is None else limit * period
        self.outcome: Optional[Outcome] = None
        self.trace = Trace()

    def set_period(self, period: float) -> None:
        """Take another decision period [s] from the next decision on, a whole number of control cycles.

        Raises:
            ApplrError: It is not such a number, or longer than 10 s.
        """
        cycles = round(period / CONTROL_PERIOD)
        if not 1 <= cycles <= 200 or abs(cycles * CONTROL_PERIOD - period) > 1e-9:
            raise ApplrError(f"decision period of {period:g} s: give a multiple of {CONTROL_PERIOD} s, at most 10 s")
        self.period, self.cycles = float(period), cycles

    @property
    def limit(self) -> int:
        """Decisions until a trial is over as timed out."""
        return max(1, round(self.time_limit / self.period))

    # -- the trial ---------------------------------------------------------------------------------
    def reset(self, world, seed: int, theta=None) -> Outcome:
        """Put robot, maps and planner back, restore theta_0 (or `theta`), look once and send the goal.

        As the authors' reset: model and odometry to the start, costmaps cleared, theta_0, goal. One idle cycle
        passes so that the first observation has a map and a plan; the clock starts when the goal is sent.
        """
        self.world = world
        state = self.simulator.reset(world, seed)
        # a planner that is drawn differs from world to world, whatever the seeds are
        self.move_base.reset(state.time, seed=[seed, zlib.crc32(world.name.encode())])
        if self.monitor is not None:
            self.monitor.reset()
        if self.prediction is not None:
            self.prediction.reset()
        self.trace = Trace()
        self._acceleration = None
        self._jerks = self._turns = self._clearances = 0.0
        self._cycles = 0
        self._scan_due = state.time
        self._ranges = np.empty(0, np.float32)  # the newest scan of the control cycles
        theta = self.apply(self.space.theta0 if theta is None else theta)
        self._tolerance = self.move_base.goal_tolerance
        lacks = self.escapes and self.move_base.variant == CPP_LIKE
        self._stalled = StalledPlanner(self._tolerance) if lacks else None
        self._planned = -math.inf  # when the newest plan was made [s]
        self._cycle()
        self.goal = self.simulator.to_odom(world.course.sent_goal)
        state = self.simulator.state
        self.began = state.time
        self.stall.reset()
        self.stall.update(0.0, *state.pose[:2])
        self.move_base.set_goal(self.goal, state.time)
        self._plan = self.move_base.make_plan(state.odom_pose, self.goal, 0.0)  # of the coming decision, as its scan is
        self._scanned = self.simulator.scan()
        near = self.nearest(self._scanned)
        self.outcome = Outcome(theta, last_scan_min=near, decision_min=near, min_clearance_m=near)
        return self.outcome

    def decide(self, theta) -> Outcome:
        """Drive one decision period (less where the course ends) with parameters theta (n,), and say how it went."""
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
        """Return the input of a method for the next decision."""
        assert self.outcome is not None, "reset() comes first"
        return Context.of(self.outcome.theta, self.seen(), self.space, self.layout)

    def seen(self) -> Seen:
        """Return what the next decision is made from."""
        state, laser = self.simulator.state, self.robot.laser
        assert self.outcome is not None, "reset() comes first"
        scan = self._scanned, laser.first_angle + laser.pose[2], laser.increment
        motion = state.odom_pose, state.odom_twist, self.goal, self._plan, self.movers()
        return Seen(scan, self.outcome.time_s, *motion)

    def movers(self) -> np.ndarray:
        """(k, 4) x, y, vx, vy of what the tracker sees moving, in the odometry's frame [m, m/s]."""
        if self.prediction is None:
            return np.zeros((0, 4))
        seen = self.prediction.movers
        return np.column_stack([seen.x, seen.y, seen.vx, seen.vy])

    # -- parameters --------------------------------------------------------------------------------
    def apply(self, theta) -> np.ndarray:
        """Set parameters theta (n,) through the same reconfigure servers as over ROS; returns what is in force."""
        has = send(self.space.requests(theta), self.move_base)
        return np.array([has[server][name] for server, name in self.space.places()], dtype=np.float64)

    # -- one control cycle of 50 ms ----------------------------------------------------------------
    def _cycle(self):
        """Scan, plan, command, drive; returns (planner's cycle, new state)."""
        simulator, state = self.simulator, self.simulator.state
        scan = self._scan(state) if state.time + 1e-6 >= self._scan_due else None
        sensed: Optional[Sensed] = scan
        if self.prediction is not None and scan is not None:
            sensed = {next(iter(self.move_base.sources)): scan, PREDICTED: self.prediction.add_scan(scan)}
        cycle = self.move_base.step(state.time, state.odom_pose, state.odom_twist, sensed)
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

    def _escape(self, state, command):
        """Return the motion that the monitor drives in place of a C++-like planner's command; None for the command."""
        if self._stalled is None:
            return None
        (x, y, _), (end_x, end_y, _) = self.move_base.global_plan[[0, -1]]
        left = math.hypot(end_x - x, end_y - y) if state.time - self._planned <= FRESH_S else None
        return self._stalled.instead(state.time, command, self.move_base.goal, left)

    def _scan(self, state) -> LaserScan:
        """A new scan of the simulated laser."""
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

    def _called_within(self, cycle, state) -> Optional[float]:
        """Return the planner's tolerance [m] where it takes the goal's place for reached, or says so, else None.

        It goes by odometry, and has still to stop and to turn there; the time of a recorded drive ends here, too. Where
        its plan ends beside an occupied goal, as default_tolerance lets it, it has only its word.
        """
        left = math.hypot(self.goal[0] - state.odom_pose[0], self.goal[1] - state.odom_pose[1])
        said = cycle.result is not None and cycle.result[0] == "succeeded"
        return self._tolerance if said or left <= self._tolerance else None

    def _judge(self, now: Outcome, cycle, state) -> None:
        """Note whether the course has ended, by its rule (Course.arrived)."""
        if self.world.course.arrived(state.pose[0], state.pose[1], self._called_within(cycle, state)):
            now.success, now.reason = True, "finished"
        elif state.flipped:
            now.flipped, now.reason = True, "flipped"
        elif self.end_on_collision and state.contact:
            now.reason = "contact"
        elif cycle.result is not None:
            status, text = cycle.result
            now.aborted, now.reason = True, "planner %s: %s" % (status, text)


def progress(goal, p, q) -> Tuple[float, float]:
    """The paper's R_p from p to q, (q - p) . (goal - p) / |goal - p|, and its simplification q_y - p_y [m]."""
    gx, gy = goal[0] - p[0], goal[1] - p[1]
    distance = math.hypot(gx, gy)
    along = ((q[0] - p[0]) * gx + (q[1] - p[1]) * gy) / distance if distance > 0.0 else 0.0
    return along, q[1] - p[1]


def laser_pose(pose, laser: Laser) -> Tuple[float, float, float]:
    """A laser's pose for a robot at pose (x, y, yaw)."""
    return (*transform_point(pose, *laser.pose[:2]), pose[2] + laser.pose[2])


def nearest(ranges: np.ndarray, lowest: float) -> float:
    """d(o): the smallest range [m], at least `lowest` (-inf: too near to tell) and inf where nothing returns."""
    low = float(np.fmin.reduce(ranges))
    return math.inf if math.isnan(low) else max(lowest, low)
