"""Publishers of the simulated robot: messages of the real robot from a RobotState and a scan.

ros_bridge.py publishes through this module. Poses are planar, at the height of the base frame.
"""

from __future__ import annotations

from typing import Any, List, Sequence

import numpy as np
import rospy
from geometry_msgs.msg import (
    Point,
    PoseWithCovariance,
    Quaternion,
    Transform,
    TransformStamped,
    TwistWithCovariance,
    Vector3,
)
from geometry_msgs.msg import Pose as PoseMessage
from geometry_msgs.msg import Twist as TwistMessage
from nav_msgs.msg import MapMetaData, OccupancyGrid, Odometry
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import Imu, LaserScan
from std_msgs.msg import Bool, ColorRGBA, Header
from tf2_msgs.msg import TFMessage
from visualization_msgs.msg import Marker, MarkerArray

from applr_ros1.common.angles import Pose, Twist, quaternion_of
from applr_ros1.common.arrays import Array32
from applr_ros1.robots import Robot
from applr_ros1.robots.robot import Laser, OdometryErrors
from worlds import World
from worlds.occupancy import occupancy

from .mechanics import GRAVITY
from .simulator import RobotState, Simulator

WORLD = "world"  # name of the frame of the world
NO_SHIFT = (0.0, 0.0, 0.0)  # pose of a frame that equals its parent
OBSTACLE_HEIGHT_M = 0.5  # height of the markers of obstacles [m]
MAP_RESOLUTION_M = 0.05  # resolution of the published map of a world without a map [m]
GREY = ColorRGBA(0.45, 0.47, 0.5, 1.0)  # colour of cylinders
BROWN = ColorRGBA(0.62, 0.5, 0.35, 1.0)  # colour of boxes
ORANGE = ColorRGBA(0.8, 0.4, 0.2, 1.0)  # colour of moving cylinders
# Covariances (6, 6) of pose and twist: x, y, z [m^2], then rotations about x, y, z [rad^2], or
# rates
_COVARIANCE = np.diag((1e-3, 1e-3, 1e-6, 1e-6, 1e-6, 3e-4)).ravel().tolist()
_ATTITUDE_COVARIANCE = np.diag((1e-4, 1e-4, 1e-4)).ravel().tolist()  # (3, 3) [rad^2]


