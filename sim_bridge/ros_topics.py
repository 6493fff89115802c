"""Publishers of the simulated robot, which convert a RobotState and a scan to the messages of the real robot.

ros_bridge.py publishes through this module. Poses are planar, at the height of the base frame.
"""

from __future__ import annotations

from typing import List, Sequence, Tuple

import numpy as np
import rospy
from geometry_msgs.msg import Quaternion, TransformStamped
from nav_msgs.msg import OccupancyGrid, Odometry
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import Imu, LaserScan
from std_msgs.msg import Bool, ColorRGBA
from tf2_msgs.msg import TFMessage
from visualization_msgs.msg import Marker, MarkerArray

from applr_ros1.common.angles import Pose, quaternion_of
from applr_ros1.common.arrays import Array32
from applr_ros1.robots import Robot
from applr_ros1.robots.robot import Laser, OdometryErrors
from worlds import World
from worlds.occupancy import occupancy

from .mechanics import GRAVITY
from .simulator import RobotState, Simulator

WORLD = "world"
OBSTACLE_HEIGHT_M = 0.5  # height of the markers of obstacles [m]
MAP_RESOLUTION_M = 0.05  # resolution of the published map of a world without a map [m]
COLOURS = {"cylinders": (0.45, 0.47, 0.5, 1.0), "boxes": (0.62, 0.5, 0.35, 1.0), "movers": (0.8, 0.4, 0.2, 1.0)}
_COVARIANCE = [0.0] * 36
for _i, _value in enumerate((1e-3, 1e-3, 1e-6, 1e-6, 1e-6, 3e-4)):
    _COVARIANCE[7 * _i] = _value
_ATTITUDE_COVARIANCE = [1e-4, 0.0, 0.0, 0.0, 1e-4, 0.0, 0.0, 0.0, 1e-4]


class BridgeTopics:
    """Publishers of one robot, with queues so that a frozen subscriber cannot block the simulation.

    Args:
        robot: Description of the robot with the names of topics and frames.
        prefix: Prefix of the names of the robot's frames, for several robots on one master.
        with_map: Whether to publish a map of the world and its frame, as a map server and a localisation do.
    """

    def __init__(self, robot: Robot, prefix: str = "", with_map: bool = False) -> None:
        self.robot, self.prefix = robot, prefix
        self.odom_frame, self.base_frame = prefix + robot.frames.odom, prefix + robot.frames.base
        self.laser_frame = prefix + robot.laser.frame
        names = robot.topics
        self.clock = rospy.Publisher("/clock", Clock, queue_size=10, tcp_nodelay=True)
        self.tf = rospy.Publisher("/tf", TFMessage, queue_size=50, tcp_nodelay=True)
        self.tf_static = rospy.Publisher("/tf_static", TFMessage, queue_size=1, latch=True)
        self.odometry = rospy.Publisher(names.odometry, Odometry, queue_size=10, tcp_nodelay=True)
        self.scan = rospy.Publisher(names.scan, LaserScan, queue_size=10, tcp_nodelay=True)
        self.imu = rospy.Publisher(names.imu, Imu, queue_size=10)
        self.truth = rospy.Publisher("~ground_truth", Odometry, queue_size=10)
        self.collisions = [rospy.Publisher(topic, Bool, queue_size=10) for topic in ("~collision", "collision")]
        self.obstacles = rospy.Publisher("~obstacles", MarkerArray, queue_size=1, latch=True)
        self.movers = rospy.Publisher("~movers", MarkerArray, queue_size=1)
        self.map = rospy.Publisher("map", OccupancyGrid, queue_size=1, latch=True) if with_map else None

    def publish_scan(self, ranges: Array32, stamp: rospy.Time) -> None:
        """Publish a scan, ranges (beams,) float32 [m]."""
        self.scan.publish(_scan(self.laser_frame, self.robot.laser, ranges, stamp))

    def publish_state(self, state: RobotState, stamp: rospy.Time, touched: bool) -> None:
        """Publish all messages of a state except the scan. touched: Whether there was contact since the last call."""
        self.tf.publish([_transform(self.odom_frame, self.base_frame, state.odom_pose, stamp)])
        self.odometry.publish(_odometry(self.odom_frame, self.base_frame, state.odom_pose, state.odom_twist, stamp))
        self.truth.publish(_odometry(WORLD, self.base_frame, state.pose, state.twist, stamp))
        for publisher in self.collisions:
            publisher.publish(touched)
        if self.imu.get_num_connections():
            self.imu.publish(_imu(self.prefix + "imu_link", self.robot.odometry, state, stamp))

    def publish_world(self, simulator: Simulator, stamp: rospy.Time) -> None:
        """Publish static frames, static obstacles and the map, after every reset and change of world."""
        self.publish_frames(simulator, stamp)
        world, clear = simulator.world, Marker(action=Marker.DELETEALL)  # also deletes the markers of publish_movers
        clear.header.frame_id = WORLD
        cylinders = _markers("cylinders", world.cylinders.tolist(), stamp)
        self.obstacles.publish([clear, *cylinders, *_markers("boxes", world.boxes.tolist(), stamp)])
        if self.map is not None:
            self.map.publish(_map(self.robot.frames.map, world, stamp))

    def publish_frames(self, simulator: Simulator, stamp: rospy.Time) -> None:
        """Publish the static frames: the parts of the robot, and the pose of odom in the world."""
        x, y = simulator.odom_origin
        base, prefix = self.base_frame, self.prefix
        # The map frame equals the world frame, and all robots share it.
        maps = [] if self.map is None else [_transform(WORLD, self.robot.frames.map, (0.0, 0.0, 0.0), stamp)]
        laser = _transform(base, self.laser_frame, self.robot.laser.pose, stamp, self.robot.laser.height)
        links = [_transform(base, prefix + name, (0.0, 0.0, 0.0), stamp) for name in ("chassis_link", "imu_link")]
        self.tf_static.publish([laser, *links, _transform(WORLD, self.odom_frame, (x, y, 0.0), stamp), *maps])

    def publish_movers(self, simulator: Simulator, stamp: rospy.Time) -> None:
        """Publish the moving cylinders at the current time, if there are subscribers."""
        circles = simulator.mover_circles().tolist()
        if circles and self.movers.get_num_connections():
            self.movers.publish(_markers("movers", circles, stamp))


