"""Occupancy grid of a world, as a mapping robot would have recorded it for map_server.

The simulated robot on ROS publishes the grid.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Tuple

import numpy as np

from applr_ros1.common.arrays import Array

from .world import Grid, World, clearance

OCCUPIED = 100
MARGIN_M = 2.0  # width of the free margin around obstacles and course [m]
BLOCKS = 50  # number of parts of a map whose cells are compared with the obstacles at once


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
    origin_x, origin_y = corner.tolist()
    x = origin_x + (np.arange(column_count) + 0.5) * resolution
    y = origin_y + (np.arange(row_count) + 0.5) * resolution
    centres = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)

    # Block by block, because the distances of all cells from all cylinders would take gigabytes.
    # Farther cylinders than these occupy no cell of a block.
    _, cylinder_y, radius = world.cylinders.T
    reach = radius + resolution
    distances = []
    for block in np.array_split(centres, min(BLOCKS, len(centres))):
        _, cell_y = block.T
        is_near = (cylinder_y + reach >= cell_y.min()) & (cylinder_y - reach <= cell_y.max())
        near_world = replace(world, cylinders=world.cylinders[is_near])
        distances.append(clearance(near_world, block))
    is_occupied = np.concatenate(distances) <= 0.5 * resolution
    cells = np.where(is_occupied, OCCUPIED, 0).astype(np.int8)
    return Grid(cells.reshape(row_count, column_count), resolution, (origin_x, origin_y, 0.0))


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
