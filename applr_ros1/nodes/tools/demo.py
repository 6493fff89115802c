"""The demo (./applr demo): one course with the whole stack, on its own ROS master.

The demo reports when each part of the stack is up, sends the goal, reports progress, and ends every
process. It writes a page that replays the drive, and prints one line of JSON. Success is judged by
the robot's true pose (Course.arrived).
"""

from __future__ import annotations

import contextlib
import dataclasses
import json
import math
import os
import sys
import time
from functools import partial
from typing import Any, Callable, Dict, Iterator, NamedTuple, Optional, Sequence, Set, Tuple

import actionlib
import numpy as np
import rospy
from actionlib_msgs.msg import GoalStatus, GoalStatusArray
from diagnostic_msgs.msg import DiagnosticArray
from move_base_msgs.msg import MoveBaseAction, MoveBaseGoal
from nav_msgs.msg import Odometry
from std_msgs.msg import Bool

import worlds
from applr_ros1.common.angles import Pose
from applr_ros1.common.arguments import boolean, frame_prefix, number_within, pose
from applr_ros1.common.errors import ApplrError
from applr_ros1.common.files import write_bytes
from applr_ros1.common.progress import announced
from applr_ros1.common.ros_node import LARGE_BUFFER
from applr_ros1.drives.contact import contact_speed
from applr_ros1.drives.drive import (
    REACHED,
    TIMED_OUT,
    Decision,
    Drive,
    DrivenToGoal,
    Goal,
)
from applr_ros1.drives.end_reasons import ODOMETRY_ARRIVED, in_full
from applr_ros1.drives.end_rules import CourseEnd, Destination, PlannerResult
from applr_ros1.drives.page import PageScene, Shown, contact_note, page, verdict_of
from applr_ros1.drives.recorder import Recorder
from applr_ros1.msg import Parameters
from applr_ros1.nodes.conversions import GOAL_STATES, Reading, pose_stamped, reading_of
from applr_ros1.nodes.move_base.reports import SKIPPED
from applr_ros1.policy import methods
from applr_ros1.policy.parameter_space import declaration, space_of
from applr_ros1.robots import Robot, geometry
from applr_ros1.senses.standing import UNDER_WAY
from sim_bridge.ros_bridge import BASE_TIME_S

from .bag_recorder import BagRecorder
from .launcher import (
    LaunchedNodes,
    check_file,
    given_arguments,
    launch_arguments,
    private_nodes,
    read,
    report,
    scene_of,
)
from .machine_load import LATE, MachineLoad
from .send_goal import course_goal

STATUS = "/move_base/status"
VERDICTS = "/collision_monitor/action"  # latched; the first one comes when the monitor is ready
MOVERS = "/applr/tracked"
PROGRESS_PERIOD_S = 2.0  # interval between progress lines, in simulated time [s]
# Defaults of the arguments that the launch file does not have
EXTRA = {"page": "applr_demo.html", "limit": "300"}
USAGE = f"""usage: demo.py [ARG:=VALUE ...]

Drive one course with the whole stack, without a window. The last line is one JSON object. The exit
status is 0 only if the goal was reached.

  page:={EXTRA["page"]}  File for a page that replays the drive (.html), or none.
  limit:={EXTRA["limit"]}             Simulated time [s] after which the drive counts as timed out,
                         1 to 3600.

The other arguments are those of the launch file:
roslaunch --ros-args applr_ros1 jackal_applr.launch"""


class DemoSetup(NamedTuple):
    """Set-up of a demo, from its arguments.

    Attributes:
        values: Values of all arguments, with the pose of the goal in odom as "sent".
        passed: Values for the launch file.
        robot: Description of the robot.
        world: World with the course.
    """

    values: Dict[str, Any]
    passed: Dict[str, str]
    robot: Robot
    world: worlds.World


def main() -> int:
    """Run the demo. Return exit status 0 if the goal was reached, else 1.

    Raises:
        ApplrError: An argument is invalid.
    """
    setup = prepare(sys.argv[1:])
    values = setup.values
    result = {
        "world": setup.world.name,
        "robot": setup.robot.name,
        "method": values["method"],
        "success": False,
        "collided": False,
        "time_s": None,
        "seed": values["seed"],
        "simulator": values["simulator"],
    }
    report("world {world}, robot {robot}, method {method}, simulator {simulator}".format(**result))
    # The line about ending the nodes is due after the drive and lasts until all have ended.
    with contextlib.ExitStack() as exit_stack:
        try:
            with private_nodes(setup.passed) as nodes:
                drive_course(nodes, setup, result)
                exit_stack.enter_context(announced("ending the nodes", report))
        except ApplrError as problem:
            report(result.setdefault("reason", str(problem)))
    print(json.dumps(result), flush=True)
    return 0 if result["success"] else 1


