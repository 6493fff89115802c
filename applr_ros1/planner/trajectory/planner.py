"""Trajectory planner (base_local_planner::TrajectoryPlanner) that chooses one velocity per cycle.

local_planner.py builds a controller on this planner. The arithmetic is in sampling.py and its
kernels.
"""

from __future__ import annotations

from functools import partial
from typing import Any, Collection, Dict, Mapping, Optional, Sequence, Tuple

import numpy as np

from applr_ros1.common.angles import Twist
from applr_ros1.planner.costmap.costmap import Costmap
from applr_ros1.planner.costmap.footprint_cost import line_offsets
from applr_ros1.planner.distance_grid import complete
from applr_ros1.planner.sampling_planner import (
    GOAL_TERM,
    OBSTACLE_TERM,
    PATH_TERM,
    CostParts,
    CostTerm,
    CycleChoice,
    SamplingPlanner,
    Velocity,
    cost_cloud,
    floats,
    follow_sample,
    start_record,
    trajectory_cloud,
)
from applr_ros1.planner.trajectory.records import (
    PARAMETERS,
    STATE,
    TrajectoryScene,
    allocate_grids,
    allocate_scratch,
)
from applr_ros1.planner.trajectory.sampling import find_best_path, remember
from applr_ros1.planner.trajectory.scoring import Score, roll_out, score, score_all_samples

NO_PLAN = np.zeros((0, 2))
# Fields of PARAMETERS with the weights of the parts of a cost
SCALES = {
    PATH_TERM: "path_scale",
    GOAL_TERM: "goal_scale",
    OBSTACLE_TERM: "occdist_scale",
}


