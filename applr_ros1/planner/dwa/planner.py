"""DWA planner (dwa_local_planner::DWAPlanner): chooses a velocity per cycle, checks single ones.

local_planner.py builds a controller on this planner. The arithmetic is in the kernels of this
package.
"""

from functools import partial
from typing import Any, Dict, List, Mapping, Optional, Sequence, Tuple

import numpy as np

from applr_ros1.planner.costmap.footprint_cost import line_offsets
from applr_ros1.planner.distance_grid import complete
from applr_ros1.planner.dwa.critics.oscillation import clear, remember
from applr_ros1.planner.dwa.critics.registry import ALL, CRITICS, weights
from applr_ros1.planner.dwa.records import (
    ALIGNMENT,
    FRONT,
    GOAL,
    PARAMETERS,
    PATH,
    STATE,
    DWAScene,
    allocate_grids,
    allocate_scratch,
    grid_of,
)
from applr_ros1.planner.dwa.samples import commanded, roll_out, step_count
from applr_ros1.planner.dwa.search import find_best, prepare
from applr_ros1.planner.dwa.total_cost import Samples, score_all_samples, total_cost
from applr_ros1.planner.parameters.dwa_planner_parameters import SAMPLES
from applr_ros1.planner.sampling_planner import (
    CostParts,
    CycleChoice,
    SamplingPlanner,
    Velocity,
    cost_cloud,
    floats,
    follow_sample,
    start_record,
    trajectory_cloud,
)

NO_PLAN = np.zeros((0, 2))
VELOCITY_LIMITS = "velocity limits"  # name of the samples that no critic has seen


