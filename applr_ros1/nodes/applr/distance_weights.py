"""Conversion of parameter sets with distance biases per cell for a planner that counts per metre.

The reconfigure client converts every parameter set on its way to the planner. meter_scoring.py
finds out the planner's unit.
"""

from __future__ import annotations

import math
from typing import List, Optional

import numpy as np

from applr_ros1.common.arrays import Array
from applr_ros1.policy.parameter_space import Space
from applr_ros1.robots.learned import TRAJECTORY

PLANNER = TRAJECTORY  # planner whose unit may vary: DWAPlannerROS always counts per metre
# Weights of a trajectory's cost: two biases that meter_scoring multiplies, and one that it does not
WEIGHTS = ("path_distance_bias", "goal_distance_bias", "occdist_scale")


def weights_at(space: Space) -> Optional[List[int]]:
    """Return the indices in theta of the three WEIGHTS, or None if the space lacks one."""
    indices = {}
    for index, target in space.addresses:
        if target.server == PLANNER:
            indices.update(dict.fromkeys(target.names, index))
    if not set(WEIGHTS) <= set(indices):
        return None
    return [indices[weight_name] for weight_name in WEIGHTS]


def multipliers_of(space: Space, factor: float, largest: Array) -> Array:
    """Return the multipliers (n,) that convert a parameter set with biases per cell.

    The choice among trajectories depends only on the ratios of the three weights. If a bias would
    exceed its bound, all three weights are therefore divided by the same power of two.

    Args:
        space: The parameters. The multipliers are ones unless it contains all three weights.
        factor: Factor that the planner applies to its two biases, 1.0 or the resolution of the
            local costmap [m].
        largest: (n,) largest values that the planner accepts.
    """
    multipliers = np.ones(len(space))
    indices = weights_at(space)
    if factor != 1.0 and indices is not None:
        # A power of two leaves all digits of the third weight as they are.
        *biases, obstacle_weight = indices
        per_meter = 1.0 / factor
        excess = per_meter * space.high[biases].max() / largest[biases].min()
        multipliers[obstacle_weight] = 0.5 ** max(0, math.ceil(math.log2(excess)))
        multipliers[biases] = per_meter * multipliers[obstacle_weight]
    return multipliers
