"""Angles [rad], planar poses (x, y, yaw) [m, m, rad], twists, and boxes in the plane.

Compiled kernels have formulas of their own: for example, planner/trajectory/sampling.py matches C++
bit for bit.
"""

from __future__ import annotations

import math
from typing import Any, Tuple

import numpy as np

from applr_ros1.common.arrays import Array

Quaternion = Tuple[float, float, float, float]  # x, y, z, w
Pose = Tuple[float, float, float]
# Velocity of a base, measured or commanded: forward v [m/s] and turn rate w [rad/s]
Twist = Tuple[float, float]


def normalize_angle(angle: float) -> float:
    """Wrap an angle to [-pi, pi] without rounding errors."""
    return math.remainder(angle, 2.0 * math.pi)


def normalize_angle_modulo(angle: Any) -> Any:
    """Wrap an angle, or an array of angles, to [-pi, pi).

    The simulators depend on how this formula rounds.
    """
    return (angle + math.pi) % (2 * math.pi) - math.pi


def yaw_of(q: Any) -> float:
    """Return the yaw in [-pi, pi] of a quaternion with x, y, z, w of any length except 0.

    The formula is that of tf2's getYaw (tf2/impl/utils.h).
    """
    sine = 2.0 * (q.x * q.y + q.w * q.z)
    cosine = q.w * q.w + q.x * q.x - q.y * q.y - q.z * q.z
    return math.atan2(sine, cosine)


def yaws_of(quaternions: Any) -> Any:
    """Return the yaws (n,) of quaternions (n, 4) x, y, z, w, as yaw_of()."""
    x, y, z, w = np.transpose(quaternions)
    return np.arctan2(2.0 * (x * y + w * z), w * w + x * x - y * y - z * z)


def quaternion_of(yaw: float) -> Quaternion:
    """Return the unit quaternion (x, y, z, w) of a rotation about z."""
    half_yaw = 0.5 * yaw
    return 0.0, 0.0, math.sin(half_yaw), math.cos(half_yaw)


def transform_point(pose: Pose, x: Any, y: Any) -> Tuple[Any, Any]:
    """Transform the point (x, y) [m] from the frame at `pose` to the parent frame of `pose`.

    x and y may be arrays of equal shapes.
    """
    origin_x, origin_y, yaw = pose
    cosine = math.cos(yaw)
    sine = math.sin(yaw)
    parent_x = origin_x + cosine * x - sine * y
    parent_y = origin_y + sine * x + cosine * y
    return parent_x, parent_y


def transform_motions(pose: Pose, motions: Array) -> Array:
    """Transform points that move from the frame at `pose` to its parent frame, which stands still.

    motions: (n, 4) x, y [m], vx, vy [m/s].
    """
    x, y, vx, vy = motions.T
    moved_x, moved_y = transform_point(pose, x, y)
    # Velocities are only rotated.
    _, _, yaw = pose
    moved_vx, moved_vy = transform_point((0.0, 0.0, yaw), vx, vy)
    return np.column_stack([moved_x, moved_y, moved_vx, moved_vy])


def compose(a: Pose, b: Pose) -> Pose:
    """Transform the pose b from the frame at a to the parent frame of a."""
    b_x, b_y, b_yaw = b
    x, y = transform_point(a, b_x, b_y)
    return x, y, normalize_angle(a[2] + b_yaw)


def inverse(pose: Pose) -> Pose:
    """Return the inverse of a pose: the pose of the parent frame in the frame at `pose`."""
    x, y, yaw = pose
    cosine = math.cos(yaw)
    sine = math.sin(yaw)
    inverse_x = -x * cosine - y * sine
    inverse_y = x * sine - y * cosine
    return inverse_x, inverse_y, -yaw


def outside_box(dx: Any, dy: Any, yaw: float, size_x: float, size_y: float) -> Tuple[Any, Any]:
    """Return the offsets [m] of points from the nearest point of a box, along the box's axes.

    Both offsets of a point inside the box are zero.

    Args:
        dx: x of the points relative to the box's centre, in the world frame [m]; broadcasts with
            dy.
        dy: y of the points relative to the box's centre [m].
        yaw: Direction of the box's first axis [rad].
        size_x: Length of the box along its first axis [m].
        size_y: Length of the box along its second axis [m].
    """
    cosine = math.cos(yaw)
    sine = math.sin(yaw)
    x_in_box = cosine * dx + sine * dy
    y_in_box = cosine * dy - sine * dx
    offset_along = _beyond(x_in_box, 0.5 * size_x)
    offset_across = _beyond(y_in_box, 0.5 * size_y)
    return offset_along, offset_across


def _beyond(coordinate: Any, half_size: float) -> Any:
    """Return by how much coordinates [m] exceed +-half_size [m], with their sign."""
    excess = np.maximum(np.abs(coordinate) - half_size, 0.0)
    return np.copysign(excess, coordinate)


def within_speed(command: Twist, max_speed: float) -> Twist:
    """Return a command (v [m/s], w [rad/s]) slowed along its arc to at most a speed [m/s]."""
    v, w = command
    if abs(v) <= max_speed:
        return command
    return math.copysign(max_speed, v), w * max_speed / abs(v)
