"""Main program of the applr node: connects method, inputs and topics, and runs the node.

Started as `rosrun applr_ros1 applr.py`; node.py has the node itself. Parameters: ~method (default:
auto), ~robot (name or folder of a description; default: jackal), ~seed (a number; auto, the
default, draws another one at each start), ~period (decision period [s]; 0 means the method's own),
~max_speed ([m/s]; 0 means no limit), ~meter_scoring (auto, true or false: see meter_scoring.py),
~map, ~tf_prefix, and ~move_base (name of the move_base node). Topic: ~set_parameters
(applr_ros1/Parameters). Services: ~enable (std_srvs/SetBool) and ~set_method
(applr_ros1/SetMethod). See docs/reference/topics.md.
"""

from __future__ import annotations

import gc
import math
import os
import secrets
import sys
from functools import partial
from typing import Any, Tuple

import rospy
from std_srvs.srv import SetBool, SetBoolResponse

from applr_ros1.common.arguments import number_within
from applr_ros1.common.errors import ApplrError
from applr_ros1.common.ros_node import init_node, until_shutdown
from applr_ros1.msg import Parameters
from applr_ros1.nodes.applr.inputs import RobotInputs
from applr_ros1.nodes.applr.meter_scoring import AUTO, CHOICES
from applr_ros1.nodes.applr.node import ApplrNode
from applr_ros1.nodes.applr.topics import ApplrTopics
from applr_ros1.nodes.robot_parameters import named_robot
from applr_ros1.policy import methods
from applr_ros1.policy.parameter_space import SPEED_LIMITS, space_of
from applr_ros1.robots import Robot
from applr_ros1.robots.check import crossed_limits
from applr_ros1.srv import SetMethod, SetMethodResponse


def started_with(spec: str) -> str:
    """Return `spec` if it was given on the command line or by roslaunch (APPLR_METHOD), else "".

    Any local user, and a website in a browser, can write to the parameter server. No code is
    imported for a method that is given only there.
    """
    if "_method:=" + spec in sys.argv or os.environ.get("APPLR_METHOD") == spec:
        return spec
    return ""


def make_method(spec: str, robot: Robot, started_spec: str) -> Tuple[Any, str]:
    """Return (method, ""), or (default parameters, reason) if the method cannot be created.

    started_spec: Result of started_with().
    """
    try:
        return methods.make(spec, robot, user_code=spec == started_spec), ""
    except ApplrError as problem:
        return methods.make("dwa", robot), str(problem)


def enable(node: ApplrNode, request: Any) -> SetBoolResponse:
    """Handle the service ~enable."""
    node.switch(request.data)
    state = f"on, method {node.method.name}" if request.data else "off"
    return SetBoolResponse(True, f"{state}: {node.supervisor.in_force} drive now")


def set_parameters(node: ApplrNode, message: Parameters) -> None:
    """Handle the topic ~set_parameters: set parameters by hand, by names and values."""
    try:
        node.set_by_hand(dict(zip(message.names, message.values)))
    except ApplrError as problem:
        rospy.logerr("applr: parameters were not set by hand: %s", problem)


def set_method(node: ApplrNode, started_spec: str, request: Any) -> SetMethodResponse:
    """Handle the service ~set_method. started_spec: Result of started_with().

    Anybody who reaches the ROS master can call this service. The service therefore imports no code,
    except for the user-defined method with which the node was started.
    """
    # An empty name asks for the method in use to be made anew, such as after a new policy file.
    spec = request.method or node.method.name
    try:
        method = methods.make(spec, node.robot, user_code=spec == started_spec)
    except ApplrError as problem:
        rospy.logerr("applr: method remains %s: %s", node.method.name, problem)
        return SetMethodResponse(False, str(problem))
    node.change_method(method)
    rospy.loginfo("applr: method %s", spec)
    return SetMethodResponse(True, f"method {spec}")


def main() -> int:
    """Run the node until shutdown.

    Raises:
        ApplrError: A private parameter is invalid.
    """
    init_node("applr")
    parameters = rospy.get_param("~", {})
    period = number_within("period", parameters.get("period", 0), 0, 60.0)
    seed = parameters.get("seed", AUTO)
    # Draws that are the same in every drive would repeat a failed drive for ever.
    if seed == AUTO:
        seed = secrets.randbelow(2**31)
    seed = number_within("seed", seed, 0, 2**31 - 1)
    max_speed = number_within("max_speed", parameters.get("max_speed", 0), 0, math.inf)
    max_speed = float(max_speed) or math.inf  # 0: no limit
    namespace = rospy.resolve_name(str(parameters.get("move_base", "move_base")))
    robot, prefix = named_robot(parameters)
    space = space_of(robot)

    # The methods choose speeds within their ranges, whose begin a limit cannot undercut, and the
    # planner has slowest speeds.
    lowest_limit = space.low[space.sets_speed].max(initial=0.0)
    planner = robot.local_planner
    values = robot.all_parameters()[planner]
    limited_values = {**values, **space.below(max_speed).defaults.get(planner, {})}
    for limits in crossed_limits(planner, limited_values):
        if limits.high in SPEED_LIMITS:
            lowest_limit = max(lowest_limit, values[limits.low])
    if max_speed < lowest_limit:
        advice = f"give at least {lowest_limit:g} m/s, or 0 for no limit"
        raise ApplrError(f"max_speed is {max_speed:g}: {advice}")
    spec = str(parameters.get("method", "auto"))
    meter_scoring = str(parameters.get("meter_scoring", AUTO)).lower()  # ROS parses true as a bool.
    if meter_scoring not in CHOICES:
        advice = f"give {', '.join(CHOICES[:-1])} or {CHOICES[-1]}"
        raise ApplrError(f"meter_scoring is {meter_scoring}: {advice}")
    started_spec = started_with(spec)
    method, trouble = make_method(spec, robot, started_spec)
    node = ApplrNode(
        method,
        RobotInputs(robot, namespace, prefix),
        ApplrTopics(robot),
        float(period) or None,
        namespace,
        max_speed,
        int(seed),
        meter_scoring,
        robot,
    )
    rospy.Subscriber("~set_parameters", Parameters, partial(set_parameters, node), queue_size=10)
    rospy.Service("~enable", SetBool, partial(enable, node))
    rospy.Service("~set_method", SetMethod, partial(set_method, node, started_spec))
    # A robot whose policy cannot be read still drives to its goals.
    if trouble:
        rospy.logerr(f"applr: {trouble}; driving with the default parameters")
        node.supervisor.degraded = trouble
    ready_message = "applr: ready, method %s, a decision every %g s, seed %d"
    rospy.loginfo(ready_message, method.name, node.supervisor.pilot.period, int(seed))
    # Objects that are loaded by now are permanent: the garbage collector can skip them.
    gc.collect()
    gc.freeze()
    with until_shutdown():
        node.spin()
    return 0
