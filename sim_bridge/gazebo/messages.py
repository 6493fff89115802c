"""Planar poses and twists as Gazebo's messages state them, and back. front.py uses it."""

from __future__ import annotations

from math import cos, isfinite, sin
from typing import Any, Optional, Tuple

from geometry_msgs.msg import Pose, Twist

from applr_ros1.common.angles import yaw_of

from ..ros_topics import quaternion


def pose_message(pose: Tuple[float, float, float]) -> Pose:
    """geometry_msgs/Pose of (x, y, yaw)."""
    message = Pose()
    message.position.x, message.position.y = pose[0], pose[1]
    message.orientation = quaternion(pose[2])
    return message


def twist_message(yaw: float, twist: Tuple[float, float]) -> Twist:
    """geometry_msgs/Twist in the world's axes of a robot with heading `yaw` and twist (v, w) along its own."""
    message = Twist()
    message.linear.x, message.linear.y = twist[0] * cos(yaw), twist[0] * sin(yaw)
    message.angular.z = twist[1]
    return message


def planar(message: Any) -> Optional[Tuple[float, float, float]]:
    """(x, y, yaw) of a geometry_msgs/Pose; None where a number is not finite.

    The quaternion may have any length, and one of zeros is the identity, as in Gazebo and in robot_localization.
    """
    q = message.orientation
    values = (message.position.x, message.position.y, q.x, q.y, q.z, q.w)
    if not all(map(isfinite, values)):
        return None
    return values[0], values[1], yaw_of(q) if any(values[2:]) else 0.0
