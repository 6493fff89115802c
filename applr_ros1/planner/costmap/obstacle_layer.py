"""Obstacle layer of a costmap: marks sensor hits, clears cells along the rays and under the robot.

Called by costmap.Costmap. Follows costmap_2d/obstacle_layer.cpp step by step. The layer has its own grid.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Optional, Sequence, Tuple

import numpy as np

from applr_ros1.common.angles import Pose
from applr_ros1.common.arrays import Data
from applr_ros1.common.kernels import kernel
from applr_ros1.common.scan import ObservationBuffer, PointCloud, Source
from applr_ros1.planner.costmap import grid
from applr_ros1.planner.costmap.footprint import fill_footprint
from applr_ros1.planner.costmap.grid import (
    FREE,
    LETHAL,
    MAXIMUM,
    OVERWRITE,
    UNKNOWN,
    Bounds,
    Window,
    union,
    world_to_map,
)

Rays = Tuple[Any, ...]  # rays of one cloud with ranges and heights, see _observe


@dataclass
class ObstacleParameters:
    """Settings of the layer, named like the ROS parameters."""

    enabled: bool = True
    footprint_clearing_enabled: bool = True
    max_obstacle_height: float = 2.0  # height above which points do not mark [m]
    combination_method: int = MAXIMUM


class ObstacleLayer:
    """Obstacle layer with its own grid `cells` (ny, nx) uint8 of 0, 254 and 255 and its own `origin` (2,) [m].

    Args:
        nx, ny, resolution, origin: size [cells], resolution and origin [m] of the costmap.
        rolling: whether the grid moves along with the robot.
        default: value of unobserved cells, 0 or 255.
        parameters: settings of the layer.
        sources: one source per entry of observation_sources, in the same order.
        name: name of the layer in the parameter files.
    """

    def __init__(
        self,
        nx: int,
        ny: int,
        resolution: float,
        origin: Any,
        rolling: bool,
        default: int,
        parameters: ObstacleParameters,
        sources: Sequence[Source] = (Source(),),
        name: str = "obstacles_layer",
    ):
        self.name = name
        self.parameters = parameters
        self.rolling = bool(rolling)
        self.default = int(default)
        self.buffers = [ObservationBuffer(source) for source in sources]
        self._hits = np.empty(1024, np.int64)
        self._bounds = np.empty(4)
        self.match_size(nx, ny, resolution, origin)

    def match_size(self, nx: int, ny: int, resolution: float, origin: Any) -> None:
        """Take size and origin of the costmap and empty the grid; the latest clouds of the sources are kept."""
        self.resolution = float(resolution)
        self.cells = np.full((ny, nx), self.default, np.uint8)
        self.origin = np.array(origin, dtype=np.float64)
        self._extra: Optional[Bounds] = None  # bounds of the area that a recovery has cleared since the last update

    def configure(self, parameters: ObstacleParameters) -> None:
        """Take new parameters; they take effect at the next update."""
        self.parameters = parameters

    @property
    def cloud(self) -> Optional[PointCloud]:
        """Latest cloud of the first source; None before the first message."""
        clouds = self.buffers[0].clouds
        return clouds[0] if clouds else None

    @cloud.setter
    def cloud(self, cloud: PointCloud) -> None:
        self.buffers[0].take(cloud, cloud.stamp)

    def update_bounds(self, bounds: Bounds, pose: Pose, footprint: np.ndarray) -> Bounds:
        """Roll, clear and mark; return the bounds (min x, min y, max x, max y) [m], widened to all possible changes."""
        if self.rolling:
            grid.roll(self.cells, self.origin, self.resolution, pose[0], pose[1], self.default)
        touched = self._bounds
        touched[:] = bounds if self._extra is None else union(bounds, self._extra)
        self._extra = None
        if len(self.buffers) == 1 and len(self.buffers[0].clouds) == 1:
            source = self.buffers[0].source
            self._observe(source, self.buffers[0].clouds[0], source.clearing, source.marking, touched)
        else:  # All rays of all sources clear before any point marks.
            observed = [(buffer.source, cloud) for buffer in self.buffers for cloud in buffer.clouds]
            for source, cloud in observed:
                if source.clearing:
                    self._observe(source, cloud, True, False, touched)
            for source, cloud in observed:
                if source.marking:
                    self._observe(source, cloud, False, True, touched)
        if self.parameters.footprint_clearing_enabled:
            _touch_footprint(footprint, pose, touched)
        low_x, low_y, high_x, high_y = touched.tolist()
        return low_x, low_y, high_x, high_y

    def _observe(self, source: Source, cloud: PointCloud, clearing: bool, marking: bool, touched: np.ndarray) -> None:
        if len(cloud.points) > len(self._hits):
            self._hits = np.empty(len(cloud.points), np.int64)
        ranges = source.raytrace_range, source.obstacle_range
        heights = source.min_obstacle_height, source.max_obstacle_height, self.parameters.max_obstacle_height
        rays = cloud.points, cloud.origin, self._hits, ranges, grid.cell_distance(ranges[0], self.resolution), heights
        _observe(self.cells, self.origin, self.resolution, rays, clearing, marking, touched)

    def write(self, base: np.ndarray, window: Window, pose: Pose, footprint: np.ndarray) -> None:
        """Clear under the robot, then write the layer into the window (x0, y0, xn, yn) of `base` (ny, nx)."""
        self.clear_footprint(pose, footprint)
        if self.is_merging:
            grid.merge(self.cells, base, self.parameters.combination_method == MAXIMUM, *window)

    def clear_footprint(self, pose: Pose, footprint: np.ndarray) -> None:
        """Free the cells under the robot if footprint_clearing_enabled is set."""
        if self.parameters.footprint_clearing_enabled:
            ox, oy = self.origin.tolist()
            fill_footprint(self.cells, FREE, ox, oy, self.resolution, footprint, pose, True)

    @property
    def is_merging(self) -> bool:
        """True unless an unknown combination_method keeps the layer out of the master."""
        return self.parameters.combination_method in (OVERWRITE, MAXIMUM)

    def reset(self) -> None:
        """Reset all cells to the default value. The next update marks the latest scan again."""
        self.cells[:] = self.default

    def clear_outside(self, pose: Pose, side: float) -> None:
        """Set the cells outside the square of `side` [m] around the pose to 255, as the clearing recovery does.

        Rows and columns on the square's border count as outside. clear_costmap_recovery.cpp:351, costmap_layer.cpp:21.
        """
        ny, nx = self.cells.shape
        ends = []
        for axis in (0, 1):
            start = pose[axis] - side / 2
            ends += [grid.truncated_cell(w, self.origin[axis], self.resolution) for w in (start, start + side)]
        xs, ys = np.arange(nx), np.arange(ny)
        inside = ((ys > ends[2]) & (ys < ends[3]))[:, None] & ((xs > ends[0]) & (xs < ends[1]))[None, :]
        self.cells[~inside] = UNKNOWN
        ox, oy = self.origin.tolist()
        whole: Bounds = (
            ox,
            oy,
            ox + grid.size_in_meters(nx, self.resolution),
            oy + grid.size_in_meters(ny, self.resolution),
        )
        self._extra = whole if self._extra is None else union(self._extra, whole)


@kernel
def _touch_footprint(footprint: Data, pose: Pose, bounds: Data) -> None:
    x, y, yaw = pose
    c = math.cos(yaw)
    s = math.sin(yaw)
    for i in range(footprint.shape[0]):
        fx = footprint[i, 0]
        fy = footprint[i, 1]
        px = x + (fx * c - fy * s)
        py = y + (fx * s + fy * c)
        bounds[0] = min(bounds[0], px)
        bounds[1] = min(bounds[1], py)
        bounds[2] = max(bounds[2], px)
        bounds[3] = max(bounds[3], py)


@kernel(error_model="numpy")
def _observe(cells: Data, origin: Data, res: float, rays: Rays, clearing: bool, marking: bool, bounds: Data) -> None:
    """If `clearing`, clear along all rays; if `marking`, then mark all points. Widen bounds (4,) to all changes.

    rays: points (n, 3), sensor position (x, y, z), scratch (n,) for the flat cell index of each point (-1 off the map),
    ranges (clearing, marking) [m], clearing range [cells], heights (lowest, highest, highest to mark) [m].
    """
    points, (sx, sy, sz), hits, (_, obstacle_range), _, (lowest, highest, highest_mark) = rays
    ny, nx = cells.shape
    ox = origin[0]
    oy = origin[1]
    for i in range(points.shape[0]):
        px = np.float64(points[i, 0])
        py = np.float64(points[i, 1])
        fx = (px - ox) / res
        fy = (py - oy) / res
        on_map = px >= ox and py >= oy and fx < nx and fy < ny
        hits[i] = int(fy) * nx + int(fx) if on_map else -1
    if clearing:
        _clear_rays(cells, ox, oy, res, rays, bounds)
    if not marking:
        return
    flat = cells.reshape(-1)
    highest = min(highest, highest_mark)
    limit = obstacle_range * obstacle_range
    min_x = bounds[0]
    min_y = bounds[1]
    max_x = bounds[2]
    max_y = bounds[3]
    for i in range(points.shape[0]):
        if hits[i] < 0:
            continue
        px = np.float64(points[i, 0])
        py = np.float64(points[i, 1])
        pz = np.float64(points[i, 2])
        if pz < lowest or pz > highest:
            continue
        if (px - sx) * (px - sx) + (py - sy) * (py - sy) + (pz - sz) * (pz - sz) >= limit:
            continue
        flat[hits[i]] = LETHAL
        min_x = min(min_x, px)
        min_y = min(min_y, py)
        max_x = max(max_x, px)
        max_y = max(max_y, py)
    bounds[0] = min_x
    bounds[1] = min_y
    bounds[2] = max_x
    bounds[3] = max_y


@kernel(error_model="numpy")
def _clear_rays(cells: Data, ox: float, oy: float, res: float, rays: Rays, bounds: Data) -> None:
    points, (sx, sy, _), hits, (raytrace_range, _), reach, (lowest, highest, _) = rays
    ny, nx = cells.shape
    flat = cells.reshape(-1)
    x0, y0 = world_to_map(sx, sy, ox, oy, res, nx, ny)
    if x0 < 0:
        return
    right = ox + nx * res
    top = oy + ny * res
    near = reach * reach
    safely_near = raytrace_range * raytrace_range * (1.0 - 1e-9)
    start = y0 * nx + x0
    last = -1
    min_x = min(bounds[0], sx)
    min_y = min(bounds[1], sy)
    max_x = max(bounds[2], sx)
    max_y = max(bounds[3], sy)
    for i in range(points.shape[0]):
        pz = np.float64(points[i, 2])
        if pz < lowest or pz > highest:
            continue
        wx = float(points[i, 0])
        wy = float(points[i, 1])
        end = hits[i]
        if wx < ox or wy < oy or wx > right or wy > top:
            a = wx - sx
            b = wy - sy
            if wx < ox:
                t = (ox - sx) / a
                wx = ox
                wy = sy + b * t
            if wy < oy:
                t = (oy - sy) / b
                wx = sx + a * t
                wy = oy
            if wx > right:
                t = (right - sx) / a
                wx = right - 0.001
                wy = sy + b * t
            if wy > top:
                t = (top - sy) / b
                wx = sx + a * t
                wy = top - 0.001
            x1, y1 = world_to_map(wx, wy, ox, oy, res, nx, ny)
            end = y1 * nx + x1 if x1 >= 0 else -1
        if end < 0:
            continue
        dx = wx - sx
        dy = wy - sy
        if dx * dx + dy * dy >= safely_near:  # The factor of nearer end points is 1.
            f = min(1.0, raytrace_range / math.hypot(dx, dy))
            dx *= f
            dy *= f
        min_x = min(min_x, sx + dx)
        min_y = min(min_y, sy + dy)
        max_x = max(max_x, sx + dx)
        max_y = max(max_y, sy + dy)
        if end == last:  # The last ray has cleared the same line of cells.
            continue
        last = end
        dy_cells = end // nx - y0
        dx_cells = end % nx - x0
        step_x = 1 if dx_cells >= 0 else -1
        step_y = nx if dy_cells >= 0 else -nx
        dx_cells = abs(dx_cells)
        dy_cells = abs(dy_cells)
        x_major = dx_cells >= dy_cells
        major = dx_cells if x_major else dy_cells
        minor = dy_cells if x_major else dx_cells
        step_major = step_x if x_major else step_y
        step_both = step_x + step_y
        length = major
        if dx_cells * dx_cells + dy_cells * dy_cells > near:
            f = min(1.0, reach / math.hypot(float(dx_cells), float(dy_cells)))
            length = min(int(f * major), major)
        counter = major // 2 - major
        k = start
        for _ in range(length + 1):
            flat[k] = FREE
            counter += minor
            k += step_both if counter >= 0 else step_major
            counter -= major if counter >= 0 else 0
    bounds[0] = min_x
    bounds[1] = min_y
    bounds[2] = max_x
    bounds[3] = max_y
