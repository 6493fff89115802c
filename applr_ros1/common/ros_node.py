"""Begin and end of a ROS node: one line if there is no master, no deadlock, no traceback at a shutdown.

rospy runs a shutdown inside its signal handler. If the main thread was just publishing or logging, it holds the lock
that the shutdown needs. init_node() therefore has a thread do it. A shutdown also closes the topics before
rospy.is_shutdown() says so: publish() then raises ROSException or, in the middle of a call, another exception.
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

PATIENCE_S = 3.0  # s for the master's answer at the start, for which rospy itself would wait for ever
STANDS_S = 0.5  # s that the main thread stands where it is interrupted, before it lets go of its locks


def init_node(name: str, **options: Any) -> None:
    """As rospy.init_node, with the shutdown in a thread of its own.

    Raises:
        ApplrError: The master of ROS_MASTER_URI (or of the argument __master:=) does not answer.
        KeyboardInterrupt: The node was interrupted meanwhile.
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
    """Ends its block without an error where something in it raises while rospy shuts down."""
    try:
        yield
    except Exception:
        if not rospy.core.is_shutdown_requested():
            raise
