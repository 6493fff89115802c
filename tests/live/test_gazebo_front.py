"""Tests of Gazebo's services on the simulated robot, and of the call sequences of two client
programs.
"""

import math
import time
from typing import NamedTuple

import actionlib
import dynamic_reconfigure.client
import pytest
import rospy
from gazebo_msgs.srv import GetModelState, SetModelState
from geometry_msgs.msg import Twist
from move_base_msgs.msg import MoveBaseAction
from nav_msgs.msg import Odometry
from nav_msgs.srv import GetPlan
from rosgraph_msgs.msg import Clock
from std_srvs.srv import Empty

from applr_ros1.nodes.conversions import twist
from tests.support import ROOT
from tests.support.gazebo import GazeboSimulation, goal, model_state
from tests.support.ros import LONGEST, session, wait_for

pytestmark = pytest.mark.ros

# Start (x, y, yaw) and goal (x, y) of the BARN Challenge, relative to the start [m, rad]
START = (-2.25, 3.0, 1.57)
GOAL = (0.0, 10.0)


class Episode(NamedTuple):
    """One episode: length of the plan [m], and the speed that was set [m/s]."""

    planned: float
    max_vel_x: float


class Training:
    """Client that drives episodes with the sequence of calls of the authors' training loop."""

    def __init__(self, simulation, target):
        self.simulation = simulation
        self.target = target
        self._clear = rospy.ServiceProxy("/move_base/clear_costmaps", Empty)
        self._plan = rospy.ServiceProxy("/move_base/make_plan", GetPlan)
        self._parameters = dynamic_reconfigure.client.Client(
            "/move_base/TrajectoryPlannerROS", timeout=180
        )
        self.action = actionlib.SimpleActionClient("/move_base", MoveBaseAction)
        assert self.action.wait_for_server(rospy.Duration(180.0))

    def episode(self, speed):
        """Reset, plan and drive for a second, with paused physics in between."""
        simulation = self.simulation

        # Reset the robot and set the parameter.
        self.action.cancel_all_goals()
        assert simulation.reset().success
        simulation.pause()
        simulation.unpause()
        configuration = self._parameters.update_configuration({"max_vel_x": speed})
        time.sleep(0.1)

        # Plan from cleared costmaps.
        self._clear()
        plan_poses = self.make_plan()
        self._clear()

        # Drive for a second, or until the robot has moved: a busy machine begins late.
        self.action.send_goal(goal(*self.target))
        start_position = simulation.place()
        time.sleep(1.0)
        wait_for(lambda: math.dist(start_position, simulation.place()) > 0.05, "motion")
        simulation.pause()
        simulation.unpause()

        points = [(pose.pose.position.x, pose.pose.position.y) for pose in plan_poses]
        planned_length = sum(map(math.dist, points, points[1:]))
        return Episode(planned_length, configuration["max_vel_x"])

    def make_plan(self):
        """Return the poses of a plan to the target."""
        start_pose = goal(0.0, 0.0).target_pose
        target_pose = goal(*self.target).target_pose
        deadline = time.monotonic() + 180.0
        while time.monotonic() < deadline:  # A goal that was just cancelled may still be active.
            try:
                return self._plan(start_pose, target_pose, 0.5).plan.poses
            except rospy.ServiceException:
                time.sleep(0.02)
        raise AssertionError("no plan")


@pytest.fixture(scope="module")
def gazebo():
    """Provide the simulated robot, started by the launch file for the BARN Challenge's runner."""
    child = session().spawn(
        "roslaunch",
        str(ROOT / "compat" / "jackal_helper" / "launch" / "gazebo_launch.launch"),
        "world_name:=generated:2",
        "gui:=false",
        APPLR_SIMULATOR="kinematic",
    )
    child.until("sim_bridge: ready")
    rospy.wait_for_service("/gazebo/set_model_state", LONGEST)
    yield child
    rospy.set_param("/use_sim_time", False)
    child.end()
    assert "Traceback" not in child.text, child.text


def test_starts_at_the_challenges_start_and_explains_refusals(gazebo):
    get_state = rospy.ServiceProxy("/gazebo/get_model_state", GetModelState)
    set_state = rospy.ServiceProxy("/gazebo/set_model_state", SetModelState)
    answer = get_state("jackal", "world")
    assert answer.success
    assert (answer.pose.position.x, answer.pose.position.y) == pytest.approx(START[:2], abs=0.02)
    # Only this model and this frame exist.
    assert not get_state("turtle", "world").success
    assert not get_state("jackal", "turtle").success
    for field, unknown_name in (("model_name", "turtle"), ("reference_frame", "moon")):
        refused_state = model_state(0, 0, 0, 0)
        setattr(refused_state, field, unknown_name)
        answer = set_state(refused_state)
        assert not answer.success
        assert unknown_name in answer.status_message


