"""Local planner DWAPlannerROS: follows a plan with the DWA planner, then stops and turns.

Called by MoveBase once per control cycle. See docs/explanation/planner_dwa.md: section 2 for the
cut of the global plan (LocalPlannerUtil), section 8 for a cycle and for stopping and turning at the
goal (LatchedStopRotateController). As in C++, angles pass through a quaternion.
"""

import math
from typing import Any, Dict, Mapping, NamedTuple, Optional, Sequence, Tuple

import numpy as np

from applr_ros1.common.angles import Pose, Twist, inverse
from applr_ros1.planner.dwa.planner import DWAPlanner
from applr_ros1.planner.local_planner import NO_POSES, LocalPlanner
from applr_ros1.planner.plan_cut import cut_plan, half_size, transformed
from applr_ros1.planner.sampling_planner import (
    Triple,
    angle_difference,
    braked,
    floats,
    through_quaternion,
    turn_speed,
)


class LocalPlan:
    """Stored global plan, cut anew in every cycle. Pruning removes its first poses for good."""

    def __init__(self) -> None:
        self.poses = NO_POSES

    def store(self, plan: np.ndarray) -> None:
        """Store a plan (n, 3) x, y [m], yaw [rad]. n may be 0."""
        self.poses = np.array(plan, dtype=np.float64, order="C").reshape(-1, 3)

    def goal(self, local_origin: Optional[Pose] = None) -> Optional[Pose]:
        """Return the plan's last pose (x, y, yaw) in the costmap's frame, or None without a plan.

        local_origin: see cut.
        """
        if len(self.poses) == 0:
            return None
        to_costmap = None if local_origin is None else inverse(local_origin)
        x, y, yaw = transformed(self.poses[-1:], to_costmap)[0].tolist()
        return x, y, yaw

    def cut(
        self, x: float, y: float, limit: float, prune: bool, local_origin: Optional[Pose] = None
    ) -> np.ndarray:
        """Return the poses (k, 3) of the plan near the robot, in the costmap's frame.

        Args:
            x: position of the robot [m].
            y: position of the robot [m].
            limit: distance up to which poses are near [m], see cut_plan.
            prune: whether to drop the leading poses that are at least 1 m away, and as many from
                the front of the stored plan.
            local_origin: pose (x, y, yaw) of the costmap's frame in the plan's frame, None for the
                same frame.
        """
        cropped_plan, dropped_count = cut_plan(self.poses, x, y, limit, prune, local_origin)
        self.poses = self.poses[dropped_count:]
        # C++ applies the identity if both frames are the same, which may change last bits.
        if local_origin is None:
            return transformed(cropped_plan, None)
        return cropped_plan


# Phases of a cycle
NO_PLAN = "no plan"
DRIVING = "driving"
STOPPING = "stopping"
TURNING = "turning"
TURNED = "turned"

STANDING = (0.0, 0.0, 0.0)
ACCELERATION_LIMITS = ("acc_lim_x", "acc_lim_y", "acc_lim_theta")


