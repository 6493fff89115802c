"""Sensor inputs of the nodes: pose and localisation from tf, twist from odometry, scans and clouds.

Callbacks only store messages, which the node's thread polls once per cycle. Each problem is logged
in one line, at most once per second.
"""

from __future__ import annotations

import contextlib
import math
import threading
import time
from collections import deque
from typing import Any, Callable, Deque, Dict, List, Mapping, Optional, Sequence, Tuple

import rospy
from nav_msgs.msg import Odometry
from rospy.rostime import is_wallclock
from sensor_msgs.msg import LaserScan as ScanMessage
from sensor_msgs.msg import PointCloud as OldCloudMessage
from sensor_msgs.msg import PointCloud2 as CloudMessage

from applr_ros1.common.angles import Pose, compose
from applr_ros1.common.messages import pose_of, twist_of
from applr_ros1.common.ros_node import LARGE_BUFFER, SMALL_BUFFER
from applr_ros1.monitor.odometry_check import OdometryCheck
from applr_ros1.policy.layout import ObservationError
from applr_ros1.robots import Robot
from applr_ros1.senses.standing import USABLE_AGE_S

from . import conversions
from .conversions import MessageError
from .transforms import MAX_AHEAD_S, TransformBuffer

SCANS_KEPT = 20  # number of messages of a topic that wait for their transform
MESSAGES = {"LaserScan": ScanMessage, "PointCloud2": CloudMessage, "PointCloud": OldCloudMessage}
RECENT_S = 2.0  # largest age or lead of a message that keeps waiting for its transform [s]
# Largest step back of a wall clock that does not count as a jump, such as NTP's [s]
ADJUSTMENT_S = 1.0


class RosClock:
    """Latest reading of ROS time, with detection of jumps back and of a stopped clock.

    Attributes:
        now: ROS time at the last call of `went_back`.
    """

    def __init__(self) -> None:
        self.now = rospy.get_rostime()
        self._changed = time.monotonic()  # wall time at which `now` changed

    def stands(self, seconds: float) -> bool:
        """Return whether ROS time has not changed for `seconds` of wall time."""
        return time.monotonic() - self._changed > seconds

    def went_back(self) -> bool:
        """Read the time and return whether it jumped back.

        A wall clock must jump by more than ADJUSTMENT_S.
        """
        last_time = self.now
        self.now = rospy.get_rostime()
        if self.now != last_time:
            self._changed = time.monotonic()
        step_back = (last_time - self.now).to_sec()
        return bool(step_back > (ADJUSTMENT_S if is_wallclock() else 0.0))


