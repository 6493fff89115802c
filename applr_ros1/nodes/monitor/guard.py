"""Guard process of the collision monitor, which stops the base if the node dies or freezes.

This is the program behind `collision_monitor.py`. A base without a time-out of its own keeps
driving with its last command if the monitor is killed, or frozen by a debugger or by swapping. The
node therefore writes heartbeats to a pipe. If none arrives for SILENCE_S, the guard publishes zeros
on cmd_vel until the next heartbeat. If the node ends, or is silent for FROZEN_S, the guard stops
the base and exits, and roslaunch restarts both. If the guard is killed, the node stops the base and
exits. If both are killed, the next guard starts with a zero. The guard's ROS name is the node's
with the suffix `_guard`.
"""

from __future__ import annotations

import math
import os
import select
import subprocess
import sys
import time
from contextlib import suppress

import rospy
from geometry_msgs.msg import Twist as TwistMessage

from applr_ros1.common.ros_node import init_node, until_shutdown
from applr_ros1.nodes.base_commands import LAST_ZEROS, ZEROS_S

GUARD_SUFFIX = "_guard"  # suffix of the guard's ROS name, after the node's name
# Environment variable with the file descriptor of the node's end of the pipe
PIPE_VARIABLE = "APPLR_HEARTBEAT"
SILENCE_S = 0.35  # time without a heartbeat after which zeros are published [s]
FROZEN_S = 5.0  # time without a heartbeat after which the node is killed [s]
ENDS_S = 3.0  # time for the node to exit at shutdown before it is killed [s]
CONNECTS_S = 5.0  # time for the base to connect to the guard before it ends [s]


class Heartbeat:
    """Tells the guard over a pipe that the node is alive. Without a guard, does nothing.

    Args:
        topic: Resolved name of the topic of commands to the base, which the guard has to know.
    """

    def __init__(self, topic: str):
        self._pipe = int(os.environ.get(PIPE_VARIABLE, -1))
        if self._pipe >= 0:
            os.set_blocking(self._pipe, False)
        self._write(topic.encode() + b"\n")

    def beat(self) -> bool:
        """Send a heartbeat. Return False if the guard has ended."""
        return self._write(b".")

    def _write(self, data: bytes) -> bool:
        """Write to the pipe. Return False if the guard has ended."""
        try:
            if self._pipe >= 0:
                os.write(self._pipe, data)
        except OSError as error:
            return isinstance(error, BlockingIOError)  # The pipe is full if the guard is frozen.
        return True


def main() -> int:
    """Run the node, and publish zeros while its heartbeats are missing. Return its exit status."""
    # roslaunch gives the name and log file of the node, which the guard cannot have, too.
    node_name = "collision_monitor"
    arguments = []
    for argument in sys.argv:
        if argument.startswith("__name:="):
            node_name = argument[len("__name:=") :]
        elif not argument.startswith("__log:="):
            arguments.append(argument)
    init_node(node_name + GUARD_SUFFIX, argv=arguments)
    with until_shutdown():
        return _watch()
    return 0


def _watch() -> int:
    """Run the node and watch its heartbeats. Return its exit status."""
    commands = _publisher("cmd_vel")
    # The base may still follow the last command of a killed monitor.
    commands.publish(TwistMessage())
    reading, writing = os.pipe()
    program = [sys.executable, "-m", "applr_ros1.nodes.monitor.node", *sys.argv[1:]]
    environment = {**os.environ, PIPE_VARIABLE: str(writing)}
    node = subprocess.Popen(program, pass_fds=[writing], env=environment)
    os.close(writing)  # The pipe ends with the node.

    # Until the first heartbeat the node compiles or loads its kernels, and the base stands.
    last_beat = math.inf  # time.monotonic() of the last heartbeat
    while not rospy.is_shutdown() and node.poll() is None:
        is_readable, _, _ = select.select([reading], [], [], ZEROS_S)
        if is_readable:
            received = os.read(reading, 4096)
            if received:
                last_beat = time.monotonic()
                topic, newline, _ = received.partition(b"\n")
                if newline and topic.decode() != commands.resolved_name:
                    commands = _publisher(topic.decode())
            else:  # The node has closed the pipe because it is ending.
                time.sleep(ZEROS_S)
        silence = time.monotonic() - last_beat
        if silence > SILENCE_S:
            commands.publish(TwistMessage())
        if silence > FROZEN_S:
            rospy.logerr("collision monitor: no heartbeat for %g s; the node is killed", FROZEN_S)
            node.kill()
            node.wait()
    if rospy.is_shutdown():
        node.terminate()
        with suppress(subprocess.TimeoutExpired):
            node.wait(ENDS_S)
        node.kill()
        return 0
    if last_beat < math.inf:
        problem = "collision monitor: the node has ended"
        rospy.logerr("%s; the base is stopped until roslaunch restarts the node", problem)
        _stop_base(commands)
    return node.wait()


def _stop_base(commands: rospy.Publisher) -> None:
    """Publish LAST_ZEROS zeros to a connected base, within CONNECTS_S.

    The base hears of the guard's topic with the node's first heartbeat, which may have been a
    moment ago. A connection that has ended counts until messages are sent to it.
    """
    deadline = time.monotonic() + CONNECTS_S
    sent_count = 0
    while sent_count < LAST_ZEROS and time.monotonic() < deadline:
        commands.publish(TwistMessage())
        time.sleep(ZEROS_S)
        sent_count += commands.get_num_connections() > 0


def _publisher(topic: str) -> rospy.Publisher:
    """Return a publisher of commands to the base."""
    return rospy.Publisher(topic, TwistMessage, queue_size=1, latch=True)
