"""How a ROS node of this package ends: within seconds, and without errors that come of the ending itself.

rospy runs a shutdown inside its signal handler, in the middle of whatever the main thread was doing. If that was
publishing, the lock that closing the topic needs may be taken, and the node would stay for ever: roslaunch kills it
after 17 s. init_node() ends it earlier and says where it was.

A shutdown of rospy also closes the topics before rospy.is_shutdown() says so: publish() raises meanwhile. It raises
ROSException, and where the topic is closed in the middle of it what happens to come of that, such as AttributeError.
"""

from __future__ import annotations

import faulthandler
from contextlib import contextmanager
from typing import Iterator

import rospy

LONGEST = 12.0  # s from the request to shut down to the end of the process; roslaunch waits for 15 s


def init_node(name: str) -> None:
    """As rospy.init_node. A node that still runs LONGEST seconds after it was asked to end is ended with status 1.

    What each of its threads was doing is then printed on stderr.
    """
    rospy.init_node(name)
    rospy.on_shutdown(lambda: faulthandler.dump_traceback_later(LONGEST, exit=True))


@contextmanager
def until_shutdown() -> Iterator[None]:
    """Ends its block without an error where something in it raises while rospy shuts down."""
    try:
        yield
    except Exception:
        if not rospy.core.is_shutdown_requested():
            raise
