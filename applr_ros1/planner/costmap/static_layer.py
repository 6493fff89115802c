"""Static layer of a costmap: writes a received map (of map_server or SLAM) among other layers.

Called by costmap.Costmap. Follows costmap_2d/static_layer.cpp. A costmap that does not roll takes
size and origin of the map; a rolling costmap shows the part of the map that it covers.
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
from applr_ros1.planner.costmap.grid import (
    FREE,
    LETHAL,
    UNKNOWN,
    Bounds,
    Geometry,
    Window,
    merge,
    union,
    world_to_map,
)

GridPlace = Tuple[float, float, float]  # origin x, y and resolution of a grid [m]


@dataclass(frozen=True)
class StaticMap:
    """Occupancy grid as in nav_msgs/OccupancyGrid.

    Attributes:
        cells: (rows, columns) int8, 0 free .. 100 occupied, -1 unknown; row 0 has the lowest y.
        resolution: edge length of a cell [m].
        origin: lower corner (x, y) [m] in `frame`.
        frame: frame of the map.
    """

    cells: np.ndarray
    resolution: float
    origin: Tuple[float, float]
    frame: str = ""

    def checked(self) -> StaticMap:
        """Return a copy with contiguous int8 cells.

        Raises:
            ApplrError: No costmap can use the map.
        """
        cells = np.array(self.cells, dtype=np.int8, order="C")
        if cells.ndim != 2 or cells.size == 0:
            shape = "x".join(map(str, cells.shape))
            raise ApplrError("map has %s cells: give it rows and columns" % shape)
        numbers = (self.resolution, *self.origin)
        if not all(map(math.isfinite, numbers)) or self.resolution <= 0:
            raise ApplrError(
                "map has resolution %r m and origin %r: "
                "give finite numbers and a resolution above 0"
                % (self.resolution, tuple(self.origin))
            )
        origin = (float(self.origin[0]), float(self.origin[1]))
        return StaticMap(cells, float(self.resolution), origin, self.frame)


@dataclass
class StaticParameters:
    """Settings of the layer, named like the ROS parameters."""

    enabled: bool = True
    map_topic: str = "map"
    first_map_only: bool = False
    subscribe_to_updates: bool = False
    track_unknown_space: bool = True  # whether unknown cells of the map stay unknown, not free
    use_maximum: bool = False  # whether only known cells with a higher cost are written
    lethal_cost_threshold: int = 100  # lowest occupancy of a lethal cell
    unknown_cost_value: int = -1  # occupancy of an unknown cell
    trinary_costmap: bool = True  # whether other cells are free instead of proportional in cost


def interpretation(parameters: StaticParameters) -> np.ndarray:
    """Return the cost (256,) uint8 of each occupancy, read as an unsigned byte.

    static_layer.cpp, interpretValue.
    """
    # Occupancies are int8. As unsigned bytes they index a table, and -1 is 255.
    threshold = max(min(parameters.lethal_cost_threshold, 100), 0)
    costs = np.empty(256, np.uint8)
    for occupancy in range(256):
        if occupancy == parameters.unknown_cost_value & 255:
            costs[occupancy] = UNKNOWN if parameters.track_unknown_space else FREE
        elif occupancy >= threshold:
            costs[occupancy] = LETHAL
        elif parameters.trinary_costmap:
            costs[occupancy] = FREE
        else:
            costs[occupancy] = int(occupancy / threshold * LETHAL)
    return costs


class StaticLayer:
    """Static layer with a grid of costs that has the resolution and origin of the map.

    Args:
        name: name of the layer in the parameter files.
        parameters: settings of the layer.

    Attributes:
        cells: (rows, columns) uint8 costs; None before the first map.
        map_frame: frame of the map.
        placement: pose (x, y, yaw) of the costmap's frame in the map's frame; None if the frames
            are the same. Only rolling costmaps use it, as in C++.
    """

    def __init__(self, name: str, parameters: StaticParameters):
        self.name = name
        self.parameters = parameters
        self.cells: Optional[np.ndarray] = None
        self.map_frame = ""
        self.placement: Optional[Pose] = None
        self._costs = interpretation(parameters)
        self._unwritten: Optional[Window] = None  # cells of the map that are not written yet

    @property
    def is_waiting(self) -> bool:
        """True until the first map arrives."""
        return self.cells is None

    def match_size(self, geometry: Geometry) -> None:
        """Take the costmap's size and place, and write the whole map again."""
        self._master = geometry
        self.reset_cells()

    def configure(self, parameters: StaticParameters) -> None:
        """Take new parameters; write the whole map again if `enabled` has changed."""
        if parameters.enabled != self.parameters.enabled:
            self.reset_cells()
        self.parameters = parameters

    def accepts(self) -> bool:
        """Return whether a new map would be used: with first_map_only, only the first map is."""
        return self.cells is None or not self.parameters.first_map_only

    def use_map(self, static_map: StaticMap) -> None:
        """Use a checked map from the next update on."""
        self.resolution = static_map.resolution
        self.origin = static_map.origin
        self.map_frame = static_map.frame
        self.cells = self._costs[static_map.cells.view(np.uint8)]
        self.reset_cells()

    def take_update(self, x: int, y: int, cells: np.ndarray) -> None:
        """Write occupancies (h, w) int8 into the map, first cell at (x, y).

        Raises:
            ApplrError: They leave the map, or there is none.
        """
        height, width = cells.shape
        right = x + width
        top = y + height
        rows, columns = (0, 0) if self.cells is None else self.cells.shape
        if self.cells is None or min(x, y) < 0 or right > columns or top > rows:
            raise ApplrError(
                "map update of %d x %d cells at (%d, %d) is not on the map" % (width, height, x, y)
            )
        occupancies = np.ascontiguousarray(cells, dtype=np.int8).view(np.uint8)
        self.cells[y:top, x:right] = self._costs[occupancies]
        updated_window = (x, y, right, top)
        if self._unwritten is not None:
            updated_window = union(self._unwritten, updated_window)
        self._unwritten = updated_window

    def reset_cells(self) -> None:
        """Write the whole map again, if there is one, after the costmap has been cleared."""
        if self.cells is not None:
            rows, columns = self.cells.shape
            self._unwritten = (0, 0, columns, rows)

    def update_bounds(self, bounds: Bounds, pose: Pose, footprint: np.ndarray) -> Bounds:
        """Return the bounds [m], widened by the cells to write.

        A rolling costmap is written as a whole. C++ instead widens the bounds to the corners of the
        map, which may miss the costmap if map and costmap have different frames.
        """
        if self.cells is None:
            return bounds
        window = self._unwritten
        self._unwritten = None
        origin_x, origin_y = self.origin
        resolution = self.resolution
        master = self._master
        if master.rolling:
            window = (0, 0, master.columns, master.rows)
            origin_x, origin_y = master.origin.tolist()
            resolution = master.resolution
        if window is None:
            return bounds
        # As in C++, from the centre of the first cell to that of the one after the last.
        left, bottom, right, top = window
        written_bounds = (
            origin_x + (left + 0.5) * resolution,
            origin_y + (bottom + 0.5) * resolution,
            origin_x + (right + 0.5) * resolution,
            origin_y + (top + 0.5) * resolution,
        )
        return union(bounds, written_bounds)

    def write(self, base: np.ndarray, window: Window, pose: Pose, footprint: np.ndarray) -> None:
        """Write the map into the window of `base` (rows, columns)."""
        if self.cells is None:
            return
        use_maximum = self.parameters.use_maximum
        # A rolling costmap shows a part of the map, cell by cell.
        # Another layer's map may have set the costmap's size.
        master = self._master
        if master.rolling or self.cells.shape != base.shape:
            map_place = (*self.origin, self.resolution)
            master_place = (*master.origin.tolist(), master.resolution)
            placement = self.placement or (0.0, 0.0, 0.0)
            _write_part(self.cells, map_place, base, master_place, placement, use_maximum, window)
        elif use_maximum:
            merge(self.cells, base, True, *window)
        else:
            left, bottom, right, top = window
            base[bottom:top, left:right] = self.cells[bottom:top, left:right]


