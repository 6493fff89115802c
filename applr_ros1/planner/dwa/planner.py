"""The DWA planner (dwa_local_planner::DWAPlanner): one velocity for one cycle, and the legality of a given one.

Called by local_planner.py, which makes a controller of it. The arithmetic is in the kernels beside this file.
"""

from typing import Any, Dict, List, Mapping, Sequence, Tuple

import numpy as np

from applr_ros1.planner.costmap.footprint_cost import line_offsets
from applr_ros1.planner.costmap.grid import INSCRIBED
from applr_ros1.planner.distance_grid import complete
from applr_ros1.planner.dwa.critics import CRITICS, Samples, clear, score_all_samples, total_cost, weights
from applr_ros1.planner.dwa.records import PARAMETERS, STATE, Scene, allocate_grids, allocate_scratch
from applr_ros1.planner.dwa.samples import commanded, roll_out, step_count
from applr_ros1.planner.dwa.search import find_best, prepare
from applr_ros1.planner.parameters.dwa_planner_parameters import SAMPLES
from applr_ros1.planner.sampling_planner import cost_cloud, through_quaternion, updated

DERIVED = ("path_scale", "goal_scale", "alignment_scale", "sim_period", "cheat_factor", "sum_scores")
ABOVE_ZERO = ("sim_granularity", "angular_sim_granularity")
NOT_NEGATIVE = ("sim_time", "path_distance_bias", "goal_distance_bias", "occdist_scale", "twirling_scale")
NO_PLAN = np.zeros((0, 2))


class Choice:
    """One cycle's choice.

    cost: below 0 means no valid command. sample: its number in the order of sampling, -1 if there is none. vx, vy
    [m/s], w [rad/s]: the trajectory's velocity. drive: the command (vx, vy, w), zero if there is none; its w went
    through a quaternion. count: how many points the trajectory has.
    """

    __slots__ = ("cost", "sample", "vx", "vy", "w", "drive", "count", "_record", "_start", "_sampled", "_points")

    def __init__(self, found, record, start):
        self.cost, self.sample, self.count, self._sampled, (self.vx, self.vy, self.w), turn, _ = found
        self.drive = (self.vx, self.vy, turn)
        self._record, self._start = record, start
        self._points: Any = None

    @property
    def points(self) -> np.ndarray:
        """The trajectory's poses (count, 3) x, y [m], yaw [rad], made when first asked for."""
        if self._points is None:
            self._points = np.empty((self.count, 3))
            if self.count:
                roll_out(self._record, self._start, *self._sampled, self._points)
        return self._points


