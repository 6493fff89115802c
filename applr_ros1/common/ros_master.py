"""Looks for the ROS master before a node starts: rospy would wait for one without a word, and for ever."""

from __future__ import annotations

import http.client
import os
import socket
import sys
import xmlrpc.client
from typing import Any

from applr_ros1.common.errors import ApplrError

PATIENCE = 3.0  # s


class NoMaster(ApplrError):
    """There is no ROS master."""


class _Transport(xmlrpc.client.Transport):
    def make_connection(self, host: Any) -> http.client.HTTPConnection:
        connection = super().make_connection(host)
        connection.timeout = PATIENCE
        return connection


def require_master() -> None:
    """Raise NoMaster, one line, unless the master of ROS_MASTER_URI (or of the argument __master:=) answers."""
    given = [word.partition(":=")[2] for word in sys.argv[1:] if word.startswith("__master:=")]
    uri = (given or [os.environ.get("ROS_MASTER_URI", "http://localhost:11311")])[0]
    try:
        xmlrpc.client.ServerProxy(uri, transport=_Transport()).getPid("/applr_start")
    except (OSError, xmlrpc.client.Error, http.client.HTTPException, socket.timeout, ValueError) as error:
        problem = getattr(error, "strerror", None) or str(error) or type(error).__name__
        raise NoMaster(
            "no ROS master at %s (%s): start one with roscore or roslaunch, or set ROS_MASTER_URI" % (uri, problem)
        ) from None
