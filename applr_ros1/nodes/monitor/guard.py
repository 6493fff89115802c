"""Starts the collision monitor's node and stops the base while that does not live: what `collision_monitor.py` runs.

A base without a time-out of its own drives on with its last command when the monitor is killed, or frozen by a debugger
or by a machine that swaps. The node therefore writes a heartbeat to a pipe. If none comes for SILENCE_S, this process,
which has nothing else to do, publishes zeros on cmd_vel until it comes again. If the node ends, or stays silent for
FROZEN_S, this process stops the base and ends with it, and roslaunch starts both anew. If this process is killed, the
node stops the base and ends; if both are, the next guard begins with a zero. The node has its ROS name, and this
process the same with `_guard` behind it.
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
from geometry_msgs.msg import Twist

from applr_ros1.common.ros_node import init_node, until_shutdown

GUARD_SUFFIX = "_guard"  # end of this process's ROS name, which begins with the node's
PIPE_VARIABLE = "APPLR_HEARTBEAT"  # environment variable with the descriptor to which the node writes
SILENCE_S = 0.35  # time without a heartbeat after which zeros are published [s]
ZEROS_S = 0.05  # time between two zeros [s]
FROZEN_S = 5.0  # time without a heartbeat after which the node is ended [s]
ENDS_S = 3.0  # time that the node has to end when this process is asked to [s]
LAST_ZEROS = 10  # number of zeros after the node's end


class Heartbeat:
    """Tells the guard over a pipe that the node is alive. Without a guard, does nothing."""

    def __init__(self) -> None:
        self._pipe = int(os.environ.get(PIPE_VARIABLE, -1))
        if self._pipe >= 0:
            os.set_blocking(self._pipe, False)

    def beat(self) -> bool:
        """Report that the node lives; return False if the guard does not."""
        if self._pipe >= 0:
            try:
                os.write(self._pipe, b".")
            except BlockingIOError:  # full, because the guard is frozen
                return True
            except OSError:
                return False
        return True


def main() -> int:
    """Run the node; publish zeros while it gives no sign of life. Return its exit status."""
    names = [argument[8:] for argument in sys.argv if argument.startswith("__name:=")]
    node_name = names[-1] if names else "collision_monitor"
    init_node(node_name + GUARD_SUFFIX, argv=[a for a in sys.argv if not a.startswith(("__name:=", "__log:="))])
    with until_shutdown():
        return _watch(rospy.Publisher("cmd_vel", Twist, queue_size=1, latch=True))
    return 0


def _watch(out: rospy.Publisher) -> int:
    out.publish(Twist())  # the base may still follow a monitor that died with its guard
    reading, writing = os.pipe()
    command = [sys.executable, "-m", "applr_ros1.nodes.monitor.node", *sys.argv[1:]]
    node = subprocess.Popen(command, pass_fds=[writing], env={**os.environ, PIPE_VARIABLE: str(writing)})
    os.close(writing)
    heard = math.inf  # time.monotonic() of the last sign of life
    while not rospy.is_shutdown() and node.poll() is None:
        if select.select([reading], [], [], ZEROS_S)[0]:
            if os.read(reading, 4096):
                heard = time.monotonic()
            else:  # the node has closed the pipe: it is ending
                time.sleep(ZEROS_S)
        silence = time.monotonic() - heard
        if silence > SILENCE_S:
            out.publish(Twist())
        if silence > FROZEN_S:
            rospy.logerr("collision monitor: no sign of life for %g s; it is ended", FROZEN_S)
            node.kill()
            node.wait()
    if rospy.is_shutdown():
        node.terminate()
        with suppress(subprocess.TimeoutExpired):
            node.wait(ENDS_S)
        node.kill()
        return 0
    if heard < math.inf:
        rospy.logerr("collision monitor: its process has ended: the base stands until roslaunch starts it anew")
        for _ in range(LAST_ZEROS):  # the end closes connections, and a single zero might be lost
            out.publish(Twist())
            time.sleep(ZEROS_S)
    return node.wait()
