"""A Jackal on ROS for tests of nodes: does what /cmd_vel says and publishes scan, odometry, tf and, if asked, /clock.

Runs as a thread of the test process, at the pace of the wall clock. What it publishes can be switched off and bent.
"""

import math
import threading
import time

import rospy
from geometry_msgs.msg import TransformStamped, Twist
from nav_msgs.msg import Odometry
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import LaserScan
from tf2_msgs.msg import TFMessage

from applr_ros1.common.angles import compose
from tests.support.toy_robot import ANGLE_MAX, ANGLE_MIN, INCREMENT, LASER_X, RANGE_MAX, RANGE_MIN, ToyRobot

TICK = 0.01
COMMAND_TIMEOUT = 0.25


class FakeJackal:
    """`clock`: publish /clock and stamp with it (starting at `clock` seconds); None: wall time."""

    def __init__(self, circles=(), pose=(0.0, 0.0, 0.0), clock=None):
        self.robot = ToyRobot(pose, circles)
        self.clock = clock
        self.scans = self.transforms = self.ticking = True
        self.bend = lambda scan: scan  # what happens to a scan before it goes out
        self.commands = []  # (wall time, v, w)
        self._command = 0.0, 0.0
        self._tf = rospy.Publisher("/tf", TFMessage, queue_size=50)
        self._tf_static = rospy.Publisher("/tf_static", TFMessage, queue_size=1, latch=True)
        self._odometry = rospy.Publisher("/odometry/filtered", Odometry, queue_size=5)
        self._scan = rospy.Publisher("/front/scan", LaserScan, queue_size=5)
        self._clock = rospy.Publisher("/clock", Clock, queue_size=5) if clock is not None else None
        self._subscriber = rospy.Subscriber("/cmd_vel", Twist, self._take, queue_size=50, tcp_nodelay=True)
        self._tf_static.publish(TFMessage([_transform("base_link", "front_laser", (LASER_X, 0.0, 0.0), self.now())]))
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def close(self):
        self._over.set()
        self._thread.join(2.0)
        for end in (self._subscriber, self._tf, self._tf_static, self._odometry, self._scan, self._clock):
            if end is not None:
                end.unregister()

    def now(self):
        return rospy.Time.from_sec(time.time() if self.clock is None else self.clock)

    def put(self, pose, circles=None):
        """Set the robot somewhere else."""
        self.robot.pose = pose
        if circles is not None:
            self.robot.circles = ToyRobot(circles=circles).circles

    def _take(self, message):
        self._command = message.linear.x, message.angular.z
        self.commands.append((time.time(),) + self._command)

    def _run(self):
        due, n = time.time(), 0
        while not self._over.wait(max(0.0, due - time.time())):
            due += TICK
            if not self.ticking:
                continue
            n += 1
            fresh = self.commands and time.time() - self.commands[-1][0] < COMMAND_TIMEOUT
            self.robot.drive(self._command if fresh else None, TICK)
            if self.clock is not None:
                self.clock += TICK
                self._clock.publish(self.now())
            stamp = self.now()
            if n % 2 == 0:
                self._publish_pose(stamp)
            if n % 5 == 0 and self.scans:
                scan = LaserScan(
                    angle_min=ANGLE_MIN,
                    angle_max=ANGLE_MAX,
                    angle_increment=INCREMENT,
                    range_min=RANGE_MIN,
                    range_max=RANGE_MAX,
                    ranges=self.robot.ranges().tolist(),
                )
                scan.header.stamp, scan.header.frame_id = stamp, "front_laser"
                self._scan.publish(self.bend(scan))

    def _publish_pose(self, stamp):
        transform = _transform("odom", "base_link", compose((0.0, 0.0, 0.0), self.robot.pose), stamp)
        if self.transforms:
            self._tf.publish(TFMessage([transform]))
        odometry = Odometry(child_frame_id="base_link")
        odometry.header = transform.header
        odometry.pose.pose.orientation = transform.transform.rotation
        odometry.pose.pose.position.x, odometry.pose.pose.position.y = self.robot.pose[:2]
        odometry.twist.twist.linear.x, odometry.twist.twist.angular.z = self.robot.twist
        self._odometry.publish(odometry)


def _transform(parent, child, pose, stamp):
    t = TransformStamped(child_frame_id=child)
    t.header.frame_id, t.header.stamp = parent, stamp
    t.transform.translation.x, t.transform.translation.y = pose[:2]
    t.transform.rotation.z, t.transform.rotation.w = math.sin(pose[2] / 2), math.cos(pose[2] / 2)
    return t