class BridgeTopics:
    """Publishers of one robot, with queues so that a frozen subscriber cannot block the simulation.

    Args:
        robot: Description of the robot with the names of topics and frames.
        prefix: Prefix of the names of the robot's frames, for several robots on one master.
        with_map: Whether to publish a map of the world and its frame, as a map server and a
            localisation do.
    """

    def __init__(self, robot: Robot, prefix: str = "", with_map: bool = False) -> None:
        self.robot = robot
        self.prefix = prefix
        self.odom_frame = prefix + robot.frames.odom
        self.base_frame = prefix + robot.frames.base
        self.laser_frame = prefix + robot.laser.frame
        names = robot.topics
        # tcp_nodelay: Nagle's algorithm would delay small messages by up to 40 ms.
        self.clock = rospy.Publisher("/clock", Clock, queue_size=10, tcp_nodelay=True)
        self.tf = rospy.Publisher("/tf", TFMessage, queue_size=50, tcp_nodelay=True)
        self.tf_static = rospy.Publisher("/tf_static", TFMessage, queue_size=1, latch=True)
        self.odometry = rospy.Publisher(names.odometry, Odometry, queue_size=10, tcp_nodelay=True)
        self.scan = rospy.Publisher(names.scan, LaserScan, queue_size=10, tcp_nodelay=True)
        self.imu = rospy.Publisher(names.imu, Imu, queue_size=10)
        self.truth = rospy.Publisher("~ground_truth", Odometry, queue_size=10)
        # The second name is that of the BARN Challenge's collision topic, see ros_gazebo.py.
        self.collisions = [
            rospy.Publisher("~collision", Bool, queue_size=10),
            rospy.Publisher("collision", Bool, queue_size=10),
        ]
        self.obstacles = rospy.Publisher("~obstacles", MarkerArray, queue_size=1, latch=True)
        self.movers = rospy.Publisher("~movers", MarkerArray, queue_size=1)
        self.map = None
        if with_map:
            self.map = rospy.Publisher("map", OccupancyGrid, queue_size=1, latch=True)

    def publish_scan(self, ranges: Array32, stamp: rospy.Time) -> None:
        """Publish a scan, ranges (beams,) float32 [m]."""
        self.scan.publish(_scan(self.laser_frame, self.robot.laser, ranges, stamp))

    def publish_state(self, state: RobotState, stamp: rospy.Time, touched: bool) -> None:
        """Publish all messages of a state except the scan.

        Args:
            state: State of the robot.
            stamp: ROS time of the state.
            touched: Whether there was contact since the last call.
        """
        odom = self.odom_frame
        base = self.base_frame
        self.tf.publish([_transform(odom, base, state.odom_pose, stamp)])
        self.odometry.publish(_odometry(odom, base, state.odom_pose, state.odom_twist, stamp))
        self.truth.publish(_odometry(WORLD, base, state.pose, state.twist, stamp))
        for publisher in self.collisions:
            publisher.publish(touched)
        if self.imu.get_num_connections():
            self.imu.publish(_imu(self.prefix + "imu_link", self.robot.odometry, state, stamp))

    def publish_world(self, simulator: Simulator, stamp: rospy.Time) -> None:
        """Publish static frames, obstacles and the map, after every reset and change of world."""
        self.publish_frames(simulator, stamp)
        world = simulator.world
        # This also deletes the markers of publish_movers.
        clear = Marker(header=Header(frame_id=WORLD), action=Marker.DELETEALL)
        cylinders = _cylinders("cylinders", GREY, world.cylinders.tolist(), stamp)
        boxes = _markers("boxes", Marker.CUBE, BROWN, world.boxes.tolist(), stamp)
        self.obstacles.publish([clear, *cylinders, *boxes])
        if self.map is not None:
            self.map.publish(_map(self.robot.frames.map, world, stamp))

    def publish_frames(self, simulator: Simulator, stamp: rospy.Time) -> None:
        """Publish the static frames: the parts of the robot, and the pose of odom in the world."""
        base = self.base_frame
        laser = self.robot.laser
        transforms = [_transform(base, self.laser_frame, laser.pose, stamp, laser.height)]
        for link in ("chassis_link", "imu_link"):
            transforms.append(_transform(base, self.prefix + link, NO_SHIFT, stamp))
        origin = (*simulator.odom_origin, 0.0)
        transforms.append(_transform(WORLD, self.odom_frame, origin, stamp))
        if self.map is not None:
            # The map frame equals the world frame, and all robots share it.
            transforms.append(_transform(WORLD, self.robot.frames.map, NO_SHIFT, stamp))
        self.tf_static.publish(transforms)

    def publish_movers(self, simulator: Simulator, stamp: rospy.Time) -> None:
        """Publish the moving cylinders at the current time, if there are subscribers."""
        circles = simulator.passers_by.circles(simulator.state.time).tolist()
        # Messages that nobody reads would only slow down the simulation.
        if circles and self.movers.get_num_connections():
            self.movers.publish(_cylinders("movers", ORANGE, circles, stamp))


def quaternion(yaw: float) -> Quaternion:
    """Return a geometry_msgs/Quaternion for a yaw [rad]."""
    return Quaternion(*quaternion_of(yaw))


def _pose(pose: Pose, height: float = 0.0) -> PoseMessage:
    """Return a geometry_msgs/Pose of (x, y, yaw) [m, m, rad] at a height [m]."""
    x, y, yaw = pose
    return PoseMessage(Point(x, y, height), quaternion(yaw))


