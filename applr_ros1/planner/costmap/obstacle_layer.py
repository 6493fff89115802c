"""Obstacle layer of a costmap: marks sensor hits, clears cells along the rays and under the robot.

Called by costmap.Costmap. Follows costmap_2d/obstacle_layer.cpp step by step. The layer has its own
grid.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple, Optional, Sequence, Tuple

import numpy as np

from applr_ros1.common.angles import Pose
from applr_ros1.common.arrays import Data
from applr_ros1.common.kernels import kernel
from applr_ros1.common.scan import ObservationBuffer, PointCloud, Source
from applr_ros1.planner.costmap import grid
from applr_ros1.planner.costmap.footprint import fill_footprint, vertex_at
from applr_ros1.planner.costmap.grid import (
    FREE,
    LETHAL,
    MAXIMUM,
    OVERWRITE,
    UNKNOWN,
    Bounds,
    Geometry,
    Window,
    line_between,
    union,
    world_to_map,
)

# C++ moves the end of a clipped ray by this much, so that it falls into the last cell.
BORDER = 0.001  # [m]


class CloudRays(NamedTuple):
    """Rays of one cloud, with the limits for marking and clearing."""

    points: Data  # (n, 3) float32 [m]
    sensor_x: float  # start of the rays [m]
    sensor_y: float
    sensor_z: float
    hits: Data  # (>= n,) int64 scratch: flat index of each point's cell, -1 off the map
    raytrace_range: float  # range up to which rays clear [m]
    reach: int  # the same range in whole cells
    obstacle_range: float  # range below which points mark [m]
    lowest: float  # height below which points are ignored [m]
    highest: float  # height above which points are ignored [m]
    highest_mark: float  # height above which points do not mark [m]


@dataclass
class ObstacleParameters:
    """Settings of the layer, named like the ROS parameters."""

    enabled: bool = True
    footprint_clearing_enabled: bool = True
    max_obstacle_height: float = 2.0  # height above which points do not mark [m]
    combination_method: int = MAXIMUM


class ObstacleLayer:
    """Obstacle layer with its own grid.

    Args:
        name: name of the layer in the parameter files.
        parameters: settings of the layer.
        sources: one source per entry of observation_sources, in the same order.
        default: value of unobserved cells, 0 or 255.

    Attributes:
        cells: (rows, columns) uint8 of 0, 254 and 255.
        origin: (2,), lower corner of cell (0, 0) [m].
    """

    def __init__(
        self, name: str, parameters: ObstacleParameters, sources: Sequence[Source], default: int
    ):
        self.name = name
        self.parameters = parameters
        self.default = default
        self.buffers = [ObservationBuffer(source) for source in sources]
        self._hits = np.empty(1024, np.int64)
        self._bounds = np.empty(4)

    def match_size(self, geometry: Geometry) -> None:
        """Take size and place of the costmap and empty the grid; the latest clouds are kept."""
        self._rolling = geometry.rolling
        self.resolution = geometry.resolution
        self.cells = np.full((geometry.rows, geometry.columns), self.default, np.uint8)
        self.origin = geometry.origin.copy()
        # Bounds of the area that a recovery has cleared since the last update.
        self._cleared_bounds: Optional[Bounds] = None

    def configure(self, parameters: ObstacleParameters) -> None:
        """Take new parameters; they take effect at the next update."""
        self.parameters = parameters

    def update_bounds(self, bounds: Bounds, pose: Pose, footprint: np.ndarray) -> Bounds:
        """Roll, clear and mark; return the bounds [m], widened to all possible changes."""
        x, y, _ = pose
        if self._rolling:
            grid.roll(self.cells, self.origin, self.resolution, x, y, self.default)

        touched_bounds = self._bounds
        touched_bounds[:] = bounds
        if self._cleared_bounds is not None:
            touched_bounds[:] = union(bounds, self._cleared_bounds)
            self._cleared_bounds = None

        clouds = []
        for buffer in self.buffers:
            for cloud in buffer.clouds:
                clouds.append((buffer.source, cloud))
        clouds_with_points = sum(len(cloud.points) > 0 for _, cloud in clouds)
        if clouds_with_points <= 1:
            # The usual single cloud is handled by one call. Others have nothing to clear or mark.
            for source, cloud in clouds:
                self._observe(source, cloud, source.clearing, source.marking, touched_bounds)
        else:
            # All rays of all sources clear before any point marks.
            for source, cloud in clouds:
                if source.clearing:
                    self._observe(source, cloud, True, False, touched_bounds)
            for source, cloud in clouds:
                if source.marking:
                    self._observe(source, cloud, False, True, touched_bounds)

        if self.parameters.footprint_clearing_enabled:
            _touch_footprint(footprint, pose, touched_bounds)
        min_x, min_y, max_x, max_y = touched_bounds.tolist()
        return min_x, min_y, max_x, max_y

    def _observe(
        self,
        source: Source,
        cloud: PointCloud,
        clearing: bool,
        marking: bool,
        touched: np.ndarray,
    ) -> None:
        if len(cloud.points) > len(self._hits):
            self._hits = np.empty(len(cloud.points), np.int64)
        sensor_x, sensor_y, sensor_z = cloud.origin
        rays = CloudRays(
            cloud.points,
            sensor_x,
            sensor_y,
            sensor_z,
            self._hits,
            source.raytrace_range,
            grid.cell_distance(source.raytrace_range, self.resolution),
            source.obstacle_range,
            source.min_obstacle_height,
            source.max_obstacle_height,
            self.parameters.max_obstacle_height,
        )
        observe(self.cells, self.origin, self.resolution, rays, clearing, marking, touched)

    def write(self, base: np.ndarray, window: Window, pose: Pose, footprint: np.ndarray) -> None:
        """Clear under the robot, then write the layer into the window of `base`."""
        if self.parameters.footprint_clearing_enabled:
            origin_x, origin_y = self.origin.tolist()
            fill_footprint(
                self.cells, FREE, origin_x, origin_y, self.resolution, footprint, pose, True
            )
        # Another combination_method keeps the layer out of the master.
        method = self.parameters.combination_method
        if method in (OVERWRITE, MAXIMUM):
            grid.merge(self.cells, base, method == MAXIMUM, *window)

    def reset_cells(self) -> None:
        """Reset all cells to the default value. The next update marks the latest scan again."""
        self.cells[:] = self.default

    def clear_outside(self, pose: Pose, side: float) -> None:
        """Set the cells outside the square of `side` [m] around the pose to 255.

        The clearing recovery does so, also if the default value is 0: an unknown cell of the layer
        changes nothing in the master. Rows and columns on the square's border count as outside.
        clear_costmap_recovery.cpp:351, costmap_layer.cpp:21.
        """
        rows, columns = self.cells.shape
        columns_inside = self._strictly_inside(columns, pose[0], side, axis=0)
        rows_inside = self._strictly_inside(rows, pose[1], side, axis=1)
        cells_inside = rows_inside[:, None] & columns_inside[None, :]
        self.cells[~cells_inside] = UNKNOWN

        # The next update writes the whole map.
        min_x, min_y = self.origin.tolist()
        max_x = min_x + grid.size_in_meters(columns, self.resolution)
        max_y = min_y + grid.size_in_meters(rows, self.resolution)
        written_bounds: Bounds = (min_x, min_y, max_x, max_y)
        if self._cleared_bounds is not None:
            written_bounds = union(self._cleared_bounds, written_bounds)
        self._cleared_bounds = written_bounds

    def _strictly_inside(self, count: int, centre: float, side: float, axis: int) -> np.ndarray:
        """Return (count,) bool: cells along an axis strictly between the sides of a square [m]."""
        square_start = centre - side / 2
        lower_border = grid.truncated_cell(square_start, self.origin[axis], self.resolution)
        upper_border = grid.truncated_cell(square_start + side, self.origin[axis], self.resolution)
        cell_indices = np.arange(count)
        return (cell_indices > lower_border) & (cell_indices < upper_border)


@kernel
def _touch_footprint(footprint: Data, pose: Pose, bounds: Data) -> None:
    """Widen bounds (4,) [m] by the vertices of the footprint (n, 2) [m] at a pose."""
    x, y, yaw = pose
    cos_yaw = math.cos(yaw)
    sin_yaw = math.sin(yaw)
    for corner in range(footprint.shape[0]):
        vertex_x, vertex_y = vertex_at(footprint, corner, x, y, cos_yaw, sin_yaw)
        bounds[0] = min(bounds[0], vertex_x)
        bounds[1] = min(bounds[1], vertex_y)
        bounds[2] = max(bounds[2], vertex_x)
        bounds[3] = max(bounds[3], vertex_y)


@kernel(error_model="numpy")
def observe(
    cells: Data,
    origin: Data,
    resolution: float,
    rays: CloudRays,
    clearing: bool,
    marking: bool,
    bounds: Data,
) -> None:
    """If `clearing`, clear along all rays; if `marking`, then mark all points.

    Bounds (4,) [m] are widened to all changes.
    """
    rows, columns = cells.shape
    origin_x = origin[0]
    origin_y = origin[1]
    points = rays.points
    hits = rays.hits
    for index in range(points.shape[0]):
        # world_to_map without branches, for many points. Cells are needed twice.
        point_x = np.float64(points[index, 0])
        point_y = np.float64(points[index, 1])
        cell_x = (point_x - origin_x) / resolution
        cell_y = (point_y - origin_y) / resolution
        on_map = point_x >= origin_x and point_y >= origin_y and cell_x < columns and cell_y < rows
        hits[index] = int(cell_y) * columns + int(cell_x) if on_map else -1
    if clearing:
        _clear_rays(cells, origin_x, origin_y, resolution, rays, bounds)
    if marking:
        _mark_points(cells, rays, bounds)


@kernel
def _mark_points(cells: Data, rays: CloudRays, bounds: Data) -> None:
    """Mark the cells of all points that are near enough and of the right height."""
    flat_cells = cells.reshape(-1)
    points = rays.points
    hits = rays.hits
    # The buffer of C++ drops points by the source's heights, the layer by its own.
    highest = min(rays.highest, rays.highest_mark)
    squared_limit = rays.obstacle_range * rays.obstacle_range
    min_x = bounds[0]
    min_y = bounds[1]
    max_x = bounds[2]
    max_y = bounds[3]
    for index in range(points.shape[0]):
        if hits[index] < 0:
            continue
        point_x = np.float64(points[index, 0])
        point_y = np.float64(points[index, 1])
        point_z = np.float64(points[index, 2])
        if point_z < rays.lowest or point_z > highest:
            continue
        offset_x = point_x - rays.sensor_x
        offset_y = point_y - rays.sensor_y
        offset_z = point_z - rays.sensor_z
        if offset_x * offset_x + offset_y * offset_y + offset_z * offset_z >= squared_limit:
            continue
        flat_cells[hits[index]] = LETHAL
        min_x = min(min_x, point_x)
        min_y = min(min_y, point_y)
        max_x = max(max_x, point_x)
        max_y = max(max_y, point_y)
    bounds[0] = min_x
    bounds[1] = min_y
    bounds[2] = max_x
    bounds[3] = max_y


@kernel(error_model="numpy")
def _clear_rays(
    cells: Data, origin_x: float, origin_y: float, resolution: float, rays: CloudRays, bounds: Data
) -> None:
    """Clear the cells along all rays, up to raytrace_range. obstacle_layer.cpp:497."""
    flat_cells = cells.reshape(-1)
    points = rays.points
    sensor_x = rays.sensor_x
    sensor_y = rays.sensor_y
    rows, columns = cells.shape
    start_x, start_y = world_to_map(
        sensor_x, sensor_y, origin_x, origin_y, resolution, columns, rows
    )
    if start_x < 0:
        return
    map_right = origin_x + columns * resolution
    map_top = origin_y + rows * resolution
    # Nearer ends are not shortened and need no square root. The factor is a margin for rounding.
    squared_range = rays.raytrace_range * rays.raytrace_range * (1.0 - 1e-9)
    last_cell = -1
    min_x = min(bounds[0], sensor_x)
    min_y = min(bounds[1], sensor_y)
    max_x = max(bounds[2], sensor_x)
    max_y = max(bounds[3], sensor_y)
    for index in range(points.shape[0]):
        point_z = np.float64(points[index, 2])
        if point_z < rays.lowest or point_z > rays.highest:
            continue

        # End of the ray, on the map's border if the point is off the map.
        point_x = float(points[index, 0])
        point_y = float(points[index, 1])
        end_cell = rays.hits[index]
        if point_x < origin_x or point_y < origin_y or point_x > map_right or point_y > map_top:
            point_x, point_y = _clipped(
                point_x, point_y, sensor_x, sensor_y, origin_x, origin_y, map_right, map_top
            )
            end_x, end_y = world_to_map(
                point_x, point_y, origin_x, origin_y, resolution, columns, rows
            )
            end_cell = -1
            if end_x >= 0:
                end_cell = end_y * columns + end_x
        if end_cell < 0:
            continue

        # The bounds grow by the last point that the ray clears.
        ray_x = point_x - sensor_x
        ray_y = point_y - sensor_y
        if ray_x * ray_x + ray_y * ray_y >= squared_range:
            fraction = min(1.0, rays.raytrace_range / math.hypot(ray_x, ray_y))
            ray_x *= fraction
            ray_y *= fraction
        min_x = min(min_x, sensor_x + ray_x)
        min_y = min(min_y, sensor_y + ray_y)
        max_x = max(max_x, sensor_x + ray_x)
        max_y = max(max_y, sensor_y + ray_y)

        # Neighbouring rays often end in the same cell, and then clear the same line of cells.
        if end_cell != last_cell:
            last_cell = end_cell
            _clear_line(
                flat_cells,
                columns,
                start_x,
                start_y,
                end_cell % columns,
                end_cell // columns,
                rays.reach,
            )
    bounds[0] = min_x
    bounds[1] = min_y
    bounds[2] = max_x
    bounds[3] = max_y


@kernel(error_model="numpy")
def _clipped(
    x: float,
    y: float,
    sensor_x: float,
    sensor_y: float,
    left: float,
    bottom: float,
    right: float,
    top: float,
) -> Tuple[float, float]:
    """Return the point x, y [m], moved along its ray to the borders that it is beyond.

    As in C++, one border after another, and along the direction of the unmoved ray.
    """
    ray_x = x - sensor_x
    ray_y = y - sensor_y
    if x < left:
        fraction = (left - sensor_x) / ray_x
        x = left
        y = sensor_y + ray_y * fraction
    if y < bottom:
        fraction = (bottom - sensor_y) / ray_y
        x = sensor_x + ray_x * fraction
        y = bottom
    if x > right:
        fraction = (right - sensor_x) / ray_x
        x = right - BORDER
        y = sensor_y + ray_y * fraction
    if y > top:
        fraction = (top - sensor_y) / ray_y
        x = sensor_x + ray_x * fraction
        y = top - BORDER
    return x, y


@kernel(error_model="numpy", inline="always")
def _clear_line(
    flat_cells: Data, columns: int, x0: int, y0: int, x1: int, y1: int, reach: int
) -> None:
    """Free the line of cells from (x0, y0) towards (x1, y1), at most `reach` cells far."""
    line = line_between(x0, y0, x1, y1)
    step_count = line.major
    if line.major * line.major + line.minor * line.minor > reach * reach:
        fraction = min(1.0, reach / math.hypot(float(line.major), float(line.minor)))
        step_count = min(int(fraction * line.major), line.major)
    step_along = line.along_y * columns + line.along_x
    step_diagonal = line.diagonal_y * columns + line.diagonal_x
    # The part of the line within reach, as the raytracer in costmap_2d.h computes it. The cell of
    # the hit is freed, too, and marked afterwards.
    # Without branches, and with the counter below 0, the loop takes two thirds of the time.
    counter = line.major // 2 - line.major
    cell = y0 * columns + x0
    for _ in range(step_count + 1):
        flat_cells[cell] = FREE
        counter += line.minor
        cell += step_diagonal if counter >= 0 else step_along
        counter -= line.major if counter >= 0 else 0
