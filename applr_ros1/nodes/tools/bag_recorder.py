"""Bag recorder of the launch file, for the programs that begin a drive: send_goal and the demo.

`rosbag record -a` looks for new topics once per second and then connects to their nodes one by one.
A goal that is sent before would begin a drive whose first seconds are missing in the bag.
"""

from __future__ import annotations

import re
import time
from http.client import HTTPConnection
from typing import Any, Dict, Set
from xmlrpc.client import Error, ServerProxy, Transport

import rosgraph
import rospy

PATIENCE_S = 10.0  # wall time after which a drive begins without some of the topics [s]
ANSWER_S = 1.0  # longest wall time to wait for the answer of a node [s]
# Indices in a row of the slave API's getBusInfo: node at the other end, and topic
OTHER_NODE = 1
TOPIC = 4


class BagRecorder:
    """Running `rosbag record -a`, as the nodes see it whose messages it records.

    Args:
        name: Name of its node, relative to this node's namespace. Its private parameter
            `unrecorded` is the pattern of the topics that it leaves out.
    """

    def __init__(self, name: str):
        # rospy.resolve_name would take the demo's argument record:=FILE for a remapping of it.
        self._name = rosgraph.names.resolve_name(name, rospy.get_name())
        self._unrecorded = re.compile(str(rospy.get_param(name + "/unrecorded")))
        self._master = rosgraph.Master(rospy.get_name())
        self._last_time = time.monotonic() + PATIENCE_S

    def is_ready(self) -> bool:
        """Return whether all publishers of the topics that it records are connected to it.

        Also True, with a warning, if PATIENCE_S have passed: a publisher may have died.
        """
        missed_topics = set()
        for node_name, topic_names in self._recordable_topics().items():
            missed_topics |= topic_names - self._recorded_topics(node_name)
        if missed_topics and time.monotonic() > self._last_time:
            rospy.logwarn("%s does not record %s yet", self._name, ", ".join(sorted(missed_topics)))
            return True
        return not missed_topics

    def _recordable_topics(self) -> Dict[str, Set[str]]:
        """Return the names of the topics to record by the name of a node that publishes them."""
        publications, _, _ = self._master.getSystemState()
        recordable_topics: Dict[str, Set[str]] = {}
        for topic_name, node_names in publications:
            if not self._unrecorded.fullmatch(topic_name):
                for node_name in node_names:
                    recordable_topics.setdefault(node_name, set()).add(topic_name)
        return recordable_topics

    def _recorded_topics(self, node_name: str) -> Set[str]:
        """Return the names of the topics that a node sends to the recorder."""
        try:
            node_uri = self._master.lookupNode(node_name)
            # (status, message, rows)
            answer: Any = ServerProxy(node_uri, _Transport()).getBusInfo(rospy.get_name())
        except (rosgraph.MasterError, OSError, Error):  # It has ended, or does not answer.
            return set()
        _, _, connections = answer
        recorded_topics = set()
        for connection in connections:
            if connection[OTHER_NODE] == self._name:
                recorded_topics.add(connection[TOPIC])
        return recorded_topics


class _Transport(Transport):
    """Transport that does not wait forever for a node that hangs."""

    def make_connection(self, host: Any) -> HTTPConnection:
        connection = super().make_connection(host)
        connection.timeout = ANSWER_S
        return connection
