"""Angles [rad], poses (x, y, yaw) [m, m, rad] in the plane, and boxes in it.

Compiled kernels keep formulas of their own (planner/trajectory/sampling.py: the C++ planner's, bit for bit).
"""

from __future__ import annotations

import math
from typing import Any, Tuple

import numpy as np

Pose = Tuple[float, float, float]


def normalize_angle(angle: float) -> float:
    """Return the angle in [-pi, pi], exact: no rounding is added."""
    return math.remainder(angle, 2.0 * math.pi)


def normalize_angle_modulo(angle):
    """Return the angle in [-pi, pi), of a number or an array. Simulators depend on how it rounds its last bits."""
    return (angle + math.pi) % (2 * math.pi) - math.pi


def yaw_of(q) -> float:
    """Return the yaw [rad] in [-pi, pi] of a quaternion x, y, z, w of any length but zero, as tf2 does (getYaw)."""
    return math.atan2(2.0 * (q.x * q.y + q.w * q.z), q.w * q.w + q.x * q.x - q.y * q.y - q.z * q.z)


def quaternion_of(yaw: float) -> Tuple[float, float, float, float]:
    """Return the unit quaternion (x, y, z, w) of a turn about z."""
    return 0.0, 0.0, math.sin(0.5 * yaw), math.cos(0.5 * yaw)


def transform_point(pose: Pose, x: Any, y: Any) -> Tuple[Any, Any]:
    """Return the point (x, y) of the frame at `pose` in the frame in which the pose is given [m]; arrays as well."""
    c, s = math.cos(pose[2]), math.sin(pose[2])
    return pose[0] + c * x - s * y, pose[1] + s * x + c * y


def compose(a: Pose, b: Pose) -> Pose:
    """Return the pose b, given in the frame at a, in the frame in which a is given."""
    return (*transform_point(a, b[0], b[1]), normalize_angle(a[2] + b[2]))


def inverse(pose: Pose) -> Pose:
    """Return the pose of the frame in which `pose` is given, in the frame at `pose`."""
    x, y, yaw = pose
    c, s = math.cos(yaw), math.sin(yaw)
    return -x * c - y * s, x * s - y * c, -yaw


def outside_box(dx, dy, yaw: float, size_x: float, size_y: float):
    """Return the ways from a box's nearest points to points, along its axes: two arrays [m], zero for those inside.

    Args:
        dx: the points' x less the box's, in the world's frame [m]; dx and dy may be of shapes that broadcast.
        dy: the points' y less the box's.
        yaw: the direction of the box's first axis.
        size_x: its length along that axis [m].
        size_y: its length along the other.
    """
    c, s = math.cos(yaw), math.sin(yaw)
    along, across = c * dx + s * dy, c * dy - s * dx
    return (
        np.copysign(np.maximum(np.abs(along) - 0.5 * size_x, 0.0), along),
        np.copysign(np.maximum(np.abs(across) - 0.5 * size_y, 0.0), across),
    )
