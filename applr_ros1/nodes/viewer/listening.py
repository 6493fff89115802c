"""What the viewer hears: messages kept as they came and read when they are looked at, and poses from tf.

A message that nobody looks at costs no reading, and while nobody looks at all there are no subscriptions.
"""

from __future__ import annotations

import math
import threading
import time
from collections import deque
from typing import Any, Deque, Dict, List, Optional

import numpy as np
import rospy

from applr_ros1.common.angles import Pose
from applr_ros1.nodes.conversions import pose_of
from applr_ros1.nodes.transforms import Transforms
from applr_ros1.policy.observation import ObservationError

KEPT = 50  # messages of a topic between two looks


class Listener:
    """Subscriptions that can be opened and closed.

    Args:
        topics: {topic: class of its messages}.
        fixed: Frame in which `place` gives poses.
    """

    def __init__(self, topics: Dict[str, Any], fixed: str):
        self.fixed = fixed
        self._kinds = topics
        self._came: Dict[str, Deque[Any]] = {topic: deque(maxlen=KEPT) for topic in topics}
        self._read: Dict[str, Any] = {}
        self._heard: Dict[str, float] = {}  # wall time of the newest message
        self._subscribers: List[Any] = []
        self._transforms = Transforms()
        self._lock = threading.Lock()

    def open(self) -> None:
        """Subscribe, unless that was done."""
        with self._lock:
            if not self._subscribers:
                self._subscribers = [
                    rospy.Subscriber(topic, rospy.AnyMsg, self._keep, topic, queue_size=KEPT, buff_size=2**24)
                    for topic in self._kinds
                ]

    def close(self) -> None:
        """Unsubscribe, and forget what was heard."""
        with self._lock:
            for subscriber in self._subscribers:
                subscriber.unregister()
            self._subscribers = []
            self._transforms.rest()
            for known in (self._read, self._heard):
                known.clear()
            for came in self._came.values():
                came.clear()

    def _keep(self, message: Any, topic: str) -> None:
        self._came[topic].append(message._buff)
        self._heard[topic] = time.monotonic()

    def fresh(self, topic: str) -> List[Any]:
        """The messages that have come since the last look, oldest first; their arrays are numpy's."""
        came, found = self._came[topic], []
        while came:
            message = self._kinds[topic]()
            message.deserialize_numpy(came.popleft(), np)
            found.append(message)
        if found:
            self._read[topic] = found[-1]
        return found

    def news(self, topic: str) -> Optional[Any]:
        """The newest message, None where none has come since the last look. Older ones are dropped."""
        came = self._came[topic]
        while len(came) > 1:
            came.popleft()
        return next(iter(self.fresh(topic)), None)

    def newest(self, topic: str) -> Optional[Any]:
        """The newest message, seen before or not; None before the first."""
        return self.news(topic) or self._read.get(topic)

    def age(self, topic: str) -> float:
        """Wall time [s] since the newest message came; inf before the first."""
        return time.monotonic() - self._heard.get(topic, -math.inf)

    def place(self, frame: str) -> Optional[Pose]:
        """The newest pose (x, y, yaw) of a frame in the fixed one; None where tf has none."""
        if frame.lstrip("/") == self.fixed.lstrip("/"):
            return 0.0, 0.0, 0.0
        try:
            return pose_of(self._transforms.newest(self.fixed, frame))
        except ObservationError:
            return None
