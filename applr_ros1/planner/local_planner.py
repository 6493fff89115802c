"""The local planner (TrajectoryPlannerROS): follows a global plan with the trajectory planner, stops and turns at its end.

Called by MoveBase once per control cycle. Rules: base_local_planner/trajectory_planner_ros.cpp, goal_functions.cpp.
"""
import math

import numpy as np
from numba import njit

from applr_ros1.planner.trajectory_planner import TrajectoryPlanner
from applr_ros1.planner.trajectory_sampling import angle_difference, wrapped

STOPPED = 0.01  # [m/s] and [rad/s]
PRUNED = 1.0  # [m]: points of the plan before the first one nearer than this are dropped
STANDING = (0.0, 0.0)
EMPTY = np.zeros((0, 3))


class LocalPlanner:
    """params: the values of the server and the static parameters of TrajectoryPlannerROS by name (parameters.py).

    footprint: padded vertices (n, 2) [m] of the local costmap. Both are kept as they are now: `reconfigure` reaches only
    the sampling; tolerances, meter_scoring, the control period and the limits of stopping and turning at the goal
    change with a restart.

    After compute_velocity: goal_reached, cropped_plan (n, 3), local_plan (k, 3), cost_cloud(costmap).
    """

    def __init__(self, params, footprint):
        frequency = params.get("controller_frequency", 20.0)
        self._period = 1.0 / frequency if frequency > 0 else 0.05
        self._xy_tolerance = params["xy_goal_tolerance"]
        self._yaw_tolerance = params["yaw_goal_tolerance"]
        self._latches = params["latch_xy_goal_tolerance"]
        self._prunes = params["prune_plan"]
        self._acceleration = params["acc_lim_x"], params["acc_lim_y"], params["acc_lim_theta"]
        self._slowest_turn = params["min_in_place_vel_theta"]
        self._fastest_turn = params["max_rotational_vel"]
        self.planner = TrajectoryPlanner(footprint, params, self._period, params["meter_scoring"])
        self.reset()

    def reset(self):
        """As a new object (training episodes): no plan, no latch, none of the planner's flags. Parameters stay."""
        self.planner.reset()
        self._rotating = False
        self._result = None
        self.cropped_plan = EMPTY
        self._local_plan = EMPTY
        self.set_plan(EMPTY)

    def reconfigure(self, params):
        """New values of the server by name, for the sampling. As in C++ the goal has to be found reached again."""
        self.planner.reconfigure(params)
        self.goal_reached = False

    def set_plan(self, plan):
        """The global plan (n, 3) x, y [m], yaw [rad] in the costmap's frame, from now on."""
        self._plan = np.array(plan, dtype=np.float64).reshape(-1, 3)
        self._latched = False
        self.goal_reached = False

    @property
    def local_plan(self):
        """(k, 3) points of the chosen trajectory; empty where the robot stops or turns at the goal."""
        return self._local_plan if self._result is None else self._result.points

    def cost_cloud(self, costmap):
        """(k, 7) float32: x, y, z, path, goal, obstacle, total cost of the last cycle's cells, for display."""
        return self.planner.cost_cloud(costmap)

    def compute_velocity(self, pose, twist, costmap):
        """(ok, (v, w)) for this cycle. pose: x, y [m], yaw [rad] in the costmap's frame; twist: measured (v, w).

        ok False: no valid command, the velocity is zero. goal_reached says whether the goal was reached in this cycle;
        it holds until the next plan or reconfigure, and whoever asks at once sees it (C++ lets a new plan clear it
        before move_base reads it).
        """
        pose = float(pose[0]), float(pose[1]), wrapped(float(pose[2]))
        velocity = float(twist[0]), float(twist[1]) if len(twist) > 2 else 0.0, wrapped(float(twist[-1]))
        cut, dropped = cut_plan(self._plan, pose[0], pose[1], *_half_size(costmap), self._prunes)
        if dropped:
            self._plan = self._plan[dropped:]
        if len(cut) == 0:
            return False, STANDING
        goal_x, goal_y, goal_yaw = cut[-1]
        if self._latched or np.hypot(goal_x - pose[0], goal_y - pose[1]) <= self._xy_tolerance:
            self._latched = self._latched or self._latches
            return self._finish(pose, velocity, wrapped(goal_yaw), cut, costmap)
        result = self._choose(pose, velocity, cut, costmap)
        self.cropped_plan = cut
        if result.cost < 0:
            self._result, self._local_plan = None, EMPTY
            return False, STANDING
        self._result = result
        return True, result.drive

    def _choose(self, pose, velocity, cut, costmap):
        self.planner.set_plan(cut)
        return self.planner.find_best_path(costmap, pose, velocity)

    def _finish(self, pose, velocity, goal_yaw, cut, costmap):
        """At the goal's place: stop, turn to its heading, done. planner_details.md, section 5, step 7."""
        if abs(angle_difference(pose[2], goal_yaw)) <= self._yaw_tolerance:
            self._rotating = self._latched = False
            self.goal_reached = True
            ok, command = True, STANDING
        else:
            self._choose(pose, velocity, cut, costmap)  # the floods are needed below, and the flags change as in C++
            if not self._rotating and max(abs(v) for v in velocity) > STOPPED:
                ok, command = self._stop(pose, velocity, costmap)
            else:
                self._rotating = True
                ok, command = self._rotate(pose, velocity, goal_yaw, costmap)
        if ok:
            self.cropped_plan, self._result, self._local_plan = cut, None, EMPTY
        return ok, command

    def _stop(self, pose, velocity, costmap):
        """Slow down as fast as the acceleration limits allow."""
        slower = tuple((-1.0 if v < 0 else 1.0) * max(0.0, abs(v) - limit * self._period)
                       for v, limit in zip(velocity, self._acceleration))
        return self._if_legal(pose, velocity, slower, costmap)

    def _rotate(self, pose, velocity, goal_yaw, costmap):
        """Turn in place to the goal's heading, no faster than the turn can be ended there."""
        error = angle_difference(pose[2], goal_yaw)
        limit = self._acceleration[2]
        w = self._turn(error)
        measured = abs(velocity[2])  # C++ forgets its sign
        speed = min(max(abs(w), measured - limit * self._period), measured + limit * self._period)
        speed = min(math.sqrt(2 * limit * abs(error)), speed)
        w = self._turn(-speed if w < 0 else speed)
        return self._if_legal(pose, velocity, (0.0, 0.0, w), costmap)

    def _turn(self, w):
        """w within the slowest and fastest turn rate, by its sign."""
        if w > 0:
            return min(self._fastest_turn, max(self._slowest_turn, w))
        return max(-self._fastest_turn, min(-self._slowest_turn, w))

    def _if_legal(self, pose, velocity, command, costmap):
        if self.planner.score(costmap, pose, velocity, command)[0] >= 0:
            return True, (command[0], command[2])
        return False, STANDING


