"""Input of the move_base node: pose and localisation from tf, twist from odometry, sensor data.

Callbacks only store; the node's thread asks once per cycle. What is wrong is said in one line, at most every second.
"""

from __future__ import annotations

import contextlib
import math
import threading
import time
from collections import deque
from typing import Any, Deque, Dict, Mapping, Optional, Sequence, Tuple

import rospy
from nav_msgs.msg import Odometry
from rospy.rostime import is_wallclock
from sensor_msgs.msg import LaserScan as ScanMessage
from sensor_msgs.msg import PointCloud as OldCloudMessage
from sensor_msgs.msg import PointCloud2 as CloudMessage

from applr_ros1.common.angles import compose
from applr_ros1.policy.observation import ObservationError
from applr_ros1.robots import Robot

from . import conversions
from .conversions import MessageError, Pose
from .transforms import MAX_AGE_S, MAX_AHEAD_S, Transforms

SCANS_KEPT = 20  # scans kept until their transform comes
MESSAGES = {"LaserScan": ScanMessage, "PointCloud2": CloudMessage, "PointCloud": OldCloudMessage}
ADJUSTMENT_S = 1.0  # s by which a wall clock may be set back without counting as a jump (NTP does this)


class Clock:
    """ROS time as it was read last, and whether it went back. `Sensors.forget` then drops what came before.

    Attributes:
        now: The time.
    """

    def __init__(self) -> None:
        self.now, self._changed = rospy.get_rostime(), time.monotonic()

    def stands(self, seconds: float) -> bool:
        """Return whether the time has not changed for `seconds` of wall time."""
        return time.monotonic() - self._changed > seconds

    def went_back(self) -> bool:
        """Read the time; return whether it went back: if simulated at all, else by more than ADJUSTMENT_S."""
        last, self.now = self.now, rospy.get_rostime()
        if self.now != last:
            self._changed = time.monotonic()
        return self.now < last and (not is_wallclock() or (last - self.now).to_sec() > ADJUSTMENT_S)


