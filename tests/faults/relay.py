"""Relay of messages between the simulated robot and the stack. It can drop, change and count
messages.

The bridge publishes under /sim/... and reads commands from /sim/cmd_vel, and the stack uses the
ordinary names. A test injects a fault by setting, for example, `relay.faults["scan"]` to a function
message -> message, or None to drop the message. `relay.clear_faults()` removes all faults. The
relay runs in the test's process, in wall time.
"""

import contextlib
import time
from collections import deque
from typing import NamedTuple

import rospy
from geometry_msgs.msg import Twist
from nav_msgs.msg import Odometry
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import LaserScan
from std_msgs.msg import Bool
from tf2_msgs.msg import TFMessage

from applr_ros1.common.angles import yaw_of
from tests.support.nodes import Command

# Initial offset of the stack's clock from the simulator's, so that tests can set it back [s]
BEGIN = 100.0
STREAMS = {  # (message type, source, destination) by name
    "clock": (Clock, "/sim/clock", "/clock"),
    "tf": (TFMessage, "/sim/tf", "/tf"),
    "odometry": (Odometry, "/sim/odometry", "/odometry/filtered"),
    "scan": (LaserScan, "/sim/scan", "/front/scan"),
    "command": (Twist, "/cmd_vel", "/sim/cmd_vel"),
}


class State(NamedTuple):
    """State of the robot in the simulator: time [s], position down the alley [m], speed [m/s]."""

    time: float
    x: float
    speed: float


class Relay:
    """Relay of the five streams, and recorder of the robot's state.

    Attributes:
        faults: {stream: function message -> message or None}.
        shift: Offset added to every stamp and to the clock [s].
        now, x, speed: Time, position and speed of the robot in the simulator [s, m, m/s].
        touched: State in which the robot first touched an obstacle; None if it has not.
        aside: Lateral position and yaw of the robot [m, rad]; both are 0 on the straight line to
            the goal.
        commands: Commands to the base.
        planned: Commands of move_base.
        driven: Simulated time of the latest nonzero command [s].
        truth: The latest 500 states.
    """

    def __init__(self):
        self.clear_faults()
        self.shift = BEGIN
        self.touched = None
        self.now = 0.0
        self.x = 0.0
        self.speed = 0.0
        self.driven = 0.0
        self.aside = (0.0, 0.0)
        self.commands = []
        self.planned = []
        self.truth = deque(maxlen=500)
        # The relay must add little to the delay of messages, which tests measure.
        without_delay = {"queue_size": 20, "tcp_nodelay": True}
        self._publishers = {}
        self._subscribers = []
        for stream, (message_kind, source, destination) in STREAMS.items():
            self._publishers[stream] = rospy.Publisher(destination, message_kind, **without_delay)
            # With the default buffer, scans would wait in the socket and arrive late.
            relaying = rospy.Subscriber(
                source, message_kind, self._pass, stream, buff_size=2**22, **without_delay
            )
            self._subscribers.append(relaying)
        for topic, message_kind, callback in (
            ("/sim_bridge/ground_truth", Odometry, self._on_truth),
            ("/sim_bridge/collision", Bool, self._on_contact),
            ("/move_base/cmd_vel", Twist, self._on_planned),
        ):
            recording = rospy.Subscriber(topic, message_kind, callback, **without_delay)
            self._subscribers.append(recording)

    def close(self):
        """Stop relaying. A new stack has a new relay."""
        for endpoint in (*self._subscribers, *self._publishers.values()):
            endpoint.unregister()

    def clear_faults(self):
        """Pass all messages unchanged."""
        self.faults = dict.fromkeys(STREAMS, lambda message: message)

    def _pass(self, message, name):
        shift = rospy.Duration.from_sec(self.shift)
        if name == "clock":
            message.clock += shift
        elif name == "tf":
            for transform in message.transforms:
                transform.header.stamp += shift
        elif name != "command":
            message.header.stamp += shift
        message = self.faults[name](message)
        if message is None:
            return
        if name == "command":
            _keep(message, self.commands)
            if message.linear.x or message.angular.z:
                self.driven = self.now
        with contextlib.suppress(rospy.ROSException):  # The publisher may have been closed.
            self._publishers[name].publish(message)

    def _on_truth(self, message):
        pose = message.pose.pose
        self.aside = (pose.position.y, yaw_of(pose.orientation))
        state = State(
            time=message.header.stamp.to_sec(),
            x=pose.position.x,
            speed=message.twist.twist.linear.x,
        )
        self.truth.append(state)
        self.now = state.time
        self.x = state.x
        self.speed = state.speed

    def _on_contact(self, message):
        # A contact stays one, until a test takes it back.
        if message.data and self.touched is None:
            self.touched = State(self.now, self.x, self.speed)

    def _on_planned(self, message):
        _keep(message, self.planned)


def _keep(command, where):
    where.append(Command(time.time(), command.linear.x, command.angular.z))
