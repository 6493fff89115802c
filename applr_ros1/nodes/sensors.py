"""What the move_base node knows of its robot: pose and localisation from tf, twist from odometry, what sensors say.

Callbacks only store; the node's thread asks once per cycle. What is wrong is said in one line, at most every second.
"""

from __future__ import annotations

import math
from collections import deque
from typing import Any, Dict, Mapping, Optional, Tuple

import rospy
import tf2_ros
from nav_msgs.msg import Odometry
from sensor_msgs.msg import LaserScan as ScanMessage
from sensor_msgs.msg import PointCloud as OldCloudMessage
from sensor_msgs.msg import PointCloud2 as CloudMessage

from applr_ros1.common.angles import compose
from applr_ros1.common.errors import reason

from . import conversions
from .conversions import MessageError, Pose
from .transforms import MAX_AHEAD

WAITING = 20  # scans kept until their transform comes
AHEAD = 1.0  # s by which the stamp of a scan or of odometry may be ahead of the clock
BEAMS_HELD = 2.0  # s without a usable scan after which the scanner may have another number of beams
MESSAGES = {"LaserScan": ScanMessage, "PointCloud2": CloudMessage, "PointCloud": OldCloudMessage}


class Sensors:
    """The robot's sensors.

    Args:
        frames: of the local costmap, of the global costmap, of the robot base.
        topics: {topic: data type} of the observation sources.
        origins: {topic: frame at whose origin the rays start}; frames that tf does not know are passed over.
        odometry: topic of the odometry.
    """

    def __init__(
        self,
        frames: Tuple[str, str, str],
        topics: Mapping[str, str],
        origins: Mapping[str, str],
        odometry: str = "odom",
    ):
        self.local, self.globe, self.base = (frame.lstrip("/") for frame in frames)
        self.buffer = tf2_ros.Buffer(rospy.Duration(10.0), debug=False)
        self._listener = tf2_ros.TransformListener(self.buffer, queue_size=100, buff_size=2**20)
        self._twist: Tuple[float, float] = (0.0, 0.0)
        self._heard = rospy.Time(0)  # when the newest odometry came
        self.pose_trouble = ""  # the last thing that was wrong, for who says why the robot stands
        self._odometry = rospy.Subscriber(odometry, Odometry, self._take_odometry, queue_size=1, buff_size=2**20)
        self._topics = {topic: _Topic(topic, kind, origins.get(topic, "")) for topic, kind in topics.items()}

    def _take_odometry(self, message) -> None:
        twist = message.twist.twist.linear.x, message.twist.twist.angular.z
        if all(map(math.isfinite, twist)):
            self._twist, self._heard = twist, rospy.get_rostime()
        else:
            rospy.logerr_throttle(1.0, f"odometry has the twist {twist}: not used")

    def forget(self) -> None:
        """The clock went back: everything older than it is void."""
        self.buffer.clear()
        self._heard = rospy.Time(0)
        for topic in self._topics.values():
            topic.forget()
        self._twist = (0.0, 0.0)

    def resolved(self, topic: str) -> str:
        """The full name of a source's topic."""
        return self._topics[topic].name if topic in self._topics else rospy.resolve_name(topic)

    def trouble(self, topic: str) -> str:
        """What was wrong with the last message of a source's topic, "" if nothing was."""
        return self._topics[topic].trouble if topic in self._topics else ""

    def forgive(self) -> None:
        """Nothing is wrong with the sources any more."""
        for topic in self._topics.values():
            topic.trouble = ""

    def twist(self) -> Tuple[float, float]:
        """(v [m/s], w [rad/s]) of the newest odometry; zeros before the first."""
        return self._twist

    def odometry_trouble(self, now, patience: float) -> str:
        """What is wrong if no odometry has come for `patience` [s], or ever; "" if it comes."""
        age = (now - self._heard).to_sec()
        if age <= patience:
            return ""
        since = "yet" if self._heard.is_zero() else f"for {age:.2f} s"
        return f"no usable odometry on {self._odometry.resolved_name} {since}"

    def pose(self, now, tolerance: float) -> Optional[Pose]:
        """The robot's newest pose in the local frame; None if there is none within `tolerance` [s] of now."""
        return self._newest_pose(self.local, self.base, now, tolerance, tolerance)

    def frame(self, now, tolerance: float) -> Optional[Pose]:
        """The newest pose of the local frame in the global one; None if there is none of the last `tolerance` [s].

        Localisation stamps it ahead of the clock, so that it is good until the next one comes (amcl by 0.1 to 2 s).
        """
        return self._newest_pose(self.globe, self.local, now, tolerance, max(tolerance, MAX_AHEAD))

    def _newest_pose(self, target, source, now, oldest, most_ahead):
        transform, self.pose_trouble = self._look_up(target, source, rospy.Time(0))
        if transform is None:
            return None
        age = (now - transform.header.stamp).to_sec()
        if not -most_ahead <= age <= oldest and not transform.header.stamp.is_zero():  # stamp 0: a static transform
            old, ahead = (
                f"old, transform_tolerance is {oldest:g} s",
                f"ahead of the clock, {most_ahead:g} s can be used",
            )
            self.pose_trouble = f"transform {target} <- {source} is {abs(age):.2f} s {old if age > 0.0 else ahead}"
            if age < -max(AHEAD, most_ahead):
                self.buffer.clear()  # else tf would refuse every right transform for as long as this one is ahead
            return None
        return conversions.pose_of(transform.transform)

    def observations(self) -> Dict[str, Any]:
        """{topic: what is new there (planner.costmap.scan)}, of all topics whose transform is there."""
        found = {}
        for name, topic in self._topics.items():
            observation = topic.newest(self._use)
            if observation is not None:
                found[name] = observation
        return found

    def _use(self, topic, message):
        """The observation of a message, None while its transform is not there. MessageError where it is of no use."""
        now = rospy.get_rostime()
        ahead = (message.header.stamp - now).to_sec()
        if ahead > AHEAD:
            raise MessageError(f"is stamped {ahead:.2f} s ahead of the clock")
        beams = topic.beams if now - topic.used < rospy.Duration(BEAMS_HELD) else None
        values = conversions.check_scan(message, beams) if topic.is_scan else conversions.points_of(message)
        transform, trouble = self._look_up(self.local, message.header.frame_id, message.header.stamp)
        if transform is None:
            topic.trouble = trouble
            return None
        origin = None
        if topic.origin and topic.origin != message.header.frame_id.lstrip("/"):
            start, _ = self._look_up(self.local, topic.origin, message.header.stamp)
            origin = None if start is None else conversions.point_of(start.transform)
        topic.beams = len(values)
        if topic.is_scan:
            return conversions.laser_scan(message, values, transform.transform, origin)
        return conversions.sensor_cloud(message, values, transform.transform, origin)

    def to_global(self, message) -> Pose:
        """(x, y, yaw) of a geometry_msgs/PoseStamped in the global frame; MessageError if its frame is not known."""
        pose, frame = conversions.pose_of(message.pose), message.header.frame_id.lstrip("/")
        if frame == self.globe:
            return pose
        transform, trouble = self._look_up(self.globe, frame, rospy.Time(0))
        if transform is None:
            raise MessageError(f"frame {message.header.frame_id!r} cannot be transformed to {self.globe}: {trouble}")
        return compose(conversions.pose_of(transform.transform), pose)

    def _look_up(self, target: str, frame: str, stamp):
        """(transform target <- frame, "") or (None, why there is none)."""
        if not frame.strip("/"):
            return None, "a message has no frame_id: give it one"
        try:
            return self.buffer.lookup_transform(target, frame.lstrip("/"), stamp), ""
        except tf2_ros.TransformException as error:
            when = "the newest" if stamp.is_zero() else f"{stamp.to_sec():.3f}"
            return None, f"transform {target} <- {frame} at {when}: {reason(error)}"


