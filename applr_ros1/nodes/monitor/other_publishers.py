"""Watches whether other nodes publish on a topic on which one node alone should.

The collision monitor uses it: a command that another node sends to the base directly is checked by nobody.
"""

from __future__ import annotations

import threading
import time
import xmlrpc.client
from typing import Callable, Tuple

import rosgraph
import rospy

GUARD_SUFFIX = (
    "_guard"  # behind the name of a node: that of the process which stops the base while the node does not live
)
PERIOD_S = 2.0  # s of wall time between two looks


class OtherPublishers:
    """The other nodes that publish on a topic, looked up at the ROS master in a thread of its own.

    Args:
        topic: Resolved name of the topic.
        say: Called with the nodes' names, separated by commas, whenever there are others than before.

    Attributes:
        names: Of the nodes that were found last, in alphabetical order.
    """

    def __init__(self, topic: str, say: Callable[[str], object]):
        self.names: Tuple[str, ...] = ()
        self._topic, self._say = topic, say
        threading.Thread(target=self._watch, daemon=True).start()

    def _watch(self) -> None:
        me = rospy.get_name()
        while not rospy.is_shutdown():
            try:
                publishers, _, _ = rosgraph.Master(me).getSystemState()
            except (rosgraph.MasterException, xmlrpc.client.Error, OSError):
                pass  # no master for the moment: what is known stays
            else:
                found = tuple(sorted(set(dict(publishers).get(self._topic, ())) - {me, me + GUARD_SUFFIX}))
                if found and found != self.names:
                    self._say(", ".join(found))
                self.names = found
            time.sleep(PERIOD_S)
