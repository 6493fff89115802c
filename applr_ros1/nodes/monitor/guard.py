"""Starts the collision monitor's node and stops the base while that does not live: what `collision_monitor.py` runs.

A base without a time-out of its own drives on with its last command when the monitor is killed, or frozen by a debugger
or by a machine that swaps. The node therefore writes a heartbeat to a pipe. Where none comes for SILENCE_S, this
process, which has nothing else to do, publishes zeros on cmd_vel until it comes again; a node that has ended is started
anew, after AGAIN_S where it ended before its first heartbeat, and one that stays silent is ended first. Where this
process is killed, the node stops the base and ends; where both are, the next guard begins with a zero. The node has its
ROS name, and this process the same with `_guard` behind it.
"""

from __future__ import annotations

import os
import select
import subprocess
import sys
import time
from typing import Optional

import rospy
from geometry_msgs.msg import Twist

from applr_ros1.common.ros_node import init_node, until_shutdown

GUARD_SUFFIX = "_guard"  # end of this process's ROS name, which begins with the node's
PIPE_VARIABLE = "APPLR_HEARTBEAT"  # environment variable with the descriptor to which the node writes
SILENCE_S = 0.35  # s without a heartbeat after which zeros are published ...
ZEROS_S = 0.05  # ... so many seconds apart
AGAIN_S = 1.0  # s before the next try where a node has ended before it lived
FROZEN_S = 5.0  # s of silence after which the node is ended
ENDS_S = 3.0  # s that the node has to end when this process is asked to


class Heartbeat:
    """The node's end of the pipe; without a guard it does nothing."""

    def __init__(self) -> None:
        self._pipe = int(os.environ.get(PIPE_VARIABLE, -1))
        if self._pipe >= 0:
            os.set_blocking(self._pipe, False)

    def beat(self) -> bool:
        """Say that the node lives; False where the guard does not."""
        if self._pipe >= 0:
            try:
                os.write(self._pipe, b".")
            except BlockingIOError:  # full, because the guard is frozen
                return True
            except OSError:
                return False
        return True


class Guard:
    """Watches one node process after the other."""

    def __init__(self) -> None:
        self._out = rospy.Publisher("cmd_vel", Twist, queue_size=1, latch=True)
        self._out.publish(Twist())  # the base may still follow a monitor that died with its guard
        self._node: Optional[subprocess.Popen] = None
        self._pipe = -1
        self._alive = False  # whether the present node has ever given a sign
        self._heard = 0.0  # time.monotonic() of the last one of any node

    def watch(self) -> int:
        """Until shutdown, or until a node ends and none has lived yet; returns the exit status."""
        status = 0
        while not rospy.is_shutdown() and status == 0:
            if self._node is None:
                self._start()
            self._listen(ZEROS_S)
            silence = time.monotonic() - self._heard
            if self._heard and silence > SILENCE_S:
                self._out.publish(Twist())
            assert self._node is not None
            if self._alive and silence > FROZEN_S and self._node.poll() is None:
                rospy.logerr("collision monitor: no sign of life for %g s; it is started anew", FROZEN_S)
                self._node.kill()
                self._node.wait()
            if self._node.poll() is not None:
                status = 0 if self._heard else self._node.returncode or 1
                if self._heard and not rospy.is_shutdown():
                    rospy.logerr("collision monitor: its process has ended; it is started anew, and the base stands")
                os.close(self._pipe)
                if not self._alive and status == 0:
                    self._stand(AGAIN_S)
                self._node = None
        self._end()
        return status

    def _start(self) -> None:
        self._pipe, theirs = os.pipe()
        self._alive = False
        command = [sys.executable, "-m", "applr_ros1.nodes.monitor.node", *sys.argv[1:]]
        self._node = subprocess.Popen(command, pass_fds=[theirs], env={**os.environ, PIPE_VARIABLE: str(theirs)})
        os.close(theirs)

    def _stand(self, seconds: float) -> None:
        until = time.monotonic() + seconds
        while time.monotonic() < until and not rospy.is_shutdown():
            self._out.publish(Twist())
            time.sleep(ZEROS_S)

    def _listen(self, patience: float) -> None:
        if select.select([self._pipe], [], [], patience)[0]:
            if os.read(self._pipe, 4096):
                self._alive, self._heard = True, time.monotonic()
            else:  # the node has closed it: it is ending
                time.sleep(patience)

    def _end(self) -> None:
        if self._node is None:
            return
        self._node.terminate()
        try:
            self._node.wait(ENDS_S)
        except subprocess.TimeoutExpired:
            self._node.kill()


def main() -> int:
    """Run the command."""
    names = [argument[8:] for argument in sys.argv if argument.startswith("__name:=")]
    node_name = names[-1] if names else "collision_monitor"
    init_node(node_name + GUARD_SUFFIX, argv=[a for a in sys.argv if not a.startswith(("__name:=", "__log:="))])
    with until_shutdown():
        return Guard().watch()
    return 0