class Sensors:
    """Subscriptions to the robot's sensors, and its pose from tf.

    Args:
        frames: Frames of the local costmap, the global costmap and the robot base.
        topics: {topic: data type} of the observation sources.
        origins: {topic: frame at whose origin the rays start}. Frames unknown to tf are ignored.
        odometry: Topic of the odometry.
        no_return: Range [m] that means no return in laser scans, besides +inf (Laser of
            robots/robot.py).

    Attributes:
        twist: (v [m/s], w [rad/s]) of the latest odometry; zeros before the first.
        pose_trouble: Reason for the last localisation failure, or "".
        odometry_problem: Contradiction between the twists and the poses of `pose`, or "".
    """

    def __init__(
        self,
        frames: Tuple[str, str, str],
        topics: Mapping[str, str],
        origins: Mapping[str, str],
        odometry: str = "odom",
        no_return: Optional[float] = None,
    ):
        # tf2 knows no frames with a leading slash, which files written for tf may have.
        self.local, self.globe, self.base = (frame.lstrip("/") for frame in frames)
        self.transforms = TransformBuffer()
        self._no_return = no_return
        self.pose_trouble = ""
        self._odometry_check = OdometryCheck()
        self._topics: Dict[str, _Topic] = {}
        self.forget()
        for topic, data_type in topics.items():
            self._topics[topic] = _Topic(topic, data_type, origins.get(topic, ""))
        self._odometry = odometry
        rospy.Subscriber(
            odometry,
            Odometry,
            self._take_odometry,
            queue_size=1,
            buff_size=SMALL_BUFFER,
            tcp_nodelay=True,
        )
        self.transforms.listen()

    @classmethod
    def of_lasers(
        cls, robot: Robot, prefix: str, frame: str, more_scans: Sequence[str] = ()
    ) -> Sensors:
        """Return the sensors of a robot, with its poses and scans in `frame`.

        Args:
            robot: Description of the robot.
            prefix: Prefix of the robot's frames.
            frame: Frame of poses and scans.
            more_scans: Topics of further lasers.
        """
        topics = dict.fromkeys([robot.topics.scan, *more_scans], "LaserScan")
        frames = frame, frame, prefix + robot.frames.base
        return cls(frames, topics, {}, robot.topics.odometry, robot.laser.no_return)

    def _take_odometry(self, message: Odometry) -> None:
        """Store the speed and turn rate of a message, with its arrival."""
        # The base cannot drive sideways: a lateral velocity is noise or slip.
        twist = twist_of(message.twist.twist)
        if not all(map(math.isfinite, twist)):
            rospy.logerr_throttle(1.0, f"odometry message ignored: its twist {twist} is not finite")
            return
        self.twist = twist
        self._odometry_time = rospy.get_rostime()
        self._twist_stamp = message.header.stamp

    def forget(self) -> None:
        """Drop all data after the clock jumped back."""
        self.transforms.buffer.clear()
        self._odometry_time = rospy.Time(0)  # arrival time of the latest odometry
        self._pose_stamp = rospy.Time(0)
        self._twist_stamp = rospy.Time(0)
        for topic in self._topics.values():
            topic.forget()
        self.twist = (0.0, 0.0)
        self._odometry_check.clear()
        self.odometry_problem = ""

    def describe_latest(self, topic: str) -> str:
        """Describe stamp, age and problem of the latest message on a source's topic.

        If lasers share the topic, its frame says of which one it is.
        """
        source = self._topics.get(topic)
        if source is None or source.stamp.is_zero():
            return "no message has arrived"
        age = (rospy.get_rostime() - source.stamp).to_sec()
        message = "the latest message"
        if len(source.publishers) > 1:
            message += f", of frame {source.frame},"
        description = f"{message} has stamp {source.stamp.to_sec():.3f}, {age:.2f} s ago"
        return f"{description}; {source.trouble}" if source.trouble else description

    def publisher_of(self, topic: str, frame: str) -> str:
        """Return the name of the node that has published scans of `frame` on a source's topic."""
        return self._topics[topic].publishers[frame]

    def silent_topics(self, besides: str) -> List[str]:
        """Return the full names of the topics on which no message has arrived yet.

        Args:
            besides: Source that is left out.
        """
        topic_names = []
        for topic_name, topic in self._topics.items():
            if topic_name != besides and topic.stamp.is_zero():
                topic_names.append(topic.name)
        if self._odometry_time.is_zero():
            topic_names.append(rospy.resolve_name(self._odometry))
        return topic_names

    def clear_errors(self) -> None:
        """Clear the source errors."""
        for topic in self._topics.values():
            topic.trouble = ""

    def stamps(self) -> Dict[str, rospy.Time]:
        """Return the stamps {"scan", "pose", "twist"} of the latest used data; 0 for none."""
        latest_scan = rospy.Time(0)
        for topic in self._topics.values():
            if topic.is_scan:
                latest_scan = max(latest_scan, *topic.used.values(), rospy.Time(0))
        return {"scan": latest_scan, "pose": self._pose_stamp, "twist": self._twist_stamp}

    def ages(self, now: rospy.Time) -> Dict[str, float]:
        """Return the ages [s] of the nonzero `stamps`.

        The names are "scan_age_s", "pose_age_s" and "twist_age_s".
        """
        ages = {}
        for name, stamp in self.stamps().items():
            if not stamp.is_zero():
                ages[f"{name}_age_s"] = (now - stamp).to_sec()
        return ages

    def odometry_trouble(self, now: rospy.Time, patience: float) -> str:
        """Return a message if no odometry has arrived for `patience` [s] or at all, else ""."""
        # The arrival counts: many bases stamp their odometry by a clock of their own.
        age = (now - self._odometry_time).to_sec()
        if age <= patience:
            return ""
        since = "yet" if self._odometry_time.is_zero() else f"for {age:.2f} s"
        return f"no usable odometry on {rospy.resolve_name(self._odometry)} {since}"

    def pose(self, now: rospy.Time, tolerance: float) -> Optional[Pose]:
        """Return the latest pose of the robot in the local frame.

        None if it is not within `tolerance` [s] of now.
        """
        pose = self._latest_pose(self.local, self.base, now, tolerance, tolerance)
        if pose is not None and not self.odometry_trouble(now, USABLE_AGE_S):
            self._compare_odometry(now, pose)
        return pose

    def _compare_odometry(self, now: rospy.Time, pose: Pose) -> None:
        """Compare the latest twist with the robot's poses, and log a new contradiction."""
        stamp = self._pose_stamp
        if stamp.is_zero():  # Static transforms have stamp 0.
            stamp = now
        problem = self._odometry_check.take(stamp.to_sec(), pose, self.twist)
        if problem and problem != self.odometry_problem:
            rospy.logerr(f"{rospy.resolve_name(self._odometry)}: {problem}")
        self.odometry_problem = problem

    def frame(self, now: rospy.Time, tolerance: float) -> Optional[Pose]:
        """Return the latest pose of the local frame in the global frame.

        None if it is older than `tolerance` [s]. Localisation stamps this pose ahead of the clock
        (amcl by 0.1 to 2 s) so that it is valid until the next one.
        """
        most_ahead = max(tolerance, MAX_AHEAD_S)
        return self._latest_pose(self.globe, self.local, now, tolerance, most_ahead)

    def _latest_pose(
        self, target: str, source: str, now: rospy.Time, oldest: float, most_ahead: float
    ) -> Optional[Pose]:
        """Return the pose of `TransformBuffer.latest`; None, with `pose_trouble`, if it raises."""
        self.pose_trouble = ""
        try:
            transform = self.transforms.latest(target, source, now, oldest, most_ahead)
        except ObservationError as problem:
            self.pose_trouble = str(problem)
            return None
        if source == self.base:
            self._pose_stamp = transform.header.stamp
        return pose_of(transform.transform)

    def place_of(self, frame: str) -> Optional[Pose]:
        """Return the latest pose of a frame in the global frame, None if tf does not know it."""
        try:
            transform = self.transforms.at(self.globe, frame, rospy.Time(0)).transform
        except ObservationError:
            return None
        return pose_of(transform)

    def observations(self) -> Dict[str, Any]:
        """Return the new observations (common.scan) whose transforms are known.

        Returns:
            {topic: observation}
        """
        observations = {}
        for topic_name, topic in self._topics.items():
            observation = topic.latest(self._observation)
            if observation is not None:
                observations[topic_name] = observation
        return observations

    def _observation(self, topic: _Topic, message: Any) -> Any:
        """Return the observation of a message, or None until its transform is known.

        Raises:
            MessageError: The message cannot be used.
        """
        frame = message.header.frame_id
        stamp = message.header.stamp
        stamp_lead = (stamp - rospy.get_rostime()).to_sec()
        if stamp_lead > USABLE_AGE_S:
            raise MessageError(f"is stamped {stamp_lead:.2f} s ahead of the clock")
        try:
            transform = self.transforms.at(self.local, frame, stamp).transform
        except ObservationError as problem:
            topic.trouble = str(problem)
            return None

        # A frame that tf does not know is ignored, as in C++ (observation_buffer.cpp).
        origin = None
        if topic.origin not in ("", frame.lstrip("/")):
            with contextlib.suppress(ObservationError):
                origin = conversions.point_of(
                    self.transforms.at(self.local, topic.origin, stamp).transform
                )
        if not topic.is_scan:
            return conversions.sensor_cloud(message, transform, origin)
        ranges = conversions.check_scan(message, self._no_return)
        return conversions.laser_scan(message, ranges, transform, origin, self._no_return)

    def to_global(self, message: Any) -> Pose:
        """Return the pose (x, y, yaw) of a geometry_msgs/PoseStamped in the global frame.

        Raises:
            MessageError: tf cannot transform its frame.
        """
        goal_pose = pose_of(message.pose)
        frame = message.header.frame_id.lstrip("/")
        if frame == self.globe:
            return goal_pose
        # As in move_base.cpp, the latest transform: a goal is no measurement of its time.
        try:
            transform = self.transforms.at(self.globe, frame, rospy.Time(0)).transform
        except ObservationError as problem:
            failure = f"frame {message.header.frame_id!r} cannot be transformed to {self.globe}"
            raise MessageError(f"{failure}: {problem}") from None
        return compose(pose_of(transform), goal_pose)


