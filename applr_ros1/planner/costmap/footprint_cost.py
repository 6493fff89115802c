"""Fast footprint cost for the many poses of one control cycle, from precomputed lines of cells.

Called by the local planners. Costs are equal to those of costmap/footprint.footprint_cost.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from applr_ros1.common.arrays import Data
from applr_ros1.common.kernels import kernel
from applr_ros1.planner.costmap.footprint import line_cost, vertex_at
from applr_ros1.planner.costmap.grid import INSCRIBED, LETHAL, walk_line, world_to_map

UNSURE = 300  # cost of an outline with a vertex whose cell is decided by rounding
NO_MARGIN = 0.0  # margin of outline_cost for exact poses, which are never UNSURE [cells]
LONGEST_TABLE = 64  # longest edge in the table [cells]; longer edges are walked cell by cell


class Outline(NamedTuple):
    """Footprint and map in the form in which outline_cost reads them."""

    cells: Data  # (rows, columns) uint8
    flat: Data  # the same cells (rows columns,)
    origin_x: float  # [m]
    origin_y: float
    resolution: float  # [m]
    footprint: Data  # (n, 2) [m]
    lines: Data  # table of line_offsets


def line_offsets(footprint: np.ndarray, resolution: float, columns: int) -> np.ndarray:
    """Return all lines of cells that an edge of the footprint (n, 2) [m] can cover on a map.

    The map is `columns` cells wide. The table is (2 r + 1, 2 r + 1, r + 1) int32, with r the
    longest edge + 2 [cells], at most LONGEST_TABLE. Row [dy + r, dx + r] describes the line to the
    cell (dx, dy) away: flat offsets of its cells from its first cell.
    """
    longest_edge = 0.0
    if len(footprint):
        edges = footprint - np.roll(footprint, -1, axis=0)
        longest_edge = float(np.max(np.hypot(edges[:, 0], edges[:, 1])))
    # Rounding both ends to cells may lengthen an edge by up to two cells.
    reach = int(min(longest_edge / resolution + 2, LONGEST_TABLE))
    side = 2 * reach + 1
    table = np.zeros((side, side, reach + 1), np.int32)
    _fill_offsets(table, reach, columns)
    return table


@kernel
def _fill_offsets(table: Data, reach: int, columns: int) -> None:
    line_x = np.zeros(reach + 1, np.int64)
    line_y = np.zeros(reach + 1, np.int64)
    for offset_y in range(-reach, reach + 1):
        for offset_x in range(-reach, reach + 1):
            for visited in range(walk_line(0, 0, offset_x, offset_y, line_x, line_y)):
                table[offset_y + reach, offset_x + reach, visited] = (
                    line_y[visited] * columns + line_x[visited]
                )


@kernel
def on_border(coordinate: float, margin: float) -> bool:
    """Return whether a coordinate [cells] lies within `margin` [cells] of a border of two cells."""
    return abs(coordinate - math.floor(coordinate + 0.5)) < margin


@kernel
def outline_of(scene: Any, footprint: Data) -> Outline:
    """Bundle a footprint (n, 2) [m] and the scene's map, which saves time for each pose."""
    cells = scene.cells
    flat_cells = cells.reshape(cells.shape[0] * cells.shape[1])
    return Outline(cells, flat_cells, scene.ox, scene.oy, scene.resolution, footprint, scene.lines)


@kernel
def outline_cost(
    outline: Outline,
    x: float,
    y: float,
    cos_yaw: float,
    sin_yaw: float,
    centre_x: int,
    centre_y: int,
    margin: float,
) -> int:
    """Return the largest cost under the footprint's outline at x, y [m] and a heading.

    Returns -1 if the pose is illegal, and UNSURE if a vertex is within `margin` cells of a cell
    border. Costs of legal poses equal those of footprint.footprint_cost. With fewer than three
    vertices, only the centre's cell (centre_x, centre_y) is tested.
    """
    cells, flat_cells, origin_x, origin_y, resolution, footprint, lines = outline
    rows, columns = cells.shape
    vertex_count = footprint.shape[0]
    if vertex_count < 3:
        cost = int(cells[centre_y, centre_x])
        return cost if cost < INSCRIBED else -1

    # Stop at the first illegal edge: most illegal poses need only a part of the outline.
    reach = lines.shape[2] - 1
    largest_cost = np.uint8(0)
    first_x = first_y = start_x = start_y = 0
    for corner in range(vertex_count + 1):
        # The last edge returns to the first vertex, whose cell is known.
        end_x = first_x
        end_y = first_y
        if corner < vertex_count:
            vertex_x, vertex_y = vertex_at(footprint, corner, x, y, cos_yaw, sin_yaw)
            # Closed forms of a trajectory differ from C++'s sums in their last bits.
            if margin > 0.0 and (
                on_border((vertex_x - origin_x) / resolution, margin)
                or on_border((vertex_y - origin_y) / resolution, margin)
            ):
                return UNSURE
            end_x, end_y = world_to_map(
                vertex_x, vertex_y, origin_x, origin_y, resolution, columns, rows
            )
            if end_x < 0:
                return -1
        if corner == 0:
            first_x = end_x
            first_y = end_y
        else:
            offset_x = end_x - start_x
            offset_y = end_y - start_y
            step_count = max(abs(offset_x), abs(offset_y))
            if step_count <= reach:
                start_cell = start_y * columns + start_x
                # Unsigned indices spare numba the wrap-around of negative ones.
                table_row = np.uintp(offset_y + reach)
                table_column = np.uintp(offset_x + reach)
                for visited in range(step_count + 1):
                    cell = np.uintp(start_cell + lines[table_row, table_column, np.uintp(visited)])
                    largest_cost = max(largest_cost, flat_cells[cell])
            else:
                cost = line_cost(cells, start_x, start_y, end_x, end_y)
                largest_cost = max(largest_cost, np.uint8(cost if cost >= 0 else LETHAL))
            if largest_cost >= LETHAL:
                return -1
        start_x = end_x
        start_y = end_y
    return int(largest_cost)
