"""The demo: one course from start to finish with the whole stack (./applr demo).

It starts the launch file on a master of its own, says when each part is up, sends the goal, reports progress, ends
every process, and leaves a picture and one line of JSON. Called by scripts/demo.py.
"""

import dataclasses
import json
import os
import re
import signal
import sys
import tempfile
import textwrap
import time

import numpy as np

import worlds
from applr_ros1.common.errors import ApplrError
from applr_ros1.common.progress import announced
from applr_ros1.robots import NAMES, load
from applr_ros1.robots.outline import extent
from worlds import drive_animation, drive_picture

from . import arguments, mode_files, processes

PICTURE, ANIMATION = "applr_demo.png", "applr_demo.gif"
DRIVE_LIMIT = 300.0  # simulated seconds: default DWA sometimes takes long to free itself
UP_WITHIN = 900.0  # wall seconds for one part to come up: the first time it compiles kernels, maybe on a busy machine
STALLED_AFTER = 20.0  # wall seconds without a new pose
COLOUR = re.compile("\x1b\\[[0-9;]*m")
NOISE = re.compile(r"The traceback for|\[[\w/]+-\d+\] |\.\.\.|Param xml|Arg xml|shutting down|done|=====|log file: ")
RESPAWNED = ("applr", "collision_monitor")  # nodes; with the others the launch file ends
TELLING = (*RESPAWNED, "sim_bridge", "move_base")  # begin the line with which they end
FAILED = re.compile(r"\[(%s)-\d+\] process has died" % "|".join(RESPAWNED))
LOOK_EVERY = 1.0  # wall seconds between looks into the log for nodes that have failed
TOPICS = ("scan_topic", "odom_topic", "cmd_vel_topic")
EXTRA = {
    "port": ("", "Port of the ROS master; empty takes a free one."),
    "picture": (PICTURE, "File for the picture."),
    "animation": (ANIMATION, "File for the animation (.gif), with scan, plans and parameters; none makes none."),
    "limit": (str(DRIVE_LIMIT), "Simulated time [s] after which the drive counts as timed out."),
}


class DemoError(ApplrError):
    """Why the demo cannot go on, in one line."""


def usage():
    """The text of --help: every argument with its default and what it means."""
    lines = ["usage: demo.py [ARG:=VALUE ...]", "", "Drives one course with the whole stack, without a window.", ""]
    for name, (default, sentence) in list(arguments.declared().items()) + list(EXTRA.items()):
        text = "%-25s %s" % ("%s:=%s" % (name, default), sentence)
        lines += textwrap.wrap(text, 118, initial_indent="  ", subsequent_indent=" " * 28)
    lines += ["", "The last line is one JSON object. The exit status is 0 only if the goal was reached."]
    return "\n".join(lines)


def main(words=None):
    """Exit status: 0 goal reached, 1 not reached, 2 wrong argument, 130 interrupted."""
    words = sys.argv[1:] if words is None else words
    if {"-h", "--help"} & set(words):
        print(usage())
        return 0
    try:
        values, world = _prepare(words)
    except (ValueError, OSError) as problem:
        print("applr: %s" % problem, file=sys.stderr)
        return 2
    signal.signal(signal.SIGTERM, _interrupt)
    processes.adopt_orphans()
    with tempfile.NamedTemporaryFile(prefix="applr_demo_", suffix=".log", delete=False) as log:
        stack = Stack(values, log)
        try:
            result, drive = _run(stack, values, world)
        except KeyboardInterrupt:
            signal.signal(signal.SIGINT, signal.SIG_IGN)
            say("interrupted: ending every process")
            stack.stop()
            os.unlink(log.name)
            return 130
        except DemoError as problem:
            signal.signal(signal.SIGINT, signal.SIG_IGN)
            say("%s; all that the nodes said is in %s" % (problem, log.name))
            stack.stop()
            print(json.dumps(_result(values, world, reason=str(problem))), flush=True)
            return 1
        signal.signal(signal.SIGINT, signal.SIG_IGN)
        stack.stop()
    os.unlink(log.name)
    drive.title = "{world}, {robot}, mode {mode}: {reason} in {time_s:.1f} s".format(**result)
    result["picture"] = _leave("picture", values["picture"], lambda path: drive_picture.save(drive, path))
    result["animation"] = _leave(
        "animation", values["animation"], lambda path: drive_animation.save(drive, _outline(values["robot"]), path)
    )
    print(json.dumps(result), flush=True)
    return 0 if result["success"] else 1


