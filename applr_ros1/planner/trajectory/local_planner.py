"""Local planner TrajectoryPlannerROS: follows a plan, then stops and turns at its end.

Called by MoveBase once per control cycle. The rules are those of
base_local_planner/trajectory_planner_ros.cpp and goal_functions.cpp.
"""

from __future__ import annotations

import math
from typing import Any, Dict, Mapping, Optional, Sequence, Tuple

import numpy as np

from applr_ros1.common.angles import Pose, Twist
from applr_ros1.planner.costmap.costmap import Costmap
from applr_ros1.planner.local_planner import NO_POSES, LocalPlanner
from applr_ros1.planner.plan_cut import cut_plan, half_size
from applr_ros1.planner.sampling_planner import (
    Triple,
    angle_difference,
    braked,
    floats,
    through_quaternion,
    turn_speed,
)
from applr_ros1.planner.trajectory.planner import TrajectoryPlanner

STOPPED_VELOCITY = 0.01  # velocity up to which the robot counts as stopped [m/s, rad/s]
STANDING = (0.0, 0.0)
NO_TRAJECTORIES = np.zeros((0, 5), np.float32)


class TrajectoryLocalPlanner(LocalPlanner):
    """Local planner TrajectoryPlannerROS.

    As in C++, `reconfigure` affects only the sampling. Tolerances, meter_scoring, the control
    period and the limits for stopping and turning at the goal change only with a restart.

    Args:
        params: {name: value} of all parameters of TrajectoryPlannerROS, static ones included
            (planner/parameters).
        footprint: padded vertices (n, 2) of the local costmap's footprint [m].
    """

    remembers_reached = True

    def __init__(self, params: Mapping[str, Any], footprint: np.ndarray):
        control_frequency = params.get("controller_frequency", 20.0)
        self._period = 1.0 / control_frequency if control_frequency > 0 else 0.05
        self._xy_tolerance = params["xy_goal_tolerance"]
        self._yaw_tolerance = params["yaw_goal_tolerance"]
        self._latches = params["latch_xy_goal_tolerance"]
        self._prunes = bool(params["prune_plan"])
        self.accelerations = (params["acc_lim_x"], params["acc_lim_y"], params["acc_lim_theta"])
        self.slowest_turn: float = params["min_in_place_rotational_vel"]
        self.fastest_turn: float = params["max_rotational_vel"]
        self.planner = TrajectoryPlanner(footprint, params, self._period, params["meter_scoring"])
        self.is_turning = False
        self._forget_cycle()
        self.set_plan(NO_POSES)

    def _forget_cycle(self) -> None:
        """Clear the state that belongs to a single cycle."""
        self.cropped_plan = NO_POSES
        self._choice = None
        self._is_blocked = False  # whether the search found no legal command

    def reconfigure(self, params: Mapping[str, Any]) -> None:
        """Apply new values {name: value} of the server to the sampling.

        As in C++, goal_reached is cleared.
        """
        self.planner.reconfigure(params)
        self.goal_reached = False

    def set_plan(self, plan: np.ndarray) -> None:
        """Follow the global plan (n, 3) x, y [m], yaw [rad] from now on."""
        # As in TrajectoryPlannerROS::setPlan, the goal's position must be reached anew.
        self._plan = np.array(plan, dtype=np.float64, order="C").reshape(-1, 3)
        self._latched = False
        self.goal_reached = False

    def end_escape(self) -> None:
        """Sample forward velocities again in the next cycle."""
        self.planner.end_escape()

    def cost_cloud(self, costmap: Costmap) -> np.ndarray:
        """Return costs (k, 7) of the last cycle's cells, see TrajectoryPlanner.cost_cloud."""
        return self.planner.cost_cloud(costmap)

    def trajectory_cloud(self, costmap: Costmap) -> np.ndarray:
        """Return points (k, 5) of the last cycle's legal forward samples, for display.

        The columns are float32: x, y, z, theta, cost.
        It is empty if the robot stops or turns at the goal, or if there
        is no valid command.
        """
        if self._choice is None:
            return NO_TRAJECTORIES
        return self.planner.trajectory_cloud(costmap)

    def refusals(self, costmap: Costmap) -> Dict[str, int]:
        """Count the rejected samples by reason if nothing was legal, see LocalPlanner."""
        if not self._is_blocked:
            return {}
        return self.planner.refusals(costmap)

    def compute_velocity(
        self,
        pose: Sequence[float],
        twist: Sequence[float],
        costmap: Costmap,
        local_origin: Optional[Pose] = None,
    ) -> Tuple[bool, Twist]:
        """Return (ok, (v, w)) for this cycle, see LocalPlanner.

        goal_reached holds until the next plan or reconfigure, so read it at once. In C++, a new
        plan may clear it.
        """
        self._forget_cycle()
        x, y, yaw = floats(pose)
        v, _, w = floats((twist[0], 0.0, twist[1]))
        # NaN would spread to the flags, which outlive the cycle.
        if not math.isfinite(x + y + yaw + v + w):
            return False, STANDING
        cropped_plan, dropped_count = cut_plan(
            self._plan, x, y, half_size(costmap), self._prunes, local_origin
        )
        if dropped_count:
            self._plan = self._plan[dropped_count:]
        if len(cropped_plan) == 0:
            return False, STANDING

        # The goal is the end of the cropped plan, even while the plan goes on beyond it.
        goal_x, goal_y, goal_yaw = cropped_plan[-1].tolist()
        goal_yaw = through_quaternion(goal_yaw)
        heading = through_quaternion(yaw)
        at_goal = self._latched or np.hypot(goal_x - x, goal_y - y) <= self._xy_tolerance
        if at_goal and self._latches:
            self._latched = True
        if at_goal and abs(angle_difference(heading, goal_yaw)) <= self._yaw_tolerance:
            self.is_turning = False
            self._latched = False
            self.goal_reached = True
            self.cropped_plan = cropped_plan
            return True, STANDING

        self.planner.set_plan(cropped_plan)
        choice = self.planner.find_best_path(costmap, (x, y, yaw), (v, 0.0, w))
        if not at_goal:
            self.cropped_plan = cropped_plan
            self._is_blocked = choice.cost < 0
            if not self._is_blocked:
                self._choice = choice
            return not self._is_blocked, (choice.drive[0], choice.drive[2])

        # The choice is ignored, but its floods are used below, and the flags change as in C++.
        velocity = (v, 0.0, through_quaternion(w))
        is_legal, command = self._stop_or_turn((x, y, heading), velocity, goal_yaw, costmap)
        if is_legal:
            self.cropped_plan = cropped_plan
        return is_legal, command

    def _stop_or_turn(
        self, pose: Triple, velocity: Triple, goal_yaw: float, costmap: Costmap
    ) -> Tuple[bool, Twist]:
        """Return (ok, (v, w)) that stops the robot, then turns it to the goal's yaw."""
        # Once the robot turns, it does not stand, and must not be stopped again.
        is_standing = max(abs(component) for component in velocity) <= STOPPED_VELOCITY
        if not self.is_turning and not is_standing:
            command = braked(velocity, self.accelerations, self._period)
        else:
            self.is_turning = True
            command = (0.0, 0.0, self._turn(pose[2], velocity[2], goal_yaw))
        if self.planner.score(costmap, pose, velocity, command).cost < 0:
            return False, STANDING
        return True, (command[0], command[2])

    def _turn(self, yaw: float, w: float, goal_yaw: float) -> float:
        """Return a turn rate [rad/s] towards the goal's yaw that lets the robot stop there.

        yaw, goal_yaw: headings of robot and goal [rad]. w: measured turn rate [rad/s].
        """
        yaw_error = angle_difference(yaw, goal_yaw)
        wanted_rate = self._clamped(yaw_error)
        speed = turn_speed(yaw_error, abs(wanted_rate), w, self.accelerations[2], self._period)
        return self._clamped(-speed if wanted_rate < 0 else speed)

    def _clamped(self, w: float) -> float:
        """Clamp the turn rate w between the slowest and the fastest one of its sign."""
        if w > 0:
            return min(self.fastest_turn, max(self.slowest_turn, w))
        return max(-self.fastest_turn, min(-self.slowest_turn, w))
