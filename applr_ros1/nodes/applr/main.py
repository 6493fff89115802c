"""Starts the applr node: reads its private parameters, joins method, inputs and topics, and runs until shutdown.

Started as `rosrun applr_ros1 applr.py`. What the node does is in node.py. Parameters: ~method (auto), ~robot (jackal;
name or folder of a description), ~seed, ~period [s] (0: the method's own), ~max_speed [m/s] (0: any), ~meter_scoring
(auto, true or false: see meter_scoring.py), ~tf_prefix and ~move_base (its name). Topic: ~set_parameters
(applr_ros1/Parameters). Services: ~enable (std_srvs/SetBool) and ~set_method (applr_ros1/SetMethod);
docs/reference/topics.md
"""

import gc
import math
import os
import sys

import rospy
from std_srvs.srv import SetBool, SetBoolResponse

from applr_ros1.common.arguments import number_within
from applr_ros1.common.errors import ApplrError
from applr_ros1.common.ros_node import init_node, until_shutdown
from applr_ros1.msg import Parameters
from applr_ros1.nodes.applr.inputs import RobotInputs
from applr_ros1.nodes.applr.meter_scoring import CHOICES
from applr_ros1.nodes.applr.node import ApplrNode
from applr_ros1.nodes.applr.topics import ApplrTopics
from applr_ros1.nodes.robot_parameters import named_robot
from applr_ros1.policy import methods
from applr_ros1.policy.parameter_space import space_of
from applr_ros1.srv import SetMethod, SetMethodResponse


def started_with(spec):
    """The specification, where whoever started the node gave it: on its command line, or in APPLR_METHOD as roslaunch.

    "" where it stands on the parameter server alone: any local user, and a website in a browser, can write there, so
    that no code is imported for it.
    """
    return spec if "_method:=" + spec in sys.argv or os.environ.get("APPLR_METHOD") == spec else ""


def make_method(spec, robot, given):
    """(method, ""), or (the planner's defaults, one line) where the method cannot be made: nothing else is lost.

    given: of started_with().
    """
    try:
        return methods.make(spec, robot, user_code=spec == given), ""
    except (ApplrError, OSError) as e:
        return methods.make("dwa", robot), str(e)


def enable(node, request):
    """The service ~enable."""
    node.switch(request.data)
    return SetBoolResponse(True, f"on, method {node.method.name}" if request.data else "off: theta_0")


def set_parameters(node, message):
    """The topic ~set_parameters: a set by hand, by names and values."""
    try:
        node.set_by_hand(dict(zip(message.names, message.values)))
    except ApplrError as problem:
        rospy.logerr("applr: no parameter was set by hand: %s", problem)


def set_method(node, given, request):
    """The service ~set_method. given: of started_with(), whether it could be made or not.

    It imports no code, since anybody who reaches the ROS master can call it: a person's own class is taken only where
    the node was started with it.
    """
    spec = request.method or node.method.name
    try:
        method = methods.make(spec, node.robot, user_code=spec == given)
    except (ValueError, OSError) as problem:
        rospy.logerr("applr: method stays %s: %s", node.method.name, problem)
        return SetMethodResponse(False, str(problem))
    node.change_method(method)
    rospy.loginfo("applr: method %s", spec)
    return SetMethodResponse(True, f"method {spec}")


def main():
    """Reads the private parameters and runs until shutdown. ApplrError, one line, for one of no use."""
    init_node("applr")
    given = rospy.get_param("~", {})
    most = {"period": 60.0, "seed": 2**31 - 1, "max_speed": math.inf}
    period, seed, max_speed = (number_within(name, given.get(name, 0), 0, high) for name, high in most.items())
    namespace = rospy.resolve_name(str(given.get("move_base", "move_base")))
    robot, prefix = named_robot(given)
    space = space_of(robot)
    slowest = dict(zip(space.names, space.low.tolist())).get("max_vel_x", 0.0)  # none: nothing to cap
    if 0 < max_speed < slowest:
        raise ApplrError(f"max_speed is {max_speed:g}: give at least {slowest:g} m/s, or 0 for any")
    spec = str(given.get("method", "auto"))
    meter_scoring = str(given.get("meter_scoring", "auto")).lower()  # ROS reads true as a bool
    if meter_scoring not in CHOICES:
        raise ApplrError(f"meter_scoring is {meter_scoring}: give {', '.join(CHOICES[:-1])} or {CHOICES[-1]}")
    code = started_with(spec)
    method, trouble = make_method(spec, robot, code)
    node = ApplrNode(
        method,
        RobotInputs(robot, namespace, prefix),
        ApplrTopics(robot),
        float(period) or None,
        namespace,
        float(max_speed) or math.inf,
        int(seed),
        meter_scoring,
        robot,
    )
    rospy.Subscriber("~set_parameters", Parameters, lambda message: set_parameters(node, message), queue_size=10)
    rospy.Service("~enable", SetBool, lambda request: enable(node, request))
    rospy.Service("~set_method", SetMethod, lambda request: set_method(node, code, request))
    if trouble:
        rospy.logerr(f"applr: {trouble}; driving on theta_0")
        node.degraded = trouble
    rospy.loginfo("applr: ready, method %s, a decision every %g s", method.name, node.period)
    gc.collect()
    gc.freeze()  # what is loaded by now stays; it need not be looked through again
    with until_shutdown():
        node.spin()
    return 0
