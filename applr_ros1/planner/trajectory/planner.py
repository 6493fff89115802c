"""The trajectory planner (findBestPath of base_local_planner, with dwa): one velocity for one cycle.

Called by local_planner.py, which makes a controller of it. The arithmetic is in sampling.py and its kernels.
"""

from __future__ import annotations

from typing import Any, Dict, List, Mapping, Optional, Sequence, Tuple

import numpy as np

from applr_ros1.common.errors import ApplrError
from applr_ros1.planner.costmap.costmap import Costmap
from applr_ros1.planner.costmap.footprint_cost import line_offsets
from applr_ros1.planner.costmap.grid import INSCRIBED
from applr_ros1.planner.distance_grid import complete
from applr_ros1.planner.sampling_planner import cost_cloud, updated
from applr_ros1.planner.trajectory.sampling import (
    STATE,
    allocate_grids,
    allocate_scratch,
    fill_evenly,
    find_best_path,
    velocity_window,
)
from applr_ros1.planner.trajectory.scoring import PARAMETERS, Scene, roll_out, score, score_all_samples

NOT_NEGATIVE = ("path_distance_bias", "goal_distance_bias", "occdist_scale")
ABOVE_ZERO = ("sim_time", "sim_granularity", "angular_sim_granularity")
SAMPLES = ("vx_samples", "vtheta_samples")


class Result:
    """One cycle's choice.

    cost: below 0 means no valid command. v [m/s], w [rad/s]: the chosen sample. drive: the command (v, w), (0, 0)
    if there is none; its w went through a quaternion. count: how many points the trajectory has; points (count, 3):
    x, y [m], yaw [rad].
    """

    __slots__ = ("cost", "v", "w", "count", "drive", "_params", "_start", "_points")

    def __init__(
        self,
        cost: float,
        v: float,
        w: float,
        count: int,
        drive: Tuple[float, float],
        params: np.ndarray,
        start: np.ndarray,
    ):
        self.cost, self.v, self.w, self.count, self.drive = cost, v, w, count, drive
        self._params, self._start = params, start
        self._points: Optional[np.ndarray] = None

    @property
    def points(self) -> np.ndarray:
        """Made when first asked for: training never looks."""
        if self._points is None:
            self._points = np.empty((self.count, 3))
            roll_out(self._params, self._start, self.v, self.w, self._points)
        return self._points


