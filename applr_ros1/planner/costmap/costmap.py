"""Layered costmap: static, obstacle and inflation layers in any order over one master grid.

Called by MoveBase (one rolling local map, one global map), the planners and the tests. Follows
costmap_2d/layered_costmap.cpp: after any sequence of updates every value of the master equals that of C++.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass, replace
from typing import Any, Deque, List, Optional, Sequence, Tuple, Union

import numpy as np

from applr_ros1.common.angles import Pose
from applr_ros1.common.errors import ApplrError
from applr_ros1.common.scan import PointCloud, Source
from applr_ros1.planner.costmap import footprint as footprints
from applr_ros1.planner.costmap.grid import FREE, UNKNOWN, Bounds, Window, clipped_cell, roll, world_to_map
from applr_ros1.planner.costmap.inflation_layer import InflationLayer, InflationParameters
from applr_ros1.planner.costmap.obstacle_layer import ObstacleLayer, ObstacleParameters
from applr_ros1.planner.costmap.static_layer import StaticLayer, StaticMap, StaticParameters

Layer = Union[StaticLayer, ObstacleLayer, InflationLayer]
NOTHING = (1e30, 1e30, -1e30, -1e30)  # empty bounds (min x, min y, max x, max y) [m]


@dataclass
class LayerDescription:
    """Description of one layer of a costmap.

    Attributes:
        name: name in the parameter files.
        parameters: settings of the layer.
        sources: observation sources of an obstacle layer.
        default: value of cells that an obstacle layer has not observed, 0 or 255; None for the costmap's default.
    """

    name: str
    parameters: Union[StaticParameters, ObstacleParameters, InflationParameters]
    sources: Sequence[Source] = ()
    default: Optional[int] = None


class Costmap:
    """Master grid with its layers.

    Attributes:
        cells: (ny, nx) uint8, 0 free .. 252 inflated, 253 inscribed, 254 lethal, 255 unknown.
        origin: (2,), lower corner of cell (0, 0) [m].
        size: (nx, ny) [cells].
        version: counter that grows whenever a cell or the origin changes.
        window: cells (x0, y0, xn, yn) that the last update wrote, for publishing; None if it wrote none.

    Args:
        size_x_m, size_y_m, resolution, origin: geometry [m], until the map of a static layer replaces it.
        rolling: whether the map moves with the robot.
        footprint: padded vertices (n, 2) [m].
        track_unknown: whether cells are unknown until a layer observes them.
        obstacles, inflation: settings of the default layers: an obstacle layer with one laser below an inflation layer.
        layers: layers from the lowest to the highest, in place of the default ones.
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
        layers: Optional[Sequence[LayerDescription]] = None,
    ):
        self.rolling = bool(rolling)
        self.default = UNKNOWN if track_unknown else FREE
        self.version = 0
        self.window: Optional[Window] = None
        self.size_is_locked = False  # True once the map of a static layer has set the size
        self._changes: Deque[Window] = deque(maxlen=64)
        self._allocate(size_x_m, size_y_m, resolution, origin)
        if layers is None:
            layers = (
                LayerDescription("obstacles_layer", obstacles or ObstacleParameters(), (Source(),)),
                LayerDescription("inflater_layer", inflation or InflationParameters()),
            )
        self.layers: List[Layer] = [self._make_layer(layer) for layer in layers]
        self.obstacle_layers = [layer for layer in self.layers if isinstance(layer, ObstacleLayer)]
        self.inflation_layers = [layer for layer in self.layers if isinstance(layer, InflationLayer)]
        self.static_layers = [layer for layer in self.layers if isinstance(layer, StaticLayer)]
        self.set_footprint(footprint)

    def _allocate(self, size_x_m: float, size_y_m: float, resolution: float, origin: Sequence[float]) -> None:
        self._allocate_cells(int(size_x_m / resolution), int(size_y_m / resolution), resolution, origin)

    def _allocate_cells(self, nx: int, ny: int, resolution: float, origin: Sequence[float]) -> None:
        self.size = (nx, ny)
        self.resolution = float(resolution)
        self.origin = np.array(origin, dtype=np.float64)
        self.cells = np.full((ny, nx), self.default, np.uint8)
        self._base = np.zeros((ny, nx), np.uint8)  # cells before inflation, valid around the last window

    def _make_layer(self, made: LayerDescription) -> Layer:
        nx, ny = self.size
        if isinstance(made.parameters, InflationParameters):
            return InflationLayer(nx, ny, self.resolution, made.parameters, made.name)
        if isinstance(made.parameters, StaticParameters):
            layer = StaticLayer(self.rolling, made.parameters, made.name)
            layer.match_size(nx, ny, self.resolution, self.origin)
            return layer
        default = self.default if made.default is None else made.default
        return ObstacleLayer(
            nx, ny, self.resolution, self.origin, self.rolling, default, made.parameters, made.sources, made.name
        )

    def resize(self, size_x_m: float, size_y_m: float, resolution: float, origin: Sequence[float]) -> None:
        """Set size, resolution and origin [m] and empty the map; the latest clouds and static maps are kept.

        Does nothing if the map of a static layer has set the size, as in C++.
        """
        if not self.size_is_locked:
            self._allocate(size_x_m, size_y_m, resolution, origin)
            self._match_layers()

    def _match_layers(self) -> None:
        for layer in self.layers:
            layer.match_size(*self.size, self.resolution, self.origin)
            if isinstance(layer, StaticLayer):
                layer.reset()
        self._changed((0, 0) + self.size)

    @property
    def obstacles(self) -> ObstacleLayer:
        """The lowest obstacle layer."""
        return self.obstacle_layers[0]

    @property
    def inflation(self) -> InflationLayer:
        """The lowest inflation layer."""
        return self.inflation_layers[0]

    def set_footprint(self, footprint: Union[np.ndarray, Sequence[Sequence[float]]]) -> None:
        """Set the padded footprint (n, 2) [m]; the next update inflates the whole map."""
        self.footprint = np.array(footprint, dtype=np.float64).reshape(-1, 2)
        self.inscribed_radius, self.circumscribed_radius = footprints.radii(self.footprint)
        for layer in self.inflation_layers:
            layer.set_inscribed_radius(self.inscribed_radius)

    def configure(self, name: str, **values: Any) -> None:
        """Set parameters of the layer `name`; they take effect at the next update."""
        layer: Any = next(layer for layer in self.layers if layer.name == name)
        layer.configure(replace(layer.parameters, **values))

    def set_map(self, topic: str, given: StaticMap) -> None:
        """Give a map to the static layers that subscribe to its topic.

        A costmap that does not roll takes the map's size, resolution and origin, and is empty until its next update.

        Raises:
            ApplrError: The map cannot be used.
        """
        given = given.checked()
        for layer in self.static_layers:
            if layer.parameters.map_topic == topic and layer.accepts():
                ny, nx = given.cells.shape
                place = (nx, ny), given.resolution, given.origin
                if not self.rolling and place != (self.size, self.resolution, tuple(self.origin.tolist())):
                    self._allocate_cells(nx, ny, given.resolution, given.origin)
                    self.size_is_locked = True
                    self._match_layers()
                layer.take(given)

    def update_map(self, topic: str, x: int, y: int, cells: np.ndarray) -> None:
        """Write occupancies (h, w) int8 into a map, first cell at (x, y). Raise ApplrError if they leave the map."""
        for layer in self.static_layers:
            p = layer.parameters
            if p.map_topic == topic and p.subscribe_to_updates:
                layer.take_update(x, y, cells)

    def update(self, robot_pose: Sequence[float], scan: Optional[PointCloud] = None) -> None:
        """Update layers and master for a pose (x, y [m], yaw [rad]) and, if given, a new cloud of the first source."""
        x, y, yaw = (float(v) for v in robot_pose)
        if not math.isfinite(x + y + yaw):
            raise ApplrError("robot pose of a costmap update is (%g, %g, %g): give finite numbers" % (x, y, yaw))
        pose = (x, y, yaw)
        if scan is not None:
            self.obstacles.cloud = scan
        if self.rolling:
            moved = roll(self.cells, self.origin, self.resolution, x, y, self.default)
            if moved != (0, 0):
                for inflation in self.inflation_layers:
                    inflation.roll(*moved)
                self._changed((0, 0) + self.size)
        bounds = NOTHING
        for layer in self.layers:
            if layer.parameters.enabled:
                bounds = layer.update_bounds(bounds, pose, self.footprint)
        self.window = self._to_window(bounds)
        if self.window is not None:
            self._refresh(pose, self.window)

    def _to_window(self, bounds: Bounds) -> Optional[Window]:
        """Return the window (x0, y0, xn, yn) of bounds (min x, min y, max x, max y) [m]; None if they are inverted."""
        nx, ny = self.size
        ox, oy = self.origin.tolist()
        x0 = clipped_cell(bounds[0], ox, self.resolution, nx)
        y0 = clipped_cell(bounds[1], oy, self.resolution, ny)
        xn = clipped_cell(bounds[2], ox, self.resolution, nx) + 1
        yn = clipped_cell(bounds[3], oy, self.resolution, ny) + 1
        return None if xn < x0 or yn < y0 else (x0, y0, xn, yn)

    def _refresh(self, pose: Pose, window: Window) -> None:
        """Write all layers into the master within the window."""
        (nx, ny), (x0, y0, xn, yn) = self.size, window
        r = 2 * sum(layer.reach for layer in self.inflation_layers)
        rect = max(0, x0 - r), max(0, y0 - r), min(nx, xn + r), min(ny, yn + r)
        around = slice(rect[1], rect[3]), slice(rect[0], rect[2])
        grid = self._base
        grid[around] = self.cells[around]
        grid[y0:yn, x0:xn] = self.default
        top = self.layers[-1] if self.layers else None
        changed = None
        for layer in self.layers:
            if not isinstance(layer, InflationLayer):
                if layer.parameters.enabled:
                    layer.write(grid, window, pose, self.footprint)
            elif layer is top:
                changed = layer.update(self.cells, grid, window)
            else:  # The layers above write over the inflated costs.
                inflated = grid.copy()
                layer.update(inflated, grid, window)
                grid = inflated
        if not isinstance(top, InflationLayer) and not np.array_equal(self.cells[around], grid[around]):
            self.cells[around] = grid[around]
            changed = rect
        if changed is not None:
            self._changed(changed)

    def snapshot(self) -> Tuple[np.ndarray, ...]:
        """Return copies of the origin, the master and the cells of the obstacle layers, for `restore`."""
        return (self.origin.copy(), self.cells.copy(), *(layer.cells.copy() for layer in self.obstacle_layers))

    def restore(self, snapshot: Sequence[np.ndarray], pose: Optional[Pose] = None) -> None:
        """Restore a snapshot. With the robot's pose, inflate it anew, with the parameters in force."""
        self.origin[:], self.cells[:] = snapshot[:2]
        for layer, cells in zip(self.obstacle_layers, snapshot[2:]):
            layer.origin[:], layer.cells[:] = snapshot[0], cells
        if pose is not None:
            self._refresh(pose, (0, 0) + self.size)

    def clear(self) -> None:
        """Reset master and layers, as clear_costmaps does. The next update marks the latest scan again."""
        self.cells[:] = self.default
        for layer in self.layers:
            layer.reset()
        self._changed((0, 0) + self.size)

    def clear_outside(self, pose: Pose, side: float) -> None:
        """Reset the obstacle layers outside the square of `side` [m] around the pose, as the clearing recovery does.

        The master follows at the next update.
        """
        for layer in self.obstacle_layers:
            layer.clear_outside(pose, side)

    def set_free(self, x0: int, y0: int, xn: int, yn: int) -> None:
        """Free the cells [x0, xn) x [y0, yn) of the master, but not of its layers, until an update covers them."""
        block = self.cells[y0:yn, x0:xn]
        if block.any():
            block[:] = FREE
            self._changed((x0, y0, xn, yn))

    def footprint_cost(self, x: float, y: float, yaw: float) -> float:
        """Return the largest cost under the footprint's outline at a pose; -1 lethal, -2 unknown, -3 off the map."""
        pose = float(x), float(y), float(yaw)
        (ox, oy), vertices = self.origin.tolist(), self.footprint
        return footprints.footprint_cost(self.cells, ox, oy, self.resolution, vertices, pose)

    def world_to_map(self, x: float, y: float) -> Tuple[int, int]:
        """Return the cell (mx, my) of a point [m], or (-1, -1) if the point is off the map."""
        (ox, oy), (nx, ny) = self.origin.tolist(), self.size
        return world_to_map(float(x), float(y), ox, oy, self.resolution, nx, ny)

    def changed_since(self, version: int) -> Optional[Window]:
        """Return a rectangle (x0, y0, xn, yn) around every cell changed after `version`; None if nothing changed."""
        if version == self.version:
            return None
        if version < self.version - len(self._changes) or version > self.version:
            return (0, 0) + self.size
        rects = list(self._changes)[version - self.version :]
        return (min(r[0] for r in rects), min(r[1] for r in rects), max(r[2] for r in rects), max(r[3] for r in rects))

    def _changed(self, rect: Window) -> None:
        self.version += 1
        self._changes.append(rect)
