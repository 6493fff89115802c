"""Client of move_base's service clear_costmaps, for the applr node."""

from __future__ import annotations

import threading
from typing import Optional

import rospy
from std_srvs.srv import Empty

from applr_ros1.common.errors import reason


class Costmaps:
    """The costmaps of one move_base, which can be cleared without waiting for it.

    A stopped process accepts calls without ever answering, and rospy has no time-out. Each call
    therefore has a thread, and none begins before the former one has ended.

    Args:
        namespace: Namespace of move_base.
    """

    def __init__(self, namespace: str):
        self._service = f"{namespace.rstrip('/')}/clear_costmaps"
        self._call: Optional[threading.Thread] = None

    def clear(self) -> None:
        """Begin to clear both costmaps."""
        if self._call is not None and self._call.is_alive():
            return
        self._call = threading.Thread(target=self._clear, name="clear_costmaps", daemon=True)
        self._call.start()

    def _clear(self) -> None:
        """Call the service. Without it, the robot drives on with its old costmaps."""
        try:
            rospy.ServiceProxy(self._service, Empty)()
        except (rospy.ServiceException, rospy.ROSException) as problem:
            rospy.logwarn(f"applr: costmaps not cleared: {reason(problem)}")
