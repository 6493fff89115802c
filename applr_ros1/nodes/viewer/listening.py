"""The viewer's subscriptions, and helpers that pass the user's actions on to other nodes.

There are no subscriptions while no page is open.
"""

from __future__ import annotations

import math
import time
from collections import deque
from concurrent.futures import TimeoutError as FutureTimeout
from typing import Any, Callable, Deque, Dict, List, Optional, Tuple

import rospy
from rospy.numpy_msg import numpy_msg

from applr_ros1.common.angles import Pose
from applr_ros1.common.errors import reason
from applr_ros1.common.messages import pose_of
from applr_ros1.common.ros_node import LARGE_BUFFER
from applr_ros1.common.threads import called
from applr_ros1.nodes.transforms import TransformBuffer
from applr_ros1.policy.layout import ObservationError

KEPT_MESSAGES = 50  # largest number of unread messages of a topic
TOUCHED_S = 0.5  # wall time for which an element keeps its value after a change by the user [s]
ANSWER_S = 1.0  # longest wall time to wait for a service [s]
WORK_S = 10.0  # longest wall time that a service may take, such as to load a method [s]
Report = Callable[[str], None]  # shows one line to all clients


class _HeardTopic:
    """Subscription to a topic.

    Attributes:
        queue: Unread messages.
        latest: Latest message that was read, or None.
        times: Wall and ROS time of the latest message.
    """

    def __init__(self, topic: str, kind: Any):
        self.queue: Deque[Any] = deque(maxlen=KEPT_MESSAGES)
        self.latest: Any = None
        self.times = (-math.inf, -math.inf)
        self.subscriber = rospy.Subscriber(
            topic, numpy_msg(kind), self._keep, queue_size=KEPT_MESSAGES, buff_size=LARGE_BUFFER
        )

    def _keep(self, message: Any) -> None:
        self.queue.append(message)
        self.times = (time.monotonic(), rospy.get_time())


class Listener:
    """Subscriptions that begin with the first request for a topic.

    Methods take the name and message class of a topic. fixed: Frame of the returned poses.
    """

    def __init__(self, fixed: str):
        self.fixed = fixed
        self._topics: Dict[str, _HeardTopic] = {}
        self._transforms = TransformBuffer()

    def close(self) -> None:
        """Unsubscribe from everything until the next request, and drop all messages."""
        for heard in self._topics.values():
            heard.subscriber.unregister()
        self._transforms.unsubscribe()
        self._topics.clear()

    def fresh(self, topic: str, kind: Any) -> List[Any]:
        """Return the unread messages, oldest first. Their arrays are numpy arrays."""
        if topic not in self._topics:
            self._topics[topic] = _HeardTopic(topic, kind)
        heard = self._topics[topic]
        # A callback may add messages at the same time: only those that are there now are read.
        messages = [heard.queue.popleft() for _ in range(len(heard.queue))]
        if messages:
            heard.latest = messages[-1]
        return messages

    def news(self, topic: str, kind: Any) -> Any:
        """Return the latest message if it is unread, otherwise None. Older messages are dropped."""
        return next(reversed(self.fresh(topic, kind)), None)

    def latest(self, topic: str, kind: Any) -> Any:
        """Return the latest message, read or unread, or None before the first."""
        self.fresh(topic, kind)
        return self._topics[topic].latest

    def placed(self, topic: str, kind: Any) -> Tuple[Any, Any]:
        """Return `news` and the pose of its frame, or (None, None) if either is missing."""
        message = self.news(topic, kind)
        if message is None:
            return None, None
        pose = self.frame_pose(message.header.frame_id)
        if pose is None:
            return None, None
        return message, pose

    def age(self, topic: str) -> float:
        """Return the age of the latest message [s]; inf before the first.

        Of the ages in wall and in ROS time the smaller one counts: a simulation may be paused, or
        run faster than the wall clock.
        """
        if topic not in self._topics:
            return math.inf
        wall_time, ros_time = self._topics[topic].times
        return min(time.monotonic() - wall_time, float(rospy.get_time()) - ros_time)

    def frame_pose(self, frame: str) -> Optional[Pose]:
        """Return the latest pose (x, y, yaw) of a frame in the fixed frame, or None."""
        if frame.lstrip("/") == self.fixed.lstrip("/"):
            return 0.0, 0.0, 0.0
        try:
            transform = self._transforms.latest(self.fixed, frame, rospy.get_rostime())
        except ObservationError:
            return None
        return pose_of(transform.transform)


def by_hand(element: Any, work: Callable[[Any], Any]) -> None:
    """Call work(value) when the user, and not this program, changes an element of the page."""
    # Only the events of a user have a client.
    element.on_update(lambda event: work(element.value) if event.client else None)


def show(element: Any, value: Any) -> None:
    """Set an element of the page, unless the user has changed it within TOUCHED_S seconds."""
    if time.time() - element.update_timestamp > TOUCHED_S:
        element.value = value


def publish(report: Report, publisher: rospy.Publisher, message: Any) -> None:
    """Publish a message, and report if there are no subscribers."""
    publisher.publish(message)
    if not publisher.get_num_connections():
        report(f"no subscribers on {publisher.resolved_name}")


def call(report: Report, name: str, kind: Any, *request: Any) -> bool:
    """Call a service and return whether it succeeded. Failures are reported."""
    name = rospy.resolve_name(name)
    try:
        rospy.wait_for_service(name, ANSWER_S)
        answer = called(rospy.ServiceProxy(name, kind), *request).result(WORK_S)
        problem = ""
        if not getattr(answer, "success", True):
            problem = answer.message or f"{name} refuses"
    except (rospy.ROSException, FutureTimeout):
        problem = f"{name} does not answer"
    except rospy.ServiceException as error:
        problem = f"{name}: {reason(error)}"
    if problem:
        report(problem)
    return not problem
