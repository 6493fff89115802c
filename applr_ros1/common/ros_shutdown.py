"""A shutdown of rospy closes the topics before rospy.is_shutdown() says so: publish() raises meanwhile.

It raises ROSException, and where the topic is closed in the middle of it what happens to come of that, such as
AttributeError.
"""

from __future__ import annotations

from contextlib import contextmanager
from typing import Iterator

import rospy


@contextmanager
def until_shutdown() -> Iterator[None]:
    """Ends its block without an error where something in it raises while rospy shuts down."""
    try:
        yield
    except Exception:
        if not rospy.core.is_shutdown_requested():
            raise
