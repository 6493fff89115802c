"""The demo (./applr demo): one course from start to finish with the whole stack, on a ROS master of its own.

It starts jackal_applr.launch through roslaunch's parent API, says when each part is up, sends the goal, reports
progress, ends every process, and leaves a picture, an animation and one line of JSON.
"""

import contextlib
import dataclasses
import json
import os
import shutil
import signal
import sys
import tempfile
import time
import uuid

import numpy as np
import roslaunch
import roslaunch.arg_dump
import rospy
from rosgraph.names import load_mappings

import worlds
from applr_ros1.common.arguments import boolean, frame_prefix, number_within, pose
from applr_ros1.common.errors import ApplrError
from applr_ros1.common.progress import announced
from applr_ros1.drives import animation, picture
from applr_ros1.policy import methods
from applr_ros1.robot_check import with_remarks
from applr_ros1.robots import NAMES
from applr_ros1.robots.geometry import bounding_box

from . import send_goal
from .demo_drive import Observer
from .processes import free_port

UP_WITHIN = 900.0  # wall seconds for one part to come up: the first time it compiles kernels, maybe on a busy machine
COMPILES = "waiting for {}, which compiles its kernels at its first start (about a minute)"
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
    values, passed, robot, world = prepare(sys.argv[1:], launch_file())
    result = {"world": world.name, "robot": robot.name, "method": values["method"], "success": False}
    result.update(collided=False, time_s=None, seed=int(values["seed"]), simulator=values["simulator"])
    say("world {world}, robot {robot}, method {method}, simulator {simulator}".format(**result))
    drive = None
    try:
        with own_stack(passed, launch_file()) as stack:
            drive = _drive(stack, values, robot, world, result)
    except ApplrError as problem:
        say(result.setdefault("reason", str(problem)))
    if drive is not None:
        drive.title = "{world}, {robot}, method {method}: {reason} in {time_s:.1f} s".format(**result)
        result["picture"] = _leave(values["picture"], lambda path: picture.save(drive, path))
        result["animation"] = _leave(values["animation"], lambda path: animation.save(drive, _outline(robot), path))
    print(json.dumps(result), flush=True)
    return 0 if result["success"] else 1


def launch_file(name="jackal_applr.launch"):
    """The path of a launch file of this package; the default is what the demo and the playground start."""
    return roslaunch.rlutil.resolve_launch_arguments(["applr_ros1", name])[0]


@contextlib.contextmanager
def own_stack(words, file):
    """A Stack of a launch file with these arguments, for this process alone; it ends with the block.

    What the nodes print goes to a folder that is kept where the block raises ApplrError, whose line says so.
    """
    folder = tempfile.mkdtemp(prefix="applr_")
    stack, keep = Stack(file, words, _own_master(folder)), False
    say(f"for other ROS programs: ROS_MASTER_URI={os.environ['ROS_MASTER_URI']}")
    try:
        with open(os.path.join(folder, "roslaunch.log"), "w", encoding="utf-8") as log, contextlib.redirect_stdout(log):
            try:
                with announced("starting ROS", say, first=5.0):
                    stack.start()
                yield stack
            finally:
                with contextlib.redirect_stderr(log):  # roslaunch's lines about nodes that take their time to end
                    stack.stop()
    except ApplrError as problem:
        keep = True
        raise ApplrError(f"{problem}; what the nodes printed is in {folder}") from None
    finally:
        if not keep:
            shutil.rmtree(folder, ignore_errors=True)


def _own_master(folder):
    """Have this process and its children use a master on a free port, which is returned; `folder` gets their logs."""
    port = free_port()
    os.environ.update(ROS_MASTER_URI=f"http://localhost:{port}", ROS_HOSTNAME="localhost", ROS_LOG_DIR=folder)
    for name in ("ROS_IP", "ROS_NAMESPACE"):  # of another robot
        os.environ.pop(name, None)
    return port


def say(text):
    """Print one line of the demo's progress."""
    print(f"applr: {text}", flush=True, file=sys.__stdout__)


def _outline(robot):
    """The rectangle (4, 2) [m] around a robot, in its base frame."""
    low_x, high_x, low_y, high_y = bounding_box(robot)
    return np.array([[high_x, high_y], [low_x, high_y], [low_x, low_y], [high_x, low_y]])


def prepare(words, file):
    """(values of all arguments, words for the launch file, Robot, World) from the command line. Raises ApplrError."""
    known = {name: default for name, (_, default) in roslaunch.arg_dump.get_args([file]).items()}
    given = arguments(words, (*known, *OWN))
    values = {**known, **OWN, **given}
    if not boolean("sim", values["sim"]) or values["move_base"] != "python" or values["goal"] == "none":
        raise ApplrError(
            "the demo needs sim:=true, move_base:=python and a goal: for a real robot use "
            "roslaunch applr_ros1 jackal_applr.launch"
        )
    with contextlib.suppress(ValueError):
        values["limit"] = float(values["limit"])
    number_within("limit", values["limit"], 1.0, 3600.0)
    for name, ending in (("picture", ".png"), ("animation", ".gif")):
        folder = os.path.dirname(os.path.abspath(values[name]))
        if values[name] != "none" and not (values[name].endswith(ending) and os.access(folder, os.W_OK)):
            raise ApplrError(f"{name} is {values[name]}: give a {ending} file in a folder that can be written")
    values = with_folders(values)
    robot = with_remarks(values["robot"])
    if values["policy"] != "none":
        kind = "applr" if values["method"] == "auto" else values["method"]
        values = with_folders(dict(values, method=kind + ":" + values["policy"]))
    values["method"] = methods.make(values["method"], robot).name
    world = worlds.scaled(worlds.load(values["world"]), robot.world_scale)
    values["sent"] = send_goal.course_goal(world.course)
    if values["goal"] != "auto":  # given in odom, whose origin is the start
        values["sent"] = x, y, yaw = pose("goal", values["goal"])
        goal = (x + world.course.start[0], y + world.course.start[1], yaw)
        world = dataclasses.replace(world, course=dataclasses.replace(world.course, goal=goal, finish_y=None))
    passed = {name: values[name] for name in {"method", *given} & set(known) - {"policy"}}
    return values, [f"{name}:={value}" for name, value in dict(passed, goal="none").items()], robot, world


