"""The two distance grids of the trajectory planner: steps to the path and steps to the local goal.

Called once per control cycle. Rules: base_local_planner/map_grid.cpp.
"""

from __future__ import annotations

import math
from collections import namedtuple

import numpy as np

from applr_ros1.common.kernels import kernel
from applr_ros1.planner import distance_grid
from applr_ros1.planner.costmap.footprint import fill_footprint
from applr_ros1.planner.distance_grid import reset, start_at, start_at_plan

# path, goal: flat grids with their *_queue and *_ends, as distance_grid.py describes them.
# within: (ny, nx) uint8, 1 under the robot's filled footprint.
Grids = namedtuple("Grids", "path goal path_queue goal_queue path_ends goal_ends within")


def allocate(nx: int, ny: int) -> Grids:
    """Grids for a map of nx by ny cells; a planner uses the same ones in all its cycles."""
    path, path_queue, path_ends = distance_grid.allocate(nx, ny)
    goal, goal_queue, goal_ends = distance_grid.allocate(nx, ny)
    return Grids(path, goal, path_queue, goal_queue, path_ends, goal_ends, np.zeros((ny, nx), np.uint8))


@kernel
def prepare(grids, cells, ox, oy, resolution, footprint, x, y, yaw, plan):
    """Reset both grids for the costmap `cells` (ny, nx) and put 0 where the floods begin.

    plan: (n, 2) [m]. x, y, yaw: the robot's pose, whose footprint (m, 2) [m] makes walls passable for the path
    grid but not for the goal grid. Returns the local goal's cell (x, y), (-1, -1) if the plan is off the map.
    """
    reset(grids.path, grids.path_ends, cells)
    reset(grids.goal, grids.goal_ends, cells)
    _open_under_robot(grids, ox, oy, resolution, footprint, x, y, yaw)
    goal_x, goal_y = start_at_plan(grids.path, grids.path_queue, grids.path_ends, cells, ox, oy, resolution, plan, True)
    if goal_x >= 0:
        start_at(grids.goal, grids.goal_queue, grids.goal_ends, (goal_y + 1) * (cells.shape[1] + 2) + goal_x + 1)
    return goal_x, goal_y


@kernel
def _open_under_robot(grids, ox, oy, resolution, footprint, x, y, yaw):
    """Mark the cells within the robot and make them passable for the path grid."""
    ny, nx = grids.within.shape
    grids.within[:] = 0
    fill_footprint(grids.within, 1, ox, oy, resolution, footprint, x, y, yaw, False)
    reach = 0.0
    for i in range(footprint.shape[0]):
        reach = max(reach, math.hypot(footprint[i, 0], footprint[i, 1]))
    side = int(min(reach / resolution, float(nx + ny))) + 2
    cx = int(min(max((x - ox) / resolution, 0.0), nx - 1.0))
    cy = int(min(max((y - oy) / resolution, 0.0), ny - 1.0))
    for row in range(max(0, cy - side), min(ny, cy + side + 1)):
        for column in range(max(0, cx - side), min(nx, cx + side + 1)):
            if grids.within[row, column]:
                grids.path[(row + 1) * (nx + 2) + column + 1] = nx * ny + 1
