"""The demo (./applr demo): one course from start to finish with the whole stack, on a ROS master of its own.

It says when each part of the stack is up, sends the goal, reports progress, ends every process, and leaves a picture,
an animation and one line of JSON. The robot's true pose decides, the course's own rule says when it is finished.
"""

import contextlib
import dataclasses
import json
import math
import os
import posixpath
import sys
import time
from functools import partial

import actionlib
import numpy as np
import rospy
from actionlib_msgs.msg import GoalStatus, GoalStatusArray
from dynamic_reconfigure.msg import Config
from move_base_msgs.msg import MoveBaseAction
from nav_msgs.msg import Odometry, Path
from sensor_msgs.msg import LaserScan, PointCloud2
from std_msgs.msg import Bool

import worlds
from applr_ros1.common.angles import transform_point, yaw_of
from applr_ros1.common.arguments import boolean, frame_prefix, number_within, pose
from applr_ros1.common.errors import ApplrError
from applr_ros1.drives import drawing
from applr_ros1.policy import methods
from applr_ros1.policy.parameter_space import space_of
from applr_ros1.robots.check import with_remarks
from applr_ros1.robots.geometry import bounding_box
from sim_bridge.ros_bridge import BASE_TIME

from . import send_goal
from .launcher import given_arguments, launch_arguments, own_stack, say

EVERY = 2.0  # simulated seconds between lines of progress
REACHED, TIMED_OUT = "goal reached", "timed out"  # how a drive ended
STALLED_AFTER = 20.0  # wall seconds without a new pose
OWN = {"picture": "applr_demo.png", "animation": "applr_demo.gif", "limit": "300"}  # arguments beside the launch file's
USAGE = f"""usage: demo.py [ARG:=VALUE ...]

Drives one course with the whole stack, without a window. The last line is one JSON object. The exit status is 0 only
if the goal was reached.

  picture:={OWN["picture"]}     File for the picture (.png).
  animation:={OWN["animation"]}   File for the animation (.gif), with scan, plans and parameters; none makes none.
  limit:={OWN["limit"]}                  Simulated time [s] after which the drive counts as timed out, 1 to 3600.

The other arguments are those of the launch file: roslaunch --ros-args applr_ros1 jackal_applr.launch"""


def main():
    """Exit status: 0 goal reached, 1 not reached, or a wrong argument (one line), 130 interrupted."""
    values, passed, robot, world = prepare(sys.argv[1:])
    result = {"world": world.name, "robot": robot.name, "method": values["method"], "success": False}
    result.update(collided=False, time_s=None, seed=int(values["seed"]), simulator=values["simulator"])
    say("world {world}, robot {robot}, method {method}, simulator {simulator}".format(**result))
    drive = None
    try:
        with own_stack(passed) as stack:
            drive = _drive(stack, values, robot, world, result)
    except ApplrError as problem:
        say(result.setdefault("reason", str(problem)))
    if drive is not None:
        low_x, high_x, low_y, high_y = bounding_box(robot)
        outline = np.array([[high_x, high_y], [low_x, high_y], [low_x, low_y], [high_x, low_y]])
        drive.title = "{world}, {robot}, method {method}: {reason} in {time_s:.1f} s".format(**result)
        result["picture"] = _leave(values["picture"], lambda path: drawing.save(drive, path))
        result["animation"] = _leave(values["animation"], lambda path: drawing.save_animation(drive, outline, path))
    print(json.dumps(result), flush=True)
    return 0 if result["success"] else 1


def prepare(words):
    """(values of all arguments, those for the launch file, Robot, World) from the command line. Raises ApplrError."""
    known = launch_arguments()
    given = given_arguments(words, (*known, *OWN))
    values = {**known, **OWN, **given}
    if not boolean("sim", values["sim"]) or values["move_base"] != "python" or values["goal"] == "none":
        needs = "the demo needs sim:=true, move_base:=python and a goal"
        raise ApplrError(f"{needs}: for a real robot use roslaunch applr_ros1 jackal_applr.launch")
    with contextlib.suppress(ValueError):
        values["limit"] = float(values["limit"])
    number_within("limit", values["limit"], 1.0, 3600.0)
    for name, ending in (("picture", ".png"), ("animation", ".gif")):
        folder = os.path.dirname(os.path.abspath(values[name]))
        if values[name] != "none" and not (values[name].endswith(ending) and os.access(folder, os.W_OK)):
            raise ApplrError(f"{name} is {values[name]}: give a {ending} file in a folder that can be written")
    robot = with_remarks(values["robot"])
    if values["policy"] != "none":
        kind = "applr" if values["method"] == "auto" else values["method"]
        values["method"] = methods.absolute(f"{kind}:{values['policy']}")
    values["method"] = methods.make(values["method"], robot).name
    world = worlds.scaled(worlds.load(values["world"]), robot.world_scale)
    values["sent"] = send_goal.course_goal(world.course)
    if values["goal"] != "auto":  # given in odom, whose origin is the start
        values["sent"] = x, y, yaw = pose("goal", values["goal"])
        goal = (x + world.course.start[0], y + world.course.start[1], yaw)
        world = dataclasses.replace(world, course=dataclasses.replace(world.course, goal=goal, finish_y=None))
    passed = {name: values[name] for name in {"method", *given} & set(known) - {"policy"}}
    return values, dict(passed, goal="none"), robot, world


