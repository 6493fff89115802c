"""A shutdown of rospy closes the topics before rospy.is_shutdown() says so: publish() raises meanwhile."""

from __future__ import annotations

from contextlib import contextmanager
from typing import Iterator

import rospy


@contextmanager
def until_shutdown() -> Iterator[None]:
    """Ends its block without an error where a shutdown closed a topic in the middle of it."""
    try:
        yield
    except rospy.ROSException:
        if not rospy.core.is_shutdown_requested():
            raise
