"""Critic "path": the distance of the last point from the path."""

from applr_ros1.common.arrays import Data
from applr_ros1.common.kernels import kernel
from applr_ros1.planner.dwa.critics.critic import CriticRow
from applr_ros1.planner.dwa.critics.distance import at_end
from applr_ros1.planner.dwa.records import PATH, DWAGrids, DWAScene
from applr_ros1.planner.sampling_planner import Record

ROW = CriticRow(
    "path",
    "path weight",
    "its grid at the last point",
    "-3: a point in a wall; -2: a point that no flood reached",
)


@kernel(inline="always")
def weight(p: Record) -> float:
    """Return the weight of the critic."""
    return p.path_scale


@kernel(inline="always")
def value(scene: DWAScene, grids: DWAGrids, points: Data) -> float:
    """Return the value for a trajectory through the points (k, 3)."""
    return at_end(scene, grids, PATH, points, 0.0, True)


@kernel(inline="always")
def bound(known: Record) -> float:
    """Return a lower bound of the value. known: KNOWN record of the sample."""
    return float(known.path)
