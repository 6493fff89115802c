"""Critic "nose to goal": the distance of the robot's nose from the goal ahead of the nose."""

from applr_ros1.common.arrays import Data
from applr_ros1.common.kernels import kernel
from applr_ros1.planner.dwa.critics.critic import CriticRow
from applr_ros1.planner.dwa.critics.distance import at_end
from applr_ros1.planner.dwa.records import FRONT, DWAGrids, DWAScene
from applr_ros1.planner.sampling_planner import Record

ROW = CriticRow(
    "nose to goal",
    "goal weight",
    "its grid at the last point's nose",
    "-4: a nose off the map",
)


@kernel(inline="always")
def weight(p: Record) -> float:
    """Return the weight of the critic."""
    return p.goal_scale


@kernel(inline="always")
def value(p: Record, scene: DWAScene, grids: DWAGrids, points: Data) -> float:
    """Return the value for a trajectory through the points (k, 3)."""
    return at_end(scene, grids, FRONT, points, p.forward_point_distance, False)


@kernel(inline="always")
def bound(known: Record) -> float:
    """Return a lower bound of the value. known: KNOWN record of the sample."""
    return float(known.front)