class Sensors:
    """The robot's sensors.

    Args:
        frames: of the local costmap, of the global costmap, of the robot base.
        topics: {topic: data type} of the observation sources.
        origins: {topic: frame at whose origin the rays start}; frames that tf does not know are passed over.
        odometry: topic of the odometry.
        no_return: range [m] that laser scans state where nothing returns, beside +inf (Laser of robots/robot.py).
    """

    def __init__(
        self,
        frames: Tuple[str, str, str],
        topics: Mapping[str, str],
        origins: Mapping[str, str],
        odometry: str = "odom",
        no_return: Optional[float] = None,
    ):
        self.local, self.globe, self.base = (frame.lstrip("/") for frame in frames)
        self.transforms = Transforms()
        self._no_return = no_return
        self._twist: Tuple[float, float] = (0.0, 0.0)
        self._heard = rospy.Time(0)  # when the newest odometry came
        self._stamps = {"pose": rospy.Time(0), "twist": rospy.Time(0)}  # of the newest ones
        self.pose_trouble = ""  # the last thing that was wrong, for who says why the robot stands
        self._topics = {topic: _Topic(topic, kind, origins.get(topic, "")) for topic, kind in topics.items()}
        self._odometry = rospy.Subscriber(
            odometry, Odometry, self._take_odometry, queue_size=1, buff_size=2**20, tcp_nodelay=True
        )
        self.transforms.listen()

    @classmethod
    def of_lasers(cls, robot: Robot, prefix: str, frame: str, more_scans: Sequence[str] = ()) -> Sensors:
        """Return the sensors of a robot, its laser and further ones by topic, placed in `frame`.

        The names of the robot's frames begin with `prefix`.
        """
        topics = dict.fromkeys([robot.topics.scan, *more_scans], "LaserScan")
        frames = frame, frame, prefix + robot.frames.base
        return cls(frames, topics, {}, robot.topics.odometry, robot.laser.no_return)

    def _take_odometry(self, message) -> None:
        twist = message.twist.twist.linear.x, message.twist.twist.angular.z
        if all(map(math.isfinite, twist)):
            self._twist, self._heard, self._stamps["twist"] = twist, rospy.get_rostime(), message.header.stamp
        else:
            rospy.logerr_throttle(1.0, f"odometry has the twist {twist}: not used")

    def forget(self) -> None:
        """Forget what is older than a clock that went back."""
        self.transforms.buffer.clear()
        self._heard = rospy.Time(0)
        self._stamps = dict.fromkeys(self._stamps, rospy.Time(0))
        for topic in self._topics.values():
            topic.forget()
        self._twist = (0.0, 0.0)

    def resolved(self, topic: str) -> str:
        """Return the full name of a source's topic."""
        return self._topics[topic].name if topic in self._topics else rospy.resolve_name(topic)

    def newest(self, topic: str) -> str:
        """Stamp and age of the newest message of a source's topic, and what was wrong with it, for people."""
        known = self._topics.get(topic)
        if known is None or known.stamp.is_zero():
            return "none has come"
        age = (rospy.get_rostime() - known.stamp).to_sec()
        return f"the newest is stamped {known.stamp.to_sec():.3f}, {age:.2f} s ago; {known.trouble}".rstrip("; ")

    def clear_errors(self) -> None:
        """Nothing is wrong with the sources any more."""
        for topic in self._topics.values():
            topic.trouble = ""

    def twist(self) -> Tuple[float, float]:
        """Return (v [m/s], w [rad/s]) of the newest odometry; zeros before the first."""
        return self._twist

    def stamps(self) -> Dict[str, rospy.Time]:
        """Return the stamps {"scan", "pose", "twist"} of the newest that were used; 0: none."""
        scan = max((topic.used for topic in self._topics.values() if topic.is_scan), default=rospy.Time(0))
        return dict(self._stamps, scan=scan)

    def ages(self, now) -> Dict[str, float]:
        """Return {"scan_age_s", "pose_age_s", "twist_age_s"}: the time [s] since each of `stamps`, if there is one."""
        return {name + "_age_s": (now - stamp).to_sec() for name, stamp in self.stamps().items() if not stamp.is_zero()}

    def odometry_trouble(self, now, patience: float) -> str:
        """Return the complaint if no odometry has come for `patience` [s], or ever; "" if it comes."""
        age = (now - self._heard).to_sec()
        if age <= patience:
            return ""
        since = "yet" if self._heard.is_zero() else f"for {age:.2f} s"
        return f"no usable odometry on {self._odometry.resolved_name} {since}"

    def pose(self, now, tolerance: float) -> Optional[Pose]:
        """Return the robot's newest pose in the local frame; None if there is none within `tolerance` [s] of now."""
        return self._newest_pose(self.local, self.base, now, tolerance, tolerance)

    def frame(self, now, tolerance: float) -> Optional[Pose]:
        """Return the newest pose of the local frame in the global one, None if it is older than `tolerance` [s].

        Localisation stamps it ahead of the clock, so that it is good until the next one comes (amcl by 0.1 to 2 s).
        """
        return self._newest_pose(self.globe, self.local, now, tolerance, max(tolerance, MAX_AHEAD_S))

    def _newest_pose(self, target, source, now, oldest, most_ahead):
        self.pose_trouble = ""
        try:
            transform = self.transforms.newest(target, source, now, oldest, most_ahead, "check transform_tolerance")
        except ObservationError as problem:
            self.pose_trouble = str(problem)
            return None
        if source == self.base:
            self._stamps["pose"] = transform.header.stamp
        return conversions.pose_of(transform.transform)

    def observations(self) -> Dict[str, Any]:
        """Return {topic: what is new there (common.scan)}, of all topics whose transform is there."""
        found = {name: topic.newest(self._use) for name, topic in self._topics.items()}
        return {name: observation for name, observation in found.items() if observation is not None}

    def _use(self, topic, message):
        """Return the observation of a message, None while its transform is not there. Raises MessageError."""
        ahead = (message.header.stamp - rospy.get_rostime()).to_sec()
        if ahead > MAX_AGE_S:
            raise MessageError(f"is stamped {ahead:.2f} s ahead of the clock")
        frame, stamp = message.header.frame_id, message.header.stamp
        try:
            transform = self.transforms.at(self.local, frame, stamp).transform
        except ObservationError as problem:
            topic.trouble = str(problem)
            return None
        origin = None
        if topic.origin not in ("", frame.lstrip("/")):
            with contextlib.suppress(ObservationError):
                origin = conversions.point_of(self.transforms.at(self.local, topic.origin, stamp).transform)
        if not topic.is_scan:
            return conversions.sensor_cloud(message, conversions.points_of(message), transform, origin)
        ranges = conversions.check_scan(message, self._no_return)
        return conversions.laser_scan(message, ranges, transform, origin)

    def to_global(self, message) -> Pose:
        """Return (x, y, yaw) of a geometry_msgs/PoseStamped in the global frame. Raises MessageError."""
        pose, frame = conversions.pose_of(message.pose), message.header.frame_id.lstrip("/")
        if frame == self.globe:
            return pose
        try:
            transform = self.transforms.at(self.globe, frame, rospy.Time(0)).transform
        except ObservationError as problem:
            raise MessageError(
                f"frame {message.header.frame_id!r} cannot be transformed to {self.globe}: {problem}"
            ) from None
        return compose(conversions.pose_of(transform), pose)


