"""Global planner navfn: grows a potential from the robot's cell and traces a path down its gradient.

Called by MoveBase. Follows navfn/navfn_ros.cpp (docs/explanation/planner.md, section 5). Potentials, cost array and
plans equal those of C++ byte for byte.
"""

from __future__ import annotations

from typing import Any, Optional, Sequence, Tuple

import numpy as np

from applr_ros1.common.arrays import Data
from applr_ros1.common.kernels import kernel
from applr_ros1.planner.costmap.costmap import Costmap
from applr_ros1.planner.costmap.grid import Window, world_to_map
from applr_ros1.planner.navfn import window
from applr_ros1.planner.navfn.flood import LINE, LIST_SIZE, OBSTACLE, PUSH_WEIGHTS, flood, make_field, reset, scratch
from applr_ros1.planner.navfn.path import trace

FREE_COST = 50  # cost of a cell that is 0 in the costmap


class Navfn:
    """Global planner for one Costmap at a time.

    Keeps navfn's cost array up to date with the costmap. The last plan is reused until a cell that the last flood read
    has changed. A flood covers only the part of the map on which the plan depends (window.py).
    """

    def __init__(self, list_size: int = LIST_SIZE):
        self._costmap: Any = None
        self._cells: Any = None  # cells of the costmap; a resized costmap has another array
        self._list_size = list_size

    def _attach(self, costmap: Costmap, allow_unknown: bool) -> None:
        """Start anew with a costmap. The next plan converts all of its cells."""
        nx, ny = costmap.size
        self._costmap, self._cells = costmap, costmap.cells
        self._allow_unknown = allow_unknown
        self._costs = np.full(nx * ny, OBSTACLE, np.uint8)
        self._costs.reshape(ny, nx)[1:-1, 1:-1] = 0  # No navfn cost is 0, so the first conversion changes every cell.
        self._field = make_field(nx * ny)
        self._lines = np.zeros(len(self._potential) // LINE, np.uint8)
        self._scratch = scratch(self._list_size)
        self._path = np.empty((4 * nx, 2), np.float32)
        self._version: Optional[int] = None  # version of the costmap at the last conversion
        self._extent = np.array([nx, ny, -1, -1])  # bounding box of all cells that were ever not free
        self._fence: Any = None  # fence of the last flood; None if it covered the whole map
        self._flooded = (-1, -1)  # cells of robot and goal of the last flood
        self._asked: Any = None  # arguments of the last plan
        self._plan: np.ndarray = np.zeros((0, 3))

    @property
    def _potential(self) -> np.ndarray:
        return self._field[::2]  # A stored view would become a separate array in a deep copy.

    @property
    def potential(self) -> np.ndarray:
        """Potential (ny, nx) float32 of the last plan, flooded over the whole map; 1e10 in unreached cells."""
        nx, ny = self._costmap.size
        if self._fence is not None:
            self._flood_within()
        return self._potential[: nx * ny].reshape(ny, nx)

    @property
    def costs(self) -> np.ndarray:
        """Cost array (ny, nx) uint8 of the last plan."""
        nx, ny = self._costmap.size
        return self._costs.reshape(ny, nx).copy()

    def plan(
        self,
        costmap: Costmap,
        start: Sequence[float],
        goal: Sequence[float],
        tolerance: float = 0.0,
        allow_unknown: bool = True,
    ) -> np.ndarray:
        """Return a plan (n, 3) of x, y [m], yaw [rad] from `start` to `goal`, or (0, 3) if there is none.

        Yaw is 0 except in the last pose, which has the goal's yaw. The robot's cell is freed in the costmap itself,
        as in C++.

        Args:
            costmap: map to plan on.
            start: position (x, y) [m] of the robot.
            goal: pose (x, y [m], yaw [rad]) to reach.
            tolerance: distance [m] from the goal within which the plan may end.
            allow_unknown: whether the plan may lead through unknown cells.
        """
        nx, ny = costmap.size
        sx, sy = costmap.world_to_map(start[0], start[1])
        if sx < 0:
            return np.zeros((0, 3))
        gx, gy = costmap.world_to_map(goal[0], goal[1])
        if gx < 0:
            if tolerance <= 0:
                return np.zeros((0, 3))
            gx, gy = 0, 0
        costmap.set_free(sx, sy, sx + 1, sy + 1)
        self._flood(costmap, bool(allow_unknown), sy * nx + sx, gy * nx + gx, tolerance)
        ox, oy = costmap.origin.tolist()
        question = (ox, oy, float(goal[0]), float(goal[1]), float(goal[2]), float(tolerance))
        if question != self._asked:
            self._asked = question
            self._plan = self._trace(costmap, ox, oy, goal, tolerance)
        return self._plan.copy()

    def _flood(self, costmap: Costmap, allow_unknown: bool, robot: int, goal: int, tolerance: float) -> None:
        """Bring the cost array up to date and flood again if the potential may have changed."""
        if costmap is not self._costmap or costmap.cells is not self._cells or allow_unknown != self._allow_unknown:
            self._attach(costmap, allow_unknown)
        nx, ny = costmap.size
        changed = (0, 0, nx, ny) if self._version is None else costmap.changed_since(self._version)
        self._version = costmap.version
        stale = changed and _convert(costmap.cells, self._costs, self._field, allow_unknown, self._extent, changed)
        # No fence for a tolerance, which reads potentials around the goal, and for short lists, which lose pushes.
        whole = tolerance > 0 or self._list_size < LIST_SIZE
        if not stale and self._flooded == (robot, goal) and not (whole and self._fence):
            return
        self._flooded = (robot, goal)
        self._asked = None
        self._flood_within(None if whole else window.around(self._extent, robot, goal, nx, ny))

    def _flood_within(self, fence: Optional[Window] = None) -> None:
        """Flood between the cells of `_flooded` inside a fence, or over the whole map if there is none."""
        nx, ny = self._costmap.size
        self._fence = fence
        reset(self._field, self._lines)
        if fence is not None:
            window.set_fence(self._field, self._costs, nx, fence, True)
        flood(self._field, self._lines, *self._scratch, nx, ny, *self._flooded)
        if fence is not None:
            window.set_fence(self._field, self._costs, nx, fence, False)

    def _trace(self, costmap: Costmap, ox: float, oy: float, goal: Sequence[float], tolerance: float) -> np.ndarray:
        nx, ny = costmap.size
        robot = self._flooded[0]
        res = costmap.resolution
        target, tx, ty = _target(self._potential, ox, oy, res, nx, ny, float(goal[0]), float(goal[1]), float(tolerance))
        n = trace(self._potential, nx, ny, target, robot, self._path) if target >= 0 else 0
        fence = self._fence
        if fence and target >= 0 and not (n and window.keeps_inside(self._path, n, nx, ny, fence)):
            self._flood_within()
            return self._trace(costmap, ox, oy, goal, tolerance)
        if n == 0:
            return np.zeros((0, 3))
        plan = np.zeros((n + 1, 3))
        _to_world(self._path, n, ox, oy, res, plan)
        plan[n] = tx, ty, goal[2]
        return plan


@kernel
def _to_world(path: Data, n: int, ox: float, oy: float, res: float, plan: Data) -> None:
    """Convert n points [cells] of `path`, goal first, to points [m] of `plan`, robot first, as in C++."""
    for i in range(n):
        plan[i, 0] = ox + np.float64(path[n - 1 - i, 0]) * res
        plan[i, 1] = oy + np.float64(path[n - 1 - i, 1]) * res


@kernel
def _convert(cells: Data, costs: Data, field: Data, allow_unknown: bool, extent: Data, window: Window) -> bool:
    """Update navfn's costs and weights of the cells in the window; the map's border stays an obstacle.

    The cost is int(50 + 0.8 v) for v < 253, in integers (navfn.cpp:228). Widens the extent (4,) of window.around().
    Returns whether the last flood may have read a changed cell, because the cell or a neighbour has a potential.
    """
    (ny, nx), (x0, y0, xn, yn) = cells.shape, window
    far = np.float32(1e10)
    unknown = np.uint16(253 if allow_unknown else OBSTACLE)
    obstacle = np.uint16(OBSTACLE)
    stale = False
    left = max(1, x0)
    right = max(left, min(nx - 1, xn))
    for y in range(max(1, y0), min(ny - 1, yn)):
        values = cells[y, left:right]
        olds = costs[y * nx + left : y * nx + right]
        differs = np.uint16(0)
        for i in range(values.shape[0]):  # (205 v) >> 8 equals (4 v) // 5 here and compiles to vector instructions.
            v = np.uint16(values[i])
            cost = np.uint16(np.uint16(50) + np.uint16(np.uint16(v * np.uint16(205)) >> np.uint16(8)))
            new = cost if v < np.uint16(253) else (unknown if v == np.uint16(255) else obstacle)
            differs |= np.uint16(new ^ np.uint16(olds[i]))
        if differs == 0:
            continue
        for i in range(values.shape[0]):
            value = int(values[i])
            new_cost = 50 + (4 * value) // 5 if value < 253 else (int(unknown) if value == 255 else OBSTACLE)
            if new_cost != olds[i]:
                olds[i] = new_cost
                k = y * nx + left + i
                field[2 * k + 1] = PUSH_WEIGHTS[new_cost]
                if new_cost != FREE_COST:
                    extent[0] = min(extent[0], left + i)
                    extent[1] = min(extent[1], y)
                    extent[2] = max(extent[2], left + i)
                    extent[3] = max(extent[3], y)
                for near in (k, k - 1, k + 1, k - nx, k + nx):
                    stale = stale or field[2 * near] < far
    return stale


@kernel
def _target(
    potential: Data, ox: float, oy: float, res: float, nx: int, ny: int, gx: float, gy: float, tolerance: float
) -> Tuple[int, float, float]:
    """Return (cell, x, y) of the reached point nearest to the goal, at most `tolerance` [m] away along each axis.

    The cell is -1 if no point is reached. navfn_ros.cpp:262.
    """
    cell = -1
    best = np.inf
    bx = gx
    by = gy
    beside = gx + tolerance < ox or gx - tolerance > ox + nx * res
    if beside or gy + tolerance < oy or gy - tolerance > oy + ny * res:
        return cell, bx, by  # off the map. At huge coordinates, x += res leaves x as it is, and the loop never ends.
    y = gy - tolerance
    while y <= gy + tolerance:
        x = gx - tolerance
        while x <= gx + tolerance:
            mx, my = world_to_map(x, y, ox, oy, res, nx, ny)
            if mx >= 0 and potential[my * nx + mx] < np.float32(1e10):
                d = (x - gx) * (x - gx) + (y - gy) * (y - gy)
                if d < best:
                    best = d
                    bx = x
                    by = y
                    cell = my * nx + mx
            x += res
        y += res
    return cell, bx, by
