"""The viewer's subscriptions, and how what a person does on the page reaches other nodes.

While no page is open there are no subscriptions.
"""

from __future__ import annotations

import math
import time
from collections import deque
from typing import Any, Callable, Deque, Dict, List, Optional, Tuple

import rospy
from rospy.numpy_msg import numpy_msg

from applr_ros1.common.angles import Pose
from applr_ros1.common.errors import reason
from applr_ros1.nodes.conversions import pose_of
from applr_ros1.nodes.transforms import Transforms
from applr_ros1.policy.observation import ObservationError

KEPT_MESSAGES = 50  # messages of a topic between two looks
TOUCHED_S = 0.5  # of wall time for which an element that was changed stays as it is
ANSWER_S = 1.0  # of wall time that a service has to appear
Say = Callable[[str], None]  # shows one line to everybody who looks


class Listener:
    """Subscribes to a topic when it is asked for it first. topic, kind: its name and the class of its messages.

    fixed: the frame in which poses are given.
    """

    def __init__(self, fixed: str):
        self.fixed = fixed
        self._queues: Dict[str, Deque[Any]] = {}  # by topic: messages as bytes
        self._newest: Dict[str, Any] = {}
        self._times: Dict[str, Tuple[float, float]] = {}  # wall and ROS time of the newest message
        self._subscribers: List[Any] = []
        self._transforms = Transforms()

    def close(self) -> None:
        """Unsubscribe from everything, until the next question, and forget all messages."""
        while self._subscribers:
            self._subscribers.pop().unregister()
        self._transforms.unsubscribe()
        for known in (self._queues, self._newest, self._times):
            known.clear()

    def fresh(self, topic: str, kind: Any) -> List[Any]:
        """The messages that have come since the last look, oldest first; their arrays are numpy's."""
        if topic not in self._queues:
            new = self._queues[topic] = deque(maxlen=KEPT_MESSAGES)

            def keep(message: Any) -> None:
                new.append(message)
                self._times[topic] = time.monotonic(), rospy.get_time()

            self._subscribers.append(
                rospy.Subscriber(topic, numpy_msg(kind), keep, queue_size=KEPT_MESSAGES, buff_size=2**24)
            )
        queue, found = self._queues[topic], []
        while queue:
            found.append(queue.popleft())
        if found:
            self._newest[topic] = found[-1]
        return found

    def news(self, topic: str, kind: Any) -> Optional[Any]:
        """The newest message, None where none has come since the last look. Older ones are dropped."""
        queue = self._queues.get(topic, deque())
        while len(queue) > 1:
            queue.popleft()
        return next(iter(self.fresh(topic, kind)), None)

    def newest(self, topic: str, kind: Any) -> Optional[Any]:
        """The newest message, seen before or not; None before the first."""
        return self.news(topic, kind) or self._newest.get(topic)

    def placed(self, topic: str, kind: Any) -> Tuple[Any, Optional[Pose]]:
        """As `news`, and the place of its frame; (None, None) where there is no message or no place."""
        message = self.news(topic, kind)
        place = self.frame_pose(message.header.frame_id) if message is not None else None
        return (message, place) if place is not None else (None, None)

    def age(self, topic: str) -> float:
        """Wall or ROS time [s] since the newest message came, the shorter of both; inf before the first."""
        wall, now = self._times.get(topic, (-math.inf, -math.inf))
        return min(time.monotonic() - wall, rospy.get_time() - now)

    def frame_pose(self, frame: str) -> Optional[Pose]:
        """The newest pose (x, y, yaw) of a frame in the fixed one; None where tf has none."""
        if frame.lstrip("/") == self.fixed.lstrip("/"):
            return 0.0, 0.0, 0.0
        try:
            return pose_of(self._transforms.latest(self.fixed, frame, rospy.get_rostime()).transform)
        except ObservationError:
            return None


def by_hand(element: Any, work: Callable[[Any], Any]) -> None:
    """Call work(value) when a person, and not this program, changes an element of the page."""
    element.on_update(lambda event: work(element.value) if event.client else None)


def show(element: Any, value: Any) -> None:
    """Set an element of the page, unless a person may have just changed it and `by_hand` has not read it yet."""
    if time.time() - element.update_timestamp > TOUCHED_S:
        element.value = value


def publish(say: Say, publisher: rospy.Publisher, message: Any) -> None:
    """Publish a message; say so where nobody listens."""
    publisher.publish(message)
    if not publisher.get_num_connections():
        say(f"nobody listens on {publisher.resolved_name}")


def call(say: Say, name: str, kind: Any, *request: Any) -> bool:
    """Call a service. Returns whether it did what was asked; says why not."""
    name = rospy.resolve_name(name)
    try:
        rospy.wait_for_service(name, ANSWER_S)
        answer = rospy.ServiceProxy(name, kind)(*request)
        problem = "" if getattr(answer, "success", True) else answer.message
    except rospy.ROSException:
        problem = f"{name} does not answer"
    except rospy.ServiceException as error:
        problem = f"{name}: {reason(error)}"
    if problem:
        say(problem)
    return not problem
