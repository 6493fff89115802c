"""Trajectory planner (base_local_planner::TrajectoryPlanner) that chooses one velocity per cycle.

local_planner.py builds a controller on this planner. The arithmetic is in sampling.py and its kernels.
"""

from __future__ import annotations

from functools import partial
from typing import Any, Dict, Mapping, Optional, Sequence, Tuple

import numpy as np

from applr_ros1.planner.costmap.costmap import Costmap
from applr_ros1.planner.costmap.footprint_cost import line_offsets
from applr_ros1.planner.distance_grid import complete
from applr_ros1.planner.sampling_planner import (
    Choice,
    SamplingPlanner,
    cost_cloud,
    floats,
    trajectory_cloud,
)
from applr_ros1.planner.trajectory.records import (
    PARAMETERS,
    STATE,
    Scene,
    allocate_grids,
    allocate_scratch,
)
from applr_ros1.planner.trajectory.sampling import find_best_path, remember
from applr_ros1.planner.trajectory.scoring import roll_out, score, score_all_samples

NO_PLAN = np.zeros((0, 2))
WEIGHTS = (
    "path_distance_bias",
    "goal_distance_bias",
    "occdist_scale",
)  # weights of the parts of a cost


class TrajectoryPlanner(SamplingPlanner):
    """Trajectory planner with velocity sampling.

    Args:
        footprint: padded vertices (n, 2) [m].
        params: values of the TrajectoryPlannerROS server by name.
        sim_period: control period [s]. The dynamic window holds the velocities that can be reached within it.
        meter_scoring: whether the two distance weights are per metre instead of per cell.

    Raises:
        ParameterError: a parameter is invalid.
    """

    PARAMETERS, STATE = PARAMETERS, STATE
    SAMPLES = ("vx_samples", "vtheta_samples")

    def __init__(
        self,
        footprint: np.ndarray,
        params: Mapping[str, Any],
        sim_period: float = 0.05,
        meter_scoring: bool = True,
    ):
        self._footprint = np.ascontiguousarray(footprint, dtype=np.float64).reshape(-1, 2)
        self._meter_scoring = bool(meter_scoring)
        self._sim_period = float(sim_period)
        self._plan = NO_PLAN
        super().__init__(params)

    def _derive(self, made: np.ndarray, resolution: Optional[float]) -> None:
        made["sim_period"] = self._sim_period
        if self._meter_scoring and resolution is not None:
            made["path_distance_bias"] *= resolution
            made["goal_distance_bias"] *= resolution

    def _allocate_scratch(self, *samples: int) -> Any:
        return allocate_scratch(*samples)

    def end_escape(self) -> None:
        """Sample forward velocities again, although the robot has not backed out far enough."""
        self._state[0]["escaping"] = 0

    def remember(self, pose: Sequence[float], v: float, w: float) -> None:
        """Update the flags as if the last cycle had chosen the command (v, w) at a pose; it backs out if v < 0."""
        remember(
            self._params[0],
            self._state[0],
            np.array(pose, float),
            -1.0 if v < 0 else 0.0,
            v,
            w,
            v >= 0,
        )

    def sample_costs(
        self, costmap: Costmap, command: Sequence[float]
    ) -> Tuple[np.ndarray, np.ndarray, Dict[str, np.ndarray]]:
        """Return v, w (m, 2), costs (m,) and their parts by weight of the last cycle's forward samples and a command.

        The cost of an illegal sample is negative, its parts are 0. `costmap` must be the one of that cycle.
        """
        scene, scratch = self._scene_of(costmap), self._scratch
        samples = [(v, w) for v in scratch.vs.tolist() for w in (0.0, *scratch.ws.tolist())]
        samples.append((float(command[0]), float(command[1])))

        def costs(*ignored: str) -> np.ndarray:
            params = self._params.copy()
            params[list(ignored)] = 0.0
            return np.array(
                [
                    score(params, scene, self._grids, scratch.start, (v, 0.0, w))[0]
                    for v, w in samples
                ]
            )

        return (
            np.array(samples),
            costs(),
            {name: np.maximum(costs(*(set(WEIGHTS) - {name})), 0.0) for name in WEIGHTS},
        )

    def reset(self) -> None:
        """Clear flags, reference positions and plan, as in a new object (for training episodes)."""
        super().reset()
        self._plan = NO_PLAN

    def set_plan(self, plan: np.ndarray) -> None:
        """Follow the plan (n, 2 or more) [m] in the costmap's frame from the next cycle on. n may be 0."""
        # The kernels are compiled only for a contiguous array in C order.
        self._plan = np.array(plan[:, :2], dtype=np.float64, order="C")

    def find_best_path(
        self, costmap: Costmap, pose: Sequence[float], velocity: Sequence[float]
    ) -> Choice:
        """Run one cycle: floods, samples, winner, flags.

        Args:
            costmap: map with cells (ny, nx) uint8, origin (x, y) [m] and resolution [m].
            pose: x, y [m], yaw [rad].
            velocity: vx, vy [m/s], w [rad/s].
        """
        scene = self._scene_of(costmap)
        given = (
            self._params,
            self._state,
            self._grids,
            self._scratch,
            scene,
            floats(pose),
            floats(velocity),
        )
        cost, v, w, count, drive_v, drive_w = find_best_path(*given)
        follow = partial(roll_out, self._params, self.start, v, w)
        return Choice(cost, (v, 0.0, w), (drive_v, 0.0, drive_w), count, follow)

    def score(
        self,
        costmap: Costmap,
        pose: Sequence[float],
        velocity: Sequence[float],
        sample: Sequence[float],
    ) -> Tuple[float, int, float, float, float]:
        """Return (cost, number of points, end x, y, yaw) of a sample (vx, vy, w) on the last cycle's grids.

        Pose and velocity are used in double precision. The cost is negative if the sample is illegal.
        """
        start = np.array(tuple(pose) + tuple(velocity), dtype=np.float64)
        return score(self._params, self._scene_of(costmap), self._grids, start, floats(sample))

    def grids(self) -> Tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return path_dist, goal_dist (ny, nx) int32 and within_robot (ny, nx) uint8 of the last cycle, as in C++.

        With N cells on the map, N is an obstacle and N + 1 a cell that no flood has reached.
        """
        return complete(self._grids.path), complete(self._grids.goal), self._grids.within.copy()

    def cost_cloud(self, costmap: Costmap) -> np.ndarray:
        """Return (k, 7) float32 x, y, z, path, goal, obstacle, total cost of the cells free for the robot's centre."""
        if self._grids is None or self._shape != costmap.cells.shape:
            return np.zeros((0, 7), np.float32)
        path, goal, within = self.grids()
        p = self._params[0]
        weights = p["path_distance_bias"], p["goal_distance_bias"], p["occdist_scale"]
        return cost_cloud(costmap, path, goal, within == 0, weights)

    def trajectory_cloud(self, costmap: Costmap) -> np.ndarray:
        """Return points (k, 5) float32 x, y, z, theta, cost of all legal forward samples of the last cycle.

        The cloud is for display, with at most POINTS points per sample. `costmap` must be the one of that cycle.
        """
        if self._grids is None or self._shape != costmap.cells.shape:
            return np.zeros((0, 5), np.float32)
        return trajectory_cloud(
            score_all_samples(self._params, self._scene_of(costmap), self._grids, self._scratch)[0]
        )

    def refusals(self, costmap: Costmap) -> Dict[str, int]:
        """Count the rejected forward samples of the last cycle by reason. `costmap` must be the one of that cycle."""
        _, (collide, lost) = score_all_samples(
            self._params, self._scene_of(costmap), self._grids, self._scratch
        )
        samples = len(self._scratch.vs) * (len(self._scratch.ws) + 1)
        return {"samples": samples, "obstacle": int(collide), "path or goal": int(lost)}

    def _scene_of(self, costmap: Costmap) -> Scene:
        """Return the scene of this costmap. Grids and tables are renewed only for a new size or resolution."""
        if not self._fits(costmap):
            ny, nx = self._shape
            self._grids = allocate_grids(nx, ny)
            self._lines = line_offsets(self._footprint, self._resolution, nx)
        x, y = costmap.origin
        return Scene(
            costmap.cells,
            float(x),
            float(y),
            self._resolution,
            self._footprint,
            self._lines,
            self._plan,
        )
