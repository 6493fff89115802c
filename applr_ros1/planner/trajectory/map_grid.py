"""The two distance grids of the trajectory planner: steps to the path and steps to the local goal.

Called once per control cycle. Rules: base_local_planner/map_grid.cpp. A flood grows only as far as somebody
asks: `settle` goes on until one cell's value is final, `complete` to the end; the numbers are the same.
"""

import math
from collections import namedtuple

import numpy as np
from numba import njit

from applr_ros1.planner.costmap.footprint import fill_footprint
from applr_ros1.planner.costmap.grid import INSCRIBED, UNKNOWN, world_to_map

# path, goal: flat int32 grids of (ny + 2) rows of (nx + 2) cells: the map inside a border of walls, so that a
# flood needs no bounds tests. With N = nx * ny a cell holds its distance, N if it is a wall, or N + 1 ("unseen")
# if no flood has come to it (yet). One cell more at the end is never reached: settling it completes the flood.
# *_queue: the cells in the order of their distances; *_ends: [next to expand, first free place] in it.
# within: (ny, nx) uint8, 1 under the robot's filled footprint.
Grids = namedtuple("Grids", "path goal path_queue goal_queue path_ends goal_ends within")


def allocate(nx, ny):
    """Grids for a map of nx by ny cells; a planner uses the same ones in all its cycles."""
    size = (nx + 2) * (ny + 2) + 1
    grids = Grids(
        np.full(size, nx * ny, np.int32),
        np.full(size, nx * ny, np.int32),
        np.zeros(nx * ny + 8, np.uint32),
        np.zeros(nx * ny + 8, np.uint32),
        np.zeros(2, np.int64),
        np.zeros(2, np.int64),
        np.zeros((ny, nx), np.uint8),
    )
    grids.path[-1] = grids.goal[-1] = nx * ny + 1
    return grids


@njit(cache=True)
def prepare(grids, cells, ox, oy, resolution, footprint, x, y, yaw, plan):
    """Reset both grids for the costmap `cells` (ny, nx) and put 0 where the floods begin.

    plan: (n, 2) [m]. x, y, yaw: the robot's pose, whose footprint (m, 2) [m] makes walls passable for the path
    grid but not for the goal grid. Returns the local goal's cell (x, y), (-1, -1) if the plan is off the map.
    """
    ny, nx = cells.shape
    stride = nx + 2
    wall = np.int32(nx * ny)
    unseen = np.int32(nx * ny + 1)
    for row in range(ny):
        base = (row + 1) * stride + 1
        for column in range(nx):
            value = wall if cells[row, column] >= INSCRIBED else unseen
            grids.path[base + column] = value
            grids.goal[base + column] = value
    grids.path_ends[:] = 0
    grids.goal_ends[:] = 0
    _open_under_robot(grids, ox, oy, resolution, footprint, x, y, yaw)
    goal_x, goal_y = _mark_plan(grids, cells, ox, oy, resolution, plan)
    if goal_x >= 0:
        k = (goal_y + 1) * stride + goal_x + 1
        grids.goal[k] = 0
        grids.goal_queue[0] = k
        grids.goal_ends[1] = 1
    return goal_x, goal_y


@njit(cache=True)
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


@njit(cache=True)
def _mark_plan(grids, cells, ox, oy, resolution, plan):
    """Put 0 on the cells of the plan, made as dense as the map; return the last one. map_grid.cpp:106, 141.

    It begins at the first point that is on the map and known, and ends before the next one that is not.
    """
    ny, nx = cells.shape
    goal_x = goal_y = -1
    tail = 0
    for i in range(plan.shape[0]):
        last_x = plan[max(i - 1, 0), 0]
        last_y = plan[max(i - 1, 0), 1]
        dx = plan[i, 0] - last_x
        dy = plan[i, 1] - last_y
        squared = dx * dx + dy * dy
        steps = 1
        if squared > resolution * resolution:
            steps = int(math.ceil(math.sqrt(squared) / resolution))
        for j in range(1, steps + 1):
            px, py = plan[i, 0], plan[i, 1]
            if j < steps:
                px, py = last_x + j * (dx / steps), last_y + j * (dy / steps)
            mx, my = world_to_map(px, py, ox, oy, resolution, nx, ny)
            if mx >= 0 and cells[my, mx] != UNKNOWN:
                goal_x, goal_y = mx, my
                k = (my + 1) * (nx + 2) + mx + 1
                if grids.path[k] != 0:
                    grids.path[k] = 0
                    grids.path_queue[tail] = k
                    tail += 1
            elif goal_x >= 0:
                grids.path_ends[1] = tail
                return goal_x, goal_y
    grids.path_ends[1] = tail
    return goal_x, goal_y


@njit(cache=True)
def settle(distance, queue, ends, stride, unseen, cell, limit):
    """Flood on until `cell` has its value; returns it: a distance, a wall's value, or `unseen`.

    `unseen` means that nothing is left to flood, so that the cell cannot be reached, or (ends[0] < ends[1]) that
    its distance is above `limit`. 4-connected, one step a cell, never into walls. map_grid.cpp:222.
    """
    one = np.uintp(1)
    side = np.uintp(stride)
    wanted = np.uintp(cell)
    head = np.uintp(ends[0])
    tail = np.uintp(ends[1])
    while head < tail and distance[wanted] == unseen:
        k = np.uintp(queue[head])
        value = distance[k]
        if value >= limit:
            break
        head += one
        value += np.int32(1)
        if distance[k - one] == unseen:
            distance[k - one] = value
            queue[tail] = k - one
            tail += one
        if distance[k + one] == unseen:
            distance[k + one] = value
            queue[tail] = k + one
            tail += one
        if distance[k - side] == unseen:
            distance[k - side] = value
            queue[tail] = k - side
            tail += one
        if distance[k + side] == unseen:
            distance[k + side] = value
            queue[tail] = k + side
            tail += one
    ends[0] = head
    ends[1] = tail
    return int(distance[wanted])


@njit(cache=True)
def complete(distance, queue, ends, nx, ny, out):
    """Flood to the end and write the grid as C++ holds it into `out` (ny, nx) int32.

    N: a wall that the flood touched; N + 1: whatever it never came to.
    """
    stride = nx + 2
    unseen = nx * ny + 1
    settle(distance, queue, ends, stride, unseen, distance.shape[0] - 1, unseen)
    for row in range(ny):
        for column in range(nx):
            out[row, column] = final_value(distance, (row + 1) * stride + column + 1, stride, nx * ny)


@njit(cache=True)
def final_value(distance, k, stride, n):
    """What C++ holds at the cell k, once k and its four neighbours are settled."""
    value = int(distance[k])
    if value == n and not (
        distance[k - 1] < n or distance[k + 1] < n or distance[k - stride] < n or distance[k + stride] < n
    ):
        return n + 1
    return value
