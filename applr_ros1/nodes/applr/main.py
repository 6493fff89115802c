"""Starts the applr node: reads its private parameters, joins method, inputs and topics, and runs until shutdown.

Run by scripts/applr.py. What the node does is in node.py. Parameters: ~method (applr), ~robot (jackal; name or folder
of a description), ~seed, ~period [s] (0: the method's own), ~max_speed [m/s] (0: any), ~meter_scoring (auto, true or
false: see meter_scoring.py), ~move_base (its name), ~scan_topic, ~odom_topic and ~plan_topic;
docs/reference/topics.md
"""

import gc
import math

import rospy

from applr_ros1.common.arguments import number_within
from applr_ros1.common.errors import ApplrError
from applr_ros1.common.ros_node import init_node, until_shutdown
from applr_ros1.nodes.applr.inputs import Inputs
from applr_ros1.nodes.applr.meter_scoring import AUTO, CHOICES
from applr_ros1.nodes.applr.node import ApplrNode
from applr_ros1.nodes.applr.services import Services
from applr_ros1.nodes.applr.topics import ApplrTopics
from applr_ros1.policy import methods
from applr_ros1.policy.parameter_space import space_of
from applr_ros1.robots import JACKAL, load


def make_method(spec, robot=JACKAL):
    """(method, ""), or (the planner's defaults, one line) where the method cannot be made: nothing else is lost."""
    try:
        return methods.make(spec, robot, commands=False), ""
    except (ApplrError, OSError) as e:
        return methods.make("dwa", robot), str(e)


def _number(name, default, low, high):
    """The private parameter `name`. ApplrError, one line, where it is no number from low to high."""
    return number_within(name, rospy.get_param("~" + name, default), low, high)


def _text(name, default):
    """The private parameter `name`, a name of something; empty only where the default is."""
    value = rospy.get_param("~" + name, default)
    if isinstance(value, bool):  # what ROS makes of true and false
        value = str(value).lower()
    if not isinstance(value, str) or (default and not value):
        raise ApplrError(f"{name} is {value!r}: give a text, for instance {default or 'a file'}")
    return value


def main():
    """Reads the private parameters and runs until shutdown. ApplrError, one line, for one of no use."""
    init_node("applr")
    period, seed, namespace = (
        _number("period", 0, 0, 60.0),
        _number("seed", 0, 0, 2**31 - 1),
        rospy.resolve_name(_text("move_base", "move_base")),
    )
    robot = load(_text("robot", JACKAL.name))
    space = space_of(robot)
    slowest = dict(zip(space.names, space.low.tolist())).get("max_vel_x", 0.0)  # none: nothing to cap
    max_speed = _number("max_speed", 0, 0, math.inf)
    if 0 < max_speed < slowest:
        raise ApplrError(f"max_speed is {max_speed:g}: give at least {slowest:g} m/s, or 0 for any")
    topics = (
        _text("scan_topic", robot.topics.scan),
        _text("odom_topic", robot.topics.odometry),
        _text("plan_topic", namespace + "/NavfnROS/plan"),
    )
    spec, meter_scoring = _text("method", "applr"), _text("meter_scoring", AUTO)
    if meter_scoring not in CHOICES:
        raise ApplrError(f"meter_scoring is {meter_scoring}: give {', '.join(CHOICES[:-1])} or {CHOICES[-1]}")
    method, trouble = make_method(spec, robot)
    inputs = Inputs(*topics, namespace, robot.laser.pose[2])
    topics = ApplrTopics(space=space)
    node = ApplrNode(
        method,
        inputs,
        topics,
        float(period) or None,
        namespace,
        float(max_speed) or math.inf,
        int(seed),
        meter_scoring,
        robot,
    )
    Services(node, spec)
    if trouble:
        rospy.logerr(f"applr: {trouble}; driving on theta_0")
        node.degraded = trouble
    rospy.loginfo("applr: ready, method %s, a decision every %g s", method.name, node.period)
    gc.collect()
    gc.freeze()  # what is loaded by now stays; it need not be looked through again
    with until_shutdown():
        node.spin()
    return 0
