"""Layered costmap: static, obstacle and inflation layers in any order over one master grid.

Called by MoveBase (one rolling local map, one global map), the planners and the tests. Follows
costmap_2d/layered_costmap.cpp: after any sequence of updates every value of the master equals that
of C++.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import replace
from typing import Any, Deque, List, Optional, Sequence, Tuple, Union

import numpy as np

from applr_ros1.common.angles import Pose
from applr_ros1.common.errors import ApplrError
from applr_ros1.planner.costmap import footprint as footprints
from applr_ros1.planner.costmap.grid import (
    FREE,
    UNKNOWN,
    Bounds,
    Geometry,
    Window,
    clipped_cell,
    roll,
    union,
    world_to_map,
)
from applr_ros1.planner.costmap.inflation_layer import InflationLayer
from applr_ros1.planner.costmap.obstacle_layer import ObstacleLayer
from applr_ros1.planner.costmap.static_layer import StaticLayer, StaticMap

Layer = Union[StaticLayer, ObstacleLayer, InflationLayer]
NOTHING = (1e30, 1e30, -1e30, -1e30)  # empty bounds [m]
REMEMBERED = 64  # number of changes that changed_since() tells apart


class Costmap:
    """Master grid with its layers.

    Attributes:
        cells: (rows, columns) uint8: 0 free, 1 .. 252 inflated, 253 inscribed, 254 lethal,
            255 unknown.
        origin: (2,), lower corner of cell (0, 0) [m].
        size: (columns, rows) [cells].
        version: counter that grows whenever a cell or the origin changes.
        window: cells that the last update wrote, for publishing; None if it wrote none.

    Args:
        size_x_m, size_y_m, resolution, origin: geometry [m], until the map of a static layer
            replaces it.
        rolling: whether the map moves with the robot.
        footprint: padded vertices (n, 2) [m].
        track_unknown: whether cells are unknown until a layer observes them.
        layers: layers from the lowest to the highest.
    """

    def __init__(
        self,
        size_x_m: float,
        size_y_m: float,
        resolution: float,
        origin: Sequence[float],
        rolling: bool,
        footprint: np.ndarray,
        track_unknown: bool,
        layers: Sequence[Layer],
    ):
        self.rolling = bool(rolling)
        self.default = UNKNOWN if track_unknown else FREE
        self.version = 0
        self.window: Optional[Window] = None
        self.size_is_locked = False  # True once the map of a static layer has set the size
        self._changes: Deque[Window] = deque(maxlen=REMEMBERED)
        self._allocate(size_x_m, size_y_m, resolution, origin)

        self.layers = layers
        self.static_layers: List[StaticLayer] = []
        self.obstacle_layers: List[ObstacleLayer] = []
        self.inflation_layers: List[InflationLayer] = []
        for layer in self.layers:
            if isinstance(layer, StaticLayer):
                self.static_layers.append(layer)
            elif isinstance(layer, ObstacleLayer):
                self.obstacle_layers.append(layer)
            else:
                self.inflation_layers.append(layer)
        self._match_layers()
        self.set_footprint(footprint)

    def _allocate(
        self, size_x_m: float, size_y_m: float, resolution: float, origin: Sequence[float]
    ) -> None:
        columns = int(size_x_m / resolution)
        rows = int(size_y_m / resolution)
        self._allocate_cells(columns, rows, resolution, origin)

    def _allocate_cells(
        self, columns: int, rows: int, resolution: float, origin: Sequence[float]
    ) -> None:
        """Give the master grid a size [cells], resolution and origin [m], and default cells."""
        self.size = (columns, rows)
        self.resolution = float(resolution)
        self.origin = np.array(origin, dtype=np.float64)
        self.cells = np.full((rows, columns), self.default, np.uint8)
        # Cells before inflation, valid around the last window.
        self._base = np.zeros((rows, columns), np.uint8)

    def resize(
        self, size_x_m: float, size_y_m: float, resolution: float, origin: Sequence[float]
    ) -> None:
        """Set size, resolution and origin [m] and empty the map.

        The latest clouds and static maps are kept. Does nothing if the map of a static layer has
        set the size, as in C++.
        """
        # Costmap2DROS calls resizeMap of an unlocked costmap only.
        if not self.size_is_locked:
            self._allocate(size_x_m, size_y_m, resolution, origin)
            self._match_layers()

    def _match_layers(self) -> None:
        geometry = Geometry(*self.size, self.resolution, self.origin, self.rolling)
        for layer in self.layers:
            layer.match_size(geometry)
        self._changed(self._whole)

    @property
    def _whole(self) -> Window:
        columns, rows = self.size
        return 0, 0, columns, rows

    def set_footprint(self, footprint: np.ndarray) -> None:
        """Set the padded footprint (n, 2) [m]; the next update inflates the whole map."""
        self.footprint = np.array(footprint, dtype=np.float64).reshape(-1, 2)
        self.inscribed_radius, self.circumscribed_radius = footprints.radii(self.footprint)
        for layer in self.inflation_layers:
            layer.set_inscribed_radius(self.inscribed_radius)

    def configure(self, name: str, **values: Any) -> None:
        """Set parameters of the layer `name`; they take effect at the next update."""
        layer: Any = next(layer for layer in self.layers if layer.name == name)
        layer.configure(replace(layer.parameters, **values))

    def set_map(self, topic: str, static_map: StaticMap) -> None:
        """Give a checked map to the static layers that subscribe to its topic.

        A costmap that does not roll takes the map's size, resolution and origin, and is empty until
        its next update.
        """
        for layer in self.static_layers:
            if layer.parameters.map_topic == topic and layer.accepts():
                if not self.rolling:
                    self._take_geometry(static_map)
                layer.use_map(static_map)

    def _take_geometry(self, static_map: StaticMap) -> None:
        """Take the map's size, resolution and origin, unless the costmap has them already."""
        rows, columns = static_map.cells.shape
        geometry = ((columns, rows), static_map.resolution, static_map.origin)
        if geometry != (self.size, self.resolution, tuple(self.origin.tolist())):
            self._allocate_cells(columns, rows, static_map.resolution, static_map.origin)
            self.size_is_locked = True
            self._match_layers()

    def update_map(self, topic: str, x: int, y: int, cells: np.ndarray) -> None:
        """Write occupancies (h, w) int8 into the map of a topic, first cell at (x, y).

        Raises:
            ApplrError: They leave the map.
        """
        for layer in self.static_layers:
            parameters = layer.parameters
            if parameters.map_topic == topic and parameters.subscribe_to_updates:
                layer.take_update(x, y, cells)

    def update_costs(self, robot_pose: Sequence[float]) -> None:
        """Update layers and master for a pose (x, y [m], yaw [rad]).

        Raises:
            ApplrError: The pose is not finite.
        """
        x, y, yaw = (float(number) for number in robot_pose)
        if not math.isfinite(x + y + yaw):
            raise ApplrError(
                "robot pose of a costmap update is (%g, %g, %g): give finite numbers" % (x, y, yaw)
            )
        pose = (x, y, yaw)

        # The master moves first, because the bounds of the layers refer to its new origin.
        if self.rolling:
            shift = roll(self.cells, self.origin, self.resolution, x, y, self.default)
            if shift != (0, 0):
                for inflation in self.inflation_layers:
                    inflation.roll(*shift)
                self._changed(self._whole)

        bounds = NOTHING
        for layer in self.layers:
            if layer.parameters.enabled:
                bounds = layer.update_bounds(bounds, pose, self.footprint)
        self.window = self._to_window(bounds)
        if self.window is not None:
            self._refresh(pose, self.window)

    def _to_window(self, bounds: Bounds) -> Optional[Window]:
        """Return the window of bounds [m]; None if they are inverted."""
        columns, rows = self.size
        origin_x, origin_y = self.origin.tolist()
        min_x, min_y, max_x, max_y = bounds
        left = clipped_cell(min_x, origin_x, self.resolution, columns)
        bottom = clipped_cell(min_y, origin_y, self.resolution, rows)
        right = clipped_cell(max_x, origin_x, self.resolution, columns) + 1
        top = clipped_cell(max_y, origin_y, self.resolution, rows) + 1
        if right < left or top < bottom:
            return None
        return left, bottom, right, top

    def _refresh(self, pose: Pose, window: Window) -> None:
        """Write all layers into the master within the window."""
        columns, rows = self.size
        left, bottom, right, top = window

        # Inflation reads obstacles outside the window, and writes beyond them.
        margin = 2 * sum(layer.reach for layer in self.inflation_layers)
        written_window = (
            max(0, left - margin),
            max(0, bottom - margin),
            min(columns, right + margin),
            min(rows, top + margin),
        )
        written_rows = slice(written_window[1], written_window[3])
        written_columns = slice(written_window[0], written_window[2])
        written_cells = (written_rows, written_columns)
        # As in C++, the layers start from the default value inside the window. Outside, the master
        # keeps its costs, which inflation may raise and never lowers.
        grid = self._base
        grid[written_cells] = self.cells[written_cells]
        grid[bottom:top, left:right] = self.default

        top_layer = self.layers[-1] if self.layers else None
        changed_window = None
        for layer in self.layers:
            if not isinstance(layer, InflationLayer):
                if layer.parameters.enabled:
                    layer.write(grid, window, pose, self.footprint)
            elif layer is top_layer:
                changed_window = layer.inflate(self.cells, grid, window)
            else:
                # The layers above write over the inflated costs.
                inflated_cells = grid.copy()
                layer.inflate(inflated_cells, grid, window)
                grid = inflated_cells

        # Only an inflation layer on top has written the master itself.
        if top_layer not in self.inflation_layers:
            is_equal = np.array_equal(self.cells[written_cells], grid[written_cells])
            if not is_equal:
                self.cells[written_cells] = grid[written_cells]
                changed_window = written_window
        if changed_window is not None:
            self._changed(changed_window)

    def snapshot(self) -> Tuple[np.ndarray, ...]:
        """Return copies of the origin, the master and the grids of obstacle layers, to restore."""
        layer_cells = [layer.cells.copy() for layer in self.obstacle_layers]
        return (self.origin.copy(), self.cells.copy(), *layer_cells)

    def restore(self, snapshot: Sequence[np.ndarray], pose: Optional[Pose] = None) -> None:
        """Restore a snapshot. With the robot's pose, inflate it anew, by the current parameters."""
        origin, master, *layer_cells = snapshot
        self.origin[:] = origin
        self.cells[:] = master
        for layer, cells in zip(self.obstacle_layers, layer_cells):
            layer.origin[:] = origin
            layer.cells[:] = cells
        self._changed(self._whole)
        if pose is not None:
            self._refresh(pose, self._whole)

    def reset_layers(self) -> None:
        """Reset master and layers, as clear_costmaps does. The next update marks the scan again."""
        self.cells[:] = self.default
        for layer in self.layers:
            layer.reset_cells()
        self._changed(self._whole)

    def clear_outside(self, pose: Pose, side: float) -> None:
        """Reset the obstacle layers outside the square of `side` [m] around the pose.

        The clearing recovery does so. The master follows at the next update.
        """
        for layer in self.obstacle_layers:
            layer.clear_outside(pose, side)

    def set_free(self, left: int, bottom: int, right: int, top: int) -> None:
        """Free a window of the master, but not of its layers, until an update covers it."""
        block = self.cells[bottom:top, left:right]
        if block.any():
            block[:] = FREE
            self._changed((left, bottom, right, top))

    def footprint_cost(self, x: float, y: float, yaw: float) -> float:
        """Return the largest cost under the footprint's outline at a pose [m, rad].

        The result is -1 on a lethal cell, -2 on an unknown cell, and -3 off the map.
        """
        pose = (float(x), float(y), float(yaw))
        origin_x, origin_y = self.origin.tolist()
        return footprints.footprint_cost(
            self.cells, origin_x, origin_y, self.resolution, self.footprint, pose
        )

    def world_to_map(self, x: float, y: float) -> Tuple[int, int]:
        """Return the cell (x, y) of a point [m], or (-1, -1) if the point is off the map."""
        origin_x, origin_y = self.origin.tolist()
        columns, rows = self.size
        return world_to_map(float(x), float(y), origin_x, origin_y, self.resolution, columns, rows)

    def changed_since(self, version: int) -> Optional[Window]:
        """Return a window around every cell changed after `version`; None if nothing changed."""
        if version == self.version:
            return None
        # The version is too old, or that of another costmap.
        if version < self.version - len(self._changes) or version > self.version:
            return self._whole
        first_window, *later_windows = list(self._changes)[version - self.version :]
        changed_window = first_window
        for window in later_windows:
            changed_window = union(changed_window, window)
        return changed_window

    def _changed(self, window: Window) -> None:
        self.version += 1
        self._changes.append(window)