class DWAPlanner(SamplingPlanner):
    """DWA planner that samples velocities and scores them with its critics.

    Args:
        params: values of the DWAPlannerROS server {name: value}.
        sim_period: control period [s]. The dynamic window holds the velocities that can be reached
            within it.
        sum_scores: whether the obstacle critic sums the costs of all points instead of using the
            largest cost.
        cheat_factor: the alignment critic is off within sqrt(cheat_factor) * forward_point_distance
            of the plan's end.

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
        self._sim_period = float(sim_period)
        self._sum_scores = int(sum_scores)
        self._cheat_factor = cheat_factor
        self._scene: Any = None
        self._footprint: Any = None
        self._costmap_footprint: Any = None  # array from which _footprint was made
        self._aligned_plan = NO_PLAN
        super().__init__(params)
        self._flags_before = self._state.copy()  # flags before the last search

    def _derive(self, record: np.ndarray, resolution: Optional[float]) -> None:
        record["sim_period"] = self._sim_period
        record["sum_scores"] = self._sum_scores
        record["cheat_factor"] = self._cheat_factor
        for parameter_name in ("acc_lim_x", "acc_lim_y", "acc_lim_theta"):
            record[parameter_name] = np.float32(record[parameter_name])
        resolution = 1.0 if resolution is None else resolution
        record["path_scale"] = resolution * record["path_distance_bias"]
        record["goal_scale"] = resolution * record["goal_distance_bias"]
        record["alignment_scale"] = record["path_scale"]

    def _allocate_scratch(self, *samples: int) -> Any:
        return allocate_scratch(ALL, *samples)

    @property
    def scales(self) -> List[float]:
        """Weights of the critics in their order."""
        return [float(weight) for weight in weights(self._params[0])]

    def remember(self, pose: Sequence[float], v: float, w: float) -> None:
        """Update the flags as if the last search had chosen (v, w) at a pose (x, y, yaw)."""
        start = start_record((*pose, 0.0, 0.0, 0.0))
        remember(self._params[0], self._state[0], start, Velocity(v, 0.0, w))

    def sample_costs(
        self, costmap: Any, command: Sequence[float]
    ) -> Tuple[np.ndarray, np.ndarray, CostParts]:
        """Return velocities, costs and the parts of the costs of all samples of the last search.

        Returns:
            v, w (m, 2), total costs (m,), and by term its weighted part of the costs (m,).
        """
        samples = self.score_all_samples()
        cost_parts = {}
        for i, critic in enumerate(CRITICS):
            cost_parts[critic.term] = samples.critics[:, i] * self.scales[i]
        # A sample that the generator rejects has no trajectory whose velocity could be given.
        velocities = np.where(samples.counts[:, None] > 0, samples.stored, samples.velocities)
        return velocities[:, [0, 2]], samples.costs, cost_parts

    def clear_flags(self) -> None:
        """Clear the barred directions, as every new plan does."""
        clear(self._state[0])

    def prepare(
        self, costmap: Any, plan: Any, pose: Sequence[float], velocity: Sequence[float]
    ) -> None:
        """Store pose, velocity and weights of a cycle that only stops or turns."""
        self._update_scene(costmap, plan)
        plan = self._scene.plan
        is_aligned = prepare(self._params, self._scratch, plan, floats(pose), floats(velocity))
        if is_aligned:
            # The grid of the nose-on-path critic stays that of this plan while the critic is off.
            self._aligned_plan = plan

    def find_best_path(
        self, costmap: Any, plan: Any, pose: Sequence[float], velocity: Sequence[float]
    ) -> CycleChoice:
        """Run one cycle: floods, samples, winner, flags.

        Args:
            costmap: map with cells (ny, nx) uint8, origin (x, y) [m], resolution [m] and footprint
                (n, 2) [m].
            plan: points (k, 2 or 3) in the costmap's frame [m], not empty.
            pose: x, y [m], yaw [rad].
            velocity: vx, vy [m/s], w [rad/s].
        """
        self._update_scene(costmap, plan)
        self._flags_before[:] = self._state
        winner = find_best(
            self._params,
            self._state,
            self._grids,
            self._scratch,
            self._scene,
            floats(pose),
            floats(velocity),
        )
        if winner.is_aligned:
            self._aligned_plan = self._scene.plan
        # The next cycle overwrites the record, so the choice keeps its values.
        start = self._scratch.start[0].item()
        follow = partial(follow_sample, roll_out, self._params[0], start, winner.sample)
        command = (winner.stored.vx, winner.stored.vy, winner.command_w)
        return CycleChoice(
            winner.cost, winner.stored, command, winner.steps, follow, sample=winner.number
        )

    def check(self, velocity: Sequence[float]) -> Tuple[float, int]:
        """Return (cost, number of points) of the trajectory towards a velocity.

        The grids are those of the last search. A velocity that the generator rejects has no points
        and cost 0, so it passes. As in C++, the oscillation flags are cleared. velocity: vx, vy
        [m/s], w [rad/s].
        """
        clear(self._state[0])
        p = self._params[0]
        start = self._scratch.start[0]
        sample = Velocity(*floats(np.array(velocity, np.float32)))
        steps = step_count(p, sample)
        points = np.empty((steps, 3))
        stored_velocity = Velocity(0.0, 0.0, 0.0)
        if steps:
            roll_out(p, start, sample, points)
            stored_velocity = commanded(p, start, sample, steps)
        no_best = -1.0  # no other cost ends the summation early
        cost, _ = total_cost(
            p, self._state[0], self._scene, self._grids, points, stored_velocity, no_best
        )
        return cost, steps

    def score_all_samples(self) -> Samples:
        """Return all samples of the last search with their critics, for display and tests."""
        return score_all_samples(
            self._params, self._flags_before, self._grids, self._scratch, self._scene
        )

    def refusals(self) -> Dict[str, int]:
        """Count the last search's rejected samples by critic.

        VELOCITY_LIMITS are the samples that the generator rejected.
        """
        samples = self.score_all_samples()
        is_rejected = (samples.counts > 0) & (samples.costs < 0)
        counts_by_critic = np.bincount(samples.ended[is_rejected], minlength=len(CRITICS))
        return {
            "samples": len(samples.costs),
            VELOCITY_LIMITS: int((samples.counts == 0).sum()),
            **{critic.term.name: int(count) for critic, count in zip(CRITICS, counts_by_critic)},
        }

    def grids(self) -> List[np.ndarray]:
        """Return the grids of the last search as in C++: path, goal, nose to goal, nose on path.

        The grids are (ny, nx) int32. With N cells on the map, N is an obstacle and N + 1 a cell
        that no flood has reached.
        """
        return [complete(grid_of(self._grids, row)) for row in (PATH, GOAL, FRONT, ALIGNMENT)]

    def cost_cloud(self, costmap: Any) -> np.ndarray:
        """Return costs (k, 7) of the cells free for the robot's centre, for display.

        The columns are float32: x, y, z, path, goal, obstacle, total cost. C++ also appends a point
        of zeros for each cell that is left out.
        """
        if self._grids is None or self._shape != costmap.cells.shape:
            return np.zeros((0, 7), np.float32)
        if not self._grids.facts["flooded"][0]:
            return np.zeros((0, 7), np.float32)
        path_distances, goal_distances, *_ = self.grids()
        p = self._params[0]
        cost_weights = (p["path_scale"], p["goal_scale"], p["occdist_scale"])
        return cost_cloud(
            costmap, path_distances, goal_distances, np.ones(self._shape, bool), cost_weights
        )

    def trajectory_cloud(self) -> np.ndarray:
        """Return points (k, 5) of all legal trajectories of the last search, for display.

        The columns are float32: x, y, z, theta, cost.
        """
        return trajectory_cloud(self.score_all_samples().points)

    def _update_scene(self, costmap: Any, plan: Any) -> None:
        """Store the cycle's scene.

        Grids and tables are renewed only if size, resolution or footprint changed.
        """
        is_new_size = self._take_map_size(costmap)
        ny, nx = self._shape
        if is_new_size:
            self._grids = allocate_grids(nx, ny)
        if is_new_size or costmap.footprint is not self._costmap_footprint:
            self._costmap_footprint = costmap.footprint
            footprint = np.array(costmap.footprint, dtype=np.float64, order="C").reshape(-1, 2)
            self._footprint = footprint
            self._lines = line_offsets(footprint, self._resolution, nx)
        self._scene = DWAScene(
            cells=costmap.cells,
            ox=float(costmap.origin[0]),
            oy=float(costmap.origin[1]),
            resolution=self._resolution,
            footprint=self._footprint,
            lines=self._lines,
            plan=np.array(plan, dtype=np.float64, order="C"),
            aligned_plan=self._aligned_plan,
        )
