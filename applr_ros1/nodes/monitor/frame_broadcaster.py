"""Broadcaster of the frame of the collision monitor's matched poses.

A move_base whose costmaps are in this frame drives without the drift of the odometry. The frame is
a child of the odometry's frame, which may have another parent in tf, such as a map.
"""

from __future__ import annotations

import rospy
from geometry_msgs.msg import Quaternion, Transform, TransformStamped, Vector3
from std_msgs.msg import Header
from tf2_msgs.msg import TFMessage

from applr_ros1.common.angles import Pose, inverse, quaternion_of

PERIOD_S = 0.05  # interval between transforms [s], in ROS time
# Lead of their stamps over the clock [s], as amcl's transform_tolerance. tf does not extrapolate,
# and costmap_2d waits until a transform is 0.05 s ahead of a scan.
LEAD_S = 0.1


class FrameBroadcaster:
    """Broadcaster of the latest correction of the odometry.

    It is broadcast without a new scan, too, because the last correction stays valid.

    Args:
        odometry_frame: Frame of the odometry, with its prefix.
        matched_frame: Frame of the matched poses, with its prefix.
    """

    def __init__(self, odometry_frame: str, matched_frame: str):
        self._odometry_frame = odometry_frame
        self._matched_frame = matched_frame
        self.forget()
        self._publisher = rospy.Publisher("/tf", TFMessage, queue_size=10, tcp_nodelay=True)

    def forget(self) -> None:
        """Forget the last transform after the clock jumped back."""
        self._broadcast_time = rospy.Time(0)  # time of the last transform

    def broadcast(self, now: rospy.Time, correction: Pose) -> None:
        """Broadcast the correction if the last transform is PERIOD_S old.

        Args:
            now: ROS time. A simulated clock is 0 until its first message.
            correction: Pose of the odometry's frame in that of the matched poses.
        """
        # A wall clock may be set back a little.
        if 0.0 <= (now - self._broadcast_time).to_sec() < PERIOD_S:
            return
        self._broadcast_time = now
        x, y, yaw = inverse(correction)
        header = Header(0, now + rospy.Duration.from_sec(LEAD_S), self._odometry_frame)
        transform = Transform(Vector3(x, y, 0.0), Quaternion(*quaternion_of(yaw)))
        self._publisher.publish([TransformStamped(header, self._matched_frame, transform)])
