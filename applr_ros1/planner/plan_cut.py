"""Cropping of the global plan to the surroundings of the robot, and pruning of the points behind it.

Called by both local planners. The rules are those of base_local_planner/goal_functions.cpp:77, 96.
"""

from __future__ import annotations

import math
from typing import Any, Optional, Tuple

import numpy as np

from applr_ros1.common.angles import Pose, inverse, transform_point
from applr_ros1.common.arrays import Data
from applr_ros1.common.kernels import kernel

NEAR = 1.0  # smallest distance from the robot at which a leading point is pruned [m]


def half_size(costmap: Any) -> float:
    """Return half of the longer side of the map [m]."""
    ny, nx = costmap.cells.shape
    return float(max(nx * costmap.resolution / 2.0, ny * costmap.resolution / 2.0))


def cut_plan(
    plan: np.ndarray,
    x: float,
    y: float,
    limit: float,
    prune: bool,
    local_origin: Optional[Pose] = None,
) -> Tuple[np.ndarray, int]:
    """Return the part (k, 3) of the plan that the robot follows, in the costmap's frame, and how many points to prune.

    The part reaches from the first point within `limit` [m] up to and including the first point beyond `limit`.

    Args:
        plan: poses (n, 3).
        x: x coordinate of the robot in the costmap's frame [m].
        y: y coordinate of the robot in the costmap's frame [m].
        limit: radius around the robot [m].
        prune: whether to drop leading points at a distance of at least NEAR. As in C++, the caller removes as many from
            the front of the stored plan. If the cut begins later in the plan, these are other points.
        local_origin: pose (x, y, yaw) of the costmap's frame in the plan's frame, None if the frames are the same.
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
def within(plan: Data, x: float, y: float, limit: float) -> Tuple[int, int]:
    """Return (first, last): plan[first:last] reaches from the first point within `limit` to the first one beyond."""
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
def leading_far(plan: Data, x: float, y: float) -> int:
    """Count the leading points at a distance of at least NEAR."""
    far = 0
    while far < plan.shape[0] and _squared_distance(plan, far, x, y) >= NEAR * NEAR:
        far += 1
    return far


@kernel
def _squared_distance(plan: Data, i: int, x: float, y: float) -> float:
    dx: float = x - plan[i, 0]
    dy: float = y - plan[i, 1]
    return dx * dx + dy * dy


def transformed(poses: np.ndarray, local_origin: Optional[Pose]) -> np.ndarray:
    """Return the poses (n, 3), transformed by local_origin if any. Angles pass through quaternions, as in tf."""
    moved = poses.copy()
    if local_origin is not None:
        moved[:, 0], moved[:, 1] = transform_point(local_origin, poses[:, 0], poses[:, 1])
    _through_matrix(moved[:, 2], 0.0 if local_origin is None else local_origin[2])
    return moved


@kernel
def _through_matrix(yaws: Data, turn: float) -> None:
    """Rotate the angles (n,) in place as tf does: quaternion, matrix, quaternion."""
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