class TrajectoryPlanner:
    """footprint: padded vertices (n, 2) [m]. params: values of the TrajectoryPlannerROS server by name.

    sim_period [s]: the control period, the dynamic window's width. meter_scoring: the two distance weights are per
    metre, not per cell. Raises ApplrError.
    """

    def __init__(
        self, footprint: np.ndarray, params: Mapping[str, Any], sim_period: float = 0.05, meter_scoring: bool = True
    ):
        self._footprint = np.ascontiguousarray(footprint, dtype=np.float64).reshape(-1, 2)
        self._meter_scoring = bool(meter_scoring)
        self._sim_period = float(sim_period)
        self._resolution: Optional[float] = None
        self._shape: Any = None  # (ny, nx)
        self._grids: Any = None
        self._lines: Any = None
        self._scratch: Any = None
        self._state = np.zeros(1, STATE)
        self._plan = np.zeros((0, 2))
        self._wanted: Dict[str, Any] = {}
        self.reconfigure(params)

    def reconfigure(self, params: Mapping[str, Any]) -> None:
        """Take over the values by name that belong to PARAMETERS, some or all of them, between two cycles.

        Other names are ignored. vx_samples and vtheta_samples below 1 become 1. Raises ApplrError.
        """
        names = [name for name in PARAMETERS.names or () if name != "sim_period"]
        wanted = updated(self._wanted, params, names, ABOVE_ZERO, NOT_NEGATIVE, SAMPLES)
        self._wanted = wanted
        self._scratch = allocate_scratch(wanted["vx_samples"], wanted["vtheta_samples"])
        self._take_parameters()

    def _take_parameters(self):
        params = np.zeros(1, PARAMETERS)  # a new record: results of earlier cycles keep theirs
        for name, value in self._wanted.items():
            params[name] = value
        params["sim_period"] = self._sim_period
        if self._meter_scoring and self._resolution is not None:
            params["path_distance_bias"] *= self._resolution
            params["goal_distance_bias"] *= self._resolution
        self._params = params

    @property
    def state(self) -> List[float]:
        """The memory between cycles, ten values that can also be assigned.

        stuck_left, stuck_right, rotating_left, rotating_right, escaping (0 or 1), prev_x, prev_y, escape_x, escape_y,
        escape_theta.
        """
        return list(self._state[0].item())

    @state.setter
    def state(self, values: Sequence[float]) -> None:
        self._state[0] = tuple(values)

    def end_escape(self) -> None:
        """Sample forward velocities again, though the robot has not backed out far enough."""
        self._state[0]["escaping"] = 0

    @property
    def start(self) -> np.ndarray:
        """Pose and velocity (6,) of the last cycle as they were used: wrapped and rounded to float32."""
        return self._scratch.start.copy()

    @property
    def window(self) -> Dict[str, float]:
        """Ranges and steps of the last cycle's samples: min_vel_x, max_vel_x, dvx, ... [m/s, rad/s]."""
        start, vs, ws = self.start, self._scratch.vs, self._scratch.ws
        least_vx, most_vx, least_w, most_w = velocity_window(self._params[0], self._plan, start)
        return {
            "min_vel_x": least_vx,
            "max_vel_x": most_vx,
            "dvx": fill_evenly(least_vx, most_vx, vs),
            "min_vel_theta": least_w,
            "max_vel_theta": most_w,
            "dvtheta": fill_evenly(least_w, most_w, ws),
        }

    @property
    def effective(self) -> Dict[str, float]:
        """The values in force by name; the distance weights per cell."""
        return {name: self._params[0][name].item() for name in PARAMETERS.names or ()}

    def reset(self) -> None:
        """Forget flags, reference positions and plan, as a new object (training episodes)."""
        self._state[:] = np.zeros(1, STATE)
        self._plan = np.zeros((0, 2))

    def set_plan(self, plan: np.ndarray) -> None:
        """The plan, an array (n, 2 or more) [m] in the costmap's frame, that the next cycles follow; n may be 0."""
        # always a fresh array in C order: the kernels are compiled for that alone
        self._plan = np.array(plan[:, :2], dtype=np.float64, order="C")

    def find_best_path(self, costmap: Costmap, pose: Sequence[float], velocity: Sequence[float]) -> Result:
        """One cycle: floods, samples, winner, flags.

        costmap: anything with cells (ny, nx) uint8, origin (x, y) [m], resolution [m]. pose: x, y [m], yaw [rad];
        velocity: vx, vy [m/s], w [rad/s]. Returns a Result.
        """
        scene = self._look_at(costmap)
        x, y, yaw = pose
        vx, vy, w = velocity
        cost, v, turn, count, drive_v, drive_w = find_best_path(
            self._params,
            self._state,
            self._grids,
            self._scratch,
            scene,
            float(x),
            float(y),
            float(yaw),
            float(vx),
            float(vy),
            float(w),
        )
        return Result(cost, v, turn, count, (drive_v, drive_w), self._params, self.start)

    def score(
        self, costmap: Costmap, pose: Sequence[float], velocity: Sequence[float], sample: Sequence[float]
    ) -> Tuple[float, int, float, float, float]:
        """(cost, number of points, end x, y, yaw) of one sample (vx, vy, w) on the grids of the last find_best_path.

        Pose and velocity are used as they are, in double. The cost is negative if the sample is illegal.
        """
        if self._grids is None:
            raise ApplrError("score needs the grids of a find_best_path before it")
        start = np.array(tuple(pose) + tuple(velocity), dtype=np.float64)
        vx, vy, w = (float(v) for v in sample)
        return score(self._params, self._look_at(costmap), self._grids, start, vx, vy, w)

    def grids(self) -> Tuple[np.ndarray, np.ndarray, np.ndarray]:
        """(path_dist, goal_dist) (ny, nx) int32 and within_robot (ny, nx) uint8 of the last cycle, as C++ holds them.

        With N cells on the map, N is an obstacle and N + 1 a cell that no flood came to.
        """
        ny, nx = self._shape
        grids = self._grids
        path, goal = np.empty((ny, nx), np.int32), np.empty((ny, nx), np.int32)
        complete(grids.path, grids.path_queue, grids.path_ends, nx, ny, path)
        complete(grids.goal, grids.goal_queue, grids.goal_ends, nx, ny, goal)
        return path, goal, grids.within.copy()

    def cost_cloud(self, costmap: Costmap) -> np.ndarray:
        """(k, 7) float32: x, y, z, path, goal, obstacle and total cost of every cell the robot's centre may be in.

        For display. MapGridVisualizer::publishCostCloud, column by column.
        """
        if self._grids is None or self._shape != costmap.cells.shape:
            return np.zeros((0, 7), np.float32)
        path, goal, within = self.grids()
        inside = (within == 0) & (path < costmap.cells.size) & (costmap.cells < INSCRIBED)
        p = self._params[0]
        weights = p["path_distance_bias"], p["goal_distance_bias"], p["occdist_scale"]
        return cost_cloud(costmap, path, goal, inside, weights)

    def trajectory_cloud(self, costmap: Costmap) -> np.ndarray:
        """(k, 5) float32: x, y, z, theta, cost of points of all legal forward samples of the last cycle.

        For display, with at most POINTS points of each. costmap: as that cycle saw it.
        """
        if self._grids is None or self._shape != costmap.cells.shape:
            return np.zeros((0, 5), np.float32)
        points, _ = score_all_samples(self._params, self._look_at(costmap), self._grids, self._scratch)
        cloud = np.zeros((len(points), 5), np.float32)
        cloud[:, :2], cloud[:, 3:] = points[:, :2], points[:, 2:]
        return cloud

    def refusals(self, costmap: Costmap) -> Dict[str, int]:
        """How many forward samples of the last cycle were refused, and why. costmap: as that cycle saw it."""
        _, (collide, lost) = score_all_samples(self._params, self._look_at(costmap), self._grids, self._scratch)
        samples = len(self._scratch.vs) * (len(self._scratch.ws) + 1)
        return {"samples": samples, "obstacle": int(collide), "path or goal": int(lost)}

    def _look_at(self, costmap):
        """The Scene of this costmap; grids and tables are made anew only when its size or resolution changes."""
        cells = costmap.cells
        resolution = float(costmap.resolution)
        if cells.shape != self._shape or resolution != self._resolution:
            self._shape, self._resolution = cells.shape, resolution
            self._grids = allocate_grids(cells.shape[1], cells.shape[0])
            self._lines = line_offsets(self._footprint, resolution, cells.shape[1])
            self._take_parameters()
        return Scene(
            cells,
            float(costmap.origin[0]),
            float(costmap.origin[1]),
            resolution,
            self._footprint,
            self._lines,
            self._plan,
        )
