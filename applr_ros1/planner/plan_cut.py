"""Cropping of the global plan to the robot's surroundings, and pruning of the points behind it.

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
    rows, columns = costmap.cells.shape
    # As in C++, each side is halved before the comparison.
    half_width = columns * costmap.resolution / 2.0
    half_height = rows * costmap.resolution / 2.0
    return float(max(half_width, half_height))


def cut_plan(
    plan: np.ndarray,
    x: float,
    y: float,
    limit: float,
    prune: bool,
    local_origin: Optional[Pose] = None,
) -> Tuple[np.ndarray, int]:
    """Return the part (k, 3) of the plan that the robot follows, and how many points to prune.

    The part is in the costmap's frame. It reaches from the first point within `limit` [m] up to and
    including the first point beyond `limit`.

    Args:
        plan: poses (n, 3).
        x: x coordinate of the robot in the costmap's frame [m].
        y: y coordinate of the robot in the costmap's frame [m].
        limit: radius around the robot [m].
        prune: whether to drop leading points at a distance of at least NEAR. As in C++, the caller
            removes as many from the front of the stored plan. If the cut begins later in the plan,
            these are other points.
        local_origin: pose (x, y, yaw) of the costmap's frame in the plan's frame, None if the
            frames are the same.
    """
    if local_origin is None:
        first_point, end_point = within(plan, x, y, limit)
        plan_part = plan[first_point:end_point]
    else:
        plan_x, plan_y = transform_point(local_origin, x, y)
        first_point, end_point = within(plan, plan_x, plan_y, limit)
        plan_part = transformed(plan[first_point:end_point], inverse(local_origin))
    dropped_count = 0
    if prune:
        dropped_count = leading_far(plan_part, x, y)
    return plan_part[dropped_count:].copy(), dropped_count


@kernel
def within(plan: Data, x: float, y: float, limit: float) -> Tuple[int, int]:
    """Return (first_point, end_point) of the part of the plan near x, y.

    The part begins with the first point within `limit` [m] and ends with the first later point
    beyond the limit: plan[first_point:end_point].
    """
    point_count = plan.shape[0]
    squared_limit = limit * limit
    first_point = 0
    while first_point < point_count and _squared_distance(plan, first_point, x, y) > squared_limit:
        first_point += 1
    end_point = first_point
    while end_point < point_count:
        end_point += 1
        if _squared_distance(plan, end_point - 1, x, y) > squared_limit:
            break
    return first_point, end_point


@kernel
def leading_far(plan: Data, x: float, y: float) -> int:
    """Count the leading points at a distance of at least NEAR."""
    far_count = 0
    while far_count < plan.shape[0] and _squared_distance(plan, far_count, x, y) >= NEAR * NEAR:
        far_count += 1
    return far_count


@kernel
def _squared_distance(plan: Data, index: int, x: float, y: float) -> float:
    offset_x: float = x - plan[index, 0]
    offset_y: float = y - plan[index, 1]
    return offset_x * offset_x + offset_y * offset_y


def transformed(poses: np.ndarray, local_origin: Optional[Pose]) -> np.ndarray:
    """Return the poses (n, 3), transformed by local_origin if any.

    Angles pass through quaternions, as in tf.
    """
    moved_poses = poses.copy()
    x, y, yaw = moved_poses.T  # views, which are changed in place
    turn = 0.0
    if local_origin is not None:
        x[:], y[:] = transform_point(local_origin, x, y)
        turn = local_origin[2]
    _through_matrix(yaw, turn)
    return moved_poses


@kernel
def _through_matrix(yaws: Data, turn: float) -> None:
    """Rotate the angles (n,) in place as tf does: quaternion, matrix, quaternion.

    All rotations are about z, so a quaternion is (0, 0, z, w).
    """
    for index in range(yaws.shape[0]):
        z = math.sin(yaws[index] / 2)
        w = math.cos(yaws[index] / 2)
        if turn != 0.0:
            turn_z = math.sin(turn / 2)
            turn_w = math.cos(turn / 2)
            product_z = turn_w * z + turn_z * w
            w = turn_w * w - turn_z * z
            z = product_z

        # Matrix3x3::setRotation: the elements m10 = -m01, and m00 = m11.
        scale = 2 / (z * z + w * w)
        m10 = w * (z * scale)
        m00 = 1 - z * (z * scale)

        # Matrix3x3::getRotation: by the trace, or by its largest element if that is m22.
        trace = m00 + m00 + 1.0
        if trace > 0:
            root = math.sqrt(trace + 1.0)
            w = root / 2
            z = (m10 + m10) * (0.5 / root)
        else:
            root = math.sqrt(1.0 - m00 - m00 + 1.0)
            z = root / 2
            w = (m10 + m10) * (0.5 / root)
        yaws[index] = math.atan2(2 * (w * z), w * w - z * z)
