"""Sends a goal to move_base, ours or the C++ one, through its action, and waits until it ends.

The node send_goal; the demo uses its functions. Parameters: ~goal ("x y yaw" [m, m, rad], auto for the course's, or
none), ~world for auto, ~robot (jackal; name or folder of a description), and ~tf_prefix of the odometry's frame, in
which a goal is given.
"""

import time

import actionlib
import rospy
from move_base_msgs.msg import MoveBaseAction, MoveBaseGoal

import worlds
from applr_ros1.common import arguments
from applr_ros1.common.progress import announced
from applr_ros1.common.ros_node import init_node
from applr_ros1.nodes.conversions import GOAL_STATES, pose_stamped
from applr_ros1.robots import load


def course_goal(course):
    """The course's goal (x, y, yaw) in the odometry's frame: its origin is the start position, its axes the world's."""
    (start_x, start_y, _), (x, y, yaw) = course.start, course.sent_goal
    return x - start_x, y - start_y, yaw


def message(pose, frame="odom", stamp=None):
    """A MoveBaseGoal for pose (x, y, yaw) [m, m, rad]."""
    return MoveBaseGoal(pose_stamped(pose, frame, stamp or rospy.Time(0)))


def main():
    """Send ~goal (auto: the course of ~world), wait and say how it ended."""
    init_node("send_goal")
    given = str(rospy.get_param("~goal", "auto"))
    if given == "none":
        rospy.loginfo("goal is none: nothing is sent")
        return
    robot = load(str(rospy.get_param("~robot", "jackal")))
    frame = arguments.frame_prefix(str(rospy.get_param("~tf_prefix", ""))) + robot.frames.odom
    if given == "auto":
        course = worlds.scaled(worlds.load(rospy.get_param("~world", "generated:0")), robot.world_scale).course
        pose = course_goal(course)
    else:
        pose = arguments.pose("goal", given)
    client = actionlib.SimpleActionClient("move_base", MoveBaseAction)
    with announced("waiting for the action server of move_base", rospy.loginfo, first=10.0):
        client.wait_for_server()
    with announced("waiting for the clock to start (use_sim_time is true)", rospy.loginfo):
        while rospy.get_time() == 0.0 and not rospy.is_shutdown():
            time.sleep(0.1)  # simulated time has not begun
    if rospy.is_shutdown():
        return
    rospy.loginfo("goal sent: %.2f m, %.2f m, %.2f rad in %s", *pose, frame)
    client.send_goal(message(pose, frame))
    client.wait_for_result()
    if not rospy.is_shutdown():
        rospy.loginfo("goal %s: %s", GOAL_STATES[client.get_state()], client.get_goal_status_text())