class DWAPlanner:
    """Samples velocities and scores them with seven critics.

    params: values of the DWAPlannerROS server by name. sim_period [s]: the control period, the dynamic window's width.
    sum_scores: the obstacle critic adds the costs of all points instead of taking the largest. cheat_factor: scales
    the squared distance to the plan's end below which the nose-on-path critic is off. Raises ParameterError.
    """

    def __init__(
        self, params: Mapping[str, Any], sim_period: float = 0.05, sum_scores: bool = False, cheat_factor: float = 1.0
    ):
        self._fixed = {"sim_period": float(sim_period), "sum_scores": int(sum_scores), "cheat_factor": cheat_factor}
        self._resolution: Any = None
        self._shape: Any = None
        self._grids: Any = None
        self._lines: Any = None
        self._scratch: Any = None
        self._scene: Any = None
        self._footprint: Any = None
        self._given_footprint: Any = None
        self._state = np.zeros(1, STATE)
        self._flags_before = self._state.copy()
        self._aligned_plan = NO_PLAN
        self._wanted: Dict[str, Any] = {}
        self.reconfigure(params)

    def reconfigure(self, params: Mapping[str, Any]) -> None:
        """Take over the server's values by name, some or all of them, between two cycles; other names are ignored.

        Numbers of samples below 1 become 1. Raises ParameterError.
        """
        names = [name for name in PARAMETERS.names or () if name not in DERIVED]
        wanted = updated(self._wanted, params, names, ABOVE_ZERO, NOT_NEGATIVE, SAMPLES)
        self._wanted = wanted
        self._scratch = allocate_scratch(*(wanted[name] for name in SAMPLES))
        self._take_parameters()

    def _take_parameters(self):
        record = np.zeros(1, PARAMETERS)  # a new one: choices of earlier cycles keep theirs
        for name, value in dict(self._wanted, **self._fixed).items():
            record[name] = value
        for name in ("acc_lim_x", "acc_lim_y", "acc_lim_theta"):
            record[name] = np.float32(self._wanted[name])
        resolution = 1.0 if self._resolution is None else self._resolution
        record["path_scale"] = resolution * self._wanted["path_distance_bias"]
        record["goal_scale"] = resolution * self._wanted["goal_distance_bias"]
        record["alignment_scale"] = record["path_scale"]
        self._record = record

    @property
    def state(self) -> List[float]:
        """The memory between cycles, which can be assigned: the twelve FLAGS, then the pose of the last change."""
        return list(self._state[0].item())

    @state.setter
    def state(self, values: Sequence[float]) -> None:
        self._state[0] = tuple(values)

    @property
    def start(self) -> np.ndarray:
        """Pose and velocity (6,) of the last cycle as they were used: wrapped and rounded to float32."""
        return self._scratch.start.copy()

    @property
    def scales(self) -> List[float]:
        """The seven critics' weights in their order."""
        return [float(weight) for weight in weights.py_func(self._record.view(np.recarray)[0])]

    def reset(self) -> None:
        """Forget flags, grids and plans, as a new object (training episodes)."""
        self._state[:] = np.zeros(1, STATE)
        self._aligned_plan = NO_PLAN
        if self._grids is not None:
            self._grids.facts[:] = 0

    def clear_flags(self) -> None:
        """Forget the barred directions, as every new plan does."""
        clear(self._state[0])

    def prepare(self, costmap: Any, plan: Any, pose: Sequence[float], velocity: Sequence[float]) -> None:
        """Begin a cycle that only stops or turns: pose, velocity and weights as find_best_path takes them."""
        self._look_at(costmap, plan)
        (x, y, yaw), (vx, vy, w) = pose, velocity
        if prepare(
            self._record, self._scratch, self._scene.plan, x, y, through_quaternion(yaw), vx, vy, through_quaternion(w)
        ):
            self._aligned_plan = self._scene.plan

    def find_best_path(self, costmap: Any, plan: Any, pose: Sequence[float], velocity: Sequence[float]) -> Choice:
        """One cycle: floods, samples, winner, flags. Returns a Choice.

        costmap: anything with cells (ny, nx) uint8, origin (x, y) [m], resolution [m], footprint (n, 2) [m]. plan:
        (k, 2 or 3) [m] in its frame, not empty. pose: x, y [m], yaw [rad]; velocity: vx, vy [m/s], w [rad/s].
        """
        self._look_at(costmap, plan)
        (x, y, yaw), (vx, vy, w) = pose, velocity
        scratch = self._scratch
        self._flags_before[:] = self._state
        found = find_best(
            self._record,
            self._state,
            self._grids,
            scratch,
            self._scene,
            float(x),
            float(y),
            float(yaw),
            float(vx),
            float(vy),
            float(w),
        )
        if found[-1]:
            self._aligned_plan = self._scene.plan
        return Choice(found, self._record[0], self.start)

    def check(self, velocity: Sequence[float]) -> Tuple[float, int]:
        """(cost, number of points) of the trajectory towards one velocity (vx, vy, w), from the prepared cycle.

        The grids are those of the last search. A velocity that the generator refuses has no points, costs nothing and
        so passes. Clears the flags, as in C++.
        """
        clear(self._state[0])
        p, start = self._record[0], self._scratch.start
        vx, vy, w = (float(np.float32(v)) for v in velocity)
        steps = step_count(p, vx, vy, w)
        points = np.empty((steps, 3))
        if steps:
            roll_out(p, start, vx, vy, w, points)
            vx, vy, w = commanded(p, start, vx, vy, w, steps)
        else:
            vx = vy = w = 0.0
        cost, _ = total_cost(p, self._state[0], self._scene, self._grids, points, vx, vy, w, -1.0)
        return cost, steps

    def score_all_samples(self) -> Samples:
        """All samples of the last search with what each critic says, for display and tests."""
        return score_all_samples(self._record, self._flags_before, self._grids, self._scratch, self._scene)

    def refusals(self) -> Dict[str, int]:
        """How many samples of the last search each critic refused; "velocity limits" are the generator's."""
        every = self.score_all_samples()
        counts = {"samples": len(every.costs), "velocity limits": int((every.counts == 0).sum())}
        by_critic = np.bincount(every.ended[(every.counts > 0) & (every.costs < 0)], minlength=len(CRITICS))
        return {**counts, **{name: int(n) for name, n in zip(CRITICS, by_critic)}}

    def grids(self) -> List[np.ndarray]:
        """The four grids (ny, nx) int32 of the last search as C++ holds them: path, goal, nose to goal, nose on path.

        With N cells on the map, N is an obstacle and N + 1 a cell that no flood came to.
        """
        ny, nx = self._shape
        rows = (0, 1, 2, int(self._grids.facts[1]))
        made = [np.empty((ny, nx), np.int32) for _ in rows]
        for row, grid in zip(rows, made):
            complete(self._grids.distances[row], self._grids.queues[row], self._grids.ends[row], nx, ny, grid)
        return made

    def cost_cloud(self, costmap: Any) -> np.ndarray:
        """(nx ny, 7) float32: x, y, z, path, goal, obstacle and total cost of every cell the robot's centre may be in.

        For display. In C++ the points left out are zeros at the end; here there are none.
        """
        if self._grids is None or not self._grids.facts[0] or self._shape != costmap.cells.shape:
            return np.zeros((0, 7), np.float32)
        path, goal = self.grids()[:2]
        inside = (path < costmap.cells.size) & (costmap.cells < INSCRIBED)
        p = self._record[0]
        return cost_cloud(costmap, path, goal, inside, (p["path_scale"], p["goal_scale"], p["occdist_scale"]))

    def trajectory_cloud(self) -> np.ndarray:
        """(k, 5) float32: x, y, z, theta, cost of the points of all legal trajectories of the last search."""
        points = self.score_all_samples().points
        cloud = np.zeros((len(points), 5), np.float32)
        cloud[:, :2], cloud[:, 3:] = points[:, :2], points[:, 2:]
        return cloud

    def _look_at(self, costmap, plan):
        """The cycle's Scene; grids and tables are made anew only when size, resolution or footprint change."""
        cells = costmap.cells
        resolution = float(costmap.resolution)
        sized = cells.shape == self._shape and resolution == self._resolution
        if not sized:
            self._shape, self._resolution = cells.shape, resolution
            self._grids = allocate_grids(cells.shape[1], cells.shape[0])
            self._take_parameters()
        if not sized or costmap.footprint is not self._given_footprint:
            self._given_footprint = costmap.footprint
            self._footprint = np.array(costmap.footprint, dtype=np.float64, order="C").reshape(-1, 2)
            self._lines = line_offsets(self._footprint, resolution, cells.shape[1])
        self._scene = Scene(
            cells,
            float(costmap.origin[0]),
            float(costmap.origin[1]),
            resolution,
            self._footprint,
            self._lines,
            np.array(plan, dtype=np.float64, order="C"),
            self._aligned_plan,
        )
