"""Cell grid: conversions between world and cells, lines of cells, shifting and merging of grids.

Called by every kernel of the planner. Cells are computed as in costmap_2d, by a division and
truncation. Multiplying by 1 / resolution instead would move points on cell borders to another
cell. Grids are (rows, columns) uint8.
"""

from __future__ import annotations

import math
from typing import NamedTuple, Tuple, TypeVar

import numpy as np

from applr_ros1.common.arrays import Data
from applr_ros1.common.kernels import kernel

FREE = 0
INSCRIBED = 253  # cost of a cell within the inscribed radius of an obstacle
LETHAL = 254
UNKNOWN = 255
# Values of combination_method: known cells of the layer replace those of the costmap, or the larger
# value counts.
OVERWRITE = 0
MAXIMUM = 1

# Columns [left, right) and rows [bottom, top) of a grid as (left, bottom, right, top).
Window = Tuple[int, int, int, int]
Bounds = Tuple[float, float, float, float]  # (min x, min y, max x, max y) [m]
Rectangle = TypeVar("Rectangle", Window, Bounds)


@kernel
def world_to_map(
    x: float,
    y: float,
    origin_x: float,
    origin_y: float,
    resolution: float,
    columns: int,
    rows: int,
) -> Tuple[int, int]:
    """Return the cell (x, y) of the point x, y [m], or (-1, -1) off the map. costmap_2d.cpp:208."""
    if x < origin_x or y < origin_y:
        return -1, -1
    cells_x = (x - origin_x) / resolution
    cells_y = (y - origin_y) / resolution
    # The negation also rejects NaN and numbers too large for an integer.
    if not (cells_x < columns and cells_y < rows):
        return -1, -1
    return int(cells_x), int(cells_y)


@kernel
def map_to_world(
    cell_x: int, cell_y: int, origin_x: float, origin_y: float, resolution: float
) -> Tuple[float, float]:
    """Return the centre (x, y) [m] of a cell."""
    return origin_x + (cell_x + 0.5) * resolution, origin_y + (cell_y + 0.5) * resolution


def truncated_cell(coordinate: float, origin: float, resolution: float) -> int:
    """Return the cell index of a coordinate [m] along one axis, truncated towards zero."""
    return int((coordinate - origin) / resolution)


def clipped_cell(coordinate: float, origin: float, resolution: float, count: int) -> int:
    """Return the cell index of a coordinate [m], clipped to 0 .. count - 1. costmap_2d.cpp:233."""
    if coordinate < origin:
        return 0
    if coordinate >= resolution * count + origin:
        return count - 1
    return truncated_cell(coordinate, origin, resolution)


def cell_distance(distance: float, resolution: float) -> int:
    """Convert a length [m] to whole cells, rounded up and never negative. costmap_2d.cpp:190."""
    return max(0, int(math.ceil(distance / resolution)))


def size_in_meters(count: int, resolution: float) -> float:
    """Return the length [m] of `count` cells as costmap_2d computes it: half a cell short."""
    return (count - 1 + 0.5) * resolution


class Geometry(NamedTuple):
    """Size and place of a costmap, which its layers share."""

    columns: int  # [cells]
    rows: int
    resolution: float  # [m]
    origin: Data  # (2,), lower corner of cell (0, 0) [m], which moves with a rolling costmap
    rolling: bool  # whether the costmap moves with the robot


class Line(NamedTuple):
    """Line of cells between two cells, as base_local_planner/line_iterator.h walks it.

    Walk it with `counter = major // 2`, and after each cell with `counter += minor`: if the counter
    has reached `major`, subtract `major` and step diagonally, otherwise step along the major axis.
    The line in the opposite direction may visit other cells.
    """

    major: int  # number of steps, along the longer axis; with equal lengths along x
    minor: int  # number of diagonal steps among them
    along_x: int  # step along the longer axis [cells]
    along_y: int
    diagonal_x: int  # step along both axes [cells]
    diagonal_y: int


@kernel
def line_between(x0: int, y0: int, x1: int, y1: int) -> Line:
    """Return the line of cells from (x0, y0) to (x1, y1), both included."""
    length_x = abs(x1 - x0)
    length_y = abs(y1 - y0)
    step_x = 1 if x1 >= x0 else -1
    step_y = 1 if y1 >= y0 else -1
    if length_x >= length_y:
        return Line(length_x, length_y, step_x, 0, step_x, step_y)
    return Line(length_y, length_x, 0, step_y, step_x, step_y)


