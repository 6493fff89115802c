"""Occupancy grid of a world, as a mapping robot would have recorded it for map_server.

The simulated robot on ROS publishes the grid.
"""

from __future__ import annotations

import math
from typing import NamedTuple, Tuple

import numpy as np
from numpy.typing import NDArray

from applr_ros1.common.angles import outside_box
from applr_ros1.common.arrays import Array

from .world import Grid, Point, World

OCCUPIED = 100
MARGIN_M = 2.0  # width of the free margin around obstacles and course [m]


class CellWindow(NamedTuple):
    """Rectangle of a grid's cells around a point.

    Attributes:
        cells: View (ny, nx) of the cells.
        dx: x of their centres relative to the point (1, nx) [m].
        dy: y of their centres relative to the point (ny, 1) [m].
    """

    cells: NDArray[np.int8]
    dx: Array
    dy: Array


def occupancy(world: World, resolution: float) -> Grid:
    """Return the map of a world.

    In a world without a map of its own, a cell is 100 if a static obstacle reaches into its inner
    circle, else 0.

    Args:
        world: World to map.
        resolution: Edge of a cell [m], unless the world has a map of its own.
    """
    if world.map is not None:
        return world.map
    lowest, highest = extent(world)
    # Corners on multiples of the resolution give neighbouring worlds the same grid.
    corner = np.floor((lowest - MARGIN_M) / resolution) * resolution
    side_cells = (highest + MARGIN_M - corner) / resolution
    column_count, row_count = np.ceil(side_cells).astype(int).tolist()
    cells = np.zeros((row_count, column_count), np.int8)
    origin = corner.tolist()

    inner_radius = 0.5 * resolution  # radius of the circle in a cell [m]
    for x, y, radius in world.cylinders.tolist():
        reach = radius + inner_radius
        window = window_of(cells, origin, resolution, (x, y), reach)
        distance = np.hypot(window.dx, window.dy)
        window.cells[distance <= reach] = OCCUPIED

    for x, y, yaw, size_x, size_y in world.boxes.tolist():
        reach = 0.5 * math.hypot(size_x, size_y) + inner_radius
        window = window_of(cells, origin, resolution, (x, y), reach)
        offset_along, offset_across = outside_box(window.dx, window.dy, yaw, size_x, size_y)
        distance = np.hypot(offset_along, offset_across)
        window.cells[distance <= inner_radius] = OCCUPIED
    return Grid(cells, resolution, origin=(origin[0], origin[1], 0.0))


def extent(world: World) -> Tuple[Array, Array]:
    """Return the corners with the lowest and highest x, y (2,) [m] around obstacles and course."""
    # A turned box reaches from its centre as far as half its bounding box along x and y.
    x, y, yaw, size_x, size_y = world.boxes.T
    cosine = np.abs(np.cos(yaw))
    sine = np.abs(np.sin(yaw))
    half_x = 0.5 * (cosine * size_x + sine * size_y)
    half_y = 0.5 * (sine * size_x + cosine * size_y)
    box_centres = np.column_stack([x, y])
    box_reach = np.column_stack([half_x, half_y])

    cylinder_centres = world.cylinders[:, :2]
    cylinder_reach = world.cylinders[:, 2:]
    course_ends = np.array([world.course.start[:2], world.course.goal[:2]])

    lowest = np.vstack([cylinder_centres - cylinder_reach, box_centres - box_reach, course_ends])
    highest = np.vstack([cylinder_centres + cylinder_reach, box_centres + box_reach, course_ends])
    return lowest.min(axis=0), highest.max(axis=0)


def window_of(
    cells: NDArray[np.int8], origin: Point, resolution: float, centre: Point, reach: float
) -> CellWindow:
    """Return the cells within `reach` [m] of a point (x, y) [m] along both axes.

    Args:
        cells: Cells (ny, nx) of the grid.
        origin: Corner of the grid with the lowest x and y [m].
        resolution: Edge of a cell [m].
        centre: Point around which the window lies [m].
        reach: Half the side of the window [m].
    """
    x, y = centre
    row_count, column_count = cells.shape
    columns, dx = _along_axis(origin[0], x, reach, resolution, column_count)
    rows, dy = _along_axis(origin[1], y, reach, resolution, row_count)
    # Slices make a view, in which the caller marks cells.
    return CellWindow(
        cells=cells[rows, columns],
        dx=dx[np.newaxis, :],
        dy=dy[:, np.newaxis],
    )


def _along_axis(
    grid_edge: float, coordinate: float, reach: float, resolution: float, cell_count: int
) -> Tuple[slice, Array]:
    """Return the cells of one axis within `reach` [m] of a coordinate [m].

    The second result has the distances of their centres from the coordinate [m], with their signs.
    """
    first_cell = int((coordinate - reach - grid_edge) / resolution)
    last_cell = int((coordinate + reach - grid_edge) / resolution)
    first_cell = max(0, first_cell)
    end_cell = min(cell_count, last_cell + 1)

    cell_numbers = np.arange(first_cell, end_cell, dtype=np.float64)
    cell_centres = grid_edge + (cell_numbers + 0.5) * resolution
    return slice(first_cell, end_cell), cell_centres - coordinate
