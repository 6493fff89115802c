"""Programs that use Gazebo's services and topics: a client of the simulation, and a BARN
Challenge's runner.

The runner makes the same calls in the same order as the Challenge's. tests/nodes/test_barn.py
copies this file as run.py into a synthetic checkout, so it imports nothing of this repository.
"""

import argparse
import math
import os
import subprocess
import time

import actionlib
import numpy as np
import rospkg
import rospy
from gazebo_msgs.msg import ModelState
from gazebo_msgs.srv import GetModelState, SetModelState
from geometry_msgs.msg import Quaternion
from move_base_msgs.msg import MoveBaseAction, MoveBaseGoal
from std_msgs.msg import Bool
from std_srvs.srv import Empty


def model_state(x, y, z, angle):
    """Return the state of a Jackal at a place [m] with a yaw [rad], at rest."""
    state = ModelState(model_name="jackal", reference_frame="world")
    state.pose.position.x = x
    state.pose.position.y = y
    state.pose.position.z = z
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
        collided = self.contacts > 0
        self.contacts = 0
        return collided

    def reset(self):
        """Put the robot back to its start."""
        rospy.wait_for_service("/gazebo/set_model_state")
        return self._set(self.start)

    def state(self):
        """Return the robot's state in the world."""
        rospy.wait_for_service("/gazebo/get_model_state")
        return self._get("jackal", "world")

    def place(self):
        """Return the robot's position (x, y) [m] in the world."""
        position = self.state().pose.position
        return position.x, position.y


def goal(x, y):
    """Return a goal of move_base in the odometry frame, along x."""
    message = MoveBaseGoal()
    message.target_pose.header.frame_id = "odom"
    message.target_pose.pose.position.x = x
    message.target_pose.pose.position.y = y
    message.target_pose.pose.orientation = Quaternion(0, 0, 0, 1)
    return message


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("--world_idx", type=int, default=0)
    parser.add_argument("--gui", action="store_true")
    parser.add_argument("--out", default="out.txt")
    arguments = parser.parse_args()
    world_number = arguments.world_idx
    if world_number < 300:
        world_file = "BARN/world_%d.world" % world_number
        start_pose = (-2.25, 3, 1.57)
        target = (0, 10)
    else:
        world_file = "DynaBARN/world_%d.world" % (world_number - 300)
        start_pose = (11, 0, 3.14)
        target = (-20, 0)

    # Start the simulation.
    package = rospkg.RosPack().get_path("jackal_helper")
    os.environ["GAZEBO_PLUGIN_PATH"] = os.path.join(package, "plugins")
    launch_file = os.path.join(package, "launch", "gazebo_launch.launch")
    world_argument = "world_name:=" + os.path.join(package, "worlds", world_file)
    gui_argument = "gui:=" + ("true" if arguments.gui else "false")
    gazebo = subprocess.Popen(["roslaunch", launch_file, world_argument, gui_argument])
    time.sleep(5)
    rospy.init_node("gym", anonymous=True)
    rospy.set_param("/use_sim_time", True)
    simulation = GazeboSimulation(start_pose)
    # The target is relative to the start, in the world's directions.
    start = start_pose[:2]
    end = (start[0] + target[0], start[1] + target[1])

    # Put the robot to the start until it stands there without a contact.
    position = simulation.place()
    collided = True
    while math.dist(start, position) > 0.1 or collided:
        simulation.reset()
        position = simulation.place()
        collided = simulation.collided()
        time.sleep(1)

    # Start the stack, and send the goal. The time counts from the robot's first motion on.
    launch_file = os.path.join(package, "..", "jackal_helper/launch/move_base_DWA.launch")
    stack = subprocess.Popen(["roslaunch", launch_file])
    client = actionlib.SimpleActionClient("/move_base", MoveBaseAction)
    client.wait_for_server()
    client.send_goal(goal(*target))
    sim_time = rospy.get_time()
    while math.dist(start, position) < 0.1:
        sim_time = rospy.get_time()
        position = simulation.place()
        time.sleep(0.01)
    began = sim_time
    elapsed = 0.0
    collided = False
    while math.dist(end, position) > 1 and not collided and elapsed < 100:
        sim_time = rospy.get_time()
        elapsed = sim_time - began
        position = simulation.place()
        print("Time: %.2f (s), x: %.2f (m), y: %.2f (m)" % (elapsed, *position), end="\r")
        collided = simulation.collided()
        while rospy.get_time() - sim_time < 0.1:
            time.sleep(0.01)

    # Metric: the optimal time, at 2 m/s along the reference path, over 2 to 8 times this time
    success = not collided and elapsed < 100
    if world_number < 300:
        path_files = os.path.join(package, "worlds/BARN/path_files")
        cells = np.load(os.path.join(path_files, "path_%d.npy" % world_number))
        # From cells of 0.15 m to the world, as the Challenge's runner does
        points = [(0.15 * x - 0.075 - 4.5, 0.15 * y + 0.075 + 5.0) for x, y in cells]
        points = [start, *points, end]
        path_length = sum(map(math.dist, points, points[1:]))
    else:
        path_length = 20.0
    optimal_time = path_length / 2
    metric = success * optimal_time / np.clip(elapsed, 2 * optimal_time, 8 * optimal_time)
    result = (world_number, success, collided, elapsed >= 100, elapsed, metric)
    with open(arguments.out, "a") as results_file:
        results_file.write("%d %d %d %d %.4f %.4f\n" % result)
    for process in (gazebo, stack):
        process.terminate()
        process.wait()


if __name__ == "__main__":
    main()
