"""Clients that call Gazebo's services and topics as existing programs do, for tests/live/test_gazebo_front.py.

GazeboSimulation makes the calls of the BARN Challenge's runner, Training those of the authors' training loop.
"""

import math
import time

import actionlib
import dynamic_reconfigure.client
import rospy
from gazebo_msgs.msg import ModelState
from gazebo_msgs.srv import GetModelState, SetModelState
from geometry_msgs.msg import PoseStamped, Quaternion
from move_base_msgs.msg import MoveBaseAction, MoveBaseGoal
from nav_msgs.srv import GetPlan
from std_msgs.msg import Bool
from std_srvs.srv import Empty


def model_state(x, y, z, angle):
    state = ModelState(model_name="jackal", reference_frame="world")
    state.pose.position.x, state.pose.position.y, state.pose.position.z = x, y, z
    state.pose.orientation = Quaternion(0, 0, math.sin(angle / 2), math.cos(angle / 2))
    return state


class GazeboSimulation:
    """Client for robot, physics and contacts, through Gazebo's services and topics."""

    def __init__(self, start):
        self.pause = rospy.ServiceProxy("/gazebo/pause_physics", Empty)
        self.unpause = rospy.ServiceProxy("/gazebo/unpause_physics", Empty)
        self._set = rospy.ServiceProxy("/gazebo/set_model_state", SetModelState)
        self._get = rospy.ServiceProxy("/gazebo/get_model_state", GetModelState)
        self.start = model_state(start[0], start[1], 0, start[2])
        self.contacts = 0
        self._subscriber = rospy.Subscriber("/collision", Bool, self._count)

    def _count(self, message):
        self.contacts += message.data

    def collided(self):
        """Return whether a contact was reported since the last call."""
        collided, self.contacts = self.contacts > 0, 0
        return collided

    def reset(self):
        rospy.wait_for_service("/gazebo/set_model_state")
        return self._set(self.start)

    def state(self):
        rospy.wait_for_service("/gazebo/get_model_state")
        return self._get("jackal", "world")

    def place(self):
        position = self.state().pose.position
        return position.x, position.y


def goal(x, y):
    made = MoveBaseGoal()
    made.target_pose.header.frame_id = "odom"
    made.target_pose.pose.position.x, made.target_pose.pose.position.y = x, y
    made.target_pose.pose.orientation = Quaternion(0, 0, 0, 1)
    return made


class Training:
    """Client that drives episodes with the sequence of calls of the authors' training loop."""

    def __init__(self, simulation, target):
        self.simulation, self.target = simulation, target
        self._clear = rospy.ServiceProxy("/move_base/clear_costmaps", Empty)
        self._plan = rospy.ServiceProxy("/move_base/make_plan", GetPlan)
        self._parameters = dynamic_reconfigure.client.Client(
            "/move_base/TrajectoryPlannerROS", timeout=180
        )
        self._action = actionlib.SimpleActionClient("/move_base", MoveBaseAction)
        assert self._action.wait_for_server(rospy.Duration(180.0))

    def episode(self, speed, seconds=1.0):
        """Reset, plan, drive, with paused physics in between. Return (planned length [m], driven length [m], speed)."""
        simulation = self.simulation
        self._action.cancel_all_goals()
        assert simulation.reset().success
        simulation.pause()
        simulation.unpause()
        taken = self._parameters.update_configuration({"max_vel_x": speed})
        self._wait(0.1)
        self._clear()
        plan = self.make_plan()
        self._clear()
        self._action.send_goal(goal(*self.target))
        began = simulation.place()
        self._wait(seconds)
        simulation.pause()
        end = simulation.place()
        simulation.unpause()
        points = [(p.pose.position.x, p.pose.position.y) for p in plan]
        planned = sum(math.dist(a, b) for a, b in zip(points, points[1:]))
        return planned, math.dist(began, end), taken["max_vel_x"]

    def make_plan(self):
        start, end = PoseStamped(), PoseStamped()
        start.header.frame_id = end.header.frame_id = "odom"
        start.pose.orientation.w = end.pose.orientation.w = 1.0
        end.pose.position.x, end.pose.position.y = self.target
        deadline = time.monotonic() + 180.0
        while time.monotonic() < deadline:  # A goal that was just cancelled may still be active.
            try:
                return self._plan(start, end, 0.5).plan.poses
            except rospy.ServiceException:
                time.sleep(0.02)
        raise AssertionError("no plan")

    @staticmethod
    def _wait(seconds):
        until = rospy.get_time() + seconds
        deadline = time.monotonic() + 180.0
        while rospy.get_time() < until:
            assert time.monotonic() < deadline, "simulated time does not advance"
            time.sleep(0.01)
