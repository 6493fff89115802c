"""Records shared by the kernels of the DWA planner."""

from typing import NamedTuple

import numpy as np

from applr_ros1.common.arrays import Data
from applr_ros1.common.kernels import kernel
from applr_ros1.planner import distance_grid
from applr_ros1.planner.distance_grid import DistanceGrid
from applr_ros1.planner.parameters.dwa_planner_parameters import DWA_PLANNER
from applr_ros1.planner.parameters.parameter import RESTORE
from applr_ros1.planner.sampling_planner import START, record

REALS = " ".join(p.name for p in DWA_PLANNER if p.type == "double")
INTEGERS = " ".join(p.name for p in DWA_PLANNER if p.type in ("int", "bool") and p is not RESTORE)
# Parameters of the server in one record [m, rad, s], and values derived from them. acc_lim_* are
# float32 values. path_scale and goal_scale are the two distance weights per cell. alignment_scale
# is path_scale or, near the goal, 0.
PARAMETERS = record(
    f"{REALS} path_scale goal_scale alignment_scale sim_period cheat_factor",
    f"{INTEGERS} sum_scores",
)

# Oscillation flags, and the pose (float32 values) at which a flag was last set. Per axis, *_only
# flags mark the only allowed sign, the others the sign of the last motion. The order is that of the
# golden set.
STATE = record(
    "",
    "forward_pos_only forward_neg_only strafe_pos_only strafe_neg_only rot_pos_only rot_neg_only "
    "forward_pos forward_neg strafing_pos strafing_neg rotating_pos rotating_neg",
    "prev_x prev_y prev_theta",
)

# Facts about the four grids: whether a search has flooded them, and the row that the nose-on-path
# critic reads. The row is PATH while the critic is on, because both grids are then the same.
FACTS = record("", "flooded alignment_row")


class DWAScene(NamedTuple):
    """Surroundings of the robot in one cycle."""

    cells: Data  # costmap (ny, nx) uint8
    ox: float  # origin of the costmap [m]
    oy: float
    resolution: float  # [m]
    footprint: Data  # padded vertices (n, 2) [m]
    lines: Data  # line_offsets of the footprint
    plan: Data  # points (k, 2 or 3) [m]
    aligned_plan: Data  # plan of the last cycle in which the nose-on-path critic was on


PATH, GOAL, FRONT, ALIGNMENT = range(4)  # rows of the grids


class DWAGrids(NamedTuple):
    """Four distance grids (DistanceGrid), one per row."""

    distances: Data  # (4, size)
    queues: Data  # (4, size)
    ends: Data  # (4, 2)
    nx: int  # size of the map [cells]
    ny: int
    facts: Data  # array of one FACTS record


class DWAScratch(NamedTuple):
    """Scratch memory of one cycle. Arrays over samples are indexed by the number of a sample."""

    sampled_vx: Data  # sampled values of vx [m/s]
    sampled_vy: Data  # sampled values of vy [m/s]
    sampled_w: Data  # sampled values of w [rad/s]
    # Lower bounds (m, ALL) of the critics' values, as far as bounds.py finds one before a sample is
    # rolled out: distances on grids [cells] and obstacle costs. With 32 bits, the table of some ten
    # thousand samples stays in the cache.
    known: Data
    bounds: Data  # see search.best_first.next_step
    heap: Data
    is_probed: Data
    start: Data  # array of one START record: pose and velocity, rounded to float32


def allocate_grids(nx: int, ny: int) -> DWAGrids:
    """Return grids for a map of nx by ny cells. A planner reuses them in every cycle."""
    grid = distance_grid.allocate(nx, ny)
    return DWAGrids(
        distances=np.tile(grid.distance, (4, 1)),
        queues=np.tile(grid.queue, (4, 1)),
        ends=np.tile(grid.ends, (4, 1)),
        nx=nx,
        ny=ny,
        facts=np.zeros(1, FACTS),
    )


@kernel
def row_of(grids: DWAGrids, row: int) -> int:
    """Return the row with the grid of a row: ALIGNMENT may share that of PATH, see FACTS."""
    return grids.facts[0].alignment_row if row == ALIGNMENT else row


@kernel
def grid_of(grids: DWAGrids, row: int) -> DistanceGrid:
    """Return the grid of a row."""
    row = row_of(grids, row)
    return DistanceGrid(
        grids.distances[row], grids.queues[row], grids.ends[row], grids.nx, grids.ny
    )


def allocate_scratch(
    critic_count: int, vx_samples: int, vy_samples: int, vth_samples: int
) -> DWAScratch:
    """Return scratch memory for these numbers of critics and samples.

    An axis has at least two values and maybe an extra zero.
    """
    sampled_vx = np.zeros(max(vx_samples, 2) + 1)
    sampled_vy = np.zeros(max(vy_samples, 2) + 1)
    sampled_w = np.zeros(max(vth_samples, 2) + 1)
    sample_count = len(sampled_vx) * len(sampled_vy) * len(sampled_w)
    return DWAScratch(
        sampled_vx=sampled_vx,
        sampled_vy=sampled_vy,
        sampled_w=sampled_w,
        known=np.zeros((sample_count, critic_count), np.int32),
        bounds=np.zeros(sample_count),
        heap=np.zeros(sample_count, np.int64),
        is_probed=np.zeros(sample_count, np.uint8),
        start=np.zeros(1, START),
    )