class _Topic:
    """The messages of one source's topic that wait, SCANS_KEPT at most, until they can be placed.

    Lasers may share a topic: what was used is known by frame, and the one that was used longest ago comes first.
    """

    def __init__(self, topic: str, data_type: str, origin: str):
        self.is_scan = data_type == "LaserScan"
        self.origin = origin.lstrip("/")
        self.trouble = ""
        self._used: Dict[str, rospy.Time] = {}  # its stamp
        self.stamp, self.name = rospy.Time(0), topic  # of the one that came last
        self._lock = threading.Lock()  # of what waits
        self._waiting: Deque[Any] = deque(maxlen=SCANS_KEPT)
        subscriber = rospy.Subscriber(
            topic, MESSAGES[data_type], self._take, queue_size=1, buff_size=2**24, tcp_nodelay=True
        )
        self.name = subscriber.resolved_name

    def _take(self, message) -> None:
        if message.header.stamp.is_zero():  # C++ takes it with the newest transform
            message.header.stamp = rospy.get_rostime()
            rospy.logwarn_once(f"{self.name}: its messages have no stamps: the time counts at which each comes")
        with self._lock:
            self._waiting.append(message)
            self.stamp = message.header.stamp

    def forget(self) -> None:
        with self._lock:
            self._waiting.clear()
            self._used = {}

    @property
    def used(self) -> rospy.Time:
        """The stamp of the newest message that was used; 0: none."""
        return max(self._used.values(), default=rospy.Time(0))

    def used_of(self, message: Any) -> rospy.Time:
        """Return the stamp of the newest one that was used of a message's frame; 0: none."""
        return self._used.get(message.header.frame_id, rospy.Time(0))

    def newest(self, use):
        """use(self, message) of the newest message that can be used and is newer than the last one; else None.

        Those that are newer, but cannot be placed yet, go on waiting; older ones count no more.
        """
        with self._lock:
            waiting = sorted(self._waiting, key=lambda message: message.header.stamp, reverse=True)
        found, refused = None, set()
        for message in sorted(waiting, key=self.used_of):
            if message.header.stamp <= self.used_of(message):
                continue
            try:
                found = use(self, message)
            except (ValueError, TypeError) as problem:
                self.trouble = f"{self.name} {problem}"
                rospy.logerr_throttle(1.0, f"{self.trouble}: not used")
                refused.add(id(message))
            if found is not None:
                self._used[message.header.frame_id] = message.header.stamp
                break
        with self._lock:
            kept = [m for m in self._waiting if m.header.stamp > self.used_of(m) and id(m) not in refused]
            self._waiting.clear()
            self._waiting.extend(filter(self._is_recent, kept))
        return found

    def _is_recent(self, message) -> bool:
        return abs((rospy.get_rostime() - message.header.stamp).to_sec()) < 2.0
