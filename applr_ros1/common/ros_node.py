"""Start and shutdown of a ROS node: one line if there is no master, no deadlock and no traceback at shutdown.

rospy shuts down inside its signal handler. This deadlocks if the main thread is publishing or logging and holds a lock
that the shutdown needs, so init_node() shuts down in a thread. A shutdown also closes topics before
rospy.is_shutdown() returns True: publish() then raises ROSException or, in the middle of a call, another exception.
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

PATIENCE_S = 3.0  # time-out for the master's answer at the start [s]; rospy itself would wait forever
STANDS_S = 0.5  # longest time that a signal handler waits for the shutdown before the main thread goes on [s]


def init_node(name: str, **options: Any) -> None:
    """Call rospy.init_node, and let SIGINT and SIGTERM shut down the node in a separate thread.

    Raises:
        ApplrError: The master of ROS_MASTER_URI (or of the argument __master:=) does not answer.
        KeyboardInterrupt: The node was interrupted during the call.
    """
    before = socket.getdefaulttimeout()
    socket.setdefaulttimeout(PATIENCE_S)
    answers = rosgraph.is_master_online()
    socket.setdefaulttimeout(before)
    if not answers:
        where = rosgraph.get_master_uri()
        raise ApplrError(f"no ROS master at {where}: start one with roscore or roslaunch, or set ROS_MASTER_URI")
    try:
        rospy.init_node(name, **options)
    except rospy.exceptions.ROSInitException:
        if not rospy.core.is_shutdown_requested():
            raise
        raise KeyboardInterrupt from None

    def end(number: int, _: Any) -> None:
        ending = threading.Thread(target=rospy.signal_shutdown, args=[f"signal {number}"])
        ending.start()
        ending.join(STANDS_S)

    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, end)
    logging.getLogger("rosout").addFilter(
        lambda record: not (rospy.core.is_shutdown_requested() and "Traceback" in record.getMessage())
    )
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
