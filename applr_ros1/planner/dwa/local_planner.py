"""Local planner DWAPlannerROS: follows a plan with the DWA planner, then stops and turns at its end.

Called by MoveBase once per control cycle. See docs/explanation/planner_dwa.md: section 2 for the cut of the global plan
(LocalPlannerUtil), section 8 for a cycle and for stopping and turning at the goal (LatchedStopRotateController). As in
C++, angles pass through a quaternion.
"""

import math
from typing import Any, Dict, Mapping, NamedTuple, Optional, Sequence, Tuple

import numpy as np

from applr_ros1.common.angles import Pose, inverse
from applr_ros1.planner.dwa.planner import DWAPlanner
from applr_ros1.planner.local_planner import Command, LocalPlanner
from applr_ros1.planner.plan_cut import cut_plan, half_size, transformed
from applr_ros1.planner.sampling_planner import (
    Choice,
    Triple,
    angle_difference,
    floats,
    through_quaternion,
)

EMPTY = np.zeros((0, 3))


class LocalPlan:
    """Stored global plan, cut anew in every cycle. Pruning removes poses at its front permanently."""

    def __init__(self) -> None:
        self.poses = EMPTY

    def set(self, plan: np.ndarray) -> None:
        """Store a plan (n, 3) x, y [m], yaw [rad]. n may be 0."""
        self.poses = np.array(plan, dtype=np.float64, order="C").reshape(-1, 3)

    def goal(self, local_origin: Optional[Pose] = None) -> Optional[Pose]:
        """Return the last pose (x, y, yaw) of the plan in the costmap's frame, or None. local_origin: see cut."""
        if len(self.poses) == 0:
            return None
        x, y, yaw = transformed(
            self.poses[-1:], None if local_origin is None else inverse(local_origin)
        )[0].tolist()
        return x, y, yaw

    def cut(
        self, x: float, y: float, limit: float, prune: bool, local_origin: Optional[Pose] = None
    ) -> np.ndarray:
        """Return the poses (k, 3) of the plan near the robot at x, y [m], in the costmap's frame (see cut_plan).

        prune: whether to drop the leading poses that are at least 1 m away, and as many from the front of the stored
        plan. local_origin: pose (x, y, yaw) of the costmap's frame in the plan's frame, None for the same frame.
        """
        cut, dropped = cut_plan(self.poses, x, y, limit, prune, local_origin)
        self.poses = self.poses[dropped:]
        return (
            cut if local_origin is not None else transformed(cut, None)
        )  # C++ applies the identity, too.


STOPPING, TURNING, TURNED = "stopping", "turning", "turned"
STANDING = (0.0, 0.0, 0.0)
LIMITS = ("acc_lim_x", "acc_lim_y", "acc_lim_theta")


