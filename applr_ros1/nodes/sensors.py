"""What the move_base node knows of its robot: pose from tf, twist from odometry, the newest usable scan.

Callbacks only store; the node's thread asks once per cycle. What is wrong is said in one line, at most every second.
"""

from __future__ import annotations

import math
from collections import deque
from typing import Optional, Tuple

import rospy
import tf2_ros
from nav_msgs.msg import Odometry
from sensor_msgs.msg import LaserScan as ScanMessage

from applr_ros1.common.angles import compose, yaw_of

from . import conversions
from .conversions import MessageError, Pose

WAITING = 20  # scans kept until their transform comes
AHEAD = 1.0  # s by which a stamp may be ahead of the clock
BEAMS_HELD = 2.0  # s without a usable scan after which the scanner may have another number of beams
TF_ERRORS = (
    tf2_ros.LookupException,
    tf2_ros.ConnectivityException,
    tf2_ros.ExtrapolationException,
    tf2_ros.InvalidArgumentException,
    tf2_ros.TransformException,
)


class Sensors:
    """Frames: `fixed` (the costmaps' global frame) and `base`; topics: `topic` of the scan, `odometry`."""

    def __init__(self, fixed: str, base: str, topic: str, odometry: str = "odom"):
        self.fixed, self.base = fixed, base
        self.buffer = tf2_ros.Buffer(rospy.Duration(10.0), debug=False)
        self._listener = tf2_ros.TransformListener(self.buffer, queue_size=100, buff_size=2**20)
        self._twist: Tuple[float, float] = (0.0, 0.0)
        self._heard = rospy.Time(0)  # when the newest odometry came
        self._scans: deque = deque(maxlen=WAITING)
        self._newest = rospy.Time(0)
        self._beams: Optional[int] = None
        self.pose_trouble = self.scan_trouble = ""  # the last thing that was wrong, for who says why the robot stands
        self._odometry = rospy.Subscriber(odometry, Odometry, self._take_odometry, queue_size=1, buff_size=2**20)
        self._scan = rospy.Subscriber(topic, ScanMessage, self._scans.append, queue_size=1, buff_size=2**24)
        self.topic = self._scan.resolved_name

    def _take_odometry(self, message) -> None:
        twist = message.twist.twist.linear.x, message.twist.twist.angular.z
        if all(map(math.isfinite, twist)):
            self._twist, self._heard = twist, rospy.get_rostime()
        else:
            rospy.logerr_throttle(1.0, "odometry has the twist %s: not used" % (twist,))

    def forget(self) -> None:
        """The clock went back: everything older than it is void."""
        self.buffer.clear()
        self._scans.clear()
        self._newest = self._heard = rospy.Time(0)
        self._twist = (0.0, 0.0)

    def twist(self) -> Tuple[float, float]:
        """(v [m/s], w [rad/s]) of the newest odometry; zeros before the first."""
        return self._twist

    def odometry_trouble(self, now, patience: float) -> str:
        """What is wrong if no odometry has come for `patience` [s], or ever; "" if it comes."""
        age = (now - self._heard).to_sec()
        if age <= patience:
            return ""
        since = "yet" if self._heard.is_zero() else "for %.2f s" % age
        return "no usable odometry on %s %s" % (self._odometry.resolved_name, since)

    def pose(self, now, tolerance: float) -> Optional[Pose]:
        """The robot's newest pose in the fixed frame; None if there is none within `tolerance` [s] of now."""
        transform, self.pose_trouble = self._look_up(self.base, rospy.Time(0))
        if transform is None:
            return None
        age = (now - transform.header.stamp).to_sec()
        if abs(age) > tolerance and not transform.header.stamp.is_zero():  # stamp 0: a static transform
            self.pose_trouble = "transform %s <- %s is %.2f s %s, transform_tolerance is %g s" % (
                self.fixed,
                self.base,
                abs(age),
                "old" if age > 0.0 else "ahead of the clock",
                tolerance,
            )
            if age < -AHEAD:
                self.buffer.clear()  # else tf would refuse every right transform for as long as this one is ahead
            return None
        return conversions.pose_of(transform.transform)

    def scan(self):
        """The newest scan whose transform is there (planner.scan.LaserScan), or None if there is no new one."""
        waiting = []
        found = None
        while self._scans and found is None:
            message = self._scans.pop()
            if message.header.stamp <= self._newest:
                continue
            found = self._use(message)
            if found is None:
                waiting.append(message)
        if found is not None:
            self._scans.clear()
        else:
            self._scans.extendleft(m for m in waiting if self._is_recent(m))
        return found

    def _is_recent(self, message) -> bool:
        return abs((rospy.get_rostime() - message.header.stamp).to_sec()) < 2.0

    def _use(self, message):
        now = rospy.get_rostime()
        beams = self._beams if now - self._newest < rospy.Duration(BEAMS_HELD) else None
        try:
            ahead = (message.header.stamp - now).to_sec()
            if ahead > AHEAD:
                raise MessageError("is stamped %.2f s ahead of the clock" % ahead)
            ranges = conversions.check_scan(message, beams)
        except MessageError as problem:
            self.scan_trouble = "%s %s" % (self.topic, problem)
            rospy.logerr_throttle(1.0, "%s: not used" % self.scan_trouble)
            message.header.stamp = rospy.Time(0)  # never looked at again
            return None
        transform, trouble = self._look_up(message.header.frame_id, message.header.stamp)
        if transform is None:
            self.scan_trouble = trouble
            return None
        self._beams, self._newest = len(ranges), message.header.stamp
        return conversions.laser_scan(
            message, ranges, conversions.pose_of(transform.transform), transform.transform.translation.z
        )

    def to_fixed(self, message):
        """(x, y, yaw) of a geometry_msgs/PoseStamped in the fixed frame; MessageError if its frame is not known."""
        p, frame = message.pose, message.header.frame_id.lstrip("/")
        pose = p.position.x, p.position.y, yaw_of(p.orientation)
        if frame == self.fixed:
            return pose
        transform, trouble = self._look_up(frame, rospy.Time(0))
        if transform is None:
            raise MessageError(
                "frame %r cannot be transformed to %s: %s" % (message.header.frame_id, self.fixed, trouble)
            )
        return compose(conversions.pose_of(transform.transform), pose)

    def _look_up(self, frame: str, stamp):
        """(transform fixed <- frame, "") or (None, why there is none)."""
        if not frame.strip("/"):
            return None, "a message has no frame_id: give it one"
        try:
            return self.buffer.lookup_transform(self.fixed, frame.lstrip("/"), stamp), ""
        except TF_ERRORS as error:
            when = "the newest" if stamp.is_zero() else "%.3f" % stamp.to_sec()
            return None, "transform %s <- %s at %s: %s" % (self.fixed, frame, when, str(error).strip().split("\n")[0])
