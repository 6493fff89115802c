"""The relay between the simulated robot and the stack: whatever passes can be held back, changed or counted.

The bridge publishes under /sim/... and takes its commands from /sim/cmd_vel; the stack knows the usual names. A test
sets `relay.bend["scan"]` and so on to a function message -> message (None: it does not pass) and `relay.mend()` takes
all faults away. It runs in the test's own process, which lives in wall time.
"""

import contextlib
import time
from collections import deque

import rospy
from geometry_msgs.msg import Twist
from nav_msgs.msg import Odometry
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import LaserScan
from std_msgs.msg import Bool
from tf2_msgs.msg import TFMessage

from applr_ros1.common.angles import yaw_of

BEGIN = 100.0  # s by which the stack's time is ahead of the simulator's, so that it can be set back
STREAMS = {  # name: (type, from, to)
    "clock": (Clock, "/sim/clock", "/clock"),
    "tf": (TFMessage, "/sim/tf", "/tf"),
    "odometry": (Odometry, "/sim/odometry", "/odometry/filtered"),
    "scan": (LaserScan, "/sim/scan", "/front/scan"),
    "command": (Twist, "/cmd_vel", "/sim/cmd_vel"),
}


class Relay:
    """Passes the five streams on, and keeps what a test wants to know of the robot.

    Attributes:
        bend: {name of a stream: what happens to its messages}.
        shift: seconds that are added to every stamp and to the clock.
        now, x, speed: of the robot in the simulator [s, m, m/s], whatever becomes of the stack's clock; `touched`:
            whether it has touched anything.
        aside: (y [m], yaw [rad]) of the robot, both 0 on the way straight on.
        commands: (wall time, v, w) that went to the base; planned: the same for what move_base asked for.
        driven: simulated time of the newest command that was not to stand.
        truth: (simulated time, x, speed), the newest 500.
    """

    def __init__(self):
        self.mend()
        self.shift, self.touched = BEGIN, False
        self.now = self.x = self.speed = self.driven = 0.0
        self.aside = (0.0, 0.0)
        self.commands, self.planned, self.truth = [], [], deque(maxlen=500)
        fast = {"queue_size": 20, "tcp_nodelay": True}
        self._publishers = {name: rospy.Publisher(to, kind, **fast) for name, (kind, _, to) in STREAMS.items()}
        self._subscribers = [
            rospy.Subscriber(source, kind, self._pass, name, buff_size=2**22, **fast)
            for name, (kind, source, _) in STREAMS.items()
        ] + [
            rospy.Subscriber("/sim_bridge/ground_truth", Odometry, self._hear_truth, **fast),
            rospy.Subscriber("/sim_bridge/collision", Bool, self._hear_contact, **fast),
            rospy.Subscriber("/move_base/cmd_vel", Twist, lambda command: _keep(command, self.planned), **fast),
        ]

    def close(self):
        """Passes nothing any more: a stack that is started anew has a relay of its own."""
        for end in (*self._subscribers, *self._publishers.values()):
            end.unregister()

    def mend(self):
        """Everything passes as it comes."""
        self.bend = dict.fromkeys(STREAMS, lambda message: message)

    def _pass(self, message, name):
        shift = rospy.Duration.from_sec(self.shift)
        if name == "clock":
            message.clock += shift
        elif name != "command":
            for stamped in message.transforms if name == "tf" else [message]:
                stamped.header.stamp += shift
        message = self.bend[name](message)
        if message is None:
            return
        if name == "command":
            _keep(message, self.commands)
            self.driven = self.now if message.linear.x or message.angular.z else self.driven
        with contextlib.suppress(rospy.ROSException):  # closed meanwhile
            self._publishers[name].publish(message)

    def _hear_truth(self, message):
        pose = message.pose.pose
        self.aside = (pose.position.y, yaw_of(pose.orientation))
        self.truth.append((message.header.stamp.to_sec(), pose.position.x, message.twist.twist.linear.x))
        self.now, self.x, self.speed = self.truth[-1]

    def _hear_contact(self, message):
        self.touched |= message.data


def _keep(command, where):
    where.append((time.time(), command.linear.x, command.angular.z))
