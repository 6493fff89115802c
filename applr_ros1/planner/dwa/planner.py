"""DWA planner (dwa_local_planner::DWAPlanner) that chooses one velocity per cycle and checks single velocities.

local_planner.py builds a controller on this planner. The arithmetic is in the kernels of this package.
"""

from functools import partial
from typing import Any, Dict, List, Mapping, Optional, Sequence, Tuple

import numpy as np

from applr_ros1.planner.costmap.footprint_cost import line_offsets
from applr_ros1.planner.distance_grid import complete
from applr_ros1.planner.dwa.critics import (
    CRITICS,
    Samples,
    clear,
    remember,
    score_all_samples,
    total_cost,
    weights,
)
from applr_ros1.planner.dwa.records import (
    PARAMETERS,
    STATE,
    Scene,
    allocate_grids,
    allocate_scratch,
    grid_of,
)
from applr_ros1.planner.dwa.samples import commanded, roll_out, step_count
from applr_ros1.planner.dwa.search import find_best, prepare
from applr_ros1.planner.parameters.dwa_planner_parameters import SAMPLES
from applr_ros1.planner.sampling_planner import (
    Choice,
    SamplingPlanner,
    cost_cloud,
    floats,
    trajectory_cloud,
)

NO_PLAN = np.zeros((0, 2))