def prepare(words: Sequence[str]) -> DemoSetup:
    """Parse a command line.

    Raises:
        ApplrError: An argument is invalid.
    """
    defaults = launch_arguments()
    given_values = given_arguments(words, defaults, EXTRA)
    # A demo can be repeated.
    values = {**defaults, **EXTRA, "seed": "0", **given_values}
    is_simulated = boolean("sim", values["sim"])
    if not is_simulated or values["move_base"] != "python" or values["goal"] == "none":
        requirement = "the demo needs sim:=true, move_base:=python and a goal"
        advice = "for a real robot use roslaunch applr_ros1 jackal_applr.launch"
        raise ApplrError(f"{requirement}: {advice}")
    # The launch file's defaults are texts.
    values["limit"] = number_within("limit", read(values["limit"]), 1.0, 3600.0)
    values["seed"] = int(number_within("seed", read(values["seed"]), 0, 2**31 - 1))
    if values["page"] != "none":
        values["page"] = os.path.abspath(values["page"])
        check_file("page", values["page"], ".html")

    # An invalid robot, method or world is an error before anything starts.
    robot, world = scene_of(values)
    values["method"] = methods.make(values["method"], robot).name
    values["sent"] = course_goal(world.course)
    if values["goal"] != "auto":
        values["sent"] = pose("goal", values["goal"])
        world = _with_goal(world, values["sent"])

    # The demo sends the goal itself, when it has begun to record.
    passed_names = {"method", "seed", *given_values} & set(defaults)
    passed_values = {name: values[name] for name in passed_names}
    return DemoSetup(values, {**passed_values, "goal": "none"}, robot, world)


def how_to_ask_why(bag: str, robot: Robot) -> str:
    """Return the command that says why a drive failed, which needs a bag of it."""
    if bag == "none":
        return "for the reason record the drive: record:=$PWD/drive.bag, then ./applr why drive.bag"
    return f"for the reason: ./applr why {bag} --robot {robot.folder}"


def _with_goal(world: worlds.World, goal: Pose) -> worlds.World:
    """Return a world with another goal, which is given in odom. The origin of odom is the start."""
    goal_x, goal_y, goal_yaw = goal
    start_x, start_y, _ = world.course.start
    course = dataclasses.replace(
        world.course,
        goal=(start_x + goal_x, start_y + goal_y, goal_yaw),
        finish_y=None,
        path=np.empty((0, 2)),
        planner_ends=True,
    )
    return dataclasses.replace(world, course=course)


def drive_course(nodes: LaunchedNodes, setup: DemoSetup, result: Dict[str, Any]) -> None:
    """Drive the course, complete the result, and write the page."""
    values = setup.values
    start_time = time.monotonic()
    observer = Observer(setup)
    for part_name, is_up in observer.parts():
        nodes.wait(part_name, is_up)
        report(f"{part_name:12} up after {time.monotonic() - start_time:.1f} s")
    load = observer.load
    load.expect_reports()
    nodes.wait("the diagnostics", lambda: load.is_reported)
    load.begin()
    drive = observer.drive(values["limit"], nodes.check)
    load.expect_reports()
    nodes.wait("the diagnostics", lambda: load.is_reported)
    truth, goals = drive.require(DrivenToGoal)
    goal = goals[-1]
    has_touched = bool(len(drive.contacts))
    report(f"{goal.reason} after {goal.end:.1f} s and {truth.length:.2f} m{contact_note(drive)}")
    spoiled = load.sentence(setup.robot.all_parameters()["controller_frequency"] * goal.end)
    if spoiled:
        report(spoiled)
    # A bag has no true motion, so that it cannot say more of wheels that slipped.
    if goal.status != REACHED and not goal.reason.startswith(ODOMETRY_ARRIVED):
        report(how_to_ask_why(values["record"], setup.robot))
    result.update(
        success=goal.status == REACHED,
        collided=has_touched,
        contact_speed=round(contact_speed(drive), 2) if has_touched else None,
        time_s=round(goal.end, 2),
        reason=goal.reason,
        timeout=goal.status == TIMED_OUT,
        path_length_m=round(truth.length, 3),
        skipped_cycles=load.count(SKIPPED),
        late_decisions=load.count(LATE),
        page=None,
    )
    if values["page"] != "none":
        begins = observer.began - BASE_TIME_S
        write_bytes(values["page"], headline_page(drive, setup, begins, result, spoiled))
        result["page"] = values["page"]
        report(result["page"])


