"""Records shared by the kernels of the DWA planner: parameters, memory, surroundings, grids, scratch memory."""

from collections import namedtuple

import numpy as np

from applr_ros1.common.kernels import kernel
from applr_ros1.planner import distance_grid
from applr_ros1.planner.distance_grid import Grid
from applr_ros1.planner.sampling_planner import record

# Parameters of the planner in one record [m, rad, s]. acc_lim_* are float32 values. path_scale and goal_scale are the
# two distance weights per cell. alignment_scale is path_scale or, near the goal, 0.
PARAMETERS = record(
    "max_vel_trans min_vel_trans max_vel_x min_vel_x max_vel_y min_vel_y max_vel_theta min_vel_theta acc_lim_x "
    "acc_lim_y acc_lim_theta sim_time sim_granularity angular_sim_granularity path_distance_bias "
    "goal_distance_bias occdist_scale twirling_scale oscillation_reset_dist oscillation_reset_angle "
    "forward_point_distance scaling_speed max_scaling_factor path_scale goal_scale alignment_scale sim_period "
    "cheat_factor",
    "vx_samples vy_samples vth_samples use_dwa sum_scores",
)

# Oscillation flags, and the pose (float32 values) at which a flag was last set. Per axis, *_only flags mark the only
# allowed sign, the others the sign of the last motion.
STATE = record(
    "",
    "forward_pos_only forward_neg_only strafe_pos_only strafe_neg_only rot_pos_only rot_neg_only "
    "forward_pos forward_neg strafing_pos strafing_neg rotating_pos rotating_neg",
    "prev_x prev_y prev_theta",
)

# Surroundings of the robot in one cycle: the costmap `cells` (ny, nx) uint8 with its origin ox, oy [m] and
# resolution [m], the padded footprint (n, 2) [m] and its line_offsets, the plan (k, 2 or 3) [m], and the plan of the
# last cycle in which the nose-on-path critic (ALIGNMENT) was on.
Scene = namedtuple("Scene", "cells ox oy resolution footprint lines plan aligned_plan")

PATH, GOAL, FRONT, ALIGNMENT = range(4)

# Four distance grids (distance_grid.Grid), one per row of distances (4, size), queues (4, size) and ends (4, 2).
# facts: (whether a search has taken place, row that the nose-on-path critic reads). The row is PATH while the critic is
# on, because both grids are then the same.
Grids = namedtuple("Grids", "distances queues ends nx ny facts")

# Scratch memory of one cycle. xs, ys, ws: sampled values of vx, vy, w. keys, bounds, occupied: lower bounds of each
# sample's cost, of its four grid values, and of its obstacle cost. heap: numbers of the samples, lowest key first.
# probed: whether bounds.probe has tested a sample. start (6,): pose and velocity, rounded to float32.
Scratch = namedtuple("Scratch", "xs ys ws keys bounds occupied heap probed start")


def allocate_grids(nx: int, ny: int) -> Grids:
    """Return grids for a map of nx by ny cells. A planner reuses them in every cycle."""
    distance, queue, ends, _, _ = distance_grid.allocate(nx, ny)
    distances, queues, ends = (np.tile(array, (4, 1)) for array in (distance, queue, ends))
    return Grids(distances, queues, ends, nx, ny, np.zeros(2, np.int64))


@kernel
def grid_of(grids: Grids, row: int) -> Grid:
    """Return one of the four grids."""
    return Grid(grids.distances[row], grids.queues[row], grids.ends[row], grids.nx, grids.ny)


def allocate_scratch(vx_samples: int, vy_samples: int, vth_samples: int) -> Scratch:
    """Return scratch memory for these numbers of samples. An axis has at least two values and maybe an extra zero."""
    xs, ys, ws = (np.zeros(max(n, 2) + 1) for n in (vx_samples, vy_samples, vth_samples))
    n = len(xs) * len(ys) * len(ws)
    integers = (
        np.zeros((n, 4), np.int32),
        np.zeros(n, np.int64),
        np.zeros(n, np.int64),
        np.zeros(n, np.uint8),
    )
    return Scratch(xs, ys, ws, np.zeros(n), *integers, np.zeros(6))
