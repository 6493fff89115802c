"""The local planner (DWAPlannerROS): follows a plan with the DWA planner, stops and turns at its end.

Called by MoveBase once per control cycle. docs/explanation/planner_dwa.md section 8.
"""

import math
from typing import Any, Mapping, NamedTuple, Optional, Tuple

import numpy as np

from applr_ros1.planner.angles import normalize_angle
from applr_ros1.planner.dwa.local_plan import EMPTY, LocalPlan
from applr_ros1.planner.dwa.planner import Choice, DWAPlanner
from applr_ros1.planner.dwa.stop_rotate import STANDING, TURNED, StopRotate, Triple
from applr_ros1.planner.local_planner import Command, LocalPlanner
from applr_ros1.planner.plan_cut import half_size

NO_COSTS, NO_TRAJECTORIES = np.zeros((0, 7), np.float32), np.zeros((0, 5), np.float32)
NO_PLAN, DRIVING = "no plan", "driving"  # beside STOPPING, TURNING and TURNED


class Step(NamedTuple):
    """What one cycle did."""

    ok: bool
    command: Tuple[float, float, float]  # vx, vy [m/s], w [rad/s]; zero if not ok
    phase: str
    cut: np.ndarray  # (k, 3), the part of the plan that was followed
    cost: float = 0.0  # of the trajectory that was chosen or checked; negative if illegal
    count: int = 0  # type: ignore[assignment]  # of its points; tuple.count is not used
    checked: Tuple[float, float, float] = STANDING  # the command that was checked at the goal's place


class DWALocalPlanner(LocalPlanner):
    """params: the values of the server and the static parameters of DWAPlannerROS by name.

    The server's values are all in force at once after `reconfigure`; the control period, sum_scores, cheat_factor and
    the latch change with a restart. The footprint is the costmap's of each cycle.
    """

    def __init__(self, params: Mapping[str, Any]):
        frequency = params["controller_frequency"]
        period = 1.0 / frequency if frequency > 0 else 0.05
        self.planner = DWAPlanner(params, period, params["sum_scores"], params["cheat_factor"])
        self.stop_rotate = StopRotate(params, period, params["latch_xy_goal_tolerance"])
        self._params = dict(params)
        self.stored_plan = LocalPlan()
        self.reset()

    def reset(self) -> None:
        """As a new object (training episodes): no plan, no latch, none of the planner's flags. Parameters stay."""
        self.planner.reset()
        self.stop_rotate.reset()
        self.set_plan(EMPTY)
        self._forget_cycle()

    def _forget_cycle(self):
        """What belongs to one cycle alone."""
        self.goal_reached, self._searched = False, False
        self.cropped_plan = EMPTY
        self._choice: Optional[Choice] = None

    def reconfigure(self, params: Mapping[str, Any]) -> None:
        """New values of the server by name, some or all. Flags, latches and the plan stay."""
        wanted = dict(self._params, **params)
        self.planner.reconfigure(wanted)
        self.stop_rotate.reconfigure(wanted)
        self._params = wanted

    def set_plan(self, plan: np.ndarray) -> None:
        """The global plan (n, 3) x, y [m], yaw [rad], from now on."""
        self.stored_plan.set(plan)
        self.planner.clear_flags()
        self.stop_rotate.new_plan()
        self.goal_reached = False

    @property
    def local_plan(self) -> np.ndarray:
        """(k, 3) points of the chosen trajectory; empty where the robot stops or turns at the goal."""
        return EMPTY if self._choice is None else self._choice.points

    def cost_cloud(self, costmap: Any) -> np.ndarray:
        """(k, 7) float32: x, y, z, path, goal, obstacle, total cost of the last search's cells, for display."""
        return self.planner.cost_cloud(costmap) if self._searched else NO_COSTS

    def trajectory_cloud(self, costmap: Any) -> np.ndarray:
        """(k, 5) float32: x, y, z, theta, cost of the points of all legal trajectories of the last search."""
        return NO_TRAJECTORIES if self._choice is None else self.planner.trajectory_cloud()

    def compute_velocity(self, pose, twist, costmap: Any, frame: Optional[Triple] = None) -> Tuple[bool, Command]:
        """(ok, (v, w)) for this cycle, see LocalPlanner. The goal is looked for before any command, as in C++."""
        self._forget_cycle()
        pose = tuple(float(v) for v in pose)
        v, w = (float(v) for v in twist)
        if not all(math.isfinite(v) for v in pose + (v, w)):
            return False, STANDING[:2]
        self.goal_reached = self.is_goal_reached(pose, (v, 0.0, w), frame)
        if self.goal_reached:
            return True, STANDING[:2]
        step = self.command(pose, (v, 0.0, w), costmap, frame)
        return step.ok, (step.command[0], step.command[2])

    def is_goal_reached(self, pose: Triple, velocity: Triple, frame: Optional[Triple] = None) -> bool:
        """Whether place and heading are reached and the robot stands; False without a plan. Sets the latch."""
        goal = self.stored_plan.goal(frame)
        return goal is not None and self.stop_rotate.is_goal_reached(_wrapped(pose), velocity, goal)

    def command(self, pose: Triple, velocity: Triple, costmap: Any, frame: Optional[Triple] = None) -> Step:
        """One cycle's Step: the search's choice, or at the goal's place the command to stop or turn.

        pose: x, y [m], yaw [rad]; velocity: vx, vy [m/s], w [rad/s] as measured; frame: as in LocalPlanner.
        """
        self._forget_cycle()
        cut = self.stored_plan.cut(pose[0], pose[1], half_size(costmap), bool(self._params["prune_plan"]), frame)
        goal = self.stored_plan.goal(frame)
        if goal is None or len(cut) == 0:
            return Step(False, STANDING, NO_PLAN, cut)
        if not self.stop_rotate.is_position_reached(pose, goal):
            choice = self.planner.find_best_path(costmap, cut, pose, velocity)
            ok, self._searched = choice.cost >= 0, True
            if ok:
                self.cropped_plan, self._choice = cut, choice
            return Step(ok, choice.drive, DRIVING, cut, choice.cost, choice.count)
        self.planner.prepare(costmap, cut, pose, velocity)
        phase, wanted = self.stop_rotate.command(_wrapped(pose), velocity, goal)
        if phase == TURNED:
            return Step(True, STANDING, phase, cut)
        cost, count = self.planner.check(wanted)
        ok = cost >= 0
        return Step(ok, wanted if ok else STANDING, phase, cut, cost, count, wanted)


def _wrapped(pose):
    """The pose with its angle gone through a quaternion."""
    return pose[0], pose[1], normalize_angle(pose[2])
