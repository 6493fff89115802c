"""Simulated Jackal on ROS for tests of nodes. It runs in a thread of the test process, in wall time.

Tests can switch off the robot's topics and alter its scans.
"""

import itertools
import math
import threading
import time

import numpy as np
import rospy
from actionlib_msgs.msg import GoalID, GoalStatus, GoalStatusArray
from applr_ros1.msg import Decision, Parameters
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseStamped, TransformStamped, Twist
from nav_msgs.msg import Odometry, Path
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import LaserScan
from std_msgs.msg import Time
from tf2_msgs.msg import TFMessage

from applr_ros1.common.angles import compose
from applr_ros1.policy.decision import Context, Seen
from applr_ros1.policy.observation import LAYOUT
from applr_ros1.policy.parameter_space import SPACE
from tests.support.toy_robot import (
    ANGLE_MAX,
    ANGLE_MIN,
    INCREMENT,
    LASER_X,
    RANGE_MAX,
    RANGE_MIN,
    ToyRobot,
)

TICK = 0.01  # simulation step [s]
COMMAND_TIMEOUT = 0.25  # age of a command after which the base stops [s]


class FakeJackal:
    """Robot that follows /cmd_vel among round obstacles and publishes scan, odometry, tf and optionally /clock.

    Args:
        circles: Obstacles (n, 3) of x, y, radius [m].
        pose: Initial pose (x, y, yaw).
        clock: Initial time of /clock [s], from which stamps are taken; None for wall time without /clock.
    """

    ticking = True

    def __init__(self, circles=(), pose=(0.0, 0.0, 0.0), clock=None):
        self.robot = ToyRobot(pose, circles)
        self.clock = clock
        self.scans = self.transforms = True
        self.bend = lambda scan: scan  # function that alters each scan before publication
        self.commands = []  # (wall time, v, w)
        self._command = 0.0, 0.0
        self._ends = []
        self._tf, self._odometry = (
            self._publisher("/tf", TFMessage),
            self._publisher("/odometry/filtered", Odometry),
        )
        self._scan, self._clock = (
            self._publisher("/front/scan", LaserScan),
            self._publisher("/clock", Clock),
        )
        mounted = rospy.Publisher("/tf_static", TFMessage, queue_size=1, latch=True)
        mounted.publish(
            TFMessage([transform("base_link", "front_laser", (LASER_X, 0.0, 0.0), self.now())])
        )
        self._ends += [
            mounted,
            rospy.Subscriber("/cmd_vel", Twist, self._take, queue_size=50, tcp_nodelay=True),
        ]
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def _publisher(self, topic, kind):
        self._ends.append(rospy.Publisher(topic, kind, queue_size=50))
        return self._ends[-1]

    def close(self):
        self._over.set()
        self._thread.join(2.0)
        for end in self._ends:
            end.unregister()

    def now(self):
        return rospy.Time.from_sec(time.time() if self.clock is None else self.clock)

    def put(self, pose, circles=None):
        """Move the robot to a pose and, if given, replace the obstacles."""
        self.robot.pose = pose
        if circles is not None:
            self.robot.circles = ToyRobot(circles=circles).circles

    def _take(self, message):
        self._command = message.linear.x, message.angular.z
        self.commands.append((time.time(),) + self._command)

    def _run(self):
        due = time.time()
        for n in itertools.count(1):
            due += TICK
            if self._over.wait(max(0.0, due - time.time())):
                return
            if self.ticking:
                if self.clock is not None:
                    self.clock += TICK
                    self._clock.publish(self.now())
                self._tick(n, self.now())

    def _tick(self, n, stamp):
        fresh = self.commands and time.time() - self.commands[-1][0] < COMMAND_TIMEOUT
        self.robot.drive(self._command if fresh else None, TICK)
        if n % 2 == 0:
            self._publish_pose(stamp)
        if n % 5 == 0 and self.scans:
            self._publish_scan(stamp, self.robot.ranges())

    def _publish_scan(self, stamp, ranges):
        limits = {
            "angle_min": ANGLE_MIN,
            "angle_max": ANGLE_MAX,
            "range_min": RANGE_MIN,
            "range_max": RANGE_MAX,
        }
        scan = LaserScan(angle_increment=INCREMENT, ranges=ranges.tolist(), **limits)
        scan.header.stamp, scan.header.frame_id = stamp, "front_laser"
        self._scan.publish(self.bend(scan))

    def _publish_pose(self, stamp):
        placed = transform("odom", "base_link", compose((0.0, 0.0, 0.0), self.robot.pose), stamp)
        if self.transforms:
            self._tf.publish(TFMessage([placed]))
        odometry = Odometry(child_frame_id="base_link")
        odometry.header = placed.header
        odometry.pose.pose.orientation = placed.transform.rotation
        odometry.pose.pose.position.x, odometry.pose.pose.position.y = self.robot.pose[:2]
        odometry.twist.twist.linear.x, odometry.twist.twist.angular.z = self.robot.twist
        self._odometry.publish(odometry)