@kernel
def _write_part(
    cells: Data,
    place: GridPlace,
    base: Data,
    base_place: GridPlace,
    placement: Pose,
    use_maximum: bool,
    window: Window,
) -> None:
    """Write the map's cost into every cell of the window whose centre lies on the map.

    Args:
        cells: costs (rows, columns) of the map.
        place: origin and resolution of the map.
        base: grid to write, (rows, columns) of the costmap.
        base_place: origin and resolution of `base`.
        placement: pose of the costmap's frame in the map's frame.
        use_maximum: whether only higher costs are written.
        window: cells of `base` to write.
    """
    origin_x, origin_y, resolution = place
    base_x, base_y, base_resolution = base_place
    shift_x, shift_y, yaw = placement
    left, bottom, right, top = window
    cos_yaw = math.cos(yaw)
    sin_yaw = math.sin(yaw)
    rows, columns = cells.shape
    for row in range(bottom, top):
        for column in range(left, right):
            # Centre of the cell in the costmap's frame, then in the map's frame.
            world_x = base_x + (column + 0.5) * base_resolution
            world_y = base_y + (row + 0.5) * base_resolution
            map_x = (cos_yaw * world_x - sin_yaw * world_y) + shift_x
            map_y = (sin_yaw * world_x + cos_yaw * world_y) + shift_y
            cell_x, cell_y = world_to_map(
                map_x, map_y, origin_x, origin_y, resolution, columns, rows
            )
            if cell_x < 0:
                continue
            cost = cells[cell_y, cell_x]
            if use_maximum:
                cost = max(cost, base[row, column])
            base[row, column] = cost