def _half_size(costmap):
    ny, nx = costmap.cells.shape
    return nx * costmap.resolution / 2, ny * costmap.resolution / 2


def cut_plan(plan, x, y, half_x, half_y, prune):
    """(cut (k, 3), dropped): the part of `plan` (n, 3) that the robot at x, y [m] follows. goal_functions.cpp:77, 96.

    From the first point within the larger half of the map on, up to and including the first one beyond it. Pruned: not
    the leading ones that are 1 m or more away; so many (`dropped`) are also to go from the front of the stored plan,
    even where the cut begins later.
    """
    first, last, dropped = _cut(np.ascontiguousarray(plan), x, y, max(half_x, half_y), bool(prune))
    return plan[first:last].copy(), dropped


@njit(cache=True)
def _cut(plan, x, y, limit, prune):
    n = plan.shape[0]
    first = 0
    while first < n and _squared_distance(plan, first, x, y) > limit * limit:
        first += 1
    last = first
    while last < n:
        last += 1
        if _squared_distance(plan, last - 1, x, y) > limit * limit:
            break
    dropped = 0
    if prune:
        while first < last and _squared_distance(plan, first, x, y) >= PRUNED:
            first += 1
            dropped += 1
    return first, last, dropped


@njit(cache=True)
def _squared_distance(plan, i, x, y):
    dx = x - plan[i, 0]
    dy = y - plan[i, 1]
    return dx * dx + dy * dy