def quaternion(yaw: float) -> Quaternion:
    """Return a geometry_msgs/Quaternion for a yaw [rad]."""
    return Quaternion(*quaternion_of(yaw))


def _map(frame: str, world: World, stamp: rospy.Time) -> OccupancyGrid:
    cells, resolution, (x, y, yaw) = occupancy(world, MAP_RESOLUTION_M)
    message = OccupancyGrid()
    message.header.frame_id, message.header.stamp = frame, stamp
    message.info.map_load_time, message.info.resolution = stamp, resolution
    message.info.height, message.info.width = cells.shape
    message.info.origin.position.x, message.info.origin.position.y = x, y
    message.info.origin.orientation = quaternion(yaw)
    message.data = cells.ravel().tolist()
    return message


def _transform(parent: str, child: str, pose: Pose, stamp: rospy.Time, z: float = 0.0) -> TransformStamped:
    message = TransformStamped(child_frame_id=child)
    message.header.frame_id, message.header.stamp = parent, stamp
    translation = message.transform.translation
    translation.x, translation.y, translation.z = pose[0], pose[1], z
    message.transform.rotation = quaternion(pose[2])
    return message


def _odometry(frame: str, child: str, pose: Pose, twist: Tuple[float, float], stamp: rospy.Time) -> Odometry:
    message = Odometry(child_frame_id=child)
    message.header.frame_id, message.header.stamp = frame, stamp
    message.pose.pose.position.x, message.pose.pose.position.y = pose[0], pose[1]
    message.pose.pose.orientation = quaternion(pose[2])
    message.twist.twist.linear.x, message.twist.twist.angular.z = twist
    message.pose.covariance = message.twist.covariance = _COVARIANCE
    return message


def _scan(frame: str, laser: Laser, ranges: Array32, stamp: rospy.Time) -> LaserScan:
    if laser.no_return is not None:
        ranges = np.where(np.isposinf(ranges), np.float32(laser.no_return), ranges)
    message = LaserScan(
        angle_min=laser.first_angle,
        angle_max=laser.last_angle,
        angle_increment=laser.increment,
        range_min=laser.range_min,
        range_max=laser.range_max,
        scan_time=1.0 / laser.rate,
        ranges=ranges.tolist(),
    )
    message.header.frame_id, message.header.stamp = frame, stamp
    return message


def _imu(frame: str, errors: OdometryErrors, state: RobotState, stamp: rospy.Time) -> Imu:
    message = Imu()
    message.header.frame_id, message.header.stamp = frame, stamp
    message.orientation = quaternion(state.odom_pose[2])
    message.linear_acceleration.x, message.angular_velocity.z = state.imu
    message.linear_acceleration.z = GRAVITY
    message.orientation_covariance = _ATTITUDE_COVARIANCE
    message.angular_velocity_covariance[8] = errors.gyro_noise**2
    message.linear_acceleration_covariance[0] = errors.accelerometer_noise**2
    return message


def _markers(name: str, shapes: Sequence[Sequence[float]], stamp: rospy.Time) -> List[Marker]:
    """Return the markers of cylinders x, y, radius, or of boxes x, y, yaw, size_x, size_y [m, rad]."""
    markers = []
    for number, (x, y, *rest) in enumerate(shapes):
        yaw, size_x, size_y = rest if name == "boxes" else (0.0, 2 * rest[0], 2 * rest[0])
        marker = Marker(ns=name, id=number, type=Marker.CUBE if name == "boxes" else Marker.CYLINDER)
        marker.header.frame_id, marker.header.stamp, marker.color = WORLD, stamp, ColorRGBA(*COLOURS[name])
        marker.pose.position.x, marker.pose.position.y, marker.pose.position.z = x, y, OBSTACLE_HEIGHT_M / 2
        marker.pose.orientation = quaternion(yaw)
        marker.scale.x, marker.scale.y, marker.scale.z = size_x, size_y, OBSTACLE_HEIGHT_M
        markers.append(marker)
    return markers
