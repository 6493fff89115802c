"""ROS node `movers`: tracks moving obstacles and predicts their positions, as an observation source of costmaps.

For each scan, the node publishes the predicted obstacle points of movers/prediction.py on applr/predicted
(sensor_msgs/PointCloud2; empty if nothing moves), the tracked obstacles for the policy on applr/tracked (Movers), and
the points with an arrow for each obstacle for display on applr/movers. All are in the odometry frame and have the
scan's stamp.

Parameters: ~robot (jackal; name or folder of a description), ~map (whether the robot drives on a map) and ~tf_prefix.
"""

from __future__ import annotations

import time
from typing import List

import rospy
from geometry_msgs.msg import Point, Vector3
from sensor_msgs.msg import PointCloud2
from std_msgs.msg import ColorRGBA, Header
from visualization_msgs.msg import Marker, MarkerArray

from applr_ros1.common.errors import run_script
from applr_ros1.common.ros_node import init_node, until_shutdown
from applr_ros1.movers.prediction import Prediction
from applr_ros1.movers.tracker import warm_up
from applr_ros1.msg import Movers
from applr_ros1.nodes import conversions
from applr_ros1.nodes.robot_parameters import named_robot
from applr_ros1.nodes.sensors import Clock, Sensors
from applr_ros1.planner.parameters.layers import PREDICTED
from applr_ros1.robots import Robot

LOOK_S = 0.01  # interval between polls for a new scan, in wall time [s]
SHOWN_S = 0.3  # lifetime of the display's markers [s]
HEIGHT_M = 0.3  # height of the arrows above the ground [m]
COLOUR = ColorRGBA(0.85, 0.1, 0.7, 1.0)


class MoversNode:
    """Node that passes a robot's scans to a Prediction and publishes the result. prefix: Prefix of the frames."""

    def __init__(self, robot: Robot, prefix: str):
        self._prediction = Prediction(robot)
        self._frame, self._scan, self._clock = (
            prefix + robot.frames.odom,
            robot.topics.scan,
            Clock(),
        )
        self._laser = ""
        self._cloud = rospy.Publisher(PREDICTED, PointCloud2, queue_size=1, tcp_nodelay=True)
        self._tracked = rospy.Publisher("applr/tracked", Movers, queue_size=1, tcp_nodelay=True)
        self._display = rospy.Publisher("applr/movers", MarkerArray, queue_size=1)
        self._sensors = Sensors.of_lasers(robot, prefix, self._frame)

    def spin(self) -> None:
        """Process scans until shutdown."""
        while not rospy.is_shutdown():
            time.sleep(LOOK_S)
            if self._clock.went_back():
                self._sensors.forget()
                self._prediction.reset()
            scan = self._sensors.observations().get(self._scan)
            if scan is not None and scan.frame == (self._laser or scan.frame):
                self._laser = scan.frame  # Only the first laser counts if several share the topic.
                stamp = rospy.Time.from_sec(scan.stamp)
                points = self._prediction.add_scan(scan).points
                self._cloud.publish(conversions.cloud(points, "xyz", self._frame, stamp))
                head, seen = Header(0, stamp, self._frame), self._prediction.movers
                self._tracked.publish(Movers(head, seen.x, seen.y, seen.vx, seen.vy, seen.radius))
                if self._display.get_num_connections():
                    self._display.publish(shown(self._prediction, self._frame, stamp))


def shown(prediction: Prediction, frame: str, stamp: rospy.Time) -> List[Marker]:
    """Return markers of the predicted obstacle points, and for each obstacle an arrow to its position in a second."""
    head, movers = Header(0, stamp, frame), prediction.movers
    marks = Marker(header=head, ns="marks", type=Marker.POINTS, scale=Vector3(0.04, 0.04, 0.0))
    marks.points = [Point(*point) for point in prediction.points.tolist()]
    made = [marks]
    for name, x, y, vx, vy in zip(movers.id, movers.x, movers.y, movers.vx, movers.vy):
        arrow = Marker(
            header=head,
            ns="movers",
            id=int(name),
            type=Marker.ARROW,
            scale=Vector3(0.05, 0.12, 0.0),
        )
        arrow.points = [Point(x, y, HEIGHT_M), Point(x + vx, y + vy, HEIGHT_M)]
        made.append(arrow)
    for marker in made:
        marker.pose.orientation.w, marker.color, marker.lifetime = (
            1.0,
            COLOUR,
            rospy.Duration(SHOWN_S),
        )
    return made


def main() -> int:
    """Run the node. Raises ApplrError if a parameter is invalid."""
    init_node("movers")
    robot, prefix = named_robot(rospy.get_param("~", {}))
    warm_up()
    node = MoversNode(robot, prefix)
    with until_shutdown():
        node.spin()
    return 0


if __name__ == "__main__":
    run_script("applr_ros1.nodes.movers.node", node=True)
