"""The demo (./applr demo): one course from start to finish with the whole stack, on its own ROS master.

The demo reports when each part of the stack is up, sends the goal, reports progress, and ends every process. It writes
a page that replays the drive, and prints one line of JSON. Success is judged by the robot's true pose (Course.arrived).
"""

from __future__ import annotations

import contextlib
import dataclasses
import json
import math
import os
import sys
import time
from typing import Any, Callable, Dict, Iterator, List, Sequence, Set, Tuple

import actionlib
import numpy as np
import rospy
from actionlib_msgs.msg import GoalStatus, GoalStatusArray
from move_base_msgs.msg import MoveBaseAction, MoveBaseGoal
from nav_msgs.msg import Odometry
from std_msgs.msg import Bool

import worlds
from applr_ros1.common.angles import Pose, yaw_of
from applr_ros1.common.arguments import boolean, frame_prefix, number_within, pose
from applr_ros1.common.errors import ApplrError
from applr_ros1.common.files import write_bytes
from applr_ros1.common.progress import announced
from applr_ros1.drives.page import POSE_PERIOD_S, Drive, Scene, page
from applr_ros1.msg import Parameters
from applr_ros1.nodes.conversions import GOAL_STATES, pose_stamped
from applr_ros1.policy import methods
from applr_ros1.policy.parameter_space import Space, space_of
from applr_ros1.robots import Robot, geometry, load
from sim_bridge.ros_bridge import BASE_TIME_S

from .launcher import Stack, given_arguments, launch_arguments, private_stack, report
from .send_goal import course_goal

STATUS = "/move_base/status"
PROGRESS_PERIOD_S = 2.0  # interval between progress lines, in simulated time [s]
REACHED, TIMED_OUT = "goal reached", "timed out"  # outcomes of a drive
EXTRA = {"page": "applr_demo.html", "limit": "300"}  # defaults of the arguments that the launch file does not have
COLOR = "#2ca02c"  # colour of the drive on its page
USAGE = f"""usage: demo.py [ARG:=VALUE ...]

Drive one course with the whole stack, without a window. The last line is one JSON object. The exit status is 0 only
if the goal was reached.

  page:={EXTRA["page"]}  File for a page that replays the drive (.html), or none.
  limit:={EXTRA["limit"]}             Simulated time [s] after which the drive counts as timed out, 1 to 3600.

The other arguments are those of the launch file: roslaunch --ros-args applr_ros1 jackal_applr.launch"""


def main() -> int:
    """Run the demo. Return exit status 0 if the goal was reached, else 1. Raises ApplrError for invalid arguments."""
    values, passed, robot, world = prepare(sys.argv[1:])
    result = {"world": world.name, "robot": robot.name, "method": values["method"], "success": False}
    result.update(collided=False, time_s=None, seed=values["seed"], simulator=values["simulator"])
    report("world {world}, robot {robot}, method {method}, simulator {simulator}".format(**result))
    with contextlib.ExitStack() as ending:
        try:
            with private_stack(passed) as stack:
                _drive(stack, values, robot, world, result)
                ending.enter_context(announced("ending the nodes", report))
        except ApplrError as problem:
            report(result.setdefault("reason", str(problem)))
    print(json.dumps(result), flush=True)
    return 0 if result["success"] else 1


