"""Lookup of tf transforms, for nodes that transform sensor data."""

from __future__ import annotations

import math
from typing import Any, Optional

import rospy
import tf2_ros

from applr_ros1.common.errors import reason
from applr_ros1.common.ros_node import SMALL_BUFFER
from applr_ros1.policy.layout import ObservationError

BUFFER_S = 20.0  # time for which tf keeps transforms [s]
# Largest lead of a transform's stamp over the clock in the buffer [s], that of the largest
# transform_tolerance. tf refuses transforms that are BUFFER_S older than the latest one.
BUFFER_AHEAD_S = 10.0
# Largest lead of a transform's stamp over the clock [s]; amcl adds its transform_tolerance.
MAX_AHEAD_S = 3.0


class _Buffer(tf2_ros.Buffer):  # type: ignore[misc]  # ROS packages have no type hints.
    """Buffer of tf that ignores transforms stamped more than BUFFER_AHEAD_S ahead of the clock."""

    def set_transform(self, transform: Any, authority: str) -> None:
        """Add a geometry_msgs/TransformStamped of the node `authority`, unless it is far ahead."""
        now = rospy.get_rostime()
        lead = (transform.header.stamp - now).to_sec()
        if lead <= BUFFER_AHEAD_S:
            super().set_transform(transform, authority)
        elif not now.is_zero():  # A simulated clock is 0 until the first message on /clock.
            frames = f"{transform.header.frame_id} <- {transform.child_frame_id}"
            problem = f"it is stamped {lead:.2f} s ahead of the clock"
            rospy.logerr_throttle(
                1.0, f"transform {frames} of {authority} ignored: {problem}: synchronise the clocks"
            )


class TransformBuffer:
    """Buffer of tf, filled from the first lookup until `unsubscribe`."""

    def __init__(self) -> None:
        self.buffer = _Buffer(rospy.Duration(BUFFER_S), debug=False)
        self._listener: Optional[tf2_ros.TransformListener] = None

    def listen(self) -> None:
        """Subscribe to tf, unless subscribed already."""
        if self._listener is None:
            self._listener = tf2_ros.TransformListener(
                self.buffer, queue_size=100, buff_size=SMALL_BUFFER, tcp_nodelay=True
            )

    def at(self, target: str, source: str, stamp: rospy.Time) -> Any:
        """Return the geometry_msgs/TransformStamped of `source` in `target` at `stamp`.

        Stamp 0 means the latest one.

        Raises:
            ObservationError: tf does not know it.
        """
        if not source.strip("/"):
            raise ObservationError("a message has no frame_id: give it one")
        self.listen()
        try:
            return self.buffer.lookup_transform(target.lstrip("/"), source.lstrip("/"), stamp)
        except tf2_ros.TransformException as error:
            missing_transform = f"transform {target} <- {source}"
            if not stamp.is_zero():
                missing_transform += f" at {stamp.to_sec():.3f}"
            raise ObservationError(f"{missing_transform}: {reason(error)}") from None

    def latest(
        self,
        target: str,
        source: str,
        now: rospy.Time,
        oldest: float = math.inf,
        most_ahead: float = MAX_AHEAD_S,
    ) -> Any:
        """Return the geometry_msgs/TransformStamped of `source` in `target` at `now`.

        If tf does not know it yet, return the latest one.

        Raises:
            ObservationError: The transform is unknown, older than `oldest` [s], or more than
            `most_ahead` [s] ahead of now.
        """
        frames = (target.lstrip("/"), source.lstrip("/"))
        is_known, _ = self.buffer.can_transform_core(*frames, now)
        transform = self.at(target, source, now if is_known else rospy.Time(0))
        stamp = transform.header.stamp
        if stamp.is_zero():
            return transform  # Static transforms have stamp 0.
        age = (now - stamp).to_sec()
        if -most_ahead <= age <= oldest:
            return transform
        limit_phrase = f"old; at most {oldest:g} s"
        if age <= 0.0:
            limit_phrase = f"ahead of the clock; at most {most_ahead:g} s"
        problem = f"transform {target} <- {source} is {abs(age):.2f} s {limit_phrase} is allowed"
        raise ObservationError(f"{problem}: check localisation and transform_tolerance")

    def unsubscribe(self) -> None:
        """Stop listening, which costs CPU time, until the next lookup."""
        if self._listener is not None:
            self._listener.unregister()
            self._listener = None
        self.buffer.clear()