@kernel
def walk_line(x0: int, y0: int, x1: int, y1: int, cells_x: Data, cells_y: Data) -> int:
    """Write the line of cells from (x0, y0) to (x1, y1) into cells_x, cells_y; return its size."""
    line = line_between(x0, y0, x1, y1)
    counter = line.major // 2
    cell_x = x0
    cell_y = y0
    for visited in range(line.major + 1):
        cells_x[visited] = cell_x
        cells_y[visited] = cell_y
        counter += line.minor
        if counter >= line.major:
            counter -= line.major
            cell_x += line.diagonal_x
            cell_y += line.diagonal_y
        else:
            cell_x += line.along_x
            cell_y += line.along_y
    return line.major + 1


def union(a: Rectangle, b: Rectangle) -> Rectangle:
    """Return the smallest rectangle around two windows or bounds."""
    a_left, a_bottom, a_right, a_top = a
    b_left, b_bottom, b_right, b_top = b
    left = min(a_left, b_left)
    bottom = min(a_bottom, b_bottom)
    right = max(a_right, b_right)
    top = max(a_top, b_top)
    return left, bottom, right, top


def roll(
    cells: Data, origin: Data, resolution: float, x: float, y: float, default: int
) -> Tuple[int, int]:
    """Centre `cells` (rows, columns) and `origin` (2,) on x, y [m]; return the shift [cells].

    Cells in the overlap keep their values, the others get `default`. costmap_2d.cpp:260.
    """
    rows, columns = cells.shape
    origin_x, origin_y = origin.tolist()
    corner_x = x - size_in_meters(columns, resolution) / 2
    corner_y = y - size_in_meters(rows, resolution) / 2
    # Truncation towards zero lets the map stand until the robot has moved by a whole cell.
    shift_x = truncated_cell(corner_x, origin_x, resolution)
    shift_y = truncated_cell(corner_y, origin_y, resolution)
    if shift_x != 0 or shift_y != 0:
        # As in C++, the origin accumulates the rounding errors of its steps.
        origin[0] = origin_x + shift_x * resolution
        origin[1] = origin_y + shift_y * resolution
        shift(cells, shift_x, shift_y, default)
    return shift_x, shift_y


def shift(cells: np.ndarray, shift_x: int, shift_y: int, default: int) -> None:
    """Set cells[y, x] = cells[y + shift_y, x + shift_x] in place, `default` off the old grid."""
    rows, columns = cells.shape
    if abs(shift_x) >= columns or abs(shift_y) >= rows:
        cells[:] = default
        return

    # A shift of the flat array takes cells from neighbouring rows, which the default then replaces.
    flat_cells = cells.reshape(-1)
    flat_shift = shift_y * columns + shift_x
    if flat_shift > 0:
        flat_cells[:-flat_shift] = flat_cells[flat_shift:]
    elif flat_shift < 0:
        flat_cells[-flat_shift:] = flat_cells[:flat_shift].copy()

    if shift_y > 0:
        cells[rows - shift_y :] = default
    elif shift_y < 0:
        cells[:-shift_y] = default
    if shift_x > 0:
        cells[:, columns - shift_x :] = default
    elif shift_x < 0:
        cells[:, :-shift_x] = default


@kernel
def merge(
    layer: Data, base: Data, maximum: bool, left: int, bottom: int, right: int, top: int
) -> None:
    """Copy the layer's known cells in the window into `base`.

    If `maximum` is set, they are copied only over lower or unknown values (costmap_layer.cpp).
    Rows are sliced and the inner loops have no branches, so that vector instructions are compiled.
    """
    unknown = np.uint8(UNKNOWN)
    for row in range(bottom, top):
        costs = layer[row, left:right]
        base_costs = base[row, left:right]
        if maximum:
            for index in range(costs.shape[0]):
                cost = costs[index]
                base_cost = base_costs[index]
                # An unknown cell of the layer changes nothing. An unknown cell of the base is lower
                # than any value.
                raises = cost != unknown and (base_cost == unknown or base_cost < cost)
                base_costs[index] = cost if raises else base_cost
        else:
            for index in range(costs.shape[0]):
                base_costs[index] = costs[index] if costs[index] != unknown else base_costs[index]
