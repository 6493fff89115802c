"""Another simulated robot in the same world, as an obstacle for this one: a cylinder that moves as that robot does.

Each robot has a bridge (ros_bridge.py) and a simulator of its own; they meet through their true poses.
"""

from __future__ import annotations

from math import cos, hypot, sin
from typing import Any, Callable, Tuple

import rospy
from nav_msgs.msg import Odometry

from applr_ros1.common.angles import yaw_of
from applr_ros1.robots import geometry, load

FAR_AWAY_M = (1e3, 1e3)  # [m], until its first message
AHEAD_S = 0.1  # s for which a pose is carried on with its velocity


class OtherRobot:
    """Stands in for a worlds.Mover: `radius` [m] and `position(t)`.

    Args:
        namespace: Of the other robot's nodes.
        sim_time: Turns a ROS time into this robot's simulated time [s].
    """

    def __init__(self, namespace: str, sim_time: Callable[[rospy.Time], float]):
        bridge = namespace.rstrip("/") + "/sim_bridge/"
        back, front, right, left = geometry.bounding_box(load(str(rospy.get_param(bridge + "robot", "jackal"))))
        self.radius = hypot(max(front, -back), max(left, -right))
        self._sim_time = sim_time
        self._newest: Any = None  # (ROS time, (x, y), velocity (x, y))
        rospy.Subscriber(bridge + "ground_truth", Odometry, self._keep, queue_size=1, tcp_nodelay=True)

    def position(self, t: float) -> Tuple[float, float]:
        """Return centre (x, y) [m] at simulated time t [s], carried on from the newest pose."""
        newest = self._newest
        if newest is None:
            return FAR_AWAY_M
        stamp, (x, y), (vx, vy) = newest
        late = min(max(t - self._sim_time(stamp), 0.0), AHEAD_S)
        return x + late * vx, y + late * vy

    def _keep(self, message: Odometry) -> None:
        pose, speed = message.pose.pose, message.twist.twist.linear.x
        yaw = yaw_of(pose.orientation)
        velocity = speed * cos(yaw), speed * sin(yaw)
        self._newest = message.header.stamp, (pose.position.x, pose.position.y), velocity
