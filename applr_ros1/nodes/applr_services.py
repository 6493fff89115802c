"""The applr node's run-time services: switch the policy off and on, and change its mode or file without a restart.

Made by nodes/applr_node.py. Services are called from rospy's threads; ApplrNode.switch and ApplrNode.change_method are
safe to call from there.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import rospy
from std_srvs.srv import SetBool, SetBoolResponse

from applr_ros1.policy import methods
from applr_ros1.srv import SetMode, SetModeResponse

if TYPE_CHECKING:
    from applr_ros1.nodes.applr_node import ApplrNode


class Services:
    """~enable (std_srvs/SetBool) and ~set_mode (applr_ros1/SetMode).

    ~set_mode imports no code, since anybody who reaches the ROS master can call it: a class of one's own is a mode only
    where the node was started with it.

    Args:
        node: The node that is controlled.
    """

    def __init__(self, node: ApplrNode):
        self._node = node
        self._first = node.method.name
        self._services = (
            rospy.Service("~enable", SetBool, self._enable),
            rospy.Service("~set_mode", SetMode, self._set_mode),
        )

    def _enable(self, request):
        self._node.switch(request.data)
        return SetBoolResponse(True, "on, mode %s" % self._node.method.name if request.data else "off: theta_0")

    def _set_mode(self, request):
        mode = request.mode or self._node.method.name
        try:
            method = methods.make_mode(
                mode, request.policy, request.parameters, self._node.robot, own=mode == self._first
            )
        except (ValueError, OSError) as problem:
            rospy.logerr("applr: mode stays %s: %s", self._node.method.name, problem)
            return SetModeResponse(False, str(problem))
        self._node.change_method(method)
        rospy.loginfo("applr: mode %s%s", mode, ", policy " + request.policy if request.policy else "")
        return SetModeResponse(True, "mode %s" % mode)