class _Topic:
    """The messages of one source's topic that wait for their transforms."""

    def __init__(self, topic: str, data_type: str, origin: str):
        self.is_scan = data_type == "LaserScan"
        self.origin = origin.lstrip("/")
        self.trouble = ""
        self.beams: Optional[int] = None  # of the last one that was used
        self.used = rospy.Time(0)  # its stamp
        self._waiting: deque = deque(maxlen=WAITING)
        subscriber = rospy.Subscriber(topic, MESSAGES[data_type], self._waiting.append, queue_size=1, buff_size=2**24)
        self.name = subscriber.resolved_name

    def forget(self) -> None:
        self._waiting.clear()
        self.used = rospy.Time(0)

    def newest(self, use):
        """use(self, message) of the newest message that can be used and is not older than the last one; else None."""
        waiting = []
        found = None
        while self._waiting and found is None:
            message = self._waiting.pop()
            if message.header.stamp <= self.used:
                continue
            try:
                found = use(self, message)
            except MessageError as problem:
                self.trouble = f"{self.name} {problem}"
                rospy.logerr_throttle(1.0, f"{self.trouble}: not used")
                continue
            if found is None:
                waiting.append(message)
            else:
                self.used = message.header.stamp
        if found is not None:
            self._waiting.clear()
        else:
            self._waiting.extendleft(m for m in waiting if self._is_recent(m))
        return found

    def _is_recent(self, message) -> bool:
        return abs((rospy.get_rostime() - message.header.stamp).to_sec()) < 2.0
