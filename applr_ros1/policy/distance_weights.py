"""What a planner's distance weights count, found from its cost_cloud, and what makes a parameter set mean the same.

In C++, TrajectoryPlannerROS reads `meter_scoring` from memory that nobody sets: the same robot may multiply
path_distance_bias and goal_distance_bias by the costmap's resolution ("per_metre") or not ("per_cell"), and drives
differently. Every policy and set learned here is for a planner that counts per cell. The applr node
(nodes/applr/meter_scoring.py) finds out what a planner counts, and rescales what it sends. No ROS here.
"""

from __future__ import annotations

import math
from typing import NamedTuple, Optional

import numpy as np

from applr_ros1.policy.parameter_space import Space

PLANNER = "TrajectoryPlannerROS"  # DWAPlannerROS always counts per metre
# what meter_scoring multiplies, and the third weight of a trajectory's cost, which it leaves alone
WEIGHTS = ("path_distance_bias", "goal_distance_bias", "occdist_scale")
CLOSE = 0.01  # relative error with which a fitted factor counts as 1 or as the resolution; float32 gives 1e-6
FEWEST = 20  # cells that a fit needs


class Indices(NamedTuple):
    """Where the weights of TrajectoryPlannerROS stand in theta."""

    path: int
    goal: int
    occ: int


def indices_of(space: Space) -> Optional[Indices]:
    """The indices of the three weights in a space; None where it does not set them all, and nothing can be made up."""
    found = {name: i for i, target in space.targets_of(PLANNER) for name in target.names}
    return Indices(*(found[name] for name in WEIGHTS)) if set(WEIGHTS) <= set(found) else None


class Effective(NamedTuple):
    """The weights with which a planner really sums up a trajectory's cost, from one cost_cloud.

    path, goal: per cell of distance; occ: per unit of costmap cost, NaN where no cell of the cloud has any.
    spacing: between neighbouring cells [m].
    """

    path: float
    goal: float
    occ: float
    spacing: float


def fit(rows: np.ndarray) -> Optional[Effective]:
    """Fit total = path_weight path + goal_weight goal + occ_weight occ by least squares of the relative error.

    Args:
        rows: (n, 7) x, y [m], z, path, goal, obstacle and total cost of cells (cost_cloud). Rows of zeros, with which
            C++ fills its clouds up, are left out.

    Returns:
        None where the cells do not determine the weights: too few, or path and goal distances that are proportional.
    """
    rows = np.asarray(rows, dtype=np.float64)
    rows = rows[np.isfinite(rows).all(axis=1) & (rows[:, 6] > 0.0)]
    columns = np.array([True, True, rows[:, 5].any()])
    if len(rows) < FEWEST:
        return None
    terms = rows[:, 3:6][:, columns] / rows[:, 6:7]
    solution, _, rank, _ = np.linalg.lstsq(terms, np.ones(len(rows)), rcond=1e-9)
    steps = np.diff(np.unique(rows[:, 0]))
    if rank < len(solution) or not len(steps):
        return None
    path, goal = float(solution[0]), float(solution[1])
    return Effective(path, goal, float(solution[2]) if columns[2] else math.nan, float(steps.min()))


def factor_of(effective: Effective, path_bias: float, goal_bias: float) -> Optional[float]:
    """By what the planner multiplies the two biases: 1.0 (per cell), or the resolution [m] (per metre).

    Args:
        effective: of a cloud that was made with the biases below.
        path_bias: path_distance_bias in force.
        goal_bias: goal_distance_bias in force.

    Returns:
        None where it is neither, or not the same for both: for instance where the biases have just been changed.
    """
    factors = [
        weight / bias for weight, bias in ((effective.path, path_bias), (effective.goal, goal_bias)) if bias > 0.0
    ]
    for candidate in (1.0, effective.spacing):
        if factors and all(abs(factor - candidate) <= CLOSE * candidate for factor in factors):
            return 1.0 if candidate == 1.0 else round(factors[0], 6)
    return None


def kind_of(factor: float) -> str:
    """The word for a factor: per_cell for 1, per_metre for a resolution."""
    return "per_cell" if factor == 1.0 else "per_metre"


class Compensation:
    """What is sent instead of a parameter set whose two biases count per cell, so that the planner drives the same.

    Args:
        space: the parameters; nothing is changed in one that does not set all three weights.
        factor: by what the planner multiplies its two biases, 1.0 or the resolution of the local costmap [m].
        largest: the upper bound of the planner's biases.

    A choice among trajectories stays the same when all three weights of their costs are multiplied alike. Biases beyond
    their bound are therefore sent, together with occdist_scale, as a half, a quarter ... of what they should be.

    Attributes:
        multipliers: (n,), of the parameters on their way to the planner; ones where nothing has to be changed.
    """

    def __init__(self, space: Space, factor: float = 1.0, largest: float = 5.0):
        self.multipliers = np.ones(len(space))
        indices = indices_of(space)
        if factor != 1.0 and indices is not None:
            path, goal, occ = indices
            wanted = 1.0 / factor
            excess = wanted * max(space.high[path], space.high[goal]) / largest
            self.multipliers[occ] = 0.5 ** max(0, math.ceil(math.log2(excess)))
            self.multipliers[[path, goal]] = wanted * self.multipliers[occ]

    @property
    def needed(self) -> bool:
        """Whether anything is sent otherwise than it stands in the set."""
        return bool((self.multipliers != 1.0).any())

    def outgoing(self, theta: np.ndarray) -> np.ndarray:
        """The values (n,) to be sent for parameters (n,)."""
        return theta * self.multipliers

    def incoming(self, values: np.ndarray) -> np.ndarray:
        """What values (n,) of the planner mean as parameters (n,)."""
        return values / self.multipliers
