"""Distance on a grid at the end of a trajectory, for the critics that read a grid."""

import math

from applr_ros1.common.arrays import Data
from applr_ros1.common.kernels import kernel
from applr_ros1.planner.costmap.grid import world_to_map
from applr_ros1.planner.distance_grid import final_distance, place
from applr_ros1.planner.dwa.critics.critic import IN_OBSTACLE, OFF_MAP, UNREACHED
from applr_ros1.planner.dwa.records import DWAGrids, DWAScene, grid_of
from applr_ros1.planner.search.best_first import HUGE


@kernel
def at_end(
    scene: DWAScene,
    grids: DWAGrids,
    grid_row: int,
    points: Data,
    nose_offset: float,
    tests_all: bool,
) -> float:
    """Return the distance on a grid `nose_offset` [m] in front of the last of the points (k, 3).

    A negative result rejects the trajectory: OFF_MAP if any point is off the map and, with
    `tests_all`, IN_OBSTACLE or UNREACHED if any point cannot be reached. Before the first search
    the result is HUGE.
    """
    rows, columns = scene.cells.shape
    grid = grid_of(grids, grid_row)
    last_distance = 0.0
    for i in range(points.shape[0]):
        x = points[i, 0]
        y = points[i, 1]
        if nose_offset != 0.0:
            x = x + nose_offset * math.cos(points[i, 2])
            y = y + nose_offset * math.sin(points[i, 2])
        cell_x, cell_y = world_to_map(x, y, scene.ox, scene.oy, scene.resolution, columns, rows)
        if cell_x < 0:
            return OFF_MAP
        if not grids.facts[0].flooded:
            last_distance = HUGE
        elif tests_all or i == points.shape[0] - 1:
            distance = final_distance(grid, place(grid, cell_x, cell_y))
            if tests_all and distance >= columns * rows:
                return IN_OBSTACLE if distance == columns * rows else UNREACHED
            last_distance = float(distance)
    return last_distance
