"""Footprint of the robot: parsing, padding, placing at a pose, radii, cost on a map, covered cells.

Called by the costmap (radii, clearing under the robot), the trajectory planner (legality), the
recoveries and the check of a robot.
"""

from __future__ import annotations

import math
import re
from typing import Any, Mapping, Sequence, Tuple, Union

import numpy as np

from applr_ros1.common.angles import Pose
from applr_ros1.common.arrays import Data
from applr_ros1.common.errors import ApplrError, shown
from applr_ros1.common.kernels import kernel
from applr_ros1.planner.costmap.grid import (
    INSCRIBED,
    LETHAL,
    UNKNOWN,
    line_between,
    walk_line,
    world_to_map,
)

# Codes of an illegal outline: off the map, on an unknown cell, and on a lethal cell.
OFF_MAP = -3.0
ON_UNKNOWN = -2.0
ON_LETHAL = -1.0
HUGE = float(np.finfo(np.float64).max)
CIRCLE_VERTICES = 16  # number of vertices that stand for a circle of robot_radius
# Twice the area of a triangle below which its corners lie on one line, up to float32 [m^2]
ON_ONE_LINE_M2 = 1e-6


def parse(text: Union[str, Sequence[Sequence[float]], np.ndarray]) -> np.ndarray:
    """Return the vertices (n, 2) float64 [m] of the parameter `footprint`.

    The parameter is a string "[[x, y], ...]" or a sequence. Values are rounded as in the C++ node,
    which prints six digits and reads float32. An empty list gives (0, 2). Commas may be missing in
    a string (array_parser.cpp).

    Raises:
        ApplrError: The text is neither empty nor a list of at least three finite points.
    """
    problem = ApplrError(
        f"footprint is {shown(text)}: give at least three points in metres, [[x, y], [x, y], ...]"
    )
    # A string is split by its form alone. Nothing in a parameter file is evaluated.
    point_list = text
    if isinstance(text, str):
        list_match = re.fullmatch(r"\s*(?:\[((?:[\s,]*\[[^][]*\])*)[\s,]*\]\s*)?", text)
        if list_match is None:
            raise problem
        point_texts = re.findall(r"\[([^]]*)\]", list_match[1] or "")
        point_list = [re.findall(r"[^\s,'\"]+", point) for point in point_texts]

    # C++ prints the parameter with "%g" and reads it into float32.
    try:
        rounded_points = [[float("%g" % float(number)) for number in point] for point in point_list]
        points = np.array(rounded_points, dtype=np.float32)
    except (TypeError, ValueError, OverflowError):
        raise problem from None

    if points.size == 0:
        return np.zeros((0, 2))
    is_polygon = points.ndim == 2 and points.shape[1] == 2 and len(points) >= 3
    if not is_polygon or not np.isfinite(points).all():
        raise problem
    return points.astype(np.float64)


def circle(radius: float) -> np.ndarray:
    """Return the vertices (16, 2) [m] of a circle, as costmap_2d derives them from robot_radius."""
    angles = [i * 2 * math.pi / CIRCLE_VERTICES for i in range(CIRCLE_VERTICES)]
    return np.array([[math.cos(angle) * radius, math.sin(angle) * radius] for angle in angles])


def pad(vertices: np.ndarray, padding: float) -> np.ndarray:
    """Move vertices (n, 2) away from the axes by `padding` [m]; keep zeros. footprint.cpp:138."""
    vertices = np.asarray(vertices, dtype=np.float64).reshape(-1, 2)
    return vertices + np.sign(vertices) * padding


def crosses_itself(vertices: np.ndarray) -> bool:
    """Return whether two sides of a closed outline (n, 2) [m] cross each other.

    Sides that touch do not cross: some outlines repeat their first vertex at the end.
    """
    sides = np.roll(vertices, -1, axis=0) - vertices
    # Row i: on which side of the line along side i each vertex lies, positive on the left
    offsets = vertices - vertices[:, np.newaxis]
    leftward = sides[:, :1] * offsets[:, :, 1] - sides[:, 1:] * offsets[:, :, 0]
    leftward[np.abs(leftward) < ON_ONE_LINE_M2] = 0.0
    # Two sides cross if the ends of each lie on both sides of the other.
    separates = leftward * np.roll(leftward, -1, axis=1) < 0.0
    return bool((separates & separates.T).any())


def padded(values: Mapping[str, Any]) -> np.ndarray:
    """Return the padded outline (n, 2) [m] from the parameters of a costmap.

    It is a circle if they give no footprint.
    """
    outline = parse(values["footprint"])
    if len(outline) == 0:
        outline = circle(values["robot_radius"])
    return pad(outline, values["footprint_padding"])


def passing_radius(values: Mapping[str, Any]) -> float:
    """Return the smallest inflation radius [m] that keeps plans out of gaps too narrow to pass.

    A smaller one marks no cell as inscribed, so navfn leads the robot's centre through every gap.
    Half a cell more, because the inflation counts whole cells.

    Args:
        values: Parameters of a costmap.
    """
    inscribed_radius, _ = radii(padded(values))
    return inscribed_radius + 0.5 * float(values["resolution"])