class DWAPlanner(SamplingPlanner):
    """DWA planner that samples velocities and scores them with seven critics.

    Args:
        params: values of the DWAPlannerROS server {name: value}.
        sim_period: control period [s]. The dynamic window holds the velocities that can be reached within it.
        sum_scores: whether the obstacle critic sums the costs of all points instead of using the largest cost.
        cheat_factor: the alignment critic is off within sqrt(cheat_factor) * forward_point_distance of the plan's end.

    Raises:
        ParameterError: a parameter is invalid.
    """

    PARAMETERS, STATE, SAMPLES = PARAMETERS, STATE, SAMPLES
    DERIVED = (
        "path_scale",
        "goal_scale",
        "alignment_scale",
        "sim_period",
        "cheat_factor",
        "sum_scores",
    )

    def __init__(
        self,
        params: Mapping[str, Any],
        sim_period: float = 0.05,
        sum_scores: bool = False,
        cheat_factor: float = 1.0,
    ):
        self._fixed = {
            "sim_period": float(sim_period),
            "sum_scores": int(sum_scores),
            "cheat_factor": cheat_factor,
        }
        self._scene: Any = None
        self._footprint: Any = None
        self._given_footprint: Any = None
        self._aligned_plan = NO_PLAN
        super().__init__(params)
        self._flags_before = self._state.copy()

    def _derive(self, made: np.ndarray, resolution: Optional[float]) -> None:
        for name, value in self._fixed.items():
            made[name] = value
        for name in ("acc_lim_x", "acc_lim_y", "acc_lim_theta"):
            made[name] = np.float32(self._values[name])
        resolution = 1.0 if resolution is None else resolution
        made["path_scale"] = resolution * self._values["path_distance_bias"]
        made["goal_scale"] = resolution * self._values["goal_distance_bias"]
        made["alignment_scale"] = made["path_scale"]

    def _allocate_scratch(self, *samples: int) -> Any:
        return allocate_scratch(*samples)

    @property
    def scales(self) -> List[float]:
        """Weights of the seven critics in their order."""
        return [float(weight) for weight in weights(self._params[0])]

    def reset(self) -> None:
        """Clear flags, grids and plans, as in a new object (for training episodes)."""
        super().reset()
        self._aligned_plan = NO_PLAN
        if self._grids is not None:
            self._grids.facts[:] = 0

    def remember(self, pose: Sequence[float], v: float, w: float) -> None:
        """Update the flags as if the last search had chosen the command (v, w) at a pose (x, y, yaw)."""
        remember(self._params[0], self._state[0], np.array(pose, float), (v, 0.0, w))

    def sample_costs(
        self, costmap: Any, command: Sequence[float]
    ) -> Tuple[np.ndarray, np.ndarray, Dict[str, np.ndarray]]:
        """Return v, w (m, 2), total costs (m,) and their weighted parts by critic of all samples of the last search."""
        every = self.score_all_samples()
        parts = {
            name: every.critics[:, i] * scale
            for i, (name, scale) in enumerate(zip(CRITICS, self.scales))
        }
        velocities = np.where(every.counts[:, None] > 0, every.stored, every.velocities)
        return velocities[:, [0, 2]], every.costs, parts

    def clear_flags(self) -> None:
        """Clear the barred directions, as every new plan does."""
        clear(self._state[0])

    def prepare(
        self, costmap: Any, plan: Any, pose: Sequence[float], velocity: Sequence[float]
    ) -> None:
        """Begin a cycle that only stops or turns: store pose, velocity and weights as find_best_path does."""
        self._update_scene(costmap, plan)
        if prepare(self._params, self._scratch, self._scene.plan, floats(pose), floats(velocity)):
            self._aligned_plan = self._scene.plan

    def find_best_path(
        self, costmap: Any, plan: Any, pose: Sequence[float], velocity: Sequence[float]
    ) -> Choice:
        """Run one cycle: floods, samples, winner, flags.

        Args:
            costmap: map with cells (ny, nx) uint8, origin (x, y) [m], resolution [m] and footprint (n, 2) [m].
            plan: points (k, 2 or 3) in the costmap's frame [m], not empty.
            pose: x, y [m], yaw [rad].
            velocity: vx, vy [m/s], w [rad/s].
        """
        self._update_scene(costmap, plan)
        self._flags_before[:] = self._state
        given = (
            self._params,
            self._state,
            self._grids,
            self._scratch,
            self._scene,
            floats(pose),
            floats(velocity),
        )
        cost, number, count, sample, moving, turn, aligned = find_best(*given)
        if aligned:
            self._aligned_plan = self._scene.plan
        follow = partial(roll_out, self._params[0], self.start, sample)
        return Choice(cost, moving, (moving[0], moving[1], turn), count, follow, number)

    def check(self, velocity: Sequence[float]) -> Tuple[float, int]:
        """Return (cost, number of points) of the trajectory towards a velocity (vx, vy, w) in the prepared cycle.

        The grids are those of the last search. A velocity that the generator rejects has no points and cost 0, so it
        passes. As in C++, the oscillation flags are cleared.
        """
        clear(self._state[0])
        p, start = self._params[0], self._scratch.start
        sample = floats(float(np.float32(v)) for v in velocity)
        steps = step_count(p, sample)
        points = np.empty((steps, 3))
        moving = (0.0, 0.0, 0.0)
        if steps:
            roll_out(p, start, sample, points)
            moving = commanded(p, start, sample, steps)
        cost, _ = total_cost(p, self._state[0], self._scene, self._grids, points, moving, -1.0)
        return cost, steps

    def score_all_samples(self) -> Samples:
        """Return all samples of the last search with the values of the critics, for display and tests."""
        return score_all_samples(
            self._params, self._flags_before, self._grids, self._scratch, self._scene
        )

    def refusals(self) -> Dict[str, int]:
        """Count the last search's samples that each critic, or the generator ("velocity limits"), rejected."""
        every = self.score_all_samples()
        counts = {"samples": len(every.costs), "velocity limits": int((every.counts == 0).sum())}
        by_critic = np.bincount(
            every.ended[(every.counts > 0) & (every.costs < 0)], minlength=len(CRITICS)
        )
        return {**counts, **{name: int(n) for name, n in zip(CRITICS, by_critic)}}

    def grids(self) -> List[np.ndarray]:
        """Return the grids (ny, nx) int32 of the last search as in C++: path, goal, nose to goal, nose on path.

        With N cells on the map, N is an obstacle and N + 1 a cell that no flood has reached.
        """
        return [complete(grid_of(self._grids, row)) for row in (0, 1, 2, int(self._grids.facts[1]))]

    def cost_cloud(self, costmap: Any) -> np.ndarray:
        """Return (k, 7) float32 x, y, z, path, goal, obstacle, total cost of the cells free for the robot's centre.

        The cloud is for display. C++ also appends a point of zeros for each cell that is left out.
        """
        if self._grids is None or not self._grids.facts[0] or self._shape != costmap.cells.shape:
            return np.zeros((0, 7), np.float32)
        path, goal = self.grids()[:2]
        p = self._params[0]
        everywhere = np.ones(self._shape, bool)
        return cost_cloud(
            costmap, path, goal, everywhere, (p["path_scale"], p["goal_scale"], p["occdist_scale"])
        )

    def trajectory_cloud(self) -> np.ndarray:
        """Return points (k, 5) float32 x, y, z, theta, cost of all legal trajectories of the last search."""
        return trajectory_cloud(self.score_all_samples().points)

    def _update_scene(self, costmap: Any, plan: Any) -> None:
        """Store the cycle's scene. Grids and tables are renewed only if size, resolution or footprint changed."""
        fits = self._fits(costmap)
        ny, nx = self._shape
        if not fits:
            self._grids = allocate_grids(nx, ny)
        if not fits or costmap.footprint is not self._given_footprint:
            self._given_footprint = costmap.footprint
            self._footprint = np.array(costmap.footprint, dtype=np.float64, order="C").reshape(
                -1, 2
            )
            self._lines = line_offsets(self._footprint, self._resolution, nx)
        self._scene = Scene(
            costmap.cells,
            float(costmap.origin[0]),
            float(costmap.origin[1]),
            self._resolution,
            self._footprint,
            self._lines,
            np.array(plan, dtype=np.float64, order="C"),
            self._aligned_plan,
        )
