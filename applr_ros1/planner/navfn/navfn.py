"""Global planner navfn: grows a potential from the robot's cell and traces a path down it.

Called by MoveBase. Follows navfn/navfn_ros.cpp (docs/explanation/planner.md, section 5).
Potentials, cost array and plans equal those of C++ byte for byte.
"""

from __future__ import annotations

from typing import Any, Optional, Sequence, Tuple

import numpy as np

from applr_ros1.common.arrays import Data
from applr_ros1.common.kernels import kernel
from applr_ros1.planner.costmap.costmap import Costmap
from applr_ros1.planner.costmap.grid import INSCRIBED, UNKNOWN, Window, world_to_map
from applr_ros1.planner.navfn import window
from applr_ros1.planner.navfn.flood import (
    FAR,
    LINE,
    LIST_SIZE,
    OBSTACLE,
    PUSH_WEIGHTS,
    flood,
    make_field,
    reset,
    scratch,
)
from applr_ros1.planner.navfn.path import trace

FREE_COST = 50  # cost of a cell that is 0 in the costmap
UNKNOWN_COST = 253  # cost of an unknown cell, if plans may lead through it
_NO_PLAN = np.zeros((0, 3))


class Navfn:
    """Global planner for one Costmap at a time.

    Keeps navfn's cost array up to date with the costmap. The last plan is reused until a cell that
    the last flood read has changed. A flood covers only the part of the map on which the plan
    depends (window.py).

    Attributes:
        fence: First column and row, last column and row of the last flood; None if it covered the
            whole map.
    """

    def __init__(self, list_size: int = LIST_SIZE):
        self.fence: Optional[Window] = None
        self._costmap: Any = None
        self._cells: Any = None  # cells of the costmap; a resized costmap has another array
        self._list_size = list_size

    def _attach(self, costmap: Costmap, allow_unknown: bool) -> None:
        """Start anew with a costmap. The next plan converts all of its cells."""
        columns, rows = costmap.size
        self._costmap = costmap
        self._cells = costmap.cells
        self._allow_unknown = allow_unknown
        self._version: Optional[int] = None  # version of the costmap at the last conversion
        # Bounding box of all cells that were ever not free, inclusive.
        self._extent = np.array([columns, rows, -1, -1])

        # No navfn cost is 0, so the first conversion changes every cell inside the map's border.
        self._costs = np.full(columns * rows, OBSTACLE, np.uint8)
        self._costs.reshape(rows, columns)[1:-1, 1:-1] = 0

        self._field = make_field(columns * rows)
        self._lines = np.zeros(len(self.flooded_potential) // LINE, np.uint8)
        self._scratch = scratch(self._list_size)
        self.fence = None
        self._flooded = (-1, -1)  # cells of robot and goal of the last flood

        self._path = np.empty((4 * columns, 2), np.float32)
        self._question: Any = None  # arguments of the last plan, None if the flood has changed
        self._plan = _NO_PLAN

    @property
    def flooded_potential(self) -> np.ndarray:
        """Potential (n,) float32 of the last flood, row by row, 1e10 in unreached cells.

        It is final inside the fence alone, and a few more cells follow those of the map.
        """
        return self._field[::2]  # A stored view would become a separate array in a deep copy.

    @property
    def potential(self) -> np.ndarray:
        """Potential (rows, columns) float32 of the last plan, 1e10 in unreached cells.

        It is flooded over the whole map.
        """
        columns, rows = self._costmap.size
        if self.fence is not None:
            self._flood_within()
        return self.flooded_potential[: columns * rows].reshape(rows, columns)

    @property
    def costs(self) -> np.ndarray:
        """Cost array (rows, columns) uint8 of the last plan."""
        columns, rows = self._costmap.size
        return self._costs.reshape(rows, columns).copy()

    def plan(
        self,
        costmap: Costmap,
        start: Sequence[float],
        goal: Sequence[float],
        tolerance: float = 0.0,
        allow_unknown: bool = True,
    ) -> np.ndarray:
        """Return a plan (n, 3) of x, y [m], yaw [rad] from start to goal, (0, 3) if there is none.

        Yaw is 0 except in the last pose, which has the goal's yaw. The robot's cell is freed in the
        costmap itself, as in C++.

        Args:
            costmap: map to plan on.
            start: position (x, y) [m] of the robot.
            goal: pose (x, y [m], yaw [rad]) to reach.
            tolerance: distance [m] from the goal within which the plan may end.
            allow_unknown: whether the plan may lead through unknown cells.
        """
        columns, _ = costmap.size
        start_x, start_y = costmap.world_to_map(start[0], start[1])
        if start_x < 0:
            return _NO_PLAN.copy()
        goal_x, goal_y = costmap.world_to_map(goal[0], goal[1])
        if goal_x < 0:
            if tolerance <= 0:
                return _NO_PLAN.copy()
            # As in C++, the cell stands for a goal off the map. It is on the border, which no flood
            # reaches, so everything is flooded.
            goal_x = 0
            goal_y = 0

        costmap.set_free(start_x, start_y, start_x + 1, start_y + 1)
        robot_cell = start_y * columns + start_x
        goal_cell = goal_y * columns + goal_x
        self._flood(costmap, bool(allow_unknown), robot_cell, goal_cell, tolerance)

        x, y, yaw = goal
        question = (*costmap.origin.tolist(), float(x), float(y), float(yaw), float(tolerance))
        if question != self._question:
            self._question = question
            self._plan = self._trace(costmap, goal, tolerance)
        return self._plan.copy()

    def _flood(
        self, costmap: Costmap, allow_unknown: bool, robot: int, goal: int, tolerance: float
    ) -> None:
        """Bring the cost array up to date and flood again if the potential may have changed."""
        if (
            costmap is not self._costmap
            or costmap.cells is not self._cells
            or allow_unknown != self._allow_unknown
        ):
            self._attach(costmap, allow_unknown)

        columns, rows = costmap.size
        changed_window: Optional[Window] = (0, 0, columns, rows)
        if self._version is not None:
            changed_window = costmap.changed_since(self._version)
        self._version = costmap.version
        is_stale = False
        if changed_window is not None:
            is_stale = _convert(
                costmap.cells, self._costs, self._field, allow_unknown, self._extent, changed_window
            )

        # A tolerance reads potentials around the goal, and short lists lose pushes: both get no
        # fence.
        needs_whole_map = tolerance > 0 or self._list_size < LIST_SIZE
        covers_enough = self.fence is None or not needs_whole_map
        is_reusable = covers_enough and self._flooded == (robot, goal)
        if is_reusable and not is_stale:
            return
        self._flooded = (robot, goal)
        self._question = None
        fence = None
        if not needs_whole_map:
            fence = window.around(self._extent, robot, goal, columns, rows)
        self._flood_within(fence)

    def _flood_within(self, fence: Optional[Window] = None) -> None:
        """Flood between the cells of `_flooded` inside a fence, or the whole map without one."""
        columns, rows = self._costmap.size
        self.fence = fence
        reset(self._field, self._lines)
        if fence is not None:
            window.set_fence(self._field, self._costs, columns, fence, window.CLOSED)
        flood(self._field, self._lines, *self._scratch, columns, rows, *self._flooded)
        if fence is not None:
            window.set_fence(self._field, self._costs, columns, fence, window.OPEN)

    def _trace(self, costmap: Costmap, goal: Sequence[float], tolerance: float) -> np.ndarray:
        """Return the plan (n, 3) down the potential of the last flood, (0, 3) if there is none."""
        columns, rows = costmap.size
        origin_x, origin_y = costmap.origin.tolist()
        resolution = costmap.resolution
        target_cell, target_x, target_y = target_of(
            self.flooded_potential,
            origin_x,
            origin_y,
            resolution,
            columns,
            rows,
            float(goal[0]),
            float(goal[1]),
            float(tolerance),
        )
        if target_cell < 0:
            return _NO_PLAN
        robot = self._flooded[0]
        point_count = trace(self.flooded_potential, columns, rows, target_cell, robot, self._path)

        # Beside the fence, the potential may differ from that of the whole map.
        fence = self.fence
        if fence is not None:
            is_inside = window.keeps_inside(self._path, point_count, columns, rows, fence)
            if point_count == 0 or not is_inside:
                self._flood_within()
                return self._trace(costmap, goal, tolerance)

        if point_count == 0:
            return _NO_PLAN
        plan = np.zeros((point_count + 1, 3))
        _to_world(self._path, point_count, origin_x, origin_y, resolution, plan)
        plan[point_count] = target_x, target_y, goal[2]
        return plan


@kernel
def _to_world(
    path: Data, count: int, origin_x: float, origin_y: float, resolution: float, plan: Data
) -> None:
    """Convert points [cells] of `path`, goal first, to points [m] of `plan`, robot first.

    As in C++, there is no half cell: the plan lies half a cell towards the map's lower corner.
    """
    for index in range(count):
        point = count - 1 - index
        plan[index, 0] = origin_x + np.float64(path[point, 0]) * resolution
        plan[index, 1] = origin_y + np.float64(path[point, 1]) * resolution


@kernel
def _convert(
    cells: Data, costs: Data, field: Data, allow_unknown: bool, extent: Data, area: Window
) -> bool:
    """Update navfn's costs and weights in a window; the map's border stays an obstacle.

    The cost is int(50 + 0.8 v) for v < 253, in integers (navfn.cpp:228). Widens the extent (4,) of
    window.around(). Returns whether the last flood may have read a changed cell, because the cell
    or a neighbour has a potential.
    """
    rows, columns = cells.shape
    first_column, first_row, end_column, end_row = area
    unknown_cost = np.uint16(OBSTACLE)
    if allow_unknown:
        unknown_cost = np.uint16(UNKNOWN_COST)
    is_stale = False
    left = max(1, first_column)
    right = max(left, min(columns - 1, end_column))
    for row in range(max(1, first_row), min(rows - 1, end_row)):
        costmap_row = cells[row, left:right]
        old_costs = costs[row * columns + left : row * columns + right]

        # Most rows are unchanged. The test has no branches and compiles to vector instructions:
        # (205 v) >> 8 equals (4 v) // 5 for v < 253.
        row_difference = np.uint16(0)
        for index in range(costmap_row.shape[0]):
            value = np.uint16(costmap_row[index])
            scaled_value = np.uint16(np.uint16(value * np.uint16(205)) >> np.uint16(8))
            scaled_cost = np.uint16(np.uint16(FREE_COST) + scaled_value)
            special_cost = unknown_cost if value == np.uint16(UNKNOWN) else np.uint16(OBSTACLE)
            new_cost = scaled_cost if value < np.uint16(INSCRIBED) else special_cost
            row_difference |= np.uint16(new_cost ^ np.uint16(old_costs[index]))
        if row_difference == 0:
            continue

        for index in range(costmap_row.shape[0]):
            navfn_cost = OBSTACLE
            if costmap_row[index] < INSCRIBED:
                navfn_cost = FREE_COST + (4 * int(costmap_row[index])) // 5
            elif costmap_row[index] == UNKNOWN:
                navfn_cost = int(unknown_cost)
            if navfn_cost == old_costs[index]:
                continue
            old_costs[index] = navfn_cost
            column = left + index
            cell = row * columns + column
            field[2 * cell + 1] = PUSH_WEIGHTS[navfn_cost]
            if navfn_cost != FREE_COST:
                extent[0] = min(extent[0], column)
                extent[1] = min(extent[1], row)
                extent[2] = max(extent[2], column)
                extent[3] = max(extent[3], row)
            for neighbour in (cell, cell - 1, cell + 1, cell - columns, cell + columns):
                is_stale = is_stale or field[2 * neighbour] < FAR
    return is_stale


@kernel
def target_of(
    potential: Data,
    origin_x: float,
    origin_y: float,
    resolution: float,
    columns: int,
    rows: int,
    goal_x: float,
    goal_y: float,
    tolerance: float,
) -> Tuple[int, float, float]:
    """Return the reached point nearest to the goal, at most `tolerance` [m] away along each axis.

    Returns:
        (cell, x, y) [m]. The cell is -1 if no point is reached. navfn_ros.cpp:262.
    """
    nearest_cell = -1
    nearest_x = goal_x
    nearest_y = goal_y
    least_distance = np.inf

    # Off the map there is nothing to find. At huge coordinates, x += resolution leaves x as it is,
    # and the loop would never end.
    max_x = origin_x + columns * resolution
    max_y = origin_y + rows * resolution
    if goal_x + tolerance < origin_x or goal_x - tolerance > max_x:
        return nearest_cell, nearest_x, nearest_y
    if goal_y + tolerance < origin_y or goal_y - tolerance > max_y:
        return nearest_cell, nearest_x, nearest_y

    # The sums accumulate rounding errors as those of C++ do.
    y = goal_y - tolerance
    while y <= goal_y + tolerance:
        x = goal_x - tolerance
        while x <= goal_x + tolerance:
            cell_x, cell_y = world_to_map(x, y, origin_x, origin_y, resolution, columns, rows)
            cell = cell_y * columns + cell_x
            if cell_x >= 0 and potential[cell] < FAR:
                distance = (x - goal_x) * (x - goal_x) + (y - goal_y) * (y - goal_y)
                if distance < least_distance:
                    least_distance = distance
                    nearest_x = x
                    nearest_y = y
                    nearest_cell = cell
            x += resolution
        y += resolution
    return nearest_cell, nearest_x, nearest_y
