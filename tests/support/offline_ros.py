"""rospy without a master: what a node's parts publish, subscribe to, read and log."""

from collections import defaultdict
from types import SimpleNamespace
from unittest.mock import create_autospec

import pytest
import rospy
import tf2_ros


class OfflineRos:
    """Stand-in for ROS around the parts of one node.

    Attributes:
        now: Time [s]; a test sets it.
        callbacks: Callbacks of subscribed topics and of services, by name.
        published: Messages by topic.
        parameters: Parameter server.
        tf: Buffer of transforms, which a test fills.
        log: Lines by level ("info", "warn", "err").
    """

    def __init__(self, monkeypatch, now=100.0):
        self.now = now
        self.callbacks = {}
        self.published = defaultdict(list)
        self.parameters = {}
        self.log = defaultdict(list)
        rospy.rostime.set_rostime_initialized(True)
        stand_ins = {
            "Publisher": self._publisher,
            "Subscriber": self._listen,
            "Service": self._listen,
            "Timer": create_autospec(rospy.Timer),
            "get_namespace": lambda: "/",
            "get_param": self.parameters.get,
            "get_rostime": lambda: self.time,
            "get_time": lambda: self.now,
            "has_param": self.parameters.__contains__,
            "resolve_name": lambda name: "/" + name.lstrip("/"),
            "search_param": lambda name: None,
            "set_param": self.parameters.__setitem__,
        }
        for level in ("info", "warn", "err"):
            stand_ins[f"log{level}"] = self._logger(level)
            stand_ins[f"log{level}_throttle"] = self._throttled(level)
        for name, stand_in in stand_ins.items():
            monkeypatch.setattr(rospy, name, stand_in)
        monkeypatch.setattr(rospy.Time, "now", lambda: self.time)
        monkeypatch.setattr(tf2_ros, "TransformListener", self._listen_to_tf)

    @property
    def time(self):
        return rospy.Time.from_sec(self.now)

    def _publisher(self, topic, kind, **_):
        def publish(content):
            # rospy, too, makes a message of its content.
            is_message = hasattr(content, "serialize")
            self.published[topic].append(content if is_message else kind(content))

        return SimpleNamespace(publish=publish, get_num_connections=lambda: 1)

    def _listen(self, name, kind, callback, *_, **__):
        self.callbacks[name] = callback

    def _listen_to_tf(self, buffer, **_):
        self.tf = buffer

    def _logger(self, level):
        def log(line, *values):
            self.log[level].append(line % values if values else line)

        return log

    def _throttled(self, level):
        log = self._logger(level)
        return lambda period, line, *values: log(line, *values)


@pytest.fixture
def offline_ros(monkeypatch):
    """Return the stand-in for ROS, at a time of 100 s."""
    return OfflineRos(monkeypatch)