class StopRotate:
    """Controller that stops the robot at the goal's position and then turns it to the goal's yaw.

    Args:
        params: values of the DWAPlannerROS server {name: value}.
        period: control period [s].
        latches: whether a reached position stays reached until the next plan.
    """

    def __init__(self, params: Mapping[str, Any], period: float, latches: bool):
        self._period = period
        self._latches = latches
        self.rotating = False  # turning phase
        self.latched = False
        self.reconfigure(params)

    def reconfigure(self, params: Mapping[str, Any]) -> None:
        """Apply the server's parameter values {name: value}."""
        # C++ keeps the limits as Eigen::Vector3f.
        self._params = params
        self._accelerations = [
            float(np.float32(params[limit_name])) for limit_name in ACCELERATION_LIMITS
        ]

    def new_plan(self) -> None:
        """Clear the latch, so that the goal's position must be reached again.

        The turning phase goes on.
        """
        self.latched = False

    def is_position_reached(self, pose: Triple, goal: Triple) -> bool:
        """Return whether `pose` is within xy_goal_tolerance of `goal`, both (x, y, yaw).

        If so, set the latch. While it is set, and if the planner latches, any pose counts.
        """
        if self._latches and self.latched:
            return True
        distance = np.hypot(goal[0] - pose[0], goal[1] - pose[1])
        if distance <= self._params["xy_goal_tolerance"]:
            self.latched = True
            return True
        return False

    def is_goal_reached(self, pose: Triple, velocity: Triple, goal: Triple) -> bool:
        """Return whether the robot stands at its goal, turned to it.

        pose, goal: x, y [m], yaw [rad]. velocity: vx, vy [m/s], w [rad/s].
        """
        if not self.is_position_reached(pose, goal):
            return False
        return self._is_turned(pose, goal) and self.is_stopped(velocity)

    def _is_turned(self, pose: Triple, goal: Triple) -> bool:
        return bool(abs(angle_difference(pose[2], goal[2])) <= self._params["yaw_goal_tolerance"])

    def is_stopped(self, velocity: Triple) -> bool:
        """Return whether the measured velocity vx, vy [m/s], w [rad/s] counts as standing."""
        vx, vy, w = velocity
        if abs(w) > self._params["theta_stopped_vel"]:
            return False
        return bool(max(abs(vx), abs(vy)) <= self._params["trans_stopped_vel"])

    def command(self, pose: Triple, velocity: Triple, goal: Triple) -> Tuple[str, Triple]:
        """Return (phase, (vx, vy, w)) at the goal's position.

        The phases are STOPPING, then TURNING, then TURNED with zero velocity. velocity: as
        measured. As in C++, w passes through a quaternion, like an angle, except in the standstill
        test.
        """
        if self._is_turned(pose, goal):
            self.rotating = False
            return TURNED, STANDING
        vx, vy, _ = velocity
        w = through_quaternion(velocity[2])
        # `rotating` outlives goals, as in C++, so that a robot that once turned stops no more.
        if not self.rotating and not self.is_stopped(velocity):
            return STOPPING, braked((vx, vy, w), self._accelerations, self._period)
        self.rotating = True
        yaw_error = angle_difference(pose[2], goal[2])
        return TURNING, (0.0, 0.0, self._turn(yaw_error, w))

    def _turn(self, yaw_error: float, w: float) -> float:
        """Return a turn rate [rad/s] towards the goal's yaw that lets the robot stop there.

        yaw_error: angle to the goal's yaw [rad]. w: measured turn rate [rad/s].
        """
        wanted_speed = self._clamped(abs(yaw_error))
        speed = turn_speed(yaw_error, wanted_speed, w, self._accelerations[2], self._period)
        speed = self._clamped(speed)
        return -speed if yaw_error < 0 else speed

    def _clamped(self, w: float) -> float:
        """Clamp a turn rate; as in C++, the upper limit wins if the limits are crossed."""
        return float(min(self._params["max_vel_theta"], max(self._params["min_vel_theta"], w)))


NO_COSTS = np.zeros((0, 7), np.float32)
NO_TRAJECTORIES = np.zeros((0, 5), np.float32)


class DWAStep(NamedTuple):
    """Outcome of one cycle."""

    ok: bool
    command: Tuple[float, float, float]  # command (vx, vy [m/s], w [rad/s]), zero if not ok
    phase: str
    cut: np.ndarray  # part (k, 3) of the plan that was followed
    cost: float = 0.0  # cost of the chosen or checked trajectory, negative if illegal
    point_count: int = 0  # number of that trajectory's points
    checked: Tuple[float, float, float] = STANDING  # command checked at the goal's position


