"""Small random scenes for the tests of maps: cellular worlds, a plain laser, drives, a static map.

Used by the tests of the planner.
"""

import math
from types import SimpleNamespace

import numpy as np

from applr_ros1.planner.costmap import footprint as footprints
from applr_ros1.planner.costmap.scan import LaserScan
from applr_ros1.planner.costmap.static_layer import StaticMap

JACKAL = footprints.pad(footprints.parse("[[-0.21,-0.165],[-0.21,0.165],[0.21,0.165],[0.21,-0.165]]"), 0.1)


def cellular(rng, ny, nx, fill, steps=3):
    """(ny, nx) bool: a cellular automaton's obstacles, like BARN's, from `fill` of random cells."""
    grid = rng.random((ny, nx)) < fill
    for _ in range(steps):
        around = sum(
            np.roll(np.roll(grid, dy, 0), dx, 1).astype(int) for dy in (-1, 0, 1) for dx in (-1, 0, 1) if dx or dy
        )
        grid = np.where(around >= 5, True, np.where(around <= 1, False, grid))
    return grid


def cylinders(rng, size=4.0, fill=0.3, radius=0.075):
    """(n, 3) x, y, radius [m] of the cylinders in a square of `size` [m] about the origin."""
    n = int(size / (2 * radius))
    ys, xs = np.nonzero(cellular(rng, n, n, fill))
    return np.stack(
        ((xs + 0.5) * 2 * radius - size / 2, (ys + 0.5) * 2 * radius - size / 2, np.full(len(xs), radius)), axis=1
    )


def laser(circles, pose, rng, beams=180, height=0.0):
    """LaserScan over 270 degrees among circles (n, 3) from the pose (x, y, yaw); 1 mm noise, +inf for no return."""
    x, y, yaw = pose
    increment = 1.5 * math.pi / (beams - 1)
    angles = yaw - 0.75 * math.pi + increment * np.arange(beams)
    ranges = np.full(beams, np.inf)
    if len(circles):
        dx, dy = circles[:, 0] - x, circles[:, 1] - y
        along = np.cos(angles)[:, None] * dx + np.sin(angles)[:, None] * dy
        across = dx * dx + dy * dy - along * along
        half = circles[:, 2] ** 2 - across
        hit = np.where((half >= 0) & (along > 0), along - np.sqrt(np.maximum(half, 0)), np.inf)
        ranges = hit.min(axis=1)
    ranges = np.where(ranges > 30, np.inf, ranges + rng.normal(0, 0.001, beams)).astype(np.float32)
    return LaserScan(0.0, -0.75 * math.pi, increment, 0.1, 30.0, ranges, (x, y, yaw), height)


def drive(rng, updates, start=(0.0, 0.0, 0.0), step=0.08):
    """A list of poses (x, y, yaw): a random drive."""
    x, y, yaw = start
    poses, w = [], 0.0
    for _ in range(updates):
        w = 0.8 * w + 0.1 * rng.normal()
        yaw += w
        v = step * rng.random()
        x, y = x + v * math.cos(yaw), y + v * math.sin(yaw)
        poses.append((x, y, yaw))
    return poses


def open_map(nx=200, ny=200, resolution=0.05, origin=(-5.0, -5.0), foot=JACKAL):
    """What a local planner takes for a costmap, with nothing in it."""
    cells = np.zeros((ny, nx), np.uint8)
    return SimpleNamespace(cells=cells, origin=origin, resolution=resolution, footprint=foot)


def straight(length=3.0, yaw=0.0, step=0.05):
    """A plan (n, 3) along x from 0 to `length` that ends with the heading `yaw`."""
    x = np.arange(0.0, length + step / 2, step)
    plan = np.column_stack([x, 0 * x, 0 * x])
    plan[-1, 2] = yaw
    return plan


def wall_with_a_door():
    """10 x 6 m: a wall across at x = 2 m with a door of 1.2 m at y = 1.5 m, and unknown space far off."""
    cells = np.zeros((120, 200), np.int8)
    cells[:, 100:103] = 100
    cells[78:102, 100:103] = 0
    cells[:10] = -1
    return StaticMap(cells, 0.05, (-3.0, -3.0), "map")
