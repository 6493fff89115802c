"""Records shared by the kernels of the trajectory planner: parameters, memory, surroundings, grids, scratch memory."""

from collections import namedtuple

import numpy as np

from applr_ros1.planner import distance_grid
from applr_ros1.planner.sampling_planner import record

# Parameters of the planner in one record [m, rad, s]. The two biases are already per cell (meter_scoring).
PARAMETERS = record(
    "acc_lim_x acc_lim_y acc_lim_theta max_vel_x min_vel_x max_vel_theta min_vel_theta min_in_place_vel_theta "
    "escape_vel sim_time sim_granularity angular_sim_granularity path_distance_bias goal_distance_bias "
    "occdist_scale heading_lookahead heading_scoring_timestep oscillation_reset_dist escape_reset_dist "
    "escape_reset_theta sim_period",
    "vx_samples vtheta_samples dwa heading_scoring simple_attractor",
)

# Surroundings of the robot in one cycle: the costmap `cells` (ny, nx) uint8 with its origin ox, oy [m] and
# resolution [m], the padded footprint (n, 2) [m] and its line_offsets, and the plan (k, 2) [m].
Scene = namedtuple("Scene", "cells ox oy resolution footprint lines plan")

# Memory of the planner between cycles, in the order of TrajectoryPlanner.state.
STATE = record(
    "",
    "stuck_left stuck_right rotating_left rotating_right escaping",
    "prev_x prev_y escape_x escape_y escape_theta",
)

# Grids of one cycle. path, goal: distance_grid.Grid. within: (ny, nx) uint8, 1 under the robot's filled footprint.
Grids = namedtuple("Grids", "path goal within")

# Scratch memory of one cycle. vs (vx_samples,), ws (vtheta_samples,): sampled vx and w. bases: lower bound of the path
# and goal terms of each forward sample. keys: lower bound of its cost. heap: numbers of the samples, lowest key first.
# probed: whether forward.probe has tested a sample. start (6,): pose and velocity at which all samples start.
Scratch = namedtuple("Scratch", "vs ws bases keys heap probed start")


def allocate_grids(nx: int, ny: int) -> Grids:
    """Return grids for a map of nx by ny cells. A planner reuses them in every cycle."""
    return Grids(
        distance_grid.allocate(nx, ny), distance_grid.allocate(nx, ny), np.zeros((ny, nx), np.uint8)
    )


def allocate_scratch(vx_samples: int, vtheta_samples: int) -> Scratch:
    """Return scratch memory for these numbers of samples."""
    n = vx_samples * vtheta_samples
    per_sample = np.zeros(n), np.zeros(n), np.zeros(n, np.int64), np.zeros(n, np.uint8)
    return Scratch(np.zeros(vx_samples), np.zeros(vtheta_samples), *per_sample, np.zeros(6))
