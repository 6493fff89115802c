"""The transforms of tf, for the nodes that place what sensors say."""

from __future__ import annotations

import math
from typing import Any, Optional

import rospy
import tf2_ros

from applr_ros1.common.errors import reason
from applr_ros1.policy.observation import ObservationError

MAX_AGE_S = 1.0  # age of a message, and time that its stamp is ahead of the clock, above which it is not used [s]
MAX_AHEAD_S = 3.0  # s that a transform's stamp may be ahead of the clock; amcl's are, by its transform_tolerance


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

    def newest(
        self,
        target: str,
        source: str,
        now: rospy.Time,
        oldest: float = math.inf,
        most_ahead: float = MAX_AHEAD_S,
        hint: str = "is localisation running?",
    ) -> Any:
        """Return the newest geometry_msgs/TransformStamped of `source` in `target`.

        It is at most `oldest` [s] old, and its stamp at most `most_ahead` [s] ahead of the clock.
        """
        found = self.at(target, source, rospy.Time(0))
        age = 0.0 if found.header.stamp.is_zero() else (now - found.header.stamp).to_sec()  # 0: a static one
        if -age > max(MAX_AGE_S, most_ahead):
            self.buffer.clear()  # tf would refuse every right transform for as long as this one is ahead
        if not -most_ahead <= age <= oldest:
            most = f"old, {oldest:g} s" if age > 0.0 else f"ahead of the clock, {most_ahead:g} s"
            raise ObservationError(f"transform {target} <- {source} is {abs(age):.2f} s {most} can be used: {hint}")
        return found

    def rest(self) -> None:
        """Stop listening, which costs a share of a core, until the next question."""
        if self._listener is not None:
            self._listener.unregister()
            self._listener = None
        self.buffer.clear()