def prepare(words: Sequence[str]) -> Tuple[Dict[str, Any], Dict[str, str], Robot, worlds.World]:
    """Parse a command line into (all values, values for the launch file, Robot, World). Raises ApplrError."""
    known = launch_arguments()
    given = given_arguments(words, (*known, *EXTRA))
    values = {**known, **EXTRA, **given}
    if not boolean("sim", values["sim"]) or values["move_base"] != "python" or values["goal"] == "none":
        needs = "the demo needs sim:=true, move_base:=python and a goal"
        raise ApplrError(f"{needs}: for a real robot use roslaunch applr_ros1 jackal_applr.launch")
    for name, kind, low, high in (("limit", float, 1.0, 3600.0), ("seed", int, 0, 2**31 - 1)):
        with contextlib.suppress(ValueError):
            values[name] = kind(values[name])
        number_within(name, values[name], low, high)
    if values["page"] != "none":
        values["page"] = os.path.abspath(values["page"])
        if not (values["page"].endswith(".html") and os.access(os.path.dirname(values["page"]), os.W_OK)):
            raise ApplrError(f"page is {values['page']}: give a .html file in a folder that can be written")
    robot = load(values["robot"])
    values["method"] = methods.make(values["method"], robot).name
    world = worlds.scaled(worlds.load(values["world"], geometry.radius(robot)), robot.world_scale)
    values["sent"] = course_goal(world.course)
    if values["goal"] != "auto":  # The goal is given in odom, whose origin is the start.
        values["sent"] = x, y, yaw = pose("goal", values["goal"])
        goal = (x + world.course.start[0], y + world.course.start[1], yaw)
        course = dataclasses.replace(world.course, goal=goal, finish_y=None, path=np.empty((0, 2)), planner_ends=True)
        world = dataclasses.replace(world, course=course)
    passed = {name: values[name] for name in {"method", *given} & set(known)}
    return values, dict(passed, goal="none"), robot, world


def _drive(stack: Stack, values: Dict[str, Any], robot: Robot, world: worlds.World, result: Dict[str, Any]) -> None:
    """Drive the course, complete the result, and write the page."""
    began = time.monotonic()
    observer = Observer(robot, world, values)
    for part, up in observer.parts():
        stack.wait(part, up)
        report(f"{part:12} up after {time.monotonic() - began:.1f} s")
    seconds, text = observer.drive(values["sent"], values["limit"], stack.check)
    length = float(np.hypot(*np.diff(np.array(observer.track)[:, 1:3], axis=0).T).sum())
    report(f"{text} after {seconds:.1f} s and {length:.2f} m{', with contact' if observer.contacts else ''}")
    result.update(success=text == REACHED, collided=bool(observer.contacts), time_s=round(seconds, 2), reason=text)
    result.update(timeout=text == TIMED_OUT, path_length_m=round(length, 3), page=None)
    if values["page"] != "none":
        title = "{world}, {robot}, method {method}".format(**result)
        space = space_of(robot)
        scene = observer.scene(seconds, result, space)
        write_bytes(values["page"], page(title, {result["method"]: COLOR}, space.names, robot.body.size[:2], [scene]))
        result["page"] = values["page"]
        report(result["page"])


