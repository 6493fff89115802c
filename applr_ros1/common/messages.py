"""Values of messages: poses, velocities and frames as numbers and names.

The nodes and the reader of bags use it. It needs no ROS, because it only reads attributes: rosbags
and rospy give them the same names.
"""

from typing import Any

from applr_ros1.common.angles import Pose, Twist, yaw_of


def frame_of(message: Any) -> str:
    """Return the frame of a message."""
    return str(message.header.frame_id.lstrip("/"))


def pose_of(message: Any) -> Pose:
    """Return (x, y, yaw) of a geometry_msgs/Pose or a geometry_msgs/Transform."""
    if hasattr(message, "position"):
        return message.position.x, message.position.y, yaw_of(message.orientation)
    return message.translation.x, message.translation.y, yaw_of(message.rotation)


def twist_of(message: Any) -> Twist:
    """Return (v, w) of a geometry_msgs/Twist."""
    return message.linear.x, message.angular.z
