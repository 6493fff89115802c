"""Lookup of tf transforms, for nodes that transform sensor data."""

from __future__ import annotations

import math
from typing import Any, Optional

import rospy
import tf2_ros

from applr_ros1.common.errors import reason
from applr_ros1.policy.layout import ObservationError

MAX_AGE_S = 1.0  # largest usable age of a message, and largest lead of its stamp over the clock [s]
MAX_AHEAD_S = (
    3.0  # largest lead of a transform's stamp over the clock [s]; amcl adds its transform_tolerance
)


class Transforms:
    """Buffer of tf, filled from the first lookup until `unsubscribe`. Failed lookups raise ObservationError."""

    def __init__(self) -> None:
        self.buffer = tf2_ros.Buffer(rospy.Duration(10.0), debug=False)
        self._listener: Optional[tf2_ros.TransformListener] = None

    def listen(self) -> None:
        """Subscribe to tf, unless subscribed already."""
        self._listener = self._listener or tf2_ros.TransformListener(
            self.buffer, queue_size=100, buff_size=2**20, tcp_nodelay=True
        )

    def at(self, target: str, source: str, stamp: rospy.Time) -> Any:
        """Return the geometry_msgs/TransformStamped of `source` in `target` at `stamp`; stamp 0 means the latest."""
        if not source.strip("/"):
            raise ObservationError("a message has no frame_id: give it one")
        self.listen()
        try:
            return self.buffer.lookup_transform(target.lstrip("/"), source.lstrip("/"), stamp)
        except tf2_ros.TransformException as error:
            when = "" if stamp.is_zero() else f" at {stamp.to_sec():.3f}"
            raise ObservationError(
                f"transform {target} <- {source}{when}: {reason(error)}"
            ) from None

    def latest(
        self,
        target: str,
        source: str,
        now: rospy.Time,
        oldest: float = math.inf,
        most_ahead: float = MAX_AHEAD_S,
    ) -> Any:
        """Return the geometry_msgs/TransformStamped of `source` in `target` at `now`, else the latest one.

        Raises ObservationError if the transform is older than `oldest` [s], or more than `most_ahead` [s] ahead of now.
        """
        known = self.buffer.can_transform_core(target.lstrip("/"), source.lstrip("/"), now)[0]
        transform = self.at(target, source, now if known else rospy.Time(0))
        stamp = transform.header.stamp
        age = 0.0 if stamp.is_zero() else (now - stamp).to_sec()  # Static transforms have stamp 0.
        if -age > max(MAX_AGE_S, most_ahead):
            self.buffer.clear()  # Otherwise tf would reject all transforms older than this one.
        if not -most_ahead <= age <= oldest:
            most = (
                f"old; at most {oldest:g} s"
                if age > 0.0
                else f"ahead of the clock; at most {most_ahead:g} s"
            )
            problem = f"transform {target} <- {source} is {abs(age):.2f} s {most} is allowed"
            raise ObservationError(f"{problem}: check localisation and transform_tolerance")
        return transform

    def unsubscribe(self) -> None:
        """Stop listening, which costs CPU time, until the next lookup."""
        if self._listener is not None:
            self._listener.unregister()
            self._listener = None
        self.buffer.clear()