class StopRotate:
    """Controller that stops the robot at the goal's position and then turns it to the goal's yaw.

    Args:
        params: values of the DWAPlannerROS server {name: value}.
        period: control period [s].
        latches: whether a reached position stays reached until the next plan.
    """

    def __init__(self, params: Mapping[str, Any], period: float, latches: bool):
        self._period, self._latches = period, latches
        self.reconfigure(params)
        self.reset()

    def reconfigure(self, params: Mapping[str, Any]) -> None:
        """Apply the server's parameter values {name: value}."""
        self._params = params
        self._acceleration = [float(np.float32(params[name])) for name in LIMITS]

    def reset(self) -> None:
        """Clear the latch and the turning phase. A new plan clears only the latch."""
        self.rotating = False
        self.latched = False

    def new_plan(self) -> None:
        """Clear the latch, so that the goal's position must be reached again."""
        self.latched = False

    def is_position_reached(self, pose: Triple, goal: Triple) -> bool:
        """Return whether `pose` is within xy_goal_tolerance of `goal`, both (x, y, yaw). If so, set the latch."""
        if self._latches and self.latched:
            return True
        if np.hypot(goal[0] - pose[0], goal[1] - pose[1]) <= self._params["xy_goal_tolerance"]:
            self.latched = True
            return True
        return False

    def is_goal_reached(self, pose: Triple, velocity: Triple, goal: Triple) -> bool:
        """Return whether the robot stands at its goal, turned to it. velocity: vx, vy [m/s], w [rad/s]."""
        return (
            self.is_position_reached(pose, goal)
            and self._is_turned(pose, goal)
            and self.is_stopped(velocity)
        )

    def _is_turned(self, pose: Triple, goal: Triple) -> bool:
        return bool(abs(angle_difference(pose[2], goal[2])) <= self._params["yaw_goal_tolerance"])

    def is_stopped(self, velocity: Triple) -> bool:
        """Return whether the measured velocity counts as standing."""
        vx, vy, w = velocity
        slow = self._params["trans_stopped_vel"]
        return bool(
            abs(w) <= self._params["theta_stopped_vel"] and abs(vx) <= slow and abs(vy) <= slow
        )

    def command(self, pose: Triple, velocity: Triple, goal: Triple) -> Tuple[str, Triple]:
        """Return (phase, (vx, vy, w)) at the goal's position: STOPPING, then TURNING, then TURNED with zero velocity.

        velocity: as measured. As in C++, w passes through a quaternion, like an angle, except in the standstill test.
        """
        if self._is_turned(pose, goal):
            self.rotating = False
            return TURNED, STANDING
        vx, vy, w = velocity[0], velocity[1], through_quaternion(velocity[2])
        if not self.rotating and not self.is_stopped(velocity):
            return STOPPING, self._slower((vx, vy, w))
        self.rotating = True
        return TURNING, (0.0, 0.0, self._turn(angle_difference(pose[2], goal[2]), w))

    def _slower(self, velocity: Triple) -> Triple:
        """Return the velocity after one period of braking at the acceleration limits."""
        pairs = zip(velocity, self._acceleration)
        return floats(
            (-1.0 if v < 0 else 1.0) * max(0.0, abs(v) - limit * self._period) for v, limit in pairs
        )

    def _turn(self, error: float, w: float) -> float:
        """Return a turn rate [rad/s] towards the goal's yaw, `error` [rad] away, at which the robot can still stop."""
        limit = self._acceleration[2]
        change = limit * self._period
        speed = min(max(self._clamped(abs(error)), abs(w) - change), abs(w) + change)
        speed = self._clamped(min(math.sqrt(float(np.float32(2.0 * limit)) * abs(error)), speed))
        return -speed if error < 0 else speed

    def _clamped(self, w: float) -> float:
        return float(min(self._params["max_vel_theta"], max(self._params["min_vel_theta"], w)))


NO_COSTS, NO_TRAJECTORIES = np.zeros((0, 7), np.float32), np.zeros((0, 5), np.float32)
NO_PLAN, DRIVING = "no plan", "driving"  # phases in addition to STOPPING, TURNING and TURNED


class Step(NamedTuple):
    """Outcome of one cycle."""

    ok: bool
    command: Tuple[float, float, float]  # command (vx, vy [m/s], w [rad/s]), zero if not ok
    phase: str
    cut: np.ndarray  # part (k, 3) of the plan that was followed
    cost: float = 0.0  # cost of the chosen or checked trajectory, negative if illegal
    count: int = 0  # type: ignore[assignment]  # number of that trajectory's points; hides tuple.count
    checked: Tuple[float, float, float] = (
        STANDING  # command that was checked at the goal's position
    )