class _Topic:
    """Queue of the messages on one source's topic that wait for their transform.

    At most SCANS_KEPT wait. Lasers may share a topic. Used stamps are kept by frame, and the frame
    that was used least recently comes first.

    Attributes:
        is_scan: Whether the messages are laser scans.
        origin: Frame at whose origin the rays start; "" for the frame of the messages.
        trouble: Reason why the latest message was not used, or "".
        used: Stamp of the last used message, by frame.
        publishers: Name of the node that published the last message, by frame.
        name: Full name of the topic.
        stamp: Stamp of the last message; 0 before the first.
        frame: Frame of the last message; "" before the first.
    """

    def __init__(self, topic: str, data_type: str, origin: str):
        self.is_scan = data_type == "LaserScan"
        self.origin = origin.lstrip("/")
        self.publishers: Dict[str, str] = {}
        self.name = rospy.resolve_name(topic)
        self.frame = ""
        self._lock = threading.Lock()  # guards _waiting
        self._waiting: Deque[Any] = deque(maxlen=SCANS_KEPT)
        self.forget()
        rospy.Subscriber(
            topic,
            MESSAGES[data_type],
            self._take,
            queue_size=1,
            buff_size=LARGE_BUFFER,
            tcp_nodelay=True,
        )

    def _take(self, message: Any) -> None:
        # C++ uses a message without stamp with the latest transform.
        if message.header.stamp.is_zero():
            message.header.stamp = rospy.get_rostime()
            problem = f"{self.name}: messages have no stamps"
            rospy.logwarn_once(f"{problem}: their arrival times are used")
        with self._lock:
            self._waiting.append(message)
            connection = getattr(message, "_connection_header", {})
            publisher_name = connection.get("callerid", "an unknown node")
            self.publishers[message.header.frame_id] = publisher_name
            self.stamp = message.header.stamp
            self.frame = message.header.frame_id

    def forget(self) -> None:
        with self._lock:
            self._waiting.clear()
            self.stamp = rospy.Time(0)
        self.trouble = ""
        self.used: Dict[str, rospy.Time] = {}

    def used_of(self, message: Any) -> rospy.Time:
        """Return the stamp of the last used message in the frame of `message`; 0 for none."""
        return self.used.get(message.header.frame_id, rospy.Time(0))

    def latest(self, use: Callable[[_Topic, Any], Any]) -> Any:
        """Return the observation of the latest usable message that is newer than the last used one.

        None if there is none. Newer messages without a transform keep waiting. Older messages are
        dropped.

        Args:
            use: Returns the observation of a message of this topic, or None until its transform is
                known.
        """
        # The sorts are stable: the latest message of the frame that has waited longest comes first.
        with self._lock:
            waiting = sorted(self._waiting, key=lambda message: message.header.stamp, reverse=True)
        observation = None
        refused_ids = set()
        for message in sorted(waiting, key=self.used_of):
            if message.header.stamp <= self.used_of(message):
                continue
            try:
                observation = use(self, message)
            except (ValueError, TypeError) as problem:
                self.trouble = f"{self.name} {problem}"
                rospy.logerr_throttle(1.0, f"message ignored: {self.trouble}")
                refused_ids.add(id(message))
            if observation is not None:
                self.used[message.header.frame_id] = message.header.stamp
                break

        # Messages may have arrived in the meantime, so that the queue is filtered, not replaced.
        with self._lock:
            kept_messages = []
            for message in self._waiting:
                age = (rospy.get_rostime() - message.header.stamp).to_sec()
                is_new = message.header.stamp > self.used_of(message)
                if is_new and id(message) not in refused_ids and abs(age) < RECENT_S:
                    kept_messages.append(message)
            self._waiting.clear()
            self._waiting.extend(kept_messages)
        return observation