def transform(vertices: np.ndarray, x: float, y: float, yaw: float) -> np.ndarray:
    """Return the vertices (n, 2) [m] placed at the pose x, y [m], yaw [rad]. footprint.cpp:106."""
    vertices = np.asarray(vertices, dtype=np.float64).reshape(-1, 2)
    vertex_x, vertex_y = vertices.T
    placed = np.empty_like(vertices)
    cos_yaw = math.cos(yaw)
    sin_yaw = math.sin(yaw)
    # The parentheses are C++'s: they decide how the sums round.
    placed[:, 0] = x + (vertex_x * cos_yaw - vertex_y * sin_yaw)
    placed[:, 1] = y + (vertex_x * sin_yaw + vertex_y * cos_yaw)
    return placed


@kernel
def vertex_at(
    vertices: Data, i: int, x: float, y: float, cos_yaw: float, sin_yaw: float
) -> Tuple[float, float]:
    """Return vertex i of `vertices` (n, 2) [m], placed at x, y [m] and a heading: `transform`."""
    vertex_x = vertices[i, 0]
    vertex_y = vertices[i, 1]
    placed_x = x + (vertex_x * cos_yaw - vertex_y * sin_yaw)
    placed_y = y + (vertex_x * sin_yaw + vertex_y * cos_yaw)
    return placed_x, placed_y


def _distance_to_edge(x0: float, y0: float, x1: float, y1: float) -> float:
    """Return the distance [m] of (0, 0) from an edge; NaN if its length is zero, as in C++."""
    edge_x = x1 - x0
    edge_y = y1 - y0
    squared_length = edge_x * edge_x + edge_y * edge_y
    if squared_length == 0:
        return math.nan
    # Position of the foot of the perpendicular along the edge: 0 at its start, 1 at its end.
    position = ((0.0 - x0) * edge_x + (0.0 - y0) * edge_y) / squared_length
    if position < 0:
        return float(np.hypot(x0, y0))
    if position > 1:
        return float(np.hypot(x1, y1))
    return float(np.hypot(x0 + position * edge_x, y0 + position * edge_y))


def radii(vertices: np.ndarray) -> Tuple[float, float]:
    """Return the (inscribed, circumscribed) radius [m] of the vertices (n, 2) about (0, 0).

    With two vertices or fewer the result is (largest double, 0), as in C++. footprint.cpp:41.
    """
    corners = np.asarray(vertices, dtype=np.float64).reshape(-1, 2).tolist()
    inscribed = HUGE
    circumscribed = 0.0
    if len(corners) <= 2:
        return inscribed, circumscribed
    for i, (start_x, start_y) in enumerate(corners):
        end_x, end_y = corners[(i + 1) % len(corners)]
        vertex_distance = float(np.hypot(start_x, start_y))
        edge_distance = _distance_to_edge(start_x, start_y, end_x, end_y)
        for distance in (vertex_distance, edge_distance):
            # In this order of the arguments, min and max ignore the NaN of an edge of length zero.
            inscribed = min(inscribed, distance)
            circumscribed = max(circumscribed, distance)
    return inscribed, circumscribed


@kernel
def farthest(vertices: Data) -> float:
    """Return the largest distance [m] of the vertices (n, 2) from the robot's centre."""
    largest_square = 0.0
    for i in range(vertices.shape[0]):
        x = vertices[i, 0]
        y = vertices[i, 1]
        largest_square = max(largest_square, x * x + y * y)
    return math.sqrt(largest_square)


@kernel(error_model="numpy")
def footprint_cost(
    cells: Data, origin_x: float, origin_y: float, resolution: float, vertices: Data, pose: Pose
) -> float:
    """Return the largest cost on `cells` (rows, columns) under the outline of a footprint.

    The vertices (n, 2) [m] are placed at a pose (x, y, yaw) [m, rad]. If edges are illegal, return
    the code of the first one: OFF_MAP, ON_UNKNOWN or ON_LETHAL. costmap_model.cpp:47.
    """
    x, y, yaw = pose
    rows, columns = cells.shape
    centre_x, centre_y = world_to_map(x, y, origin_x, origin_y, resolution, columns, rows)
    if centre_x < 0:
        return OFF_MAP

    # Without an area, the robot is its centre.
    vertex_count = vertices.shape[0]
    if vertex_count < 3:
        cost = int(cells[centre_y, centre_x])
        if cost == UNKNOWN:
            return ON_UNKNOWN
        if cost >= INSCRIBED:
            return ON_LETHAL
        return float(cost)

    # Edges are walked in the order of C++, because the first illegal one decides the code.
    cos_yaw = math.cos(yaw)
    sin_yaw = math.sin(yaw)
    start_x = start_y = largest_cost = 0
    for corner in range(vertex_count + 1):
        vertex_x, vertex_y = vertex_at(vertices, corner % vertex_count, x, y, cos_yaw, sin_yaw)
        end_x, end_y = world_to_map(
            vertex_x, vertex_y, origin_x, origin_y, resolution, columns, rows
        )
        if end_x < 0:
            return OFF_MAP
        if corner > 0:
            cost = line_cost(cells, start_x, start_y, end_x, end_y)
            if cost < 0:
                return float(cost)
            largest_cost = max(largest_cost, cost)
        start_x = end_x
        start_y = end_y
    return float(largest_cost)