def say(text):
    """Print one line of the demo's progress."""
    print("applr: %s" % text, flush=True)


def _outline(robot):
    """The rectangle (4, 2) [m] around a robot, in its base frame."""
    low_x, high_x, low_y, high_y = extent(load(robot))
    return np.array([[high_x, high_y], [low_x, high_y], [low_x, low_y], [high_x, low_y]])


def _interrupt(signum, frame):
    raise KeyboardInterrupt


def _prepare(words):
    """({argument: text}, World) from the command line. ValueError or OSError, one line, for a mistake."""
    known = arguments.declared()
    given = arguments.parse(words, list(known) + list(EXTRA))
    values = {name: default for name, (default, _) in list(known.items()) + list(EXTRA.items())}
    values.update(given, given=given)
    arguments.check({name: values[name] for name in known})
    if not arguments.boolean("sim", values["sim"]) or values["move_base"] != "python" or values["goal"] == "none":
        raise arguments.ArgumentError(
            "the demo needs sim:=true, move_base:=python and a goal: for a real robot use "
            "roslaunch applr_ros1 jackal_applr.launch"
        )
    if not arguments.boolean("clock", values["clock"]):
        raise arguments.ArgumentError(
            "clock is %s: on the demo's own master nobody else makes the clock; leave clock:= away" % values["clock"]
        )
    if not 1.0 <= arguments.number("limit", values["limit"]) <= 3600.0:
        raise arguments.ArgumentError("limit is %s: give 1 to 3600 simulated seconds" % values["limit"])
    _check_file("picture", values["picture"], ".png")
    if values["animation"] != "none":
        _check_file("animation", values["animation"], ".gif")
    _choose_port(values)
    for name in ("robot", "world", "policy", "parameters", "params", "record"):  # the nodes run in another folder
        if (
            os.path.exists(values[name])
            and values[name] not in NAMES
            or name == "record"
            and arguments.path(values[name])
        ):
            values[name] = os.path.abspath(values[name])
    robot = load(values["robot"])
    mode = arguments.usable_mode(values, robot)
    if mode != values["mode"]:
        say("robot %s has no policy of its own: mode %s; train one or give policy:=FILE" % (robot.name, mode))
        values["mode"] = mode
    for name, topic in zip(TOPICS, (robot.topics.scan, robot.topics.odometry, robot.topics.cmd_vel)):
        values[name] = topic if values[name] == "auto" else values[name]
    world = worlds.scaled(worlds.load(values["world"]), robot.world_scale)
    start = arguments.pose("start", values["start"])
    if start is not None:
        world = dataclasses.replace(world, course=dataclasses.replace(world.course, start=start))
    goal = arguments.goal(values["goal"])
    if goal is not None:  # given in odom, whose origin is the start
        start = world.course.start
        goal = (goal[0] + start[0], goal[1] + start[1], goal[2])
        world = dataclasses.replace(world, course=dataclasses.replace(world.course, goal=goal, finish_y=None))
    return values, world


def _check_file(name, path, ending):
    folder = os.path.dirname(os.path.abspath(path))
    if not path.endswith(ending) or not os.path.isdir(folder) or not os.access(folder, os.W_OK):
        raise arguments.ArgumentError(
            "%s is %s: give a %s file in a folder that can be written" % (name, path or "empty", ending)
        )


def _choose_port(values):
    if not values["port"]:
        values["port"] = str(processes.free_port())
        return
    port = arguments.whole("port", values["port"], 1024, 65535)
    if not processes.port_is_free(port):
        raise arguments.ArgumentError(
            "port %d is taken by another program: leave port:= away and a free one is chosen" % port
        )


