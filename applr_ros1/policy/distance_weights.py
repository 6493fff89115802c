"""Distance weights of a planner: what they count, found from its cost_cloud, and what makes a set mean the same.

In C++, TrajectoryPlannerROS reads `meter_scoring` from memory that nobody sets: the same robot may multiply
path_distance_bias and goal_distance_bias by the costmap's resolution (they count per metre) or not (per cell), and
drives differently. Every policy and set learned here is for a planner that counts per cell. The applr node
(nodes/applr/meter_scoring.py) finds out what a planner counts, and rescales what it sends. No ROS here.
"""

from __future__ import annotations

import math
from typing import List, Optional

import numpy as np

from applr_ros1.policy.parameter_space import Space

PLANNER = "TrajectoryPlannerROS"  # DWAPlannerROS always counts per metre
# what meter_scoring multiplies, and the third weight of a trajectory's cost, which it leaves alone
WEIGHTS = ("path_distance_bias", "goal_distance_bias", "occdist_scale")
CLOSE = 0.002  # relative error of a cell's cost that a factor explains; float32 gives 1e-6
FEWEST = 20  # cells that an answer needs


def indices_of(space: Space) -> Optional[List[int]]:
    """Return the indices in theta of the three WEIGHTS; None where a space does not set them all."""
    found = {name: i for i, target in space.targets_of(PLANNER) for name in target.names}
    return [found[name] for name in WEIGHTS] if set(WEIGHTS) <= set(found) else None


def factor_of(rows: np.ndarray, weights: np.ndarray, resolution: float) -> Optional[float]:
    """Find by what the planner multiplies its two biases: 1.0 (per cell), or the resolution [m] (per metre).

    Args:
        rows: (n, 7) x, y, z [m], path, goal, obstacle and total cost of cells (cost_cloud). Rows of zeros, with which
            C++ fills its clouds up, are left out.
        weights: (3,) values in force of WEIGHTS.
        resolution: Of the local costmap.

    Returns:
        None where not exactly one of the two gives every cell's total cost: for instance where the biases have just
        been changed, or where there are too few cells.
    """
    rows = np.asarray(rows, dtype=np.float64)
    rows = rows[np.isfinite(rows).all(axis=1) & (rows[:, 6] > 0.0)]
    if len(rows) < FEWEST:
        return None
    path, goal, occ = weights
    distances, obstacles, total = path * rows[:, 3] + goal * rows[:, 4], occ * rows[:, 5], rows[:, 6]
    fitting = [
        factor
        for factor in (1.0, resolution)
        if (np.abs(factor * distances + obstacles - total) <= CLOSE * total).all()
    ]
    return fitting[0] if len(fitting) == 1 else None


def multipliers_of(space: Space, factor: float, largest: float = 5.0) -> np.ndarray:
    """Return by what (n,) a set that counts per cell is multiplied on its way to a planner, which then drives the same.

    A choice among trajectories stays the same when all three weights of their costs are multiplied alike. Biases beyond
    their bound are therefore sent, together with occdist_scale, as a half, a quarter ... of what they should be.

    Args:
        space: The parameters; of one that does not set all three weights none is changed.
        factor: By what the planner multiplies its two biases, 1.0 or the resolution of the local costmap [m].
        largest: The upper bound of the planner's biases.
    """
    found, indices = np.ones(len(space)), indices_of(space)
    if factor != 1.0 and indices is not None:
        path, goal, occ = indices
        wanted = 1.0 / factor
        excess = wanted * max(space.high[path], space.high[goal]) / largest
        found[occ] = 0.5 ** max(0, math.ceil(math.log2(excess)))
        found[[path, goal]] = wanted * found[occ]
    return found
