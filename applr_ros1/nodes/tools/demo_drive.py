"""What the demo sees over ROS of one drive, and how it starts and ends it.

Called by demo.py; keeps what it hears until the picture is drawn. The robot's true pose decides, the course's own rule
says when it is finished.
"""

import dataclasses
import math
import posixpath
import time

import actionlib
import numpy as np
import rospy
from actionlib_msgs.msg import GoalStatus, GoalStatusArray
from dynamic_reconfigure.msg import Config
from move_base_msgs.msg import MoveBaseAction
from nav_msgs.msg import Odometry, Path
from sensor_msgs.msg import LaserScan, PointCloud2
from std_msgs.msg import Bool

from applr_ros1.common import angles as angles_of
from applr_ros1.common.errors import ApplrError
from applr_ros1.drives.animation import STEP
from applr_ros1.drives.picture import Drive, View
from applr_ros1.policy.parameter_space import space_of
from sim_bridge.ros_bridge import BASE_TIME

from . import send_goal
from .launcher import say

EVERY = 2.0  # simulated seconds between lines of progress
STALLED_AFTER = 20.0  # wall seconds without a new pose


class Observer:
    """Subscribes to the stack; `parts`, then `drive`, then `recorded`.

    Args:
        robot: Its description.
        world: The world at the robot's scale.
        scan: Topic of the laser's scans.
        frame: Frame of the odometry, in which goals are sent.
    """

    def __init__(self, robot, world, scan, frame):
        self.world, self._robot, self._frame = world, robot, frame
        self.track, self.contacts, self.views, self._yaw = [], [], [], 0.0  # _yaw: the newest true heading [rad]
        self._newest, self._began, self._client = {}, None, None
        rospy.init_node("demo", anonymous=True, disable_signals=True)
        planner = "/move_base/" + robot.local_planner
        self._paths, self._cloud = ("/move_base/NavfnROS/plan", planner + "/local_plan"), planner + "/trajectory_cloud"
        rospy.Subscriber("/" + scan.lstrip("/"), LaserScan, self._on_scan, queue_size=50, buff_size=2**24)
        rospy.Subscriber("/sim_bridge/ground_truth", Odometry, self._on_pose, queue_size=50)
        rospy.Subscriber("/sim_bridge/collision", Bool, self._on_contact, queue_size=50)
        kept = {**dict.fromkeys(self._paths, Path), self._cloud: PointCloud2}
        kept.update({"/move_base/status": GoalStatusArray, "/applr/parameters": rospy.AnyMsg})
        for topic, kind in kept.items():
            rospy.Subscriber(topic, kind, self._keep, topic, queue_size=1, buff_size=2**24)
        places = space_of(robot).places()
        self.parameters = {name: [] for _, name in places}
        for server in dict(places):
            names = tuple(name for place, name in places if place == server)
            topic = posixpath.join("/move_base", server, "parameter_updates")
            rospy.Subscriber(topic, Config, self._on_parameters, names, queue_size=10)

    def parts(self):
        """(name, function that says whether it is up) in the order in which they come up."""
        yield "simulator", lambda: "scan" in self._newest and self.track
        yield "move_base", self._move_base_up
        yield "applr", lambda: "/applr/parameters" in self._newest

    def drive(self, pose, limit, check):
        """Send the goal `pose` (frame odom); watch until it is reached, given up, or `limit` simulated seconds pass.

        Args:
            pose: (x, y, yaw) [m, m, rad].
            limit: Simulated time [s].
            check: Is called again and again; what it raises ends the drive.

        Returns:
            (success, timeout, simulated time [s], how it ended in words).
        """
        self._began = self.track[-1][0]
        self.track, self.contacts, self.views = self.track[-1:], [], []
        self._client.send_goal(send_goal.message(pose, self._frame))
        course = self.world.course
        line = f"to the finish line at y = {course.finish_y:g} m" if course.finish_y is not None else "ahead"
        say(f"goal sent   {course.length_m:.2f} m {line}")
        printed, heard, newest, ended = self._began, time.monotonic(), self._began, None
        while ended is None:
            time.sleep(0.01)
            check()
            now, x, y, speed, _ = self.track[-1]
            seconds = now - self._began
            if course.done(x, y):
                ended = (True, False, seconds, "goal reached")
            elif seconds >= limit:
                ended = (False, True, seconds, "timed out")
            elif self._client.get_state() not in (GoalStatus.PENDING, GoalStatus.ACTIVE):
                text = self._client.get_goal_status_text() or send_goal.WORDS.get(self._client.get_state(), "no reason")
                ended = (False, False, seconds, f"move_base gave up: {text}")
            if now > newest:
                newest, heard = now, time.monotonic()
            elif time.monotonic() - heard > STALLED_AFTER:
                raise ApplrError("the simulation stands still")
            if now - printed >= EVERY:
                printed += EVERY
                to_go = math.dist(course.goal[:2], (x, y)) if course.finish_y is None else max(0.0, course.finish_y - y)
                touched = "   contact" if self.contacts and now - self.contacts[-1] < EVERY else ""
                say(f"{seconds:6.1f} s    {to_go:5.2f} m to go   {speed:4.2f} m/s{touched}")
        self._client.cancel_goal()
        return ended

    def recorded(self, seconds):
        """The drive as applr_ros1.drives draws it, the first `seconds` after the goal was sent."""
        began = self._began
        track = np.array(self.track, dtype=np.float64).reshape(-1, 5) - (began, 0.0, 0.0, 0.0, 0.0)
        steps = {name: [(max(0.0, t - began), value) for t, value in seen] for name, seen in self.parameters.items()}
        return Drive(
            self.world,
            track[track[:, 0] <= seconds + 1e-6],
            {name: seen for name, seen in steps.items() if seen},
            [t - began for t in self.contacts if t - began <= seconds],
            views=[dataclasses.replace(v, time=v.time - began) for v in self.views if v.time - began <= seconds],
            world_time=began - BASE_TIME,
        )

    def _move_base_up(self):
        if self._client is None:
            self._client = actionlib.SimpleActionClient("move_base", MoveBaseAction)
        action = self._client.action_client
        ends = (action.pub_goal, action.pub_cancel, action.result_sub)
        return "/move_base/status" in self._newest and all(end.get_num_connections() > 0 for end in ends)

    def _keep(self, message, topic):
        self._newest[topic] = message

    def _on_scan(self, message):
        """Every tenth of a simulated second keeps what was known, in the world's frame."""
        self._newest["scan"] = message
        if not self.track or self.views and 0.0 <= self.track[-1][0] - self.views[-1].time < STEP - 1e-6:
            return
        now, x, y = self.track[-1][:3]
        pose = (x, y, self._yaw)
        ranges = np.array(message.ranges, dtype=np.float64)
        hits = np.flatnonzero((ranges >= message.range_min) & (ranges < message.range_max))
        laser_x, laser_y, laser_yaw = self._robot.laser.pose
        angles = self._yaw + laser_yaw + message.angle_min + hits * message.angle_increment
        laser = angles_of.transform_point(pose, laser_x, laser_y)
        scan = laser + np.column_stack((ranges[hits] * np.cos(angles), ranges[hits] * np.sin(angles)))
        plan, chosen = (self._path(topic) for topic in self._paths)
        self.views.append(View(now, pose, scan, plan, chosen, self._samples()))

    def _path(self, topic):
        """(n, 2) of the newest path on a topic in the world's frame, which is the map's; odom's origin is the start."""
        message = self._newest.get(topic) or Path()
        points = np.array([(p.pose.position.x, p.pose.position.y) for p in message.poses], np.float64).reshape(-1, 2)
        on_map = message.header.frame_id == self._robot.frames.map
        return points if on_map else points + self.world.course.start[:2]

    def _samples(self):
        """(n, 2) of the newest sampled trajectories, in the world's frame."""
        message = self._newest.get(self._cloud)
        rows = np.empty((0, 2)) if message is None else np.frombuffer(message.data, "<f4").reshape(message.width, -1)
        return rows[:, :2].astype(np.float64) + self.world.course.start[:2]

    def _on_pose(self, message):
        pose, twist = message.pose.pose, message.twist.twist
        self._yaw = angles_of.yaw_of(pose.orientation)
        now = message.header.stamp.to_sec()
        self.track.append((now, pose.position.x, pose.position.y, twist.linear.x, twist.angular.z))

    def _on_contact(self, message):
        if message.data and self.track:
            self.contacts.append(self.track[-1][0])

    def _on_parameters(self, message, names):
        now = self.track[-1][0] if self.track else 0.0
        for parameter in [*message.doubles, *message.ints]:
            if parameter.name in names:
                self.parameters[parameter.name].append((now, float(parameter.value)))