class Stack:
    """The launch file running below this process, on its own master."""

    def __init__(self, values, log):
        self.log = log
        passed = dict(values, mode=mode_files.absolute(values["mode"]))
        launch = ["%s:=%s" % (name, passed[name]) for name in arguments.declared() if name not in ("goal", *TOPICS)]
        launch += ["%s:=%s" % (name, values["given"][name]) for name in TOPICS if name in values["given"]]
        environment = dict(
            os.environ,
            ROS_MASTER_URI="http://localhost:%s" % values["port"],
            ROS_HOSTNAME="localhost",
            PYTHONUNBUFFERED="1",
        )
        os.environ.update(ROS_MASTER_URI=environment["ROS_MASTER_URI"], ROS_HOSTNAME="localhost")
        for name in ("ROS_IP", "ROS_NAMESPACE"):  # of another robot
            environment.pop(name, None)
            os.environ.pop(name, None)
        self.process = processes.start(
            [
                "roslaunch",
                "--skip-log-check",
                "--disable-title",
                "--sigint-timeout=2",
                "--sigterm-timeout=0.5",
                "-p",
                values["port"],
                "applr_ros1",
                "jackal_applr.launch",
                "goal:=none",
            ]
            + launch,
            environment,
            log,
        )

    def check(self):
        """DemoError if it has ended."""
        if self.process.poll() is not None:
            raise DemoError("the stack ended by itself: %s" % self.last_words())

    def check_nodes(self):
        """DemoError if a node of RESPAWNED has failed; the launch file starts it again and again."""
        for line in self._lines():
            if FAILED.match(line):
                raise DemoError("a node ended by itself: %s" % self.last_words())

    def _lines(self):
        """The lines of the log that are not empty, without colours."""
        with open(self.log.name, encoding="utf-8", errors="replace") as file:
            return [COLOUR.sub("", line).strip() for line in file if line.strip()]

    def last_words(self):
        """The first line of the log that reports an error, else its last line."""
        lines = [line for line in self._lines() if not NOISE.match(line)]
        telling = [line for line in lines if line.startswith(tuple(node + ": " for node in TELLING))] or [
            line for line in lines if "rror" in line or "xception" in line or "FATAL" in line
        ]
        return (telling[:1] or lines[-1:] or ["it said nothing"])[0][:300]

    def stop(self):
        """End the launch file and everything below it."""
        processes.stop(self.process)


def _run(stack, values, world):
    from . import demo_drive, goal  # rospy is loaded only when there is something to drive

    say(
        "world %s, robot %s, mode %s, simulator %s, master on port %s"
        % (world.name, load(values["robot"]).name, values["mode"], values["simulator"], values["port"])
    )
    began = time.monotonic()
    wait = Waiting(stack)
    with announced("starting ROS", say, first=5.0):
        observer = demo_drive.Observer(values, world, wait)
    for part, up in observer.parts():
        with announced("waiting for %s, which compiles its kernels at its first start" % part, say, first=10.0):
            wait.until(up, UP_WITHIN, "%s does not come up" % part)
        say("%-12s up after %.1f s" % (part, time.monotonic() - began))
    pose = arguments.goal(values["goal"]) or goal.course_goal(world.course)
    outcome = observer.drive(pose, float(values["limit"]), say, STALLED_AFTER)
    drive = observer.recorded(outcome.time)
    say(
        "%s after %.1f s and %.2f m%s"
        % (outcome.text, outcome.time, drive.length(), ", touching something" if drive.contacts else "")
    )
    result = _result(values, world, outcome.success, bool(drive.contacts), outcome.time, outcome.text)
    gap = observer.command_gap()
    result.update(
        timeout=outcome.timeout,
        path_length_m=round(drive.length(), 3),
        seed=int(values["seed"]),
        simulator=values["simulator"],
        memory_mb=round(observer.memory / 1e6),
        command_gap_p99_ms=None if gap is None else round(1e3 * gap, 1),
    )
    return result, drive


class Waiting:
    """Waits in wall time and notices when the stack or one of its nodes ends meanwhile."""

    def __init__(self, stack):
        self.stack = stack

    def until(self, condition, seconds, otherwise):
        """Wait until condition() is true.

        Raises:
            DemoError: The stack or a node ended, or `seconds` of wall time passed, where the error begins with the text
                `otherwise`.
        """
        deadline = time.monotonic() + seconds
        look = 0.0
        while not condition():
            self.stack.check()
            if time.monotonic() >= look:
                self.stack.check_nodes()
                look = time.monotonic() + LOOK_EVERY
            if time.monotonic() > deadline:
                raise DemoError("%s within %g s: %s" % (otherwise, seconds, self.stack.last_words()))
            time.sleep(0.02)


def _result(values, world, success=False, collided=False, seconds=None, reason=""):
    return {
        "world": world.name,
        "robot": load(values["robot"]).name,
        "mode": values["mode"],
        "success": success,
        "collided": collided,
        "time_s": None if seconds is None else round(seconds, 2),
        "reason": reason,
    }


def _leave(what, path, save):
    """Write a file beside the result: its absolute path, or None where there is none."""
    if path == "none":
        return None
    try:
        save(path)
    except (OSError, ValueError) as problem:
        say("no %s: %s" % (what, problem))
        return None
    say("%s %s" % (what, os.path.abspath(path)))
    return os.path.abspath(path)
