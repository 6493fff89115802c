"""The local planner (TrajectoryPlannerROS): follows a plan with the trajectory planner, stops and turns at its end.

Called by MoveBase once per control cycle. Rules: base_local_planner/trajectory_planner_ros.cpp, goal_functions.cpp.
"""

from __future__ import annotations

import math
from typing import Any, Dict, Mapping, Optional, Sequence, Tuple

import numpy as np

from applr_ros1.common.angles import Pose
from applr_ros1.planner.costmap.costmap import Costmap
from applr_ros1.planner.local_planner import LocalPlanner
from applr_ros1.planner.plan_cut import cut_plan, half_size
from applr_ros1.planner.sampling_planner import Choice, angle_difference, through_quaternion
from applr_ros1.planner.trajectory.planner import TrajectoryPlanner

STOPPED = 0.01  # [m/s] and [rad/s]
STANDING = (0.0, 0.0)
EMPTY = np.zeros((0, 3))
NO_TRAJECTORIES = np.zeros((0, 5), np.float32)


class TrajectoryLocalPlanner(LocalPlanner):
    """params: the values of the server and the static parameters of TrajectoryPlannerROS by name (planner/parameters).

    footprint: padded vertices (n, 2) [m] of the local costmap. Both are kept as they are now: `reconfigure` reaches
    only the sampling. Tolerances, meter_scoring, the control period and the limits of stopping and turning at the
    goal change with a restart.

    After compute_velocity: goal_reached, cropped_plan (n, 3), local_plan (k, 3), cost_cloud(costmap).
    """

    remembers_reached = True

    def __init__(self, params: Mapping[str, Any], footprint: np.ndarray):
        frequency = params.get("controller_frequency", 20.0)
        self._period = 1.0 / frequency if frequency > 0 else 0.05
        self._xy_tolerance = params["xy_goal_tolerance"]
        self._yaw_tolerance = params["yaw_goal_tolerance"]
        self._latches = params["latch_xy_goal_tolerance"]
        self._prunes = bool(params["prune_plan"])
        self._acceleration = params["acc_lim_x"], params["acc_lim_y"], params["acc_lim_theta"]
        self._slowest_turn = params["min_in_place_rotational_vel"]
        self._fastest_turn = params["max_rotational_vel"]
        self.planner = TrajectoryPlanner(footprint, params, self._period, params["meter_scoring"])
        self.reset()

    def reset(self) -> None:
        """As a new object (training episodes): no plan, no latch, none of the planner's flags. Parameters stay."""
        self.planner.reset()
        self._rotating = False
        self._choice: Optional[Choice] = None
        self._is_blocked = False  # no sample gave a command
        self.cropped_plan = EMPTY
        self.set_plan(EMPTY)

    def reconfigure(self, params: Mapping[str, Any]) -> None:
        """New values of the server by name, for the sampling. As in C++ the goal has to be found reached again."""
        self.planner.reconfigure(params)
        self.goal_reached = False

    def set_plan(self, plan: np.ndarray) -> None:
        """The global plan (n, 3) x, y [m], yaw [rad], from now on."""
        self._plan = np.array(plan, dtype=np.float64, order="C").reshape(-1, 3)
        self._latched = False
        self.goal_reached = False

    def end_escape(self) -> None:
        """The next cycle samples forward velocities again."""
        self.planner.end_escape()

    @property
    def local_plan(self) -> np.ndarray:
        """(k, 3) points of the chosen trajectory; empty where the robot stops or turns at the goal."""
        return EMPTY if self._choice is None else self._choice.points

    def cost_cloud(self, costmap: Costmap) -> np.ndarray:
        """(k, 7) float32: x, y, z, path, goal, obstacle, total cost of the last cycle's cells, for display."""
        return self.planner.cost_cloud(costmap)

    def trajectory_cloud(self, costmap: Costmap) -> np.ndarray:
        """(k, 5) float32: x, y, z, theta, cost of points of the legal forward samples of the last cycle, for display.

        Empty where the robot stops or turns at the goal, and without a valid command.
        """
        return NO_TRAJECTORIES if self._choice is None else self.planner.trajectory_cloud(costmap)

    def refusals(self, costmap: Costmap) -> Dict[str, int]:
        """Count the forward samples refused, by reason, where not even backing up was legal; see LocalPlanner."""
        return self.planner.refusals(costmap) if self._is_blocked else {}

    def compute_velocity(
        self, pose: Sequence[float], twist: Sequence[float], costmap: Costmap, local_origin: Optional[Pose] = None
    ) -> Tuple[bool, Tuple[float, float]]:
        """(ok, (v, w)) for this cycle. pose: x, y [m], yaw [rad] in the costmap's frame; twist: measured (v, w).

        ok False: no valid command, the velocity is zero. goal_reached tells whether the goal was found reached; it
        holds until the next plan or reconfigure, so it is to be read at once (in C++ a new plan comes in between).
        """
        self.cropped_plan, self._choice, self._is_blocked = EMPTY, None, False
        x, y, yaw = (float(v) for v in pose)
        v, w = (float(v) for v in twist)
        if not math.isfinite(x + y + yaw + v + w):
            return False, STANDING
        cut, dropped = cut_plan(self._plan, x, y, half_size(costmap), self._prunes, local_origin)
        if dropped:
            self._plan = self._plan[dropped:]
        if len(cut) == 0:
            return False, STANDING
        goal_x, goal_y, goal_yaw = cut[-1].tolist()
        heading, goal_yaw = through_quaternion(yaw), through_quaternion(goal_yaw)
        at_goal = self._latched or np.hypot(goal_x - x, goal_y - y) <= self._xy_tolerance
        if at_goal and self._latches:
            self._latched = True
        if at_goal and abs(angle_difference(heading, goal_yaw)) <= self._yaw_tolerance:
            self._rotating = self._latched = False
            self.goal_reached = True
            self.cropped_plan = cut
            return True, STANDING

        self.planner.set_plan(cut)
        choice = self.planner.find_best_path(costmap, (x, y, yaw), (v, 0.0, w))
        if at_goal:  # the choice is ignored; its floods are needed below, and its flags change as in C++
            ok, command = self._stop_or_turn((x, y, heading), (v, 0.0, through_quaternion(w)), goal_yaw, costmap)
            if ok:
                self.cropped_plan = cut
            return ok, command
        legal = choice.cost >= 0
        self.cropped_plan, self._choice, self._is_blocked = cut, choice if legal else None, not legal
        return legal, (choice.drive[0], choice.drive[2])

    def _stop_or_turn(self, pose, velocity, goal_yaw, costmap):
        """At the goal's place: once the robot has stopped it turns to the goal's heading."""
        if not self._rotating and max(abs(v) for v in velocity) > STOPPED:
            return self._if_legal(pose, velocity, self._slower(velocity), costmap)
        self._rotating = True
        return self._if_legal(pose, velocity, (0.0, 0.0, self._turn(pose[2], velocity[2], goal_yaw)), costmap)

    def _slower(self, velocity):
        """The velocity after one period of braking as hard as the acceleration limits allow."""
        return tuple(
            math.copysign(max(0.0, abs(v) - limit * self._period), v) for v, limit in zip(velocity, self._acceleration)
        )

    def _turn(self, yaw, w, goal_yaw):
        """Turn rate [rad/s] towards the goal's heading, no faster than the turn can be ended there."""
        error = angle_difference(yaw, goal_yaw)
        limit = self._acceleration[2]
        wanted = self._clamped(error)
        speed = min(max(abs(wanted), abs(w) - limit * self._period), abs(w) + limit * self._period)
        speed = min(math.sqrt(2 * limit * abs(error)), speed)
        return self._clamped(-speed if wanted < 0 else speed)

    def _clamped(self, w):
        """The turn rate w moved between the slowest and the fastest one, by its sign."""
        if w > 0:
            return min(self._fastest_turn, max(self._slowest_turn, w))
        return max(-self._fastest_turn, min(-self._slowest_turn, w))

    def _if_legal(self, pose, velocity, command, costmap):
        if self.planner.score(costmap, pose, velocity, command)[0] >= 0:
            return True, (command[0], command[2])
        return False, STANDING
