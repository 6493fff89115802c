"""Footprint of the robot: parsing, padding, placing at a pose, radii, cost on a map and covered cells.

Called by the costmap (radii, clearing under the robot), the trajectory planner (legality) and the recoveries.
"""

from __future__ import annotations

import math
import re
from typing import Any, Mapping, Sequence, Tuple, Union

import numpy as np

from applr_ros1.common.angles import Pose
from applr_ros1.common.arrays import Data
from applr_ros1.common.errors import ApplrError
from applr_ros1.common.kernels import kernel
from applr_ros1.planner.costmap.grid import INSCRIBED, LETHAL, UNKNOWN, walk_line, world_to_map

OFF_MAP = -3.0  # cost of an outline that leaves the map
ON_UNKNOWN = -2.0  # cost of an outline on an unknown cell
ON_LETHAL = -1.0  # cost of an outline on a lethal cell
HUGE = float(np.finfo(np.float64).max)


def parse(text: Union[str, Sequence[Sequence[float]], np.ndarray]) -> np.ndarray:
    """Return the vertices (n, 2) float64 [m] of the parameter `footprint`, a string "[[x, y], ...]" or a sequence.

    Values are rounded as in the C++ node, which prints six digits and reads float32. An empty list gives (0, 2). Commas
    may be missing in a string (array_parser.cpp).

    Raises:
        ApplrError: The text is neither empty nor a list of at least three finite points.
    """
    wrong = ApplrError(f"footprint is {text!r:.60}: give at least three points in metres, [[x, y], [x, y], ...]")
    value = text
    if isinstance(text, str):
        inside = re.fullmatch(r"\s*(?:\[((?:[\s,]*\[[^][]*\])*)[\s,]*\]\s*)?", text)
        if inside is None:
            raise wrong
        value = [re.findall(r"[^\s,'\"]+", point) for point in re.findall(r"\[([^]]*)\]", inside[1] or "")]
    try:
        points = np.array([[float("%g" % float(v)) for v in point] for point in value], dtype=np.float32)
    except (TypeError, ValueError, OverflowError):
        raise wrong from None
    if points.size == 0:
        return np.zeros((0, 2))
    if points.ndim != 2 or points.shape[1] != 2 or len(points) < 3 or not np.isfinite(points).all():
        raise wrong
    return points.astype(np.float64)


def circle(radius: float) -> np.ndarray:
    """Return sixteen vertices (16, 2) [m] on a circle, as costmap_2d derives them from `robot_radius`."""
    angles = [i * 2 * math.pi / 16 for i in range(16)]
    return np.array([[math.cos(a) * radius, math.sin(a) * radius] for a in angles])


def pad(vertices: np.ndarray, padding: float) -> np.ndarray:
    """Move vertices (n, 2) away from the axes by `padding` [m]; a coordinate of 0 is kept. footprint.cpp:138."""
    vertices = np.asarray(vertices, dtype=np.float64).reshape(-1, 2)
    return vertices + np.sign(vertices) * padding


def padded(values: Mapping[str, Any]) -> np.ndarray:
    """Return the padded outline (n, 2) [m] from the parameters of a costmap; a circle if they give no footprint."""
    outline = parse(values["footprint"])
    return pad(outline if len(outline) else circle(values["robot_radius"]), values["footprint_padding"])


def transform(vertices: np.ndarray, x: float, y: float, yaw: float) -> np.ndarray:
    """Return the vertices (n, 2) [m] placed at the pose x, y [m], yaw [rad]. footprint.cpp:106."""
    vertices = np.asarray(vertices, dtype=np.float64).reshape(-1, 2)
    out = np.empty_like(vertices)
    c, s = math.cos(yaw), math.sin(yaw)
    out[:, 0] = x + (vertices[:, 0] * c - vertices[:, 1] * s)
    out[:, 1] = y + (vertices[:, 0] * s + vertices[:, 1] * c)
    return out


def _distance_to_edge(x0: float, y0: float, x1: float, y1: float) -> float:
    a, b = 0.0 - x0, 0.0 - y0
    c, d = x1 - x0, y1 - y0
    dot, length = a * c + b * d, c * c + d * d
    t = dot / length if length != 0 else math.nan
    if t < 0:
        px, py = x0, y0
    elif t > 1:
        px, py = x1, y1
    else:
        px, py = x0 + t * c, y0 + t * d
    return float(np.hypot(0.0 - px, 0.0 - py))


def radii(vertices: np.ndarray) -> Tuple[float, float]:
    """Return the (inscribed, circumscribed) radius [m] of the vertices (n, 2) about (0, 0). footprint.cpp:41.

    With two vertices or fewer the result is (largest double, 0), as in C++.
    """
    vertices = np.asarray(vertices, dtype=np.float64).reshape(-1, 2)
    inscribed, circumscribed = HUGE, 0.0
    if len(vertices) <= 2:
        return inscribed, circumscribed
    for i in range(len(vertices)):
        x0, y0 = (float(v) for v in vertices[i])
        x1, y1 = (float(v) for v in vertices[(i + 1) % len(vertices)])
        for distance in (float(np.hypot(x0, y0)), _distance_to_edge(x0, y0, x1, y1)):
            inscribed, circumscribed = min(inscribed, distance), max(circumscribed, distance)
    return inscribed, circumscribed