class DWALocalPlanner(LocalPlanner):
    """Local planner DWAPlannerROS. Each cycle uses the current footprint of the costmap.

    params: {name: value} of all parameters of DWAPlannerROS, static ones included. `reconfigure`
    applies all values at once. The control period, sum_scores, cheat_factor and the latch change
    only with a restart.
    """

    def __init__(self, params: Mapping[str, Any]):
        control_frequency = params["controller_frequency"]
        control_period = 1.0 / control_frequency if control_frequency > 0 else 0.05
        self.planner = DWAPlanner(
            params,
            sim_period=control_period,
            sum_scores=params["sum_scores"],
            cheat_factor=params["cheat_factor"],
        )
        self.stop_rotate = StopRotate(params, control_period, params["latch_xy_goal_tolerance"])
        self._params = dict(params)
        self.stored_plan = LocalPlan()
        self.set_plan(NO_POSES)
        self._forget_cycle()

    def _forget_cycle(self) -> None:
        """Clear the state that belongs to a single cycle."""
        self.goal_reached = False
        self._searched = False
        self.cropped_plan = NO_POSES
        self._choice = None

    @property
    def is_turning(self) -> bool:
        """Return whether it turns the robot to the goal's heading."""
        return self.stop_rotate.rotating

    @is_turning.setter
    def is_turning(self, is_turning: bool) -> None:
        self.stop_rotate.rotating = is_turning

    def reconfigure(self, params: Mapping[str, Any]) -> None:
        """Apply new values {name: value} of some or all parameters of the server.

        Flags, latches and the plan stay.
        """
        # The values that are missing stay as they are.
        merged_params = dict(self._params, **params)
        self.planner.reconfigure(merged_params)
        self.stop_rotate.reconfigure(merged_params)
        self._params = merged_params

    def set_plan(self, plan: np.ndarray) -> None:
        """Follow the global plan (n, 3) x, y [m], yaw [rad] from now on."""
        # DWAPlannerROS::setPlan clears the latch and the oscillation flags with each new plan.
        self.stored_plan.store(plan)
        self.planner.clear_flags()
        self.stop_rotate.new_plan()
        self.goal_reached = False

    def cost_cloud(self, costmap: Any) -> np.ndarray:
        """Return costs (k, 7) of the last search's cells, see DWAPlanner.cost_cloud."""
        if not self._searched:
            return NO_COSTS
        return self.planner.cost_cloud(costmap)

    def trajectory_cloud(self, costmap: Any) -> np.ndarray:
        """Return points (k, 5) of all legal trajectories of the last search, for display.

        The columns are float32: x, y, z, theta, cost.
        """
        if self._choice is None:
            return NO_TRAJECTORIES
        return self.planner.trajectory_cloud()

    def refusals(self, costmap: Any) -> Dict[str, int]:
        """Count the rejected samples by critic if none was legal, see LocalPlanner."""
        if self._searched and self._choice is None:
            return self.planner.refusals()
        return {}

    def compute_velocity(
        self,
        pose: Sequence[float],
        twist: Sequence[float],
        costmap: Any,
        local_origin: Optional[Pose] = None,
    ) -> Tuple[bool, Twist]:
        """Return (ok, (v, w)) for this cycle, see LocalPlanner.

        As in C++, the goal is tested before any command.
        """
        self._forget_cycle()
        robot_pose = floats(pose)
        v, w = twist
        velocity = floats((v, 0.0, w))
        # NaN would spread to the flags, which outlive the cycle.
        if not all(math.isfinite(component) for component in (*robot_pose, *velocity)):
            return False, STANDING[:2]
        self.goal_reached = self.is_goal_reached(robot_pose, velocity, local_origin)
        if self.goal_reached:
            return True, STANDING[:2]
        step = self.command(robot_pose, velocity, costmap, local_origin)
        return step.ok, (step.command[0], step.command[2])

    def is_goal_reached(
        self, pose: Triple, velocity: Triple, local_origin: Optional[Triple] = None
    ) -> bool:
        """Return whether the robot stands at its goal, turned to it. False without a plan.

        May set the latch. pose, velocity, local_origin: see command.
        """
        goal_pose = self.stored_plan.goal(local_origin)
        if goal_pose is None:
            return False
        return self.stop_rotate.is_goal_reached(_wrapped(pose), velocity, goal_pose)

    def command(
        self, pose: Triple, velocity: Triple, costmap: Any, local_origin: Optional[Triple] = None
    ) -> DWAStep:
        """Return the DWAStep of one cycle: the search's choice, or a command to stop or turn.

        pose: x, y [m], yaw [rad]. velocity: measured vx, vy [m/s], w [rad/s]. local_origin: see
        LocalPlanner.
        """
        self._forget_cycle()
        x, y, _ = pose
        prunes = bool(self._params["prune_plan"])
        cropped_plan = self.stored_plan.cut(x, y, half_size(costmap), prunes, local_origin)
        goal_pose = self.stored_plan.goal(local_origin)
        if goal_pose is None or len(cropped_plan) == 0:
            return DWAStep(False, STANDING, NO_PLAN, cropped_plan)

        if not self.stop_rotate.is_position_reached(pose, goal_pose):
            choice = self.planner.find_best_path(costmap, cropped_plan, pose, velocity)
            self._searched = True
            is_legal = choice.cost >= 0
            if is_legal:
                self.cropped_plan = cropped_plan
                self._choice = choice
            return DWAStep(is_legal, choice.drive, DRIVING, cropped_plan, choice.cost, choice.count)

        # At the goal's position there is no search. The command is checked on the last search's
        # grids.
        self.planner.prepare(costmap, cropped_plan, pose, velocity)
        phase, goal_command = self.stop_rotate.command(_wrapped(pose), velocity, goal_pose)
        if phase == TURNED:
            return DWAStep(True, STANDING, phase, cropped_plan)
        cost, point_count = self.planner.check(goal_command)
        is_legal = cost >= 0
        command = goal_command if is_legal else STANDING
        return DWAStep(
            is_legal, command, phase, cropped_plan, cost, point_count, checked=goal_command
        )


def _wrapped(pose: Triple) -> Triple:
    """Return the pose with its yaw passed through a quaternion."""
    x, y, yaw = pose
    return x, y, through_quaternion(yaw)