def odometry():
    """Return the next odometry message."""
    return rospy.wait_for_message("/odometry/filtered", Odometry, LONGEST)


def test_teleport_stops_the_robot_while_clock_and_odometry_go_on(gazebo):
    simulation = GazeboSimulation(START)
    publisher = rospy.Publisher("/cmd_vel", Twist, queue_size=1)
    wait_for(publisher.get_num_connections, "connection")

    def speed(v):
        """Command a speed, and return that along y in the world a moment later [m/s]."""
        publisher.publish(twist(v, 0.0))
        time.sleep(0.05)
        return simulation.state().twist.linear.y

    wait_for(
        lambda: speed(0.5) == pytest.approx(0.5, abs=0.1),
        "the speed along +y, the robot's heading in the world",
    )
    wait_for(lambda: abs(speed(0.0)) < 0.02, "standstill")
    # A jump of odometry or clock would make planner and monitor start anew.
    position_before = odometry().pose.pose.position
    clock_before = rospy.wait_for_message("/clock", Clock, LONGEST).clock
    assert simulation.reset().success
    assert simulation.place() == pytest.approx(START[:2], abs=0.01)
    assert abs(simulation.state().twist.linear.y) < 0.02
    position_after = odometry().pose.pose.position
    assert position_after.x == pytest.approx(position_before.x, abs=0.03)
    assert position_after.y == pytest.approx(position_before.y, abs=0.03)
    assert rospy.wait_for_message("/clock", Clock, LONGEST).clock > clock_before
    publisher.unregister()


def test_time_pauses_and_resumes(gazebo):
    simulation = GazeboSimulation(START)
    clocks = []
    subscriber = rospy.Subscriber("/clock", Clock, lambda message: clocks.append(message.clock))
    wait_for(lambda: clocks, "the clock")
    simulation.pause()

    def stands():
        """Return whether no clock message with a later time comes within half a second."""
        latest_clock = clocks[-1]
        time.sleep(0.5)
        return clocks[-1] == latest_clock

    wait_for(stands, "the clock to stop")
    paused_at = clocks[-1]
    assert simulation.reset().success  # Services still answer.
    assert simulation.place() == pytest.approx(START[:2], abs=0.01)
    simulation.unpause()
    wait_for(lambda: clocks[-1] > paused_at, "the clock")
    subscriber.unregister()


@pytest.fixture(scope="module")
def move_base(gazebo):
    """Provide move_base under its name in launch files, move_base/move_base."""
    child = session().spawn(
        "roslaunch", str(ROOT / "compat" / "jackal_helper" / "launch" / "move_base_DWA.launch")
    )
    child.until("ready")
    yield child
    child.end()


def test_move_base_stops_without_warnings_while_time_is_paused(gazebo, move_base):
    simulation = GazeboSimulation(START)
    training = Training(simulation, GOAL)
    simulation.reset()
    training.action.send_goal(goal(*GOAL))
    wait_for(lambda: simulation.place()[1] > START[1] + 0.2, "the robot")
    simulation.pause()
    paused_position = simulation.place()
    # The last cycle may still report those that a busy machine has skipped before the pause.
    time.sleep(0.5)
    earlier_output = len(move_base.text)
    time.sleep(3.0)
    assert simulation.place() == paused_position
    output = move_base.text[earlier_output:]
    assert "WARN" not in output, output
    assert "ERROR" not in output, output
    simulation.unpause()
    wait_for(lambda: math.dist(simulation.place(), paused_position) > 0.2, "the robot")


@pytest.mark.parametrize("count", [4, pytest.param(100, marks=pytest.mark.long)])
def test_the_training_loop_of_the_authors(gazebo, move_base, count):
    """Every episode drives with its own parameter value, and no call fails."""
    training = Training(GazeboSimulation(START), GOAL)
    for episode_number in range(count):
        speed = 0.3 + 0.1 * (episode_number % 5)
        episode = training.episode(speed)
        assert episode.max_vel_x == pytest.approx(speed)
        # The goal is 10 m ahead, and obstacles make the way longer.
        assert 9.5 < episode.planned < 16.0, episode_number
    assert "Traceback" not in move_base.text
