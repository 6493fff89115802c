"""The part of the global plan that lies around the robot, and what of its beginning is behind.

Called by both local planners. Rules: base_local_planner/goal_functions.cpp:77, 96.
"""

from __future__ import annotations

import math
from typing import Any, Optional, Tuple

import numpy as np

from applr_ros1.common.angles import Pose, inverse, transform_point
from applr_ros1.common.kernels import kernel

NEAR = 1.0  # [m]: leading points of the plan that are not nearer than this are dropped


def half_size(costmap: Any) -> float:
    """The larger half [m] of the map's two sides."""
    ny, nx = costmap.cells.shape
    return max(nx * costmap.resolution / 2.0, ny * costmap.resolution / 2.0)


def cut_plan(
    plan: np.ndarray, x: float, y: float, limit: float, prune: bool, local_origin: Optional[Pose] = None
) -> Tuple[np.ndarray, int]:
    """(cut (k, 3), dropped): the part of `plan` (n, 3) that a robot at x, y [m] follows, in the costmap's frame.

    From the first point within `limit` [m] on, up to and including the first one beyond it. Pruned: without the
    leading points that are NEAR or farther away; that many (`dropped`) are also to go from the front of the stored
    plan, even where the cut begins later. local_origin: pose (x, y, yaw) of the costmap's frame in the plan's,
    None if they are one.
    """
    if local_origin is None:
        first, last = within(plan, x, y, limit)
        cut = plan[first:last]
    else:
        first, last = within(plan, *transform_point(local_origin, x, y), limit)
        cut = transformed(plan[first:last], inverse(local_origin))
    dropped = leading_far(cut, x, y) if prune else 0
    return cut[dropped:].copy(), dropped


@kernel
def within(plan, x, y, limit):
    """(first, last) of the points that are kept: plan[first:last]."""
    n = plan.shape[0]
    first = 0
    while first < n and _squared_distance(plan, first, x, y) > limit * limit:
        first += 1
    last = first
    while last < n:
        last += 1
        if _squared_distance(plan, last - 1, x, y) > limit * limit:
            break
    return first, last


@kernel
def leading_far(plan, x, y):
    """Count the first points that are NEAR or farther away."""
    far = 0
    while far < plan.shape[0] and _squared_distance(plan, far, x, y) >= NEAR * NEAR:
        far += 1
    return far


@kernel
def _squared_distance(plan, i, x, y):
    dx = x - plan[i, 0]
    dy = y - plan[i, 1]
    return dx * dx + dy * dy


def transformed(poses: np.ndarray, local_origin: Optional[Pose]) -> np.ndarray:
    """The poses (n, 3) as they are, or moved by a pose; their angles go through quaternions and a matrix."""
    moved = poses.copy()
    if local_origin is not None:
        moved[:, 0], moved[:, 1] = transform_point(local_origin, poses[:, 0], poses[:, 1])
    _through_matrix(moved[:, 2], 0.0 if local_origin is None else local_origin[2])
    return moved


@kernel
def _through_matrix(yaws, turn):
    """Turn the angles (n,) in place, on the way that tf takes: quaternion, matrix, quaternion."""
    for i in range(yaws.shape[0]):
        z = math.sin(yaws[i] / 2)
        w = math.cos(yaws[i] / 2)
        if turn != 0.0:
            tz = math.sin(turn / 2)
            tw = math.cos(turn / 2)
            z, w = tw * z + tz * w, tw * w - tz * z
        scale = 2 / (z * z + w * w)
        a = w * (z * scale)
        m = 1 - z * (z * scale)
        trace = m + m + 1.0
        if trace > 0:
            r = math.sqrt(trace + 1.0)
            w = r / 2
        else:
            r = math.sqrt(1.0 - m - m + 1.0)
        back = (a + a) * (0.5 / r)
        if trace > 0:
            z = back
        else:
            z, w = r / 2, back
        yaws[i] = math.atan2(2 * (w * z), w * w - z * z)
