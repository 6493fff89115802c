"""Starts the applr node: reads its private parameters, joins method, inputs and topics, and runs until shutdown.

Run by scripts/applr.py. What the node does is in applr_node.py. Parameters: ~mode (applr), ~policy and ~parameters (its
files), ~robot (jackal; name or folder of a description), ~seed, ~period [s], ~max_speed [m/s], ~weights (fit),
~move_base (its name), ~scan_topic, ~odom_topic and ~plan_topic; README.md says more.
"""

import gc
import math
import sys

import rospy

from applr_ros1.common.arguments import number_within
from applr_ros1.common.errors import ApplrError
from applr_ros1.common.ros_master import require_master
from applr_ros1.common.ros_shutdown import init_node, until_shutdown
from applr_ros1.nodes.applr_inputs import Inputs
from applr_ros1.nodes.applr_node import ApplrNode
from applr_ros1.nodes.applr_services import Services
from applr_ros1.nodes.applr_topics import ApplrTopics
from applr_ros1.policy import methods
from applr_ros1.policy.distance_weights import CHOICES, FIT
from applr_ros1.policy.parameter_space import SpaceError, space_of
from applr_ros1.robots import JACKAL, load


def make_method(mode, policy, parameters, robot=JACKAL):
    """The method for `mode`. When its file cannot be used: one line, and the planner drives on theta_0."""
    try:
        return methods.make_mode(mode, policy, parameters, robot), ""
    except ApplrError as e:
        if mode not in methods.METHODS and mode not in methods.MODES:
            raise
        return methods.make_mode("dwa", robot=robot), str(e)


def _number(name, default, low, high):
    """The private parameter `name`. SpaceError, one line, where it is no number from low to high."""
    return number_within(name, rospy.get_param("~" + name, default), low, high, SpaceError)


def _text(name, default):
    """The private parameter `name`, a name of something; empty only where the default is."""
    value = rospy.get_param("~" + name, default)
    if not isinstance(value, str) or (default and not value):
        raise SpaceError(f"{name} is {value!r}: give a text, for instance {default or 'a file'}")
    return value


def main():
    """Reads the private parameters and runs until shutdown. Returns the exit status."""
    require_master()
    init_node("applr")
    try:
        period, seed, namespace = (
            _number("period", 0, 0, 60.0),
            _number("seed", 0, 0, 2**31 - 1),
            rospy.resolve_name(_text("move_base", "move_base")),
        )
        robot = load(_text("robot", JACKAL.name))
        space = space_of(robot)
        slowest = dict(zip(space.names, space.low.tolist())).get("max_vel_x", 0.0)  # none: nothing to cap
        max_speed = _number("max_speed", math.inf, slowest, math.inf)
        topics = (
            _text("scan_topic", robot.topics.scan),
            _text("odom_topic", robot.topics.odometry),
            _text("plan_topic", namespace + "/NavfnROS/plan"),
        )
        mode, weights = _text("mode", "applr"), _text("weights", FIT)
        if weights not in CHOICES:
            raise SpaceError(f"weights is {weights!r}: give {', '.join(CHOICES[:-1])} or {CHOICES[-1]}")
        method, trouble = make_method(mode, _text("policy", ""), _text("parameters", ""), robot)
    except ApplrError as e:
        print(f"applr: {e}", file=sys.stderr)
        return 1
    inputs = Inputs(*topics, namespace, robot.laser.pose[2])
    topics = ApplrTopics(space=space)
    node = ApplrNode(
        method, inputs, topics, float(period) or None, namespace, float(max_speed), int(seed), weights, robot
    )
    Services(node)
    if trouble:
        rospy.logerr(f"applr: {trouble}; driving on theta_0")
        node.degraded = trouble
    rospy.loginfo("applr: ready, mode %s, a decision every %g s", method.name, node.period)
    gc.collect()
    gc.freeze()  # what is loaded by now stays; it need not be looked through again
    with until_shutdown():
        node.spin()
    return 0