class Standing(FakeJackal):
    """Jackal at rest that publishes a plan and optionally a goal, and records the messages of the applr node."""

    def __init__(self):
        self.reset()
        self.ticking = False  # The thread must not tick before the publishers exist.
        super().__init__(pose=self.pose)
        self.robot.twist = self.twist
        self._plan = self._publisher("/move_base/NavfnROS/plan", Path)
        self._status = self._publisher("/move_base/status", GoalStatusArray)
        for topic, kind, callback in (
            ("/applr/decision", Decision, self._on_decision),
            ("/applr/course_end", Decision, lambda m: self.ends.append(m)),
            ("/applr/heartbeat", Time, lambda m: self.beats.append(m.data.to_sec())),
            ("/applr/parameters", Parameters, lambda m: self.parameters.append(list(m.values))),
            ("/diagnostics", DiagnosticArray, self._on_diagnostics),
        ):
            self._ends.append(rospy.Subscriber(topic, kind, callback, queue_size=50))
        self.ticking = True

    def reset(self):
        self.ranges = np.random.default_rng(0).uniform(0.3, 4.0, 720).astype(np.float32)
        self.pose, self.twist = (0.5, -0.25, 0.4), (0.3, -0.1)
        self.path = np.column_stack([np.linspace(0.5, 5.0, 180), np.sin(np.linspace(0, 2, 180))])
        self.goal = self.clock = None
        self.statuses = True  # whether move_base's status is published
        self.decisions, self.messages, self.ends = [], [], []
        self.beats, self.parameters, self.values = [], [], {}

    def count(self, key):
        return int(self.values.get(key, 0))

    def _on_decision(self, message):
        self.decisions.append(decided(message))
        self.messages.append(message)

    def _on_diagnostics(self, message):
        status = message.status[0]
        self.values = {
            **{v.key: v.value for v in status.values},
            "level": status.level,
            "message": status.message,
        }

    def _tick(self, n, stamp):
        if n % 2:
            return
        goal = self.goal
        if self.statuses:
            active = (
                [GoalStatus(GoalID(id=goal), GoalStatus.ACTIVE, "")] if goal is not None else []
            )
            status = GoalStatusArray(status_list=active)
            status.header.stamp = stamp
            self._status.publish(status)
        self._publish_pose(stamp)
        self._publish_scan(stamp, self.ranges)
        if goal is not None:
            plan = Path()
            plan.header.stamp, plan.header.frame_id = stamp, "odom"
            for x, y in self.path:
                plan.poses.append(PoseStamped())
                plan.poses[-1].pose.position.x, plan.poses[-1].pose.position.y = x, y
            self._plan.publish(plan)


def decided(message):
    """Return an applr_ros1/Decision as a dict. "theta" is empty if the method's output was rejected."""
    sets = {
        key: dict(zip(of.names, of.values))
        for key, of in (("theta_prev", message.before), ("theta", message.after))
    }
    return dict(sets, stamp=str(message.header.stamp), refused=message.refused)


def observed(message):
    """Return the paper's observation (729,) from an applr_ros1/Decision of a Jackal."""
    scan = np.array(message.ranges, np.float32), message.angle_min, message.angle_increment
    pose, plan = (
        (message.x, message.y, message.yaw),
        np.column_stack([message.plan_x, message.plan_y]),
    )
    seen = Seen(scan, message.elapsed, pose, (message.v, message.w), pose, plan, np.zeros((0, 4)))
    return Context.of(np.array(message.before.values), seen, SPACE, LAYOUT).observation


def transform(parent, child, pose, stamp):
    """Return the geometry_msgs/TransformStamped of a frame at a pose (x, y, yaw) in its parent."""
    t = TransformStamped(child_frame_id=child)
    t.header.frame_id, t.header.stamp = parent, stamp
    t.transform.translation.x, t.transform.translation.y = pose[:2]
    t.transform.rotation.z, t.transform.rotation.w = math.sin(pose[2] / 2), math.cos(pose[2] / 2)
    return t
