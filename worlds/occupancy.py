"""Occupancy grid of a world, as a mapping robot would have recorded it for map_server.

The simulated robot on ROS publishes the grid.
"""

from __future__ import annotations

import math
from typing import Tuple

import numpy as np

from applr_ros1.common.angles import outside_box

from .world import Grid, World

OCCUPIED = 100
MARGIN_M = 2.0  # width of the free margin around obstacles and course [m]


def occupancy(world: World, resolution: float) -> Grid:
    """Return the map of a world. By default, a cell is 100 if a static obstacle reaches into its inner circle, else 0.

    Args:
        world: World to map.
        resolution: Edge of a cell [m], unless the world has a map of its own.
    """
    if world.map is not None:
        return world.map
    boxes, c, s = world.boxes, np.abs(np.cos(world.boxes[:, 2])), np.abs(np.sin(world.boxes[:, 2]))
    half = 0.5 * np.stack([c * boxes[:, 3] + s * boxes[:, 4], s * boxes[:, 3] + c * boxes[:, 4]], axis=1)
    reach = np.concatenate([np.repeat(world.cylinders[:, 2:], 2, axis=1), half])
    centres = np.concatenate([world.cylinders[:, :2], boxes[:, :2]])
    course = np.array([world.course.start[:2], world.course.goal[:2]])
    low = np.vstack([centres - reach, course]).min(axis=0) - MARGIN_M
    high = np.vstack([centres + reach, course]).max(axis=0) + MARGIN_M
    low = np.floor(low / resolution) * resolution
    nx, ny = (int(math.ceil(side / resolution)) for side in high - low)
    cells = np.zeros((ny, nx), np.int8)
    inner = 0.5 * resolution
    for x, y, radius in world.cylinders.tolist():
        block, dx, dy = _window(cells, low, resolution, x, y, radius + inner)
        block[np.hypot(dx, dy) <= radius + inner] = OCCUPIED
    for x, y, yaw, size_x, size_y in boxes.tolist():
        block, dx, dy = _window(cells, low, resolution, x, y, 0.5 * math.hypot(size_x, size_y) + inner)
        block[np.hypot(*outside_box(dx, dy, yaw, size_x, size_y)) <= inner] = OCCUPIED
    return Grid(cells, resolution, (float(low[0]), float(low[1]), 0.0))


def _window(
    cells: np.ndarray, low: np.ndarray, resolution: float, x: float, y: float, reach: float
) -> Tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the cells within `reach` of (x, y) along both axes, and dx (1, n), dy (m, 1) of their centres."""
    ny, nx = cells.shape
    first = [max(0, int((v - reach - o) / resolution)) for v, o in zip((x, y), low)]
    last = [min(n, int((v + reach - o) / resolution) + 1) for v, o, n in zip((x, y), low, (nx, ny))]
    columns = low[0] + (np.arange(first[0], last[0]) + 0.5) * resolution
    rows = low[1] + (np.arange(first[1], last[1]) + 0.5) * resolution
    return cells[first[1] : last[1], first[0] : last[0]], columns[None, :] - x, rows[:, None] - y