def _map(frame: str, world: World, stamp: rospy.Time) -> OccupancyGrid:
    """Return the map of a world, whose own resolution counts if it has a map."""
    cells, resolution, origin = occupancy(world, MAP_RESOLUTION_M)
    rows, columns = cells.shape
    info = MapMetaData(stamp, resolution, columns, rows, _pose(origin))
    return OccupancyGrid(Header(0, stamp, frame), info, cells.ravel().tolist())


def _transform(
    parent: str, child: str, pose: Pose, stamp: rospy.Time, height: float = 0.0
) -> TransformStamped:
    """Return the transform of frame `child` at `pose` and `height` [m] in frame `parent`."""
    x, y, yaw = pose
    transform = Transform(Vector3(x, y, height), quaternion(yaw))
    return TransformStamped(Header(0, stamp, parent), child, transform)


def _odometry(frame: str, child: str, pose: Pose, twist: Twist, stamp: rospy.Time) -> Odometry:
    """Return pose [m, m, rad] and twist (v, w) [m/s, rad/s] of frame `child` in `frame`."""
    v, w = twist
    velocity = TwistMessage(Vector3(v, 0.0, 0.0), Vector3(0.0, 0.0, w))
    return Odometry(
        Header(0, stamp, frame),
        child,
        PoseWithCovariance(_pose(pose), _COVARIANCE),
        TwistWithCovariance(velocity, _COVARIANCE),
    )


def _scan(frame: str, laser: Laser, ranges: Array32, stamp: rospy.Time) -> LaserScan:
    """Return the scan of ranges (beams,) [m], without a return as the laser's driver reports it."""
    # Some drivers publish a number for a beam without a return, not the +inf of REP 117.
    if laser.no_return is not None:
        ranges = np.where(np.isposinf(ranges), np.float32(laser.no_return), ranges)
    return LaserScan(
        header=Header(0, stamp, frame),
        angle_min=laser.first_angle,
        angle_max=laser.last_angle,
        angle_increment=laser.increment,
        range_min=laser.range_min,
        range_max=laser.range_max,
        scan_time=1.0 / laser.rate,
        ranges=ranges.tolist(),
    )


def _imu(frame: str, errors: OdometryErrors, state: RobotState, stamp: rospy.Time) -> Imu:
    """Return the measurement of the IMU, whose orientation is that of the odometry."""
    acceleration, yaw_rate = state.imu
    message = Imu(
        header=Header(0, stamp, frame),
        orientation=quaternion(state.odom_pose[2]),
        orientation_covariance=_ATTITUDE_COVARIANCE,
        angular_velocity=Vector3(0.0, 0.0, yaw_rate),
        linear_acceleration=Vector3(acceleration, 0.0, GRAVITY),
    )
    message.angular_velocity_covariance[8] = errors.gyro_noise**2
    message.linear_acceleration_covariance[0] = errors.accelerometer_noise**2
    return message


def _cylinders(
    name: str, colour: ColorRGBA, circles: Sequence[Sequence[float]], stamp: rospy.Time
) -> List[Marker]:
    """Return the markers of cylinders x, y, radius [m]."""
    places = [(x, y, 0.0, 2 * radius, 2 * radius) for x, y, radius in circles]
    return _markers(name, Marker.CYLINDER, colour, places, stamp)


def _markers(
    name: str, shape: int, colour: ColorRGBA, places: Sequence[Any], stamp: rospy.Time
) -> List[Marker]:
    """Return the markers of obstacles on the ground: x, y, yaw, size_x, size_y [m, rad]."""
    markers = []
    for number, (x, y, yaw, size_x, size_y) in enumerate(places):
        marker = Marker(
            header=Header(0, stamp, WORLD),
            ns=name,
            id=number,
            type=shape,
            pose=_pose((x, y, yaw), OBSTACLE_HEIGHT_M / 2),
            scale=Vector3(size_x, size_y, OBSTACLE_HEIGHT_M),
            color=colour,
        )
        markers.append(marker)
    return markers