def arguments(words, known):
    """{name: value} of ARG:=VALUE; ROS's own arguments, such as __name:=N, are left out. Raises ApplrError."""
    for word in words:
        name, separator, _ = word.partition(":=")
        if not separator or name not in known and not name.startswith("_"):
            raise ApplrError(f"{word} is no argument: give ARG:=VALUE; there are {', '.join(known)}")
    return load_mappings(words)


def with_folders(values):
    """Arguments {name: value} of the launch file with paths from the root: the nodes run in another folder."""
    found = {name: methods.absolute(value) if name == "method" else value for name, value in values.items()}
    for name in {"robot", "world", "record", "policy"} & set(values):
        if values[name] not in (*NAMES, "none") and (name == "record" or os.path.exists(values[name])):
            found[name] = os.path.abspath(values[name])
    return found


class Stack(roslaunch.pmon.ProcessListener):
    """The nodes of a launch file below this process, on a master of their own.

    What the nodes print on standard output goes to files in ROS_LOG_DIR, their warnings and errors to this terminal.
    Make and start it in the main thread. SIGINT, SIGTERM or SIGHUP make check() raise; while it starts, roslaunch's own
    handlers end the nodes as well.
    """

    def __init__(self, file, words, port):
        self._ended, self._interrupted = "", False
        self._take_signals()
        self._parent = roslaunch.parent.ROSLaunchParent(
            str(uuid.uuid1()),
            [(file, words)],
            port=port,
            process_listeners=[self],
            force_log=True,
            show_summary=False,
            sigint_timeout=2.0,
            sigterm_timeout=0.5,
        )

    def _take_signals(self):
        for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
            signal.signal(number, self._interrupt)

    def _interrupt(self, *_):
        self._interrupted = True

    def process_died(self, process_name, exit_code):
        """Called by roslaunch for a process that ended, also for one that it starts again."""
        if exit_code:
            self._ended = self._ended or f"{process_name.rpartition('-')[0]} ended with status {exit_code}"

    def start(self):
        """Start master and nodes. Raises ApplrError for a launch file that cannot be loaded."""
        try:
            self._parent.start(auto_terminate=False)
        except roslaunch.RLException as error:
            raise ApplrError(" ".join(str(error).split())) from None
        self._take_signals()

    def check(self):
        """Raises KeyboardInterrupt after a Ctrl-C, ApplrError when a node has ended by itself."""
        if self._interrupted:
            raise KeyboardInterrupt("interrupted, every process has ended")
        if self._ended or self._parent.pm.is_shutdown:
            raise ApplrError(self._ended or "the stack ended by itself")

    def wait(self, condition, seconds, otherwise, pause=0.02):
        """Wait in wall time until condition() is true, and return it. Looks every `pause` seconds.

        Raises as check() does, and ApplrError(otherwise).
        """
        deadline, found = time.monotonic() + seconds, None
        while not found:
            self.check()
            if time.monotonic() > deadline:
                raise ApplrError(f"{otherwise} within {seconds:g} s")
            time.sleep(pause)
            found = condition()
        return found

    def stop(self):
        """End all processes."""
        rospy.signal_shutdown("the demo has ended")
        self._parent.shutdown()


def _drive(stack, values, robot, world, result):
    """Drive the course, complete the result; returns the recorded Drive."""
    began = time.monotonic()
    scan = robot.topics.scan if values["scan_topic"] == "auto" else values["scan_topic"]
    observer = Observer(robot, world, scan, frame_prefix(values["tf_prefix"]) + robot.frames.odom)
    for part, up in observer.parts():
        with announced(COMPILES.format(part), say, first=10.0):
            stack.wait(up, UP_WITHIN, f"{part} does not come up")
        say(f"{part:12} up after {time.monotonic() - began:.1f} s")
    success, timeout, seconds, text = observer.drive(values["sent"], values["limit"], say, stack.check)
    drive = observer.recorded(seconds)
    touching = ", touching something" if drive.contacts else ""
    say(f"{text} after {seconds:.1f} s and {drive.length():.2f} m{touching}")
    result.update(success=success, collided=bool(drive.contacts), time_s=round(seconds, 2), reason=text)
    result.update(timeout=timeout, path_length_m=round(drive.length(), 3))
    return drive


def _leave(path, save):
    """Write a file beside the result: its absolute path, or None where there is none."""
    if path == "none":
        return None
    try:
        save(path)
    except (OSError, ValueError) as problem:
        say(f"not written: {problem}")
        return None
    say(os.path.abspath(path))
    return os.path.abspath(path)