def _drive(stack, values, robot, world, result):
    """Drive the course, complete the result; returns the recorded Drive."""
    began = time.monotonic()
    observer = Observer(robot, world, values)
    for part, up in observer.parts():
        stack.wait_until_up(part, up)
        say(f"{part:12} up after {time.monotonic() - began:.1f} s")
    seconds, text = observer.drive(values["sent"], values["limit"], stack.check)
    drive = observer.recorded(seconds)
    touching = ", touching something" if drive.contacts else ""
    say(f"{text} after {seconds:.1f} s and {drive.length():.2f} m{touching}")
    result.update(success=text == REACHED, collided=bool(drive.contacts), time_s=round(seconds, 2), reason=text)
    result.update(timeout=text == TIMED_OUT, path_length_m=round(drive.length(), 3))
    return drive


def _leave(path, save):
    """Write a file beside the result: its absolute path, or None where there is none."""
    if path == "none":
        return None
    path = os.path.abspath(path)
    try:
        save(path)
    except (OSError, ValueError) as problem:
        say(f"not written: {problem}")
        return None
    say(path)
    return path


class Observer:
    """Subscribes to the stack of a robot in a world; `parts`, then `drive`, then `recorded`."""

    def __init__(self, robot, world, values):
        self.world, self._robot = world, robot
        self._frame = frame_prefix(values["tf_prefix"]) + robot.frames.odom  # in which goals are sent
        scan = robot.topics.scan if values["scan_topic"] == "auto" else values["scan_topic"]
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
            rospy.Subscriber(topic, kind, partial(self._newest.__setitem__, topic), queue_size=1, buff_size=2**24)
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
        """Send the goal `pose`, (x, y, yaw) in odom; watch until it is reached, given up, or `limit` [s] are over.

        check() is called again and again; what it raises ends the drive. Returns (simulated time [s], how it ended).
        """
        self._began = self.track[-1][0]
        self.track, self.contacts, self.views = self.track[-1:], [], []
        self._client.send_goal(send_goal.message(pose, self._frame))
        course = self.world.course
        line = f"to the finish line at y = {course.finish_y:g} m" if course.finish_y is not None else "ahead"
        say(f"goal sent   {course.length_m:.2f} m {line}")
        printed, heard, newest, ended = self._began, time.monotonic(), self._began, ""
        while not ended:
            time.sleep(0.01)
            check()
            now, x, y, speed, _ = self.track[-1]
            seconds = now - self._began
            if course.done(x, y):
                ended = REACHED
            elif seconds >= limit:
                ended = TIMED_OUT
            elif self._client.get_state() not in (GoalStatus.PENDING, GoalStatus.ACTIVE):
                text = self._client.get_goal_status_text() or send_goal.WORDS.get(self._client.get_state(), "no reason")
                ended = f"move_base gave up: {text}"
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
        return seconds, ended

    def recorded(self, seconds):
        """The drive as applr_ros1.drives draws it, the first `seconds` after the goal was sent."""
        began = self._began
        track = np.array(self.track, dtype=np.float64).reshape(-1, 5) - (began, 0.0, 0.0, 0.0, 0.0)
        steps = {name: [(max(0.0, t - began), value) for t, value in seen] for name, seen in self.parameters.items()}
        return drawing.Drive(
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

    def _on_scan(self, message):
        """Every tenth of a simulated second keeps what was known, in the world's frame."""
        self._newest["scan"] = message
        if not self.track or self.views and 0.0 <= self.track[-1][0] - self.views[-1].time < drawing.STEP - 1e-6:
            return
        now, x, y = self.track[-1][:3]
        pose = (x, y, self._yaw)
        ranges = np.array(message.ranges, dtype=np.float64)
        hits = np.flatnonzero((ranges >= message.range_min) & (ranges < message.range_max))
        laser_x, laser_y, laser_yaw = self._robot.laser.pose
        angles = self._yaw + laser_yaw + message.angle_min + hits * message.angle_increment
        laser = transform_point(pose, laser_x, laser_y)
        scan = laser + np.column_stack((ranges[hits] * np.cos(angles), ranges[hits] * np.sin(angles)))
        plan, chosen = (self._path(topic) for topic in self._paths)
        self.views.append(drawing.View(now, pose, scan, plan, chosen, self._samples()))

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
        self._yaw = yaw_of(pose.orientation)
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
