"""Start and shutdown of a ROS node: a line without a master, no deadlock, and no traceback.

rospy shuts down inside its signal handler. This deadlocks if the main thread is publishing or
logging and holds a lock that the shutdown needs, so init_node() shuts down in a thread. A shutdown
also closes topics before rospy.is_shutdown() returns True: publish() then raises ROSException or,
in the middle of a call, another exception.
"""

from __future__ import annotations

import logging
import signal
import socket
import threading
from contextlib import contextmanager
from typing import Any, Iterator

import rosgraph
import rospy

from applr_ros1.common.errors import ApplrError

# time-out for the master's answer at the start [s]; rospy itself would wait forever
PATIENCE_S = 3.0
# longest time that a signal handler waits for the shutdown before the main thread goes on [s]
STANDS_S = 0.5
# Receive buffers of subscribers [bytes]. rospy drops old messages only among those that are in the
# buffer at once. A message that does not fit into it, with rospy's 64 kB, waits behind older ones.
LARGE_BUFFER = 2**24  # for plans, scans, costmaps and point clouds
SMALL_BUFFER = 2**20  # for transforms and odometry


def init_node(name: str, **options: Any) -> None:
    """Call rospy.init_node, and let SIGINT and SIGTERM shut down the node in a separate thread.

    Raises:
        ApplrError: The master of ROS_MASTER_URI (or of the argument __master:=) does not answer.
        KeyboardInterrupt: The node was interrupted during the call.
    """
    if not _master_answers():
        problem = f"no ROS master at {rosgraph.get_master_uri()}"
        raise ApplrError(f"{problem}: start one with roscore or roslaunch, or set ROS_MASTER_URI")
    try:
        rospy.init_node(name, **options)
    except rospy.exceptions.ROSInitException:
        if not rospy.core.is_shutdown_requested():
            raise
        # rospy was shut down by a signal that came during the call.
        raise KeyboardInterrupt from None

    def shut_down(number: int, _: Any) -> None:
        shutdown_thread = threading.Thread(target=rospy.signal_shutdown, args=[f"signal {number}"])
        shutdown_thread.start()
        shutdown_thread.join(STANDS_S)

    for signal_number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(signal_number, shut_down)
    _silence_tracebacks_of_the_shutdown()


def _master_answers() -> bool:
    """Return whether the ROS master answers within PATIENCE_S."""
    usual_timeout = socket.getdefaulttimeout()
    socket.setdefaulttimeout(PATIENCE_S)
    has_answered: bool = rosgraph.is_master_online()
    socket.setdefaulttimeout(usual_timeout)
    return has_answered


def _silence_tracebacks_of_the_shutdown() -> None:
    """Drop tracebacks of callbacks and threads that use topics while rospy shuts down."""

    def is_wanted(record: logging.LogRecord) -> bool:
        return not (rospy.core.is_shutdown_requested() and "Traceback" in record.getMessage())

    logging.getLogger("rosout").addFilter(is_wanted)

    print_exception = threading.excepthook

    def print_while_running(error: Any) -> None:
        if not rospy.core.is_shutdown_requested():
            print_exception(error)

    threading.excepthook = print_while_running


@contextmanager
def until_shutdown() -> Iterator[None]:
    """Suppress exceptions that the block raises while rospy shuts down."""
    try:
        yield
    except Exception:
        if not rospy.core.is_shutdown_requested():
            raise


def status_name(node: str, subject: str) -> str:
    """Return the name under which a node of this namespace has a status in /diagnostics."""
    namespace: str = rospy.get_namespace()
    return (namespace + node).lstrip("/") + f": {subject}"


def policy_status() -> str:
    """Return the name of the applr node's status, for the node and for those that read it."""
    return status_name("applr", "parameter policy")


def command_topic(robot_topic: str) -> str:
    """Return the topic of commands to the base: the robot's, unless cmd_vel is remapped."""
    name_before = rosgraph.names.resolve_name("cmd_vel", rospy.get_name())
    is_remapped = rospy.resolve_name("cmd_vel") != name_before
    return "cmd_vel" if is_remapped else robot_topic
