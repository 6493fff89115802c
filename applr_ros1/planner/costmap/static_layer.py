"""Static layer of a costmap: writes a received map (of map_server or SLAM) under or over other layers.

Called by costmap.Costmap. Follows costmap_2d/static_layer.cpp. A costmap that does not roll takes size and origin of
the map; a rolling costmap shows the part of the map that it covers.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Optional, Tuple

import numpy as np

from applr_ros1.common.angles import Pose
from applr_ros1.common.arrays import Data
from applr_ros1.common.errors import ApplrError
from applr_ros1.common.kernels import kernel
from applr_ros1.planner.costmap.grid import FREE, LETHAL, UNKNOWN, Bounds, Window, merge, union


@dataclass(frozen=True)
class StaticMap:
    """Occupancy grid as in nav_msgs/OccupancyGrid.

    Attributes:
        cells: (ny, nx) int8, 0 free .. 100 occupied, -1 unknown; row 0 has the lowest y.
        resolution: edge length of a cell [m].
        origin: lower corner (x, y) [m] in `frame`.
        frame: frame of the map.
    """

    cells: np.ndarray
    resolution: float
    origin: Tuple[float, float]
    frame: str = ""

    def checked(self) -> StaticMap:
        """Return a copy with contiguous int8 cells; raise ApplrError if no costmap can use the map."""
        cells = np.array(self.cells, dtype=np.int8, order="C")
        if cells.ndim != 2 or cells.size == 0:
            raise ApplrError("map has %s cells: give it rows and columns" % "x".join(map(str, cells.shape)))
        if not (math.isfinite(self.resolution) and self.resolution > 0 and all(map(math.isfinite, self.origin))):
            raise ApplrError(
                "map has resolution %r m and origin %r: give finite numbers and a resolution above 0"
                % (self.resolution, tuple(self.origin))
            )
        return StaticMap(cells, float(self.resolution), (float(self.origin[0]), float(self.origin[1])), self.frame)


@dataclass
class StaticParameters:
    """Settings of the layer, named like the ROS parameters."""

    enabled: bool = True
    map_topic: str = "map"
    first_map_only: bool = False
    subscribe_to_updates: bool = False
    track_unknown_space: bool = True  # whether unknown cells of the map stay unknown instead of free
    use_maximum: bool = False  # whether only known cells with a higher cost are written
    lethal_cost_threshold: int = 100  # lowest occupancy of a lethal cell
    unknown_cost_value: int = -1  # occupancy of an unknown cell
    trinary_costmap: bool = True  # whether other cells are free; otherwise their cost is proportional to occupancy


def interpretation(p: StaticParameters) -> np.ndarray:
    """Return the cost (256,) uint8 of each occupancy, read as an unsigned byte. static_layer.cpp, interpretValue."""
    threshold = max(min(p.lethal_cost_threshold, 100), 0)
    costs = np.empty(256, np.uint8)
    for value in range(256):
        if value == p.unknown_cost_value & 255:
            costs[value] = UNKNOWN if p.track_unknown_space else FREE
        elif value >= threshold:
            costs[value] = LETHAL
        else:
            costs[value] = FREE if p.trinary_costmap else int(value / threshold * LETHAL)
    return costs


class StaticLayer:
    """Static layer with a grid of costs that has the resolution and origin of the map.

    Args:
        rolling: whether the costmap moves with the robot.
        parameters: settings of the layer.
        name: name of the layer in the parameter files.

    Attributes:
        cells: (ny, nx) uint8 costs; None before the first map.
        map_frame: frame of the map.
        placement: pose (x, y, yaw) of the costmap's frame in the map's frame; None if the frames are the same. Only
            rolling costmaps use it, as in C++.
    """

    def __init__(self, rolling: bool, parameters: StaticParameters, name: str = "static_layer"):
        self.name = name
        self.parameters = parameters
        self.rolling = bool(rolling)
        self.cells: Optional[np.ndarray] = None
        self.map_frame = ""
        self.placement: Optional[Pose] = None
        self._costs = interpretation(parameters)
        self._due: Optional[Window] = None  # rectangle of cells that are not written yet

    @property
    def is_waiting(self) -> bool:
        """True until the first map arrives."""
        return self.cells is None

    def match_size(self, nx: int, ny: int, resolution: float, origin: np.ndarray) -> None:
        """Take the costmap's size and origin (2,) [m]. The array of the origin is shared and moves with the costmap."""
        self._master_size, self._master_origin, self._master_resolution = (nx, ny), origin, float(resolution)

    def configure(self, parameters: StaticParameters) -> None:
        """Take new parameters; write the whole map again if `enabled` has changed."""
        if parameters.enabled != self.parameters.enabled and self.cells is not None:
            self._due = self._all()
        self.parameters = parameters

    def accepts(self) -> bool:
        """Return whether a new map would be used. With first_map_only, only the first map is used."""
        return self.cells is None or not self.parameters.first_map_only

    def take(self, given: StaticMap) -> None:
        """Use a checked map from the next update on."""
        self.resolution, self.origin, self.map_frame = given.resolution, given.origin, given.frame
        self.cells = self._costs[given.cells.view(np.uint8)]
        self._due = self._all()

    def take_update(self, x: int, y: int, cells: np.ndarray) -> None:
        """Write occupancies (h, w) int8 into the map, first cell at (x, y). Raise ApplrError if they leave the map."""
        h, w = cells.shape
        ny, nx = (0, 0) if self.cells is None else self.cells.shape
        if self.cells is None or min(x, y) < 0 or x + w > nx or y + h > ny:
            raise ApplrError("map update of %d x %d cells at (%d, %d) is not on the map" % (w, h, x, y))
        self.cells[y : y + h, x : x + w] = self._costs[np.ascontiguousarray(cells, dtype=np.int8).view(np.uint8)]
        part = (x, y, x + w, y + h)
        self._due = part if self._due is None else union(self._due, part)

    def reset(self) -> None:
        """Write the whole map again after the costmap has been cleared."""
        if self.cells is not None:
            self._due = self._all()

    def _all(self) -> Window:
        assert self.cells is not None
        return 0, 0, self.cells.shape[1], self.cells.shape[0]

    def update_bounds(self, bounds: Bounds, pose: Pose, footprint: np.ndarray) -> Bounds:
        """Return the bounds (min x, min y, max x, max y) [m], widened by the cells to write.

        A rolling costmap is written as a whole. C++ instead widens the bounds to the corners of the map, which may miss
        the costmap if map and costmap have different frames.
        """
        if self.cells is None:
            return bounds
        due, self._due = self._due, None
        (ox, oy), res = self.origin, self.resolution
        if self.rolling:
            due = (0, 0, *self._master_size)
            (ox, oy), res = self._master_origin.tolist(), self._master_resolution
        if due is None:
            return bounds
        x0, y0, xn, yn = ((cell + 0.5) * res for cell in due)
        return union(bounds, (ox + x0, oy + y0, ox + xn, oy + yn))

    def write(self, base: np.ndarray, window: Window, pose: Pose, footprint: np.ndarray) -> None:
        """Write the map into the window (x0, y0, xn, yn) of `base` (ny, nx)."""
        if self.cells is None:
            return
        if self.rolling or self.cells.shape != base.shape:  # Another layer's map may have set the costmap's size.
            place = *self.origin, self.resolution
            master_place = *self._master_origin.tolist(), self._master_resolution
            placement = self.placement or (0.0, 0.0, 0.0)
            _write_part(self.cells, place, base, master_place, placement, self.parameters.use_maximum, window)
        elif self.parameters.use_maximum:
            merge(self.cells, base, True, *window)
        else:
            x0, y0, xn, yn = window
            base[y0:yn, x0:xn] = self.cells[y0:yn, x0:xn]


@kernel
def _write_part(
    cells: Data, place: Pose, base: Data, base_place: Pose, placement: Pose, use_maximum: bool, window: Window
) -> None:
    """Write the map's cost into every cell of the window whose centre lies on the map.

    place, base_place: origin (x, y) and resolution [m] of the map and of `base`. placement: see StaticLayer.
    """
    (ox, oy, res), (bx, by, base_res), (tx, ty, yaw), (x0, y0, xn, yn) = place, base_place, placement, window
    c = math.cos(yaw)
    s = math.sin(yaw)
    ny, nx = cells.shape
    for j in range(y0, yn):
        for i in range(x0, xn):
            wx = bx + (i + 0.5) * base_res
            wy = by + (j + 0.5) * base_res
            px = (c * wx - s * wy) + tx
            py = (s * wx + c * wy) + ty
            if px < ox or py < oy:
                continue
            fx = (px - ox) / res
            fy = (py - oy) / res
            if fx >= nx or fy >= ny:
                continue
            value = cells[int(fy), int(fx)]
            base[j, i] = max(value, base[j, i]) if use_maximum else value
