"""Critic "goal": the distance of the last point from the local goal."""

from applr_ros1.common.arrays import Data
from applr_ros1.common.kernels import kernel
from applr_ros1.planner.dwa.critics.critic import CriticRow
from applr_ros1.planner.dwa.critics.distance import at_end
from applr_ros1.planner.dwa.records import GOAL, DWAGrids, DWAScene
from applr_ros1.planner.sampling_planner import Record

ROW = CriticRow(
    "goal",
    "goal weight",
    "its grid at the last point",
    "the same",
)


@kernel(inline="always")
def weight(p: Record) -> float:
    """Return the weight of the critic."""
    return p.goal_scale


@kernel(inline="always")
def value(scene: DWAScene, grids: DWAGrids, points: Data) -> float:
    """Return the value for a trajectory through the points (k, 3)."""
    return at_end(scene, grids, GOAL, points, 0.0, True)


@kernel(inline="always")
def bound(known: Record) -> float:
    """Return a lower bound of the value. known: KNOWN record of the sample."""
    return float(known.goal)
