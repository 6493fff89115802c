"""ROS node `movers`: tracks moving obstacles and predicts their positions for the costmaps.

For each scan, the node publishes the predicted obstacle points of movers/prediction.py on
applr/predicted (sensor_msgs/PointCloud2; empty if nothing moves), the tracked obstacles for the
policy on applr/tracked (Movers), and the points with an arrow for each obstacle for display on
applr/movers. All are in the odometry frame and have the scan's stamp.

Parameters: ~robot (jackal; name or folder of a description), ~map (whether the robot drives on a
map) and ~tf_prefix.
"""

from __future__ import annotations

import math
import time
from typing import List

import rospy
from geometry_msgs.msg import Point, Vector3
from sensor_msgs.msg import PointCloud2
from std_msgs.msg import ColorRGBA, Header
from visualization_msgs.msg import Marker, MarkerArray

from applr_ros1.common.errors import run_script
from applr_ros1.common.ros_node import init_node, until_shutdown
from applr_ros1.common.scan import LaserScan
from applr_ros1.movers.prediction import Prediction, warm_up
from applr_ros1.movers.tracker import MoverTracker
from applr_ros1.msg import Movers
from applr_ros1.nodes import conversions
from applr_ros1.nodes.robot_parameters import named_robot
from applr_ros1.nodes.sensors import RosClock, Sensors
from applr_ros1.planner.parameters.layers import PREDICTED
from applr_ros1.robots import Robot
from applr_ros1.senses.standing import SILENT_S

LOOK_S = 0.01  # interval between polls for a new scan, in wall time [s]
SHOWN_S = 0.3  # lifetime of the display's markers [s]
HEIGHT_M = 0.3  # height of the arrows above the ground [m]
COLOUR = ColorRGBA(0.85, 0.1, 0.7, 1.0)  # magenta, which no other display uses


class TrackedLaser:
    """Choice of one laser if several share the topic: two views would seem to jump.

    The first one is tracked until it is silent for SILENT_S while another one goes on.
    """

    def __init__(self) -> None:
        self._frame = ""
        self._stamp = -math.inf

    def forget_tracks(self) -> None:
        """Forget the laser after the clock jumped back."""
        self._stamp = -math.inf

    def switches_to(self, scan: LaserScan) -> bool:
        """Track the laser of a scan instead if the tracked one is silent.

        Return whether the laser has changed.
        """
        if scan.frame == self._frame or scan.stamp - self._stamp <= SILENT_S:
            return False
        self._frame = scan.frame
        return True

    def takes(self, scan: LaserScan) -> bool:
        """Return whether a scan is from the tracked laser."""
        if scan.frame != self._frame:
            return False
        self._stamp = scan.stamp
        return True


class MoversNode:
    """Node that passes a robot's scans to a Prediction and publishes the result.

    Args:
        robot: Description of the robot.
        prefix: Prefix of its frames.
    """

    def __init__(self, robot: Robot, prefix: str):
        self._prediction = Prediction(robot, MoverTracker.of(robot))
        self._frame = prefix + robot.frames.odom
        self._scan_topic = robot.topics.scan
        self._clock = RosClock()
        self._laser = TrackedLaser()
        self._cloud = rospy.Publisher(PREDICTED, PointCloud2, queue_size=1, tcp_nodelay=True)
        self._tracked = rospy.Publisher("applr/tracked", Movers, queue_size=1, tcp_nodelay=True)
        self._display = rospy.Publisher("applr/movers", MarkerArray, queue_size=1)
        self._sensors = Sensors.of_lasers(robot, prefix, self._frame)

    def spin(self) -> None:
        """Process scans until shutdown."""
        while not rospy.is_shutdown():
            # In wall time: ROS time may stand still, and then jump back.
            time.sleep(LOOK_S)
            if self._clock.went_back():
                self._sensors.forget()
                self._prediction.reset()
                self._laser.forget_tracks()
            scan = self._sensors.observations().get(self._scan_topic)
            if scan is None:
                continue
            if self._laser.switches_to(scan):
                self._prediction.reset()
            if self._laser.takes(scan):
                self._publish(scan)

    def _publish(self, scan: LaserScan) -> None:
        """Track and predict with a scan, and publish the result."""
        stamp = rospy.Time.from_sec(scan.stamp)
        points = self._prediction.add_scan(scan).points
        self._cloud.publish(conversions.cloud(points, "xyz", self._frame, stamp))
        header = Header(0, stamp, self._frame)
        movers = self._prediction.movers
        self._tracked.publish(
            Movers(header, movers.x, movers.y, movers.vx, movers.vy, movers.radius)
        )
        # Markers are large: without a display, they are not made.
        if self._display.get_num_connections():
            self._display.publish(markers_of(self._prediction, self._frame, stamp))


def markers_of(prediction: Prediction, frame: str, stamp: rospy.Time) -> List[Marker]:
    """Return markers of the predicted obstacle points, and an arrow for each moving obstacle.

    An arrow ends at the obstacle's position in a second.
    """
    header = Header(0, stamp, frame)
    points_marker = Marker(header=header, ns="marks", type=Marker.POINTS)
    points_marker.scale = Vector3(0.04, 0.04, 0.0)  # width and height of a point [m]
    points_marker.points = [Point(*point) for point in prediction.points.tolist()]
    markers = [points_marker]
    movers = prediction.movers
    for mover_id, x, y, vx, vy in zip(movers.id, movers.x, movers.y, movers.vx, movers.vy):
        arrow = Marker(header=header, ns="movers", id=int(mover_id), type=Marker.ARROW)
        arrow.scale = Vector3(0.05, 0.12, 0.0)  # width of shaft and head [m]
        arrow.points = [Point(x, y, HEIGHT_M), Point(x + vx, y + vy, HEIGHT_M)]
        markers.append(arrow)

    # Markers expire by themselves, so that no obstacle that was lost has to be deleted.
    for marker in markers:
        marker.pose.orientation.w = 1.0
        marker.color = COLOUR
        marker.lifetime = rospy.Duration(SHOWN_S)
    return markers


def main() -> int:
    """Run the node.

    Raises:
        ApplrError: A parameter is invalid.
    """
    init_node("movers")
    robot, prefix = named_robot(rospy.get_param("~", {}))
    warm_up()  # Before the subscriptions: compiling takes longer than a scan stays usable.
    node = MoversNode(robot, prefix)
    with until_shutdown():
        node.spin()
    return 0


if __name__ == "__main__":
    run_script("applr_ros1.nodes.movers.node", node=True)