@kernel
def line_cost(cells: Data, x0: int, y0: int, x1: int, y1: int) -> int:
    """Return the largest cost on the line of cells from (x0, y0) to (x1, y1).

    If the line has illegal cells, return -1 if the first is lethal and -2 if it is unknown.
    """
    line = line_between(x0, y0, x1, y1)
    counter = line.major // 2
    cell_x = x0
    cell_y = y0
    largest_cost = 0
    for _ in range(line.major + 1):
        cost = int(cells[cell_y, cell_x])
        if cost == UNKNOWN:
            return -2
        if cost == LETHAL:
            return -1
        largest_cost = max(largest_cost, cost)
        counter += line.minor
        if counter >= line.major:
            counter -= line.major
            cell_x += line.diagonal_x
            cell_y += line.diagonal_y
        else:
            cell_x += line.along_x
            cell_y += line.along_y
    return largest_cost


@kernel(error_model="numpy")
def fill_footprint(
    grid: Data,
    value: int,
    origin_x: float,
    origin_y: float,
    resolution: float,
    vertices: Data,
    pose: Pose,
    whole: bool,
) -> bool:
    """Write `value` into every cell of `grid` (rows, columns) that the placed footprint covers.

    If `whole` is true, nothing is written when a vertex is off the map or there are fewer than
    three vertices, as in Costmap2D::setConvexPolygonCost. If `whole` is false, the edges before the
    first vertex off the map are drawn, and a footprint of at most one point covers the cell of the
    robot's centre, as in FootprintHelper::getFootprintCells (footprint_helper.cpp:123, 180).

    Returns:
        Whether the footprint lies on the map and was filled.
    """
    x, y, yaw = pose
    rows, columns = grid.shape
    vertex_count = vertices.shape[0]
    if vertex_count < 3 and whole:
        return False
    if vertex_count <= 1:
        centre_x, centre_y = world_to_map(x, y, origin_x, origin_y, resolution, columns, rows)
        if centre_x >= 0:
            grid[centre_y, centre_x] = value
        return centre_x >= 0

    # Cells of the vertices up to the first one off the map.
    cos_yaw = math.cos(yaw)
    sin_yaw = math.sin(yaw)
    corners_x = np.empty(vertex_count, np.int64)
    corners_y = np.empty(vertex_count, np.int64)
    corner_count = 0
    while corner_count < vertex_count:
        vertex_x, vertex_y = vertex_at(vertices, corner_count, x, y, cos_yaw, sin_yaw)
        cell_x, cell_y = world_to_map(
            vertex_x, vertex_y, origin_x, origin_y, resolution, columns, rows
        )
        if cell_x < 0:
            break
        corners_x[corner_count] = cell_x
        corners_y[corner_count] = cell_y
        corner_count += 1

    if corner_count == vertex_count:
        _fill_polygon(grid, value, corners_x, corners_y)
    elif not whole:
        _draw_edges(grid, value, corners_x[:corner_count], corners_y[:corner_count])
    is_on_map: bool = corner_count == vertex_count
    return is_on_map


@kernel
def _draw_edges(grid: Data, value: int, corners_x: Data, corners_y: Data) -> None:
    """Write `value` into the lines of cells that join the corners (n,), without the closing one."""
    line_x = np.empty(grid.shape[0] + grid.shape[1], np.int64)
    line_y = np.empty_like(line_x)
    for corner in range(corners_x.shape[0] - 1):
        end_x = corners_x[corner + 1]
        end_y = corners_y[corner + 1]
        for visited in range(
            walk_line(corners_x[corner], corners_y[corner], end_x, end_y, line_x, line_y)
        ):
            grid[line_y[visited], line_x[visited]] = value


@kernel
def _fill_polygon(grid: Data, value: int, corners_x: Data, corners_y: Data) -> None:
    """Write `value` into all cells between the lowest and highest outline cell of each column."""
    # Range of rows by column.
    corner_count = corners_x.shape[0]
    first_column = corners_x.min()
    column_count = corners_x.max() - first_column + 1
    lowest_row = np.full(column_count, grid.shape[0], np.int64)
    highest_row = np.full(column_count, -1, np.int64)
    line_x = np.empty(grid.shape[0] + grid.shape[1], np.int64)
    line_y = np.empty_like(line_x)
    for corner in range(corner_count):
        end_x = corners_x[(corner + 1) % corner_count]
        end_y = corners_y[(corner + 1) % corner_count]
        for visited in range(
            walk_line(corners_x[corner], corners_y[corner], end_x, end_y, line_x, line_y)
        ):
            column = line_x[visited] - first_column
            lowest_row[column] = min(lowest_row[column], line_y[visited])
            highest_row[column] = max(highest_row[column], line_y[visited])
    # For a closed outline, this is the filling of C++, which sorts the outline cells by column.
    for column in range(column_count):
        for row in range(lowest_row[column], highest_row[column] + 1):
            grid[row, first_column + column] = value
