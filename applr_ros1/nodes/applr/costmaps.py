"""Client of move_base's service clear_costmaps, for the applr node."""

from __future__ import annotations

from concurrent.futures import Future
from typing import Optional

import rospy
from std_srvs.srv import Empty

from applr_ros1.common.errors import reason
from applr_ros1.common.threads import called


class Costmaps:
    """The costmaps of one move_base, which can be cleared without waiting for it.

    move_base may never answer, so each call has a thread, and none begins before the former one has
    ended.

    Args:
        namespace: Namespace of move_base.
    """

    def __init__(self, namespace: str):
        self._service = f"{namespace.rstrip('/')}/clear_costmaps"
        self._call: Optional[Future[None]] = None

    def request_clearing(self) -> None:
        """Begin to clear both costmaps."""
        if self._call is None or self._call.done():
            self._call = called(self._clear)

    def _clear(self) -> None:
        """Call the service. Without it, the robot drives on with its old costmaps."""
        try:
            rospy.ServiceProxy(self._service, Empty)()
        except (rospy.ServiceException, rospy.ROSException) as problem:
            rospy.logwarn(f"applr: costmaps not cleared: {reason(problem)}")
