"""Records shared by the kernels of the trajectory planner."""

from typing import NamedTuple

import numpy as np

from applr_ros1.common.arrays import Data
from applr_ros1.planner import distance_grid
from applr_ros1.planner.distance_grid import DistanceGrid
from applr_ros1.planner.sampling_planner import START, record

# Parameters of the planner in one record [m, rad, s]. path_scale and goal_scale are the two
# distance biases per cell (meter_scoring).
PARAMETERS = record(
    "acc_lim_x acc_lim_y acc_lim_theta max_vel_x min_vel_x max_vel_theta min_vel_theta "
    "min_in_place_vel_theta escape_vel sim_time sim_granularity angular_sim_granularity "
    "path_distance_bias goal_distance_bias occdist_scale heading_lookahead "
    "heading_scoring_timestep oscillation_reset_dist escape_reset_dist escape_reset_theta "
    "path_scale goal_scale sim_period",
    "vx_samples vtheta_samples dwa heading_scoring simple_attractor",
)

# Memory of the planner between cycles, in the order of TrajectoryPlanner.state.
STATE = record(
    "",
    "stuck_left stuck_right rotating_left rotating_right escaping",
    "prev_x prev_y escape_x escape_y escape_theta",
)


class TrajectoryScene(NamedTuple):
    """Surroundings of the robot in one cycle."""

    cells: Data  # costmap (ny, nx) uint8
    ox: float  # origin of the costmap [m]
    oy: float
    resolution: float  # [m]
    footprint: Data  # padded vertices (n, 2) [m]
    lines: Data  # line_offsets of the footprint
    plan: Data  # points (k, 2) [m]


class TrajectoryGrids(NamedTuple):
    """Grids of one cycle."""

    path: DistanceGrid  # distances to the plan [cells]
    goal: DistanceGrid  # distances to the local goal [cells]
    within: Data  # (ny, nx) uint8, 1 under the robot's filled footprint


class TrajectoryScratch(NamedTuple):
    """Scratch memory of one cycle. Forward samples are numbered, see scoring.forward_sample."""

    speeds: Data  # sampled values of vx (vx_samples,) [m/s]
    turn_rates: Data  # sampled values of w (vtheta_samples,) [rad/s]
    base_costs: Data  # lower bounds of the path and goal terms of the samples' costs
    bounds: Data  # see search.best_first.Queue
    heap: Data
    is_probed: Data
    start: Data  # array of one START record: pose and velocity at which all samples start


def allocate_grids(nx: int, ny: int) -> TrajectoryGrids:
    """Return grids for a map of nx by ny cells. A planner reuses them in every cycle."""
    return TrajectoryGrids(
        path=distance_grid.allocate(nx, ny),
        goal=distance_grid.allocate(nx, ny),
        within=np.zeros((ny, nx), np.uint8),
    )


def allocate_scratch(vx_samples: int, vtheta_samples: int) -> TrajectoryScratch:
    """Return scratch memory for these numbers of samples."""
    sample_count = vx_samples * vtheta_samples
    return TrajectoryScratch(
        speeds=np.zeros(vx_samples),
        turn_rates=np.zeros(vtheta_samples),
        base_costs=np.zeros(sample_count),
        bounds=np.zeros(sample_count),
        heap=np.zeros(sample_count, np.int64),
        is_probed=np.zeros(sample_count, np.uint8),
        start=np.zeros(1, START),
    )
