"""Distances of points, and lengths along paths, which are lines through points (n, 2) x, y [m]."""

from __future__ import annotations

import numpy as np

from applr_ros1.common.arrays import Array


def distances(points: Array, others: Array) -> Array:
    """Return the distances [m] of points (..., 2) from other points, whose shapes broadcast."""
    offsets = points - others
    return np.hypot(offsets[..., 0], offsets[..., 1])


def step_lengths(points: Array) -> Array:
    """Return the distances (n - 1,) [m] from each of the points (n, 2) to the next one."""
    return distances(points[1:], points[:-1])


def travelled(points: Array) -> Array:
    """Return the way (n,) [m] along a path from its first point to each of its points (n, 2)."""
    return np.concatenate([[0.0], np.cumsum(step_lengths(points))])


def points_at(points: Array, ways: Array) -> Array:
    """Return the points (k, 2) of a path through points (n, 2) after these ways (k,) [m].

    Ways beyond the end of the path give its last point.
    """
    point_ways = travelled(points)
    x = np.interp(ways, point_ways, points[:, 0])
    y = np.interp(ways, point_ways, points[:, 1])
    return np.column_stack([x, y])