class TrajectoryPlanner(SamplingPlanner):
    """Trajectory planner with velocity sampling.

    Args:
        footprint: padded vertices (n, 2) [m].
        params: values of the TrajectoryPlannerROS server by name.
        sim_period: control period [s]. The dynamic window holds the velocities that can be reached
            within it.
        meter_scoring: whether the two distance weights are per metre instead of per cell.

    Attributes:
        footprint: see above.

    Raises:
        ParameterError: a parameter is invalid.
    """

    PARAMETERS = PARAMETERS
    STATE = STATE
    SAMPLES = ("vx_samples", "vtheta_samples")
    DERIVED = ("path_scale", "goal_scale", "sim_period")

    def __init__(
        self,
        footprint: np.ndarray,
        params: Mapping[str, Any],
        sim_period: float = 0.05,
        meter_scoring: bool = True,
    ):
        self.footprint = np.ascontiguousarray(footprint, dtype=np.float64).reshape(-1, 2)
        self._meter_scoring = bool(meter_scoring)
        self._sim_period = float(sim_period)
        self._plan = NO_PLAN
        super().__init__(params)

    def _derive(self, record: np.ndarray, resolution: Optional[float]) -> None:
        # C++ scales the two weights as soon as it knows the costmap
        # (TrajectoryPlannerROS::initialize).
        record["sim_period"] = self._sim_period
        weight_per_cell = 1.0
        if self._meter_scoring and resolution is not None:
            weight_per_cell = resolution
        record["path_scale"] = weight_per_cell * record["path_distance_bias"]
        record["goal_scale"] = weight_per_cell * record["goal_distance_bias"]

    def _allocate_scratch(self, *samples: int) -> Any:
        return allocate_scratch(*samples)

    def end_escape(self) -> None:
        """Sample forward velocities again, although the robot has not backed out far enough."""
        self._state[0]["escaping"] = 0

    def remember(self, pose: Sequence[float], v: float, w: float) -> None:
        """Update the flags as if the last cycle had chosen the command (v, w) at a pose.

        The robot backs out if v < 0.
        """
        # Backing out follows a cycle in which nothing was legal, of a cost above NO_PATH.
        start = start_record((*pose, 0.0, 0.0, 0.0))
        is_legal = v >= 0
        cost = 0.0 if is_legal else -1.0
        remember(self._params[0], self._state[0], start, cost, v, w, is_legal)

    def sample_costs(
        self, costmap: Costmap, command: Sequence[float]
    ) -> Tuple[np.ndarray, np.ndarray, CostParts]:
        """Return velocities, costs and their parts of the last forward samples and a command.

        The cost of an illegal sample is negative, its parts are 0.

        Args:
            costmap: map of that cycle.
            command: v [m/s], w [rad/s]. It comes after the samples.

        Returns:
            v, w (m, 2), costs (m,), and by term each part of the costs (m,).
        """
        samples = []
        for v in self._scratch.speeds.tolist():
            for w in (0.0, *self._scratch.turn_rates.tolist()):
                samples.append((v, w))
        samples.append((float(command[0]), float(command[1])))

        # A part is the cost when only its weight is not 0.
        costs = self._costs(costmap, samples, SCALES)
        cost_parts = {}
        for term in SCALES:
            cost_parts[term] = np.maximum(self._costs(costmap, samples, (term,)), 0.0)
        return np.array(samples), costs, cost_parts

    def _costs(
        self, costmap: Costmap, samples: Sequence[Twist], terms: Collection[CostTerm]
    ) -> np.ndarray:
        """Return the costs (m,) of samples (v, w) if only the weights of these terms are not 0."""
        scene = self._scene_of(costmap)
        start = self._scratch.start[0]
        params = self._params.copy()
        for term, field_name in SCALES.items():
            if term not in terms:
                params[field_name] = 0.0
        costs = []
        for v, w in samples:
            costs.append(score(params, scene, self._grids, start, Velocity(v, 0.0, w)).cost)
        return np.array(costs)

    def set_plan(self, plan: np.ndarray) -> None:
        """Follow the plan (n, 2 or more) [m], in the costmap's frame, from now on. n may be 0."""
        # The kernels are compiled only for a contiguous array in C order.
        self._plan = np.array(plan[:, :2], dtype=np.float64, order="C")

    def find_best_path(
        self, costmap: Costmap, pose: Sequence[float], velocity: Sequence[float]
    ) -> CycleChoice:
        """Run one cycle: floods, samples, winner, flags.

        Args:
            costmap: map with cells (ny, nx) uint8, origin (x, y) [m] and resolution [m].
            pose: x, y [m], yaw [rad].
            velocity: vx, vy [m/s], w [rad/s].
        """
        scene = self._scene_of(costmap)
        winner = find_best_path(
            self._params,
            self._state,
            self._grids,
            self._scratch,
            scene,
            floats(pose),
            floats(velocity),
        )
        sample = Velocity(winner.vx, 0.0, winner.w)
        command = (winner.command_vx, 0.0, winner.command_w)
        # The next cycle overwrites the record, so the choice keeps its values.
        start = self._scratch.start[0].item()
        follow = partial(follow_sample, roll_out, self._params[0], start, sample)
        return CycleChoice(winner.cost, sample, command, winner.point_count, follow)

    def score(
        self,
        costmap: Costmap,
        pose: Sequence[float],
        velocity: Sequence[float],
        sample: Sequence[float],
    ) -> Score:
        """Return the score of a sample (vx, vy, w) on the last cycle's grids.

        Pose and velocity are used in double precision. The cost is negative if the sample is
        illegal.
        """
        start = start_record((*pose, *velocity))
        scene = self._scene_of(costmap)
        return score(self._params, scene, self._grids, start, Velocity(*floats(sample)))

    def grids(self) -> Tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return path_dist, goal_dist and within_robot of the last cycle, as in C++.

        They are (ny, nx) int32, int32 and uint8.
        With N cells on the map, N is an obstacle and N + 1 a cell that no flood has reached.
        """
        return complete(self._grids.path), complete(self._grids.goal), self._grids.within.copy()

    def cost_cloud(self, costmap: Costmap) -> np.ndarray:
        """Return costs (k, 7) of the cells free for the robot's centre, for display.

        The columns are float32: x, y, z, path, goal, obstacle, total cost.
        """
        # Before the first cycle and after a resize there are no distances for these cells.
        if self._grids is None or self._shape != costmap.cells.shape:
            return np.zeros((0, 7), np.float32)
        path_distances, goal_distances, within_robot = self.grids()
        p = self._params[0]
        cost_weights = (p["path_scale"], p["goal_scale"], p["occdist_scale"])
        return cost_cloud(costmap, path_distances, goal_distances, within_robot == 0, cost_weights)

    def trajectory_cloud(self, costmap: Costmap) -> np.ndarray:
        """Return points (k, 5) of all legal forward samples of the last cycle, for display.

        The columns are float32: x, y, z, theta, cost. There are at most POINTS points per sample.
        `costmap` must be the one of that cycle.
        """
        if self._grids is None or self._shape != costmap.cells.shape:
            return np.zeros((0, 5), np.float32)
        scene = self._scene_of(costmap)
        points, _ = score_all_samples(self._params, scene, self._grids, self._scratch)
        return trajectory_cloud(points)

    def refusals(self, costmap: Costmap) -> Dict[str, int]:
        """Count the rejected forward samples of the last cycle by reason.

        `costmap` must be the one of that cycle.
        """
        scene = self._scene_of(costmap)
        _, refused = score_all_samples(self._params, scene, self._grids, self._scratch)
        return {
            "samples": len(self._scratch.speeds) * (len(self._scratch.turn_rates) + 1),
            "obstacle": int(refused[0]),
            "path or goal": int(refused[1]),
        }

    def _scene_of(self, costmap: Costmap) -> TrajectoryScene:
        """Return the scene of this costmap.

        Grids and tables are renewed only for a new size or resolution.
        """
        # The memory of the grids depends on the size, the lines under the footprint on the
        # resolution.
        if self._take_map_size(costmap):
            ny, nx = self._shape
            self._grids = allocate_grids(nx, ny)
            self._lines = line_offsets(self.footprint, self._resolution, nx)
        return TrajectoryScene(
            cells=costmap.cells,
            ox=float(costmap.origin[0]),
            oy=float(costmap.origin[1]),
            resolution=self._resolution,
            footprint=self.footprint,
            lines=self._lines,
            plan=self._plan,
        )