class DWALocalPlanner(LocalPlanner):
    """Local planner DWAPlannerROS. Each cycle uses the current footprint of the costmap.

    params: {name: value} of all parameters of DWAPlannerROS, static ones included. `reconfigure` applies all values at
    once. The control period, sum_scores, cheat_factor and the latch change only with a restart.
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
        """Clear plan, latch and the planner's flags, as in a new object (for training episodes). Parameters stay."""
        self.planner.reset()
        self.stop_rotate.reset()
        self.set_plan(EMPTY)
        self._forget_cycle()

    def _forget_cycle(self) -> None:
        """Clear the state that belongs to a single cycle."""
        self.goal_reached, self._searched = False, False
        self.cropped_plan = EMPTY
        self._choice: Optional[Choice] = None

    def reconfigure(self, params: Mapping[str, Any]) -> None:
        """Apply new values {name: value} of some or all parameters of the server. Flags, latches and the plan stay."""
        wanted = dict(self._params, **params)
        self.planner.reconfigure(wanted)
        self.stop_rotate.reconfigure(wanted)
        self._params = wanted

    def set_plan(self, plan: np.ndarray) -> None:
        """Follow the global plan (n, 3) x, y [m], yaw [rad] from now on."""
        self.stored_plan.set(plan)
        self.planner.clear_flags()
        self.stop_rotate.new_plan()
        self.goal_reached = False

    @property
    def local_plan(self) -> np.ndarray:
        """Points (k, 3) of this cycle's trajectory, empty if the robot stops or turns at the goal."""
        return EMPTY if self._choice is None else self._choice.points

    def cost_cloud(self, costmap: Any) -> np.ndarray:
        """Return (k, 7) float32 x, y, z, path, goal, obstacle, total cost of the last search's cells, for display."""
        return self.planner.cost_cloud(costmap) if self._searched else NO_COSTS

    def trajectory_cloud(self, costmap: Any) -> np.ndarray:
        """Return points (k, 5) float32 x, y, z, theta, cost of all legal trajectories of the last search."""
        return NO_TRAJECTORIES if self._choice is None else self.planner.trajectory_cloud()

    def refusals(self, costmap: Any) -> Dict[str, int]:
        """Count the samples that each critic rejected in a search without a legal sample, see LocalPlanner."""
        return self.planner.refusals() if self._searched and self._choice is None else {}

    def compute_velocity(
        self,
        pose: Sequence[float],
        twist: Sequence[float],
        costmap: Any,
        local_origin: Optional[Pose] = None,
    ) -> Tuple[bool, Command]:
        """Return (ok, (v, w)) for this cycle, see LocalPlanner. As in C++, the goal is tested before any command."""
        self._forget_cycle()
        place = floats(pose)
        v, w = (float(v) for v in twist)
        if not all(map(math.isfinite, (*place, v, w))):
            return False, STANDING[:2]
        self.goal_reached = self.is_goal_reached(place, (v, 0.0, w), local_origin)
        if self.goal_reached:
            return True, STANDING[:2]
        step = self.command(place, (v, 0.0, w), costmap, local_origin)
        return step.ok, (step.command[0], step.command[2])

    def is_goal_reached(
        self, pose: Triple, velocity: Triple, local_origin: Optional[Triple] = None
    ) -> bool:
        """Return whether the robot stands at its goal, turned to it. False without a plan. May set the latch."""
        goal = self.stored_plan.goal(local_origin)
        return goal is not None and self.stop_rotate.is_goal_reached(_wrapped(pose), velocity, goal)

    def command(
        self, pose: Triple, velocity: Triple, costmap: Any, local_origin: Optional[Triple] = None
    ) -> Step:
        """Return the Step of one cycle: the search's choice, or the command to stop or turn at the goal's position.

        pose: x, y [m], yaw [rad]. velocity: measured vx, vy [m/s], w [rad/s]. local_origin: see LocalPlanner.
        """
        self._forget_cycle()
        cut = self.stored_plan.cut(
            pose[0], pose[1], half_size(costmap), bool(self._params["prune_plan"]), local_origin
        )
        goal = self.stored_plan.goal(local_origin)
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


def _wrapped(pose: Triple) -> Triple:
    """Return the pose with its yaw passed through a quaternion."""
    return pose[0], pose[1], through_quaternion(pose[2])
