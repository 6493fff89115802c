"""tf for a node that seldom needs it: listened to from the first question on, until nobody asks any more."""

from __future__ import annotations

import math
from typing import Any, Optional, Tuple

import numpy as np
import rospy

from applr_ros1.common.angles import yaw_of
from applr_ros1.nodes.conversions import cos_tilt, with_infinity
from applr_ros1.policy.observation import ObservationError

LEVEL = 0.95  # least cosine of the tilt, 18 degrees, of a laser that scans level
MAX_AHEAD = 3.0  # [s] that a transform's stamp may be ahead of the clock; amcl's are, by its transform_tolerance


class Transforms:
    """What tf knows."""

    def __init__(self) -> None:
        self._buffer: Any = None
        self._listener: Any = None

    def newest(self, target: str, source: str, oldest: float = math.inf) -> Any:
        """The newest geometry_msgs/Transform of `source` in `target`.

        ObservationError, of one line, where there is none, or where it is older than `oldest` [s].
        """
        import tf2_ros

        if self._buffer is None:
            self._buffer = tf2_ros.Buffer(rospy.Duration(10.0))
            self._listener = tf2_ros.TransformListener(self._buffer)
        try:
            found = self._buffer.lookup_transform(target.lstrip("/"), source.lstrip("/"), rospy.Time(0))
        except tf2_ros.TransformException as e:
            raise ObservationError(f"no transform {target} <- {source} ({str(e).splitlines()[0]})") from None
        if found.header.stamp.is_zero():  # a static transform
            return found.transform
        ahead = (found.header.stamp - rospy.Time.now()).to_sec()
        if ahead > MAX_AHEAD:
            self._buffer.clear()  # else tf would refuse every right transform for `ahead` seconds
            raise ObservationError(f"transform {target} <- {source} is stamped {ahead:.2f} s ahead of the clock")
        if -ahead > oldest:
            raise ObservationError(f"transform {target} <- {source} is {-ahead:.2f} s old: is localisation running?")
        return found.transform

    def rest(self) -> None:
        """Stop listening, which costs a share of a core, until the next question."""
        if self._listener is not None:
            self._listener.unregister()
            self._buffer = self._listener = None


class LaserMount:
    """How a fixed laser is mounted on the robot: as tf says, and as the robot's description says until tf knows.

    Args:
        transforms: tf.
        yaw: of the laser in the robot's frame, by the description [rad].
        no_return: range [m] that becomes +inf (conversions.with_infinity).
    """

    def __init__(self, transforms: Transforms, yaw: float, no_return: Optional[float] = None):
        self._transforms, self._described, self._no_return = transforms, yaw, no_return
        self._known: dict = {}  # {(robot's frame, laser's frame): (yaw, cosine of the tilt)}

    def beams(self, scan: Any, base: str) -> Tuple[Any, float, float]:
        """(ranges, angle of the first [rad], step to the next [rad]) of a sensor_msgs/LaserScan, in the frame `base`.

        Angles are counter-clockwise as seen from above. ObservationError for a laser that does not scan horizontally.
        """
        frames = base, scan.header.frame_id
        if frames not in self._known:
            self._ask(*frames)
        yaw, upright = self._known.get(frames, (self._described, 1.0))
        if abs(upright) < LEVEL:
            raise ObservationError(f"the laser in {frames[1]} is mounted aslant: the policy needs one that scans level")
        first, step = scan.angle_min, scan.angle_increment
        ranges = with_infinity(np.asarray(scan.ranges, np.float32), self._no_return)
        if upright < 0.0:
            return ranges[::-1], yaw - first - (len(ranges) - 1) * step, step
        return ranges, yaw + first, step

    def _ask(self, base: str, laser: str) -> None:
        try:
            transform = self._transforms.newest(base, laser)
        except ObservationError:
            return
        self._transforms.rest()
        self._known[base, laser] = yaw_of(transform.rotation), cos_tilt(transform)