@kernel(error_model="numpy")
def footprint_cost(cells: Data, ox: float, oy: float, resolution: float, vertices: Data, pose: Pose) -> float:
    """Return the largest cost on `cells` (ny, nx) under the outline of `vertices` (n, 2) [m] at a pose (x, y, yaw).

    If edges are illegal, return the code of the first one: OFF_MAP, ON_UNKNOWN or ON_LETHAL. costmap_model.cpp:47.
    """
    x, y, yaw = pose
    ny, nx = cells.shape
    cx, cy = world_to_map(x, y, ox, oy, resolution, nx, ny)
    if cx < 0:
        return OFF_MAP
    n = vertices.shape[0]
    if n < 3:
        cost = int(cells[cy, cx])
        if cost == UNKNOWN:
            return ON_UNKNOWN
        return ON_LETHAL if cost >= INSCRIBED else float(cost)
    c = math.cos(yaw)
    s = math.sin(yaw)
    x0 = y0 = worst = 0
    for i in range(n + 1):
        fx = vertices[i % n, 0]
        fy = vertices[i % n, 1]
        x1, y1 = world_to_map(x + (fx * c - fy * s), y + (fx * s + fy * c), ox, oy, resolution, nx, ny)
        if x1 < 0:
            return OFF_MAP
        if i > 0:
            cost = line_cost(cells, x0, y0, x1, y1)
            if cost < 0:
                return float(cost)
            worst = max(worst, cost)
        x0, y0 = x1, y1
    return float(worst)


@kernel
def line_cost(cells: Data, x0: int, y0: int, x1: int, y1: int) -> int:
    """Return the largest cost on the line of cells from (x0, y0) to (x1, y1).

    If the line has illegal cells, return -1 if the first is lethal and -2 if it is unknown.
    """
    adx = abs(x1 - x0)
    ady = abs(y1 - y0)
    sx = 1 if x1 >= x0 else -1
    sy = 1 if y1 >= y0 else -1
    x_major = adx >= ady
    major = adx if x_major else ady
    minor = ady if x_major else adx
    counter = major // 2
    x = x0
    y = y0
    worst = 0
    for _ in range(major + 1):
        cost = int(cells[y, x])
        if cost >= LETHAL:
            return -2 if cost == UNKNOWN else -1
        worst = max(worst, cost)
        counter += minor
        both = counter >= major
        counter -= major if both else 0
        x += sx if both or x_major else 0
        y += sy if both or not x_major else 0
    return worst


@kernel(error_model="numpy")
def fill_footprint(
    grid: Data, value: int, ox: float, oy: float, resolution: float, vertices: Data, pose: Pose, whole: bool
) -> bool:
    """Write `value` into every cell of `grid` (ny, nx) that the placed footprint covers; return success.

    If `whole` is true, nothing is written when a vertex is off the map or there are fewer than three vertices, as in
    Costmap2D::setConvexPolygonCost. If `whole` is false, the edges before the first vertex off the map are drawn, and a
    footprint of at most one point covers the cell of the robot's centre, as in FootprintHelper::getFootprintCells.
    """
    x, y, yaw = pose
    ny, nx = grid.shape
    n = vertices.shape[0]
    if n < 3 and whole:
        return False
    if n <= 1:
        cx, cy = world_to_map(x, y, ox, oy, resolution, nx, ny)
        if cx >= 0:
            grid[cy, cx] = value
        return cx >= 0
    c = math.cos(yaw)
    s = math.sin(yaw)
    px = np.empty(n, np.int64)
    py = np.empty(n, np.int64)
    xs = np.empty(nx + ny, np.int64)
    ys = np.empty(nx + ny, np.int64)
    count = n  # number of vertices before the first one off the map
    for i in range(n):
        fx = vertices[i, 0]
        fy = vertices[i, 1]
        px[i], py[i] = world_to_map(x + (fx * c - fy * s), y + (fx * s + fy * c), ox, oy, resolution, nx, ny)
        if px[i] < 0:
            count = i
            break
    if count < n:
        if whole:
            return False
        for i in range(count - 1):
            for k in range(walk_line(px[i], py[i], px[i + 1], py[i + 1], xs, ys)):
                grid[ys[k], xs[k]] = value
        return False
    left = nx
    right = -1
    for i in range(n):
        left = min(left, px[i])
        right = max(right, px[i])
    low = np.full(right - left + 1, ny, np.int64)
    high = np.full(right - left + 1, -1, np.int64)
    for i in range(n):
        j = i + 1 if i + 1 < n else 0
        for k in range(walk_line(px[i], py[i], px[j], py[j], xs, ys)):
            column = xs[k] - left
            low[column] = min(low[column], ys[k])
            high[column] = max(high[column], ys[k])
    for column in range(right - left + 1):
        for row in range(low[column], high[column] + 1):
            grid[row, left + column] = value
    return True