class Observer:
    """Client of the running stack: sends the goal and records the drive. Call `parts`, then `drive`, then `scene`."""

    def __init__(self, robot: Robot, world: worlds.World, values: Dict[str, Any]):
        self.world, self._tolerance = world, robot.goal_tolerance
        self._frame = frame_prefix(values["tf_prefix"]) + robot.frames.odom  # frame of the goal
        scan = robot.topics.scan if values["scan_topic"] == "auto" else values["scan_topic"]
        self.track: List[Any] = []  # true motion: (stamp [s], x, y, yaw, v, w)
        self.contacts: List[float] = []  # times of contacts [s]
        self.parameters: List[Any] = []  # parameter sets when they changed: (stamp [s], theta)
        self._up: Set[str] = set()  # topics on which a message has arrived
        self._began: Any = None  # time of sending the goal [s]
        self._client: Any = None
        rospy.init_node("demo", anonymous=True, disable_signals=True)
        self._scan = "/" + scan.lstrip("/")
        for topic, kind in ((self._scan, rospy.AnyMsg), (STATUS, GoalStatusArray)):
            rospy.Subscriber(topic, kind, lambda _, topic=topic: self._up.add(topic), queue_size=1, buff_size=2**24)
        rospy.Subscriber("/sim_bridge/ground_truth", Odometry, self._on_pose, queue_size=50)
        rospy.Subscriber("/sim_bridge/collision", Bool, self._on_contact, queue_size=50)
        rospy.Subscriber("/applr/parameters", Parameters, self._on_parameters, queue_size=50)

    def parts(self) -> Iterator[Tuple[str, Callable[[], Any]]]:
        """Yield (name, function that returns whether the part is up) in the order of the start."""
        yield "simulator", lambda: self._scan in self._up and self.track
        yield "move_base", self._move_base_up
        yield "applr", lambda: self.parameters

    def drive(self, pose: Pose, limit: float, check: Callable[[], None]) -> Tuple[float, str]:
        """Send the goal `pose` (x, y, yaw) in odom and return (simulated time [s], outcome) at the end of the drive.

        The drive times out after `limit` [s]. check() is called repeatedly, and its exceptions end the drive.
        """
        self._began = self.track[-1][0]
        self.track, self.contacts = self.track[-1:], []
        self._client.send_goal(MoveBaseGoal(pose_stamped(pose, self._frame, rospy.Time(0))))
        course = self.world.course
        line = f"to the finish line at y = {course.finish_y:g} m" if course.finish_y is not None else "ahead"
        report(f"goal sent   {course.length_m:.2f} m {line}")
        printed, ended = self._began, ""
        while not ended:
            time.sleep(0.01)
            check()
            now, x, y, _, speed, _ = self.track[-1]
            seconds = now - self._began
            is_called = self._client.get_state() == GoalStatus.SUCCEEDED
            if course.arrived(x, y, self._tolerance if is_called else None):
                ended = REACHED
            elif seconds >= limit:
                ended = TIMED_OUT
            elif self._client.get_state() not in (GoalStatus.PENDING, GoalStatus.ACTIVE):
                text = self._client.get_goal_status_text() or GOAL_STATES[self._client.get_state()]
                ended = f"move_base gave up: {text}"
            if now - printed >= PROGRESS_PERIOD_S:
                printed += PROGRESS_PERIOD_S
                to_go = math.dist(course.goal[:2], (x, y)) if course.finish_y is None else max(0.0, course.finish_y - y)
                touched = "   contact" if self.contacts and now - self.contacts[-1] < PROGRESS_PERIOD_S else ""
                report(f"{seconds:6.1f} s    {to_go:5.2f} m to go   {speed:4.2f} m/s{touched}")
        self._client.cancel_goal()
        return seconds, ended

    def scene(self, seconds: float, result: Dict[str, Any], space: Space) -> Scene:
        """Return the recorded drive, which took `seconds` [s], as the scene of its page."""
        track = np.array(self.track, dtype=np.float64)
        times = np.unique(np.append(np.arange(0.0, seconds, POSE_PERIOD_S), seconds))
        columns = (*track[:, 1:3].T, np.unwrap(track[:, 3]), track[:, 4])
        *poses, speeds = (np.interp(times, track[:, 0] - self._began, column) for column in columns)
        changes = [(max(0.0, t - self._began), space.to_action(theta)) for t, theta in self.parameters]
        how = (result["time_s"], result["success"], result["collided"], result["reason"])
        decided, actions = [time for time, _ in changes], np.array([action for _, action in changes])
        drive = Drive(0, 0, *how, np.column_stack(poses), speeds, decided, actions)
        return Scene(self.world.name, self.world, [drive], self._began - BASE_TIME_S)

    def _move_base_up(self) -> bool:
        if self._client is None:
            self._client = actionlib.SimpleActionClient("move_base", MoveBaseAction)
        action = self._client.action_client
        ends = (action.pub_goal, action.pub_cancel, action.result_sub)
        return STATUS in self._up and all(end.get_num_connections() > 0 for end in ends)

    def _on_pose(self, message: Odometry) -> None:
        pose, twist = message.pose.pose, message.twist.twist
        at = (pose.position.x, pose.position.y, yaw_of(pose.orientation))
        self.track.append((message.header.stamp.to_sec(), *at, twist.linear.x, twist.angular.z))

    def _on_contact(self, message: Bool) -> None:
        if message.data and self.track:
            self.contacts.append(self.track[-1][0])

    def _on_parameters(self, message: Parameters) -> None:
        if message.names and (not self.parameters or self.parameters[-1][1] != message.values):
            self.parameters.append((message.header.stamp.to_sec(), message.values))
