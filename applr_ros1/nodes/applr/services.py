"""The applr node's run-time services: switch the method off and on, and take another one without a restart.

Made by main.py. Services are called from rospy's threads; ApplrNode.switch and ApplrNode.change_method are safe to call
from there.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import rospy
from std_srvs.srv import SetBool, SetBoolResponse

from applr_ros1.policy import methods
from applr_ros1.srv import SetMethod, SetMethodResponse

if TYPE_CHECKING:
    from applr_ros1.nodes.applr.node import ApplrNode


class Services:
    """~enable (std_srvs/SetBool) and ~set_method (applr_ros1/SetMethod).

    ~set_method imports no code, since anybody who reaches the ROS master can call it: a person's own class is taken
    only where the node was started with it.

    Args:
        node: The node that is controlled.
        first: The method that the node was started with, whether it could be made or not.
    """

    def __init__(self, node: ApplrNode, first: str):
        self._node, self._first = node, first
        self._services = (
            rospy.Service("~enable", SetBool, self._enable),
            rospy.Service("~set_method", SetMethod, self._set_method),
        )

    def _enable(self, request):
        self._node.switch(request.data)
        return SetBoolResponse(True, f"on, method {self._node.method.name}" if request.data else "off: theta_0")

    def _set_method(self, request):
        spec = request.method or self._node.method.name
        try:
            method = methods.make(spec, self._node.robot, own=spec == self._first, commands=False)
        except (ValueError, OSError) as problem:
            rospy.logerr("applr: method stays %s: %s", self._node.method.name, problem)
            return SetMethodResponse(False, str(problem))
        self._node.change_method(method)
        rospy.loginfo("applr: method %s", spec)
        return SetMethodResponse(True, f"method {spec}")
