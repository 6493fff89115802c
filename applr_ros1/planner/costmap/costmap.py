"""The layered costmap: an obstacle layer and an inflation layer over one master grid.

Called by MoveBase (one local rolling map, one global map), the planners and the tests. Follows
costmap_2d/layered_costmap.cpp; every value of the master after any sequence of updates is the C++ one's.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import replace
from typing import Any, Deque, Optional, Sequence, Tuple, Union

import numpy as np

from applr_ros1.common.errors import ApplrError
from applr_ros1.planner.costmap import footprint as footprints
from applr_ros1.planner.costmap.grid import (
    FREE,
    UNKNOWN,
    roll,
    size_in_meters,
    world_to_map,
    world_to_map_enforce_bounds,
)
from applr_ros1.planner.costmap.inflation_layer import InflationLayer, InflationParameters
from applr_ros1.planner.costmap.obstacle_layer import ObstacleLayer, ObstacleParameters
from applr_ros1.planner.costmap.scan import PointCloud


class CostmapError(ApplrError):
    """A costmap that cannot be made or used so; the message is one line."""


class Costmap:
    """Master grid with its layers.

    cells (ny, nx) uint8: 0 free .. 252 inflated, 253 inscribed, 254 lethal, 255 unknown. origin (2,) [m]: the low
    corner of cell (0, 0). size (nx, ny). version: grows whenever a cell or the origin changed.
    window: (x0, y0, xn, yn) of the last update, what a publisher sends; None if it updated nothing.
    """

    def __init__(
        self,
        size_x_m: float,
        size_y_m: float,
        resolution: float,
        origin: Sequence[float] = (0.0, 0.0),
        rolling: bool = False,
        footprint: Union[np.ndarray, Sequence[Sequence[float]]] = (),
        track_unknown: bool = False,
        obstacles: Optional[ObstacleParameters] = None,
        inflation: Optional[InflationParameters] = None,
    ):
        if not (resolution > 0 and size_x_m / resolution >= 1 and size_y_m / resolution >= 1):
            raise CostmapError(
                "costmap of %g x %g m at %g m has no cells: give a positive resolution below the size"
                % (size_x_m, size_y_m, resolution)
            )
        nx, ny = int(size_x_m / resolution), int(size_y_m / resolution)
        self.size = (nx, ny)
        self.resolution = float(resolution)
        self.rolling = bool(rolling)
        self.default = UNKNOWN if track_unknown else FREE
        self.origin = np.array(origin, dtype=np.float64)
        self.cells = np.full((ny, nx), self.default, np.uint8)
        self._base = np.zeros((ny, nx), np.uint8)  # the cells before inflation, where the last update went
        self.version = 0
        self.window: Optional[Tuple[int, int, int, int]] = None
        self._changes: Deque[Tuple[int, int, int, int]] = deque(maxlen=64)
        self.obstacles = ObstacleLayer(
            nx, ny, resolution, origin, rolling, self.default, obstacles or ObstacleParameters()
        )
        self.inflation = InflationLayer(nx, ny, resolution, inflation or InflationParameters())
        self.set_footprint(footprint)

    def set_footprint(self, footprint: Union[np.ndarray, Sequence[Sequence[float]]]) -> None:
        """Take the padded footprint (n, 2) [m]; the next update is a full one."""
        self.footprint = np.array(footprint, dtype=np.float64).reshape(-1, 2)
        self.inscribed_radius, self.circumscribed_radius = footprints.radii(self.footprint)
        self.inflation.set_inscribed_radius(self.inscribed_radius)

    def set_inflation(self, **values: Any) -> None:
        """Set any of inflation_radius, cost_scaling_factor, enabled, inflate_unknown; shows at the next update."""
        self.inflation.configure(replace(self.inflation.parameters, **values))

    def set_obstacles(self, **values: Any) -> None:
        """Set any field of ObstacleParameters; shows at the next update."""
        self.obstacles.parameters = replace(self.obstacles.parameters, **values)

    def update(self, robot_pose: Sequence[float], scan: Optional[PointCloud] = None) -> None:
        """One layered update for the robot's pose (x, y, yaw). `scan`: a new PointCloud, None: the last one again."""
        x, y, yaw = (float(v) for v in robot_pose)
        if not math.isfinite(x + y + yaw):
            raise CostmapError("costmap update at the pose %g %g %g: the pose must be finite" % (x, y, yaw))
        pose = (x, y, yaw)
        nx, ny = self.size
        if scan is not None:
            self.obstacles.cloud = scan
        if self.rolling:
            moved = roll(
                self.cells,
                self.origin,
                self.resolution,
                x - size_in_meters(nx, self.resolution) / 2,
                y - size_in_meters(ny, self.resolution) / 2,
                self.default,
            )
            if moved != (0, 0):
                self.inflation.roll(*moved)
                self._changed((0, 0, nx, ny))
        bounds = (1e30, 1e30, -1e30, -1e30)
        if self.obstacles.parameters.enabled:
            bounds = self.obstacles.update_bounds(pose, self.footprint)
        if self.inflation.parameters.enabled:
            bounds = self.inflation.update_bounds(bounds)
        self.window = self._to_window(bounds)
        if self.window is not None:
            self._refresh(pose, self.window)

    def _to_window(self, bounds):
        """Cells (x0, y0, xn, yn) of the bounds (min x, min y, max x, max y) [m]; None if they are inverted."""
        nx, ny = self.size
        ox, oy = self.origin.tolist()
        x0 = world_to_map_enforce_bounds(bounds[0], ox, self.resolution, nx)
        y0 = world_to_map_enforce_bounds(bounds[1], oy, self.resolution, ny)
        xn = world_to_map_enforce_bounds(bounds[2], ox, self.resolution, nx) + 1
        yn = world_to_map_enforce_bounds(bounds[3], oy, self.resolution, ny) + 1
        return None if xn < x0 or yn < y0 else (x0, y0, xn, yn)

    def _refresh(self, pose, window):
        """The cost steps of both layers over the window."""
        nx, ny = self.size
        r = 2 * self.inflation.reach
        around = (max(0, window[0] - r), max(0, window[1] - r), min(nx, window[2] + r), min(ny, window[3] + r))
        self.obstacles.update_costs(self.cells, self._base, pose, self.footprint, window, around)
        changed = self.inflation.update(self.cells, self._base, window)
        if changed is not None:
            self._changed(changed)

    def clear(self) -> None:
        """The clear_costmaps service: master and layers back to the default. The newest scan marks again."""
        self.cells[:] = self.default
        self.obstacles.reset()
        self.inflation.reset()
        self._changed((0, 0) + self.size)

    def clear_outside(self, pose: Sequence[float], side: float, inverted: bool = False) -> None:
        """Clearing recovery: the obstacle layer forgets what lies outside the square of `side` [m] about the pose.

        The master shows it after the next update.
        """
        self.obstacles.clear_outside(pose, side, inverted)

    def paint(self, cells: np.ndarray) -> None:
        """Write the non-zero cells (ny, nx) over the master and inflate the whole map: a map made by hand."""
        np.copyto(self._base, self.cells)
        np.copyto(self._base, cells, where=np.asarray(cells) != 0)
        self.inflation.update(self.cells, self._base, (0, 0) + self.size)
        self._changed((0, 0) + self.size)

    def set_free(self, x0: int, y0: int, xn: int, yn: int) -> None:
        """Write 0 into the cells [x0, xn) x [y0, yn) of the master alone, until an update covers them."""
        block = self.cells[y0:yn, x0:xn]
        if block.any():
            block[:] = FREE
            self._changed((x0, y0, xn, yn))

    def footprint_cost(self, x: float, y: float, yaw: float) -> float:
        """Largest cost under the footprint's outline at the pose; -1 lethal, -2 unknown, -3 off the map."""
        return footprints.footprint_cost(
            self.cells, self.origin[0], self.origin[1], self.resolution, self.footprint, float(x), float(y), float(yaw)
        )

    def world_to_map(self, x: float, y: float) -> Tuple[int, int]:
        """Cell (mx, my) of a point [m], (-1, -1) off the map."""
        return world_to_map(float(x), float(y), self.origin[0], self.origin[1], self.resolution, *self.size)

    def changed_since(self, version: int) -> Optional[Tuple[int, int, int, int]]:
        """Rectangle (x0, y0, xn, yn) that holds every cell changed after `version`; None if nothing changed."""
        if version == self.version:
            return None
        if version < self.version - len(self._changes) or version > self.version:
            return (0, 0) + self.size
        rects = list(self._changes)[version - self.version :]
        return (min(r[0] for r in rects), min(r[1] for r in rects), max(r[2] for r in rects), max(r[3] for r in rects))

    def _changed(self, rect):
        self.version += 1
        self._changes.append(rect)
