"""The transforms of tf, and the mount of the policy's laser by them, for the nodes that place what sensors say."""

from __future__ import annotations

import math
from typing import Any, Optional, Tuple

import numpy as np
import rospy
import tf2_ros

from applr_ros1.common.angles import yaw_of
from applr_ros1.common.errors import reason
from applr_ros1.nodes.conversions import cos_tilt, from_above, with_infinity
from applr_ros1.policy.observation import ObservationError

LEAST_LEVEL_COS = 0.95  # least cosine of the tilt, 18 degrees, of a laser that scans level
MAX_AGE_S = 1.0  # age of a message, and time that its stamp is ahead of the clock, above which it is not used [s]
MAX_AHEAD_S = 3.0  # s that a transform's stamp may be ahead of the clock; amcl's are, by its transform_tolerance


def check_age(
    what: str,
    stamp: rospy.Time,
    now: rospy.Time,
    oldest: float = MAX_AGE_S,
    most_ahead: float = MAX_AGE_S,
    hint: str = "is its clock that of this machine?",
) -> None:
    """Raise ObservationError if a stamp is more than `oldest` [s] old or `most_ahead` [s] ahead of the clock."""
    age = (now - stamp).to_sec()
    if not -most_ahead <= age <= oldest:
        most = f"old, {oldest:g} s" if age > 0.0 else f"ahead of the clock, {most_ahead:g} s"
        raise ObservationError(f"{what} is {abs(age):.2f} s {most} can be used: {hint}")


class Transforms:
    """A tf buffer, filled from the first question on, until `rest`. Errors are ObservationErrors of one line."""

    def __init__(self) -> None:
        self.buffer = tf2_ros.Buffer(rospy.Duration(10.0), debug=False)
        self._listener: Optional[tf2_ros.TransformListener] = None

    def listen(self) -> None:
        """Fill the buffer from now on."""
        self._listener = self._listener or tf2_ros.TransformListener(
            self.buffer, queue_size=100, buff_size=2**20, tcp_nodelay=True
        )

    def at(self, target: str, source: str, stamp: rospy.Time) -> Any:
        """Return the geometry_msgs/TransformStamped of `source` in `target` at a time; time 0: the newest of all."""
        if not source.strip("/"):
            raise ObservationError("a message has no frame_id: give it one")
        self.listen()
        try:
            return self.buffer.lookup_transform(target.lstrip("/"), source.lstrip("/"), stamp)
        except tf2_ros.TransformException as error:
            when = "the newest" if stamp.is_zero() else f"{stamp.to_sec():.3f}"
            raise ObservationError(f"transform {target} <- {source} at {when}: {reason(error)}") from None

    def has(self, target: str, source: str, stamp: rospy.Time) -> bool:
        """Return whether `at` would give the transform now."""
        return self.buffer.can_transform_core(target.lstrip("/"), source.lstrip("/"), stamp)[0]

    def newest(self, target: str, source: str, oldest: float = math.inf) -> Any:
        """Return the newest geometry_msgs/Transform of `source` in `target`, at most `oldest` [s] old."""
        found = self.at(target, source, rospy.Time(0))
        self.check_age(found, target, rospy.get_rostime(), oldest, MAX_AHEAD_S, "is localisation running?")
        return found.transform

    def check_age(self, found: Any, target: str, now: rospy.Time, oldest: float, most_ahead: float, hint: str) -> None:
        """Raise ObservationError if a geometry_msgs/TransformStamped is too old or too far ahead, as `check_age`."""
        stamp = found.header.stamp or now  # 0: a static one
        if (stamp - now).to_sec() > max(MAX_AGE_S, most_ahead):
            self.buffer.clear()  # tf would refuse every right transform for as long as this one is ahead
        check_age(f"transform {target} <- {found.child_frame_id}", stamp, now, oldest, most_ahead, hint)

    def rest(self) -> None:
        """Stop listening, which costs a share of a core, until the next question."""
        if self._listener is not None:
            self._listener.unregister()
            self._listener = None
        self.buffer.clear()


class LaserMount:
    """The mount of a fixed laser on the robot: as tf says, and as the robot's description says until tf knows.

    Args:
        transforms: tf.
        yaw: of the laser in the robot's frame, by the description [rad].
        no_return: range [m] that becomes +inf (conversions.with_infinity).
    """

    def __init__(self, transforms: Transforms, yaw: float, no_return: Optional[float] = None):
        self._transforms, self._described, self._no_return = transforms, yaw, no_return
        self._known: dict = {}  # {(robot's frame, laser's frame): (yaw, cosine of the tilt)}

    def beams(self, scan: Any, base: str) -> Tuple[Any, float, float]:
        """Return (ranges, angle of the first, step to the next [rad]) of a sensor_msgs/LaserScan, in the frame `base`.

        Angles are counter-clockwise as seen from above. ObservationError for a laser that does not scan horizontally.
        """
        frames = base, scan.header.frame_id
        if frames not in self._known:
            self._ask(*frames)
        yaw, upright = self._known.get(frames, (self._described, 1.0))
        if abs(upright) < LEAST_LEVEL_COS:
            raise ObservationError(f"the laser in {frames[1]} is mounted aslant: the policy needs one that scans level")
        ranges = with_infinity(np.asarray(scan.ranges, np.float32), self._no_return)
        ranges, first = from_above(scan, ranges, upright < 0.0)
        return ranges, yaw + first, scan.angle_increment

    def _ask(self, base: str, laser: str) -> None:
        try:
            transform = self._transforms.newest(base, laser)
        except ObservationError:
            return
        self._known[base, laser] = yaw_of(transform.rotation), cos_tilt(transform)
