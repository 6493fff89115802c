"""ROS node `send_goal`: sends a goal to move_base and waits for its end.

The move_base is this package's or the C++ one.

Parameters: ~goal ("x y yaw" [m, m, rad] in the odometry frame, auto for the course's goal, or
none), ~world for auto, ~robot (jackal; name or folder of a description), ~tf_prefix of the odometry
frame, ~wait_for (topics of which the goal waits for a message), and ~recorder (name of a bag
recorder that the goal waits for; none if empty).
"""

from __future__ import annotations

import time

import actionlib
import rospy
from move_base_msgs.msg import MoveBaseAction, MoveBaseGoal

import worlds
from applr_ros1.common import arguments
from applr_ros1.common.angles import Pose
from applr_ros1.common.progress import announced
from applr_ros1.common.ros_node import init_node
from applr_ros1.nodes.conversions import GOAL_STATES, pose_stamped
from applr_ros1.nodes.robot_parameters import named_robot
from applr_ros1.robots.robot_world import world_of

from .bag_recorder import BagRecorder

PATIENCE_S = 60.0  # longest wall time for which the goal waits for a message [s]


def course_goal(course: worlds.Course) -> Pose:
    """Return the course's goal (x, y, yaw) in odom.

    This frame has the start as its origin, and the axes of the world.
    """
    start_x, start_y, _ = course.start
    goal_x, goal_y, goal_yaw = course.sent_goal
    return goal_x - start_x, goal_y - start_y, goal_yaw


def _wait_for(topic: str) -> None:
    """Wait for a message on a topic, at most PATIENCE_S seconds.

    Until then, the robot would drive without what publishes there.
    """
    with announced(f"waiting for {rospy.resolve_name(topic)}", rospy.loginfo, first=10.0):
        try:
            rospy.wait_for_message(topic, rospy.AnyMsg, timeout=PATIENCE_S)
        except rospy.ROSException as problem:
            if not rospy.is_shutdown():
                rospy.logwarn("send_goal: %s: the goal is sent all the same", problem)


def main() -> None:
    """Send the goal, wait for its end and log the outcome."""
    init_node("send_goal")
    parameters = rospy.get_param("~", {})
    goal_words = str(parameters.get("goal", "auto"))
    if goal_words == "none":
        rospy.loginfo("send_goal: goal is none: nothing is sent")
        return
    robot, prefix = named_robot(parameters)
    odom_frame = prefix + robot.frames.odom
    if goal_words == "auto":
        world = world_of(str(parameters.get("world", "generated:0")), robot)
        goal_pose = course_goal(world.course)
    else:
        goal_pose = arguments.pose("goal", goal_words)
    client = actionlib.SimpleActionClient("move_base", MoveBaseAction)
    with announced("waiting for the action server of move_base", rospy.loginfo, first=10.0):
        client.wait_for_server()
    with announced("waiting for the clock to start (use_sim_time is true)", rospy.loginfo):
        while rospy.get_time() == 0.0 and not rospy.is_shutdown():
            time.sleep(0.1)
    for topic in parameters.get("wait_for", []):
        _wait_for(topic)
    recorder_name = str(parameters.get("recorder", ""))
    if recorder_name:
        recorder = BagRecorder(recorder_name)
        while not rospy.is_shutdown() and not recorder.is_ready():
            time.sleep(0.1)
    if rospy.is_shutdown():
        return
    rospy.loginfo("send_goal: goal %.2f m, %.2f m, %.2f rad in %s", *goal_pose, odom_frame)
    # Stamp 0 means the latest transform: a stamp of now would lie ahead of tf.
    client.send_goal(MoveBaseGoal(pose_stamped(goal_pose, odom_frame, rospy.Time(0))))
    client.wait_for_result()
    if not rospy.is_shutdown():
        state = GOAL_STATES[client.get_state()]
        rospy.loginfo("send_goal: goal %s: %s", state, client.get_goal_status_text())