def headline_page(
    drive: Drive, setup: DemoSetup, begins: float, result: Dict[str, Any], spoiled: str
) -> bytes:
    """Return the page of a drive that begins at the world's time `begins` [s].

    spoiled: What a busy machine has spoiled, or "".
    """
    robot = setup.robot
    world = setup.world
    outline = geometry.outline(robot)
    space = space_of(robot)
    distance_note = "distances are those of the robot's outline in the simulated world"
    verdict = verdict_of(drive, world, outline, begins)
    if spoiled:
        verdict += f"; {spoiled}"
    return page(
        title="{robot} in {world}, method {method}".format(**result),
        verdict=verdict,
        methods=[result["method"]],
        space=space,
        outline=outline,
        scenes=[PageScene(world.name, world, [Shown(0, 0, drive)], begins)],
        units={name: declaration(robot, name).unit for name in space.names},
        measured=["Simulator {simulator}, seed {seed}; ".format(**result) + distance_note + "."],
    )


def _topic(given: str, robot_topic: str) -> str:
    """Return the topic that the launch argument `given` chooses; auto: the robot's."""
    topic = robot_topic if given == "auto" else given
    return "/" + topic.lstrip("/")


class Observer:
    """Client of the running stack: sends the goal and records the drive.

    Call `parts`, then `drive`.

    Attributes:
        began: ROS time of sending the goal [s].
        client: Client of move_base's action, None until move_base is up.
        load: What a busy machine has spoiled.
    """

    def __init__(self, setup: DemoSetup):
        values = setup.values
        robot = setup.robot
        self.world = setup.world
        self._destination = Destination(setup.world.course, values["sent"], robot.goal_tolerance)
        self._frame = frame_prefix(values["tf_prefix"]) + robot.frames.odom  # frame of the goal
        self._names = space_of(robot).names
        self._latest: Optional[Reading] = None  # latest true motion
        self._odometry: Optional[Reading] = None  # latest motion by odometry
        self._theta: Sequence[float] = ()  # latest parameters
        self._recorder: Optional[Recorder] = None  # from the sending of the goal on
        self._up: Set[str] = set()  # topics on which a message has arrived
        self.began = 0.0
        self.client: Any = None
        self.load = MachineLoad()
        rospy.init_node("demo", anonymous=True, disable_signals=True)
        self._scan = _topic(values["scan_topic"], robot.topics.scan)
        self._has_monitor = boolean("monitor", values["monitor"])
        self._has_movers = boolean("movers", values["movers"])
        self._has_recorder = values["record"] != "none"
        # A process subscribes to a topic with one type only, and the action client to the status.
        message_types = dict.fromkeys((self._scan, VERDICTS, MOVERS), rospy.AnyMsg)
        message_types[STATUS] = GoalStatusArray
        for topic, message_type in message_types.items():
            on_arrival = partial(self._on_message, topic)
            rospy.Subscriber(topic, message_type, on_arrival, queue_size=1, buff_size=LARGE_BUFFER)
        odometry_topic = _topic(values["odom_topic"], robot.topics.odometry)
        for topic, message_type, take in (
            ("/sim_bridge/ground_truth", Odometry, lambda odom: self.take_motion(reading_of(odom))),
            (odometry_topic, Odometry, lambda odom: self.take_odometry(reading_of(odom))),
            ("/sim_bridge/collision", Bool, self._on_contact),
            ("/applr/parameters", Parameters, self._on_parameters),
            ("/diagnostics", DiagnosticArray, self.load.read_diagnostics),
        ):
            rospy.Subscriber(topic, message_type, take, queue_size=50)

    def parts(self) -> Iterator[Tuple[str, Callable[[], Any]]]:
        """Yield (name, function that returns whether the part is up) in the order of the start."""
        yield "simulator", lambda: self._scan in self._up and self._latest is not None
        yield "move_base", self._move_base_up
        yield "applr", lambda: self._theta
        # Without them the robot would wait in its first seconds, or not see what moves.
        if self._has_monitor:
            yield "monitor", lambda: VERDICTS in self._up
        if self._has_movers:
            yield "movers", lambda: MOVERS in self._up
        if self._has_recorder:
            yield "recorder", BagRecorder("/record").is_ready

    def drive(self, limit: float, check: Callable[[], None]) -> Drive:
        """Send the goal, and return the drive with its goal's end.

        The drive times out after `limit` [s]. check() is called repeatedly, and its exceptions end
        the drive.
        """
        recorder = self._begin()
        goal_pose = pose_stamped(self._destination.goal, self._frame, rospy.Time(0))
        self.client.send_goal(MoveBaseGoal(goal_pose))
        course = self.world.course
        goal_place = "ahead"
        if course.finish_y is not None:
            goal_place = f"to the finish line at y = {course.finish_y:g} m"
        report(f"goal sent   {course.length_m:.2f} m {goal_place}")
        # In simulated time, by the stamps of the true motion
        progress_time = 0.0
        end = None
        while end is None:
            time.sleep(0.01)
            check()
            seconds = self._motion.time - self.began
            end = self._end(seconds, limit)
            if seconds - progress_time >= PROGRESS_PERIOD_S:
                progress_time += PROGRESS_PERIOD_S
                self._report_progress(seconds, recorder.drive)
        reason = "goal reached" if end.status == REACHED else end.reason
        recorder.goals.append(Goal("demo", 0.0, seconds, end.status, reason))
        # A goal that move_base has ended cannot be cancelled: actionlib would log an error.
        if self.client.get_state() in UNDER_WAY:
            self.client.cancel_goal()
        drive = recorder.drive
        drive.goals[-1] = drive.goals[-1]._replace(reason=in_full(drive))
        return drive

    def _begin(self) -> Recorder:
        """Start recording with the latest motion and parameters."""
        motion = self._motion
        self.began = motion.time
        # From here on, callbacks record.
        self._recorder = Recorder(self.world)
        self._recorder.moved(0.0, motion.pose, motion.twist)
        if self._odometry is not None:
            self._recorder.localised(0.0, self._odometry.pose, self._odometry.twist)
        self._record_parameters(0.0)
        return self._recorder

    def _end(self, seconds: float, limit: float) -> Optional[CourseEnd]:
        """Return how the drive has ended, or None while it goes on."""
        goal_state = self.client.get_state()
        result = None
        if goal_state not in UNDER_WAY:
            message = self.client.get_goal_status_text() or GOAL_STATES[goal_state]
            result = PlannerResult(goal_state == GoalStatus.SUCCEEDED, message)
        end = self._destination.end(self._motion.pose, self._left_by_odometry(), result)
        if end is None and seconds >= limit:
            return CourseEnd(TIMED_OUT, "timed out")
        return end

    def _left_by_odometry(self) -> float:
        """Return the distance from the sent goal by the odometry [m]; inf without odometry."""
        if self._odometry is None:
            return math.inf
        return math.dist(self._odometry.pose[:2], self._destination.goal[:2])

    def _report_progress(self, seconds: float, drive: Drive) -> None:
        """Print the distance to the goal, the speed, and contacts since the last line."""
        motion = self._motion
        x, y, _ = motion.pose
        speed, _ = motion.twist
        course = self.world.course
        distance_left = math.dist(course.goal[:2], (x, y))
        if course.finish_y is not None:
            distance_left = max(0.0, course.finish_y - y)
        has_touched = (drive.contacts > seconds - PROGRESS_PERIOD_S).any()
        contact_note = "   contact" if has_touched else ""
        report(f"{seconds:6.1f} s    {distance_left:5.2f} m to go   {speed:4.2f} m/s{contact_note}")

    @property
    def _motion(self) -> Reading:
        """Latest true motion.

        Raises:
            ApplrError: None has arrived.
        """
        if self._latest is None:
            raise ApplrError("the simulator has not published the robot's motion: wait for `parts`")
        return self._latest

    def _on_message(self, topic: str, _: Any) -> None:
        self._up.add(topic)

    def _move_base_up(self) -> bool:
        """Return whether move_base takes goals: a goal that is sent before would be lost."""
        if self.client is None:
            self.client = actionlib.SimpleActionClient("move_base", MoveBaseAction)
        action_client = self.client.action_client
        endpoints = (action_client.pub_goal, action_client.pub_cancel, action_client.result_sub)
        are_connected = all(endpoint.get_num_connections() > 0 for endpoint in endpoints)
        return STATUS in self._up and are_connected

    def take_motion(self, reading: Reading) -> None:
        """Take the robot's true motion."""
        self._latest = reading
        if self._recorder is not None:
            self._recorder.moved(reading.time - self.began, reading.pose, reading.twist)

    def take_odometry(self, reading: Reading) -> None:
        """Take the robot's motion by odometry."""
        self._odometry = reading
        if self._recorder is not None:
            self._recorder.localised(reading.time - self.began, reading.pose, reading.twist)

    def _on_contact(self, message: Bool) -> None:
        if message.data and self._recorder is not None and self._latest is not None:
            self._recorder.contacts.append(self._latest.time - self.began)

    def _on_parameters(self, message: Parameters) -> None:
        # The applr node repeats the parameters every second.
        if message.names and self._theta != message.values:
            self._theta = message.values
            self._record_parameters(message.header.stamp.to_sec() - self.began)

    def _record_parameters(self, seconds: float) -> None:
        """Record the latest parameters as a decision, if the drive has begun."""
        if self._recorder is not None:
            values = dict(zip(self._names, self._theta))
            self._recorder.decisions.append(Decision("demo", seconds, seconds, {}, values, None))
