"""Fast footprint cost for the many poses of one control cycle, from precomputed lines of cells.

Called by the local planners. Costs are equal to those of costmap/footprint.footprint_cost.
"""

from __future__ import annotations

import math
from typing import Any, Tuple

import numpy as np

from applr_ros1.common.arrays import Data
from applr_ros1.common.kernels import kernel
from applr_ros1.planner.costmap.footprint import line_cost
from applr_ros1.planner.costmap.grid import INSCRIBED, LETHAL, walk_line, world_to_map

UNSURE = 300  # cost of an outline with a vertex so close to a cell border that rounding decides its cell
Outline = Tuple[Data, Data, float, float, float, Data, Data]  # see outline_of
LONGEST_TABLE = 64  # longest footprint edge in the table [cells]; longer edges are walked cell by cell


def line_offsets(footprint: np.ndarray, resolution: float, nx: int) -> np.ndarray:
    """Return all lines of cells that an edge of the footprint (n, 2) [m] can cover on a map nx cells wide.

    The table is (2 r + 1, 2 r + 1, r + 1) int32, with r the longest edge + 2 [cells], at most LONGEST_TABLE. Row
    [dy + r, dx + r] describes the line to the cell (dx, dy) away: flat offsets of its cells from its first cell.
    """
    edges = footprint - np.roll(footprint, -1, axis=0)
    longest = float(np.max(np.hypot(edges[:, 0], edges[:, 1]))) if len(footprint) else 0.0
    r = int(min(longest / resolution + 2, LONGEST_TABLE))
    table = np.zeros((2 * r + 1, 2 * r + 1, r + 1), np.int32)
    _fill_offsets(table, r, nx)
    return table


@kernel
def _fill_offsets(table: Data, r: int, nx: int) -> None:
    xs = np.zeros(r + 1, np.int64)
    ys = np.zeros(r + 1, np.int64)
    for dy in range(-r, r + 1):
        for dx in range(-r, r + 1):
            for i in range(walk_line(0, 0, dx, dy, xs, ys)):
                table[dy + r, dx + r, i] = ys[i] * nx + xs[i]


@kernel
def on_border(f: float, margin: float) -> bool:
    """Return True if the cell coordinate f lies within `margin` cells of a border between two cells."""
    return abs(f - math.floor(f + 0.5)) < margin


@kernel
def outline_of(scene: Any, footprint: Data) -> Outline:
    """Bundle a footprint (n, 2) [m] and the scene's map for outline_cost, which saves time for each pose."""
    cells = scene.cells
    flat = cells.reshape(cells.shape[0] * cells.shape[1])
    return cells, flat, scene.ox, scene.oy, scene.resolution, footprint, scene.lines


@kernel
def outline_cost(outline: Outline, x: float, y: float, c: float, s: float, cx: int, cy: int, margin: float) -> int:
    """Return the largest cost under the footprint's outline at x, y and heading (cosine c, sine s); -1 if illegal.

    Returns UNSURE if a vertex is within `margin` cells of a cell border. Costs of legal poses equal those of
    footprint.footprint_cost. With fewer than three vertices, only the centre's cell (cx, cy) is tested.
    """
    cells, flat, ox, oy, resolution, footprint, lines = outline
    ny, nx = cells.shape
    n = footprint.shape[0]
    if n < 3:
        return int(cells[cy, cx]) if cells[cy, cx] < INSCRIBED else -1
    r = lines.shape[2] - 1
    worst = np.uint8(0)
    first_x = first_y = x0 = y0 = 0
    for i in range(n + 1):
        x1, y1 = first_x, first_y
        if i < n:
            wx = x + (footprint[i, 0] * c - footprint[i, 1] * s)
            wy = y + (footprint[i, 0] * s + footprint[i, 1] * c)
            if margin > 0.0 and (
                on_border((wx - ox) / resolution, margin) or on_border((wy - oy) / resolution, margin)
            ):
                return UNSURE
            x1, y1 = world_to_map(wx, wy, ox, oy, resolution, nx, ny)
            if x1 < 0:
                return -1
        if i == 0:
            first_x, first_y = x1, y1
        else:
            dx = x1 - x0
            dy = y1 - y0
            major = max(abs(dx), abs(dy))
            if major <= r:
                k = y0 * nx + x0
                row = np.uintp(dy + r)
                column = np.uintp(dx + r)
                for j in range(major + 1):
                    worst = max(worst, flat[np.uintp(k + lines[row, column, np.uintp(j)])])
            else:
                cost = line_cost(cells, x0, y0, x1, y1)
                worst = max(worst, np.uint8(cost if cost >= 0 else LETHAL))
            if worst >= LETHAL:
                return -1
        x0, y0 = x1, y1
    return int(worst)
