"""The demo (./applr demo): one course from start to finish with the whole stack, on a ROS master of its own.

It says when each part of the stack is up, sends the goal, reports progress, ends every process, and leaves a picture,
an animation and one line of JSON.
"""

import contextlib
import dataclasses
import json
import os
import sys
import time

import numpy as np

import worlds
from applr_ros1.common.arguments import boolean, frame_prefix, number_within, pose
from applr_ros1.common.errors import ApplrError
from applr_ros1.drives import animation, picture
from applr_ros1.policy import methods
from applr_ros1.robots.check import with_remarks
from applr_ros1.robots.geometry import bounding_box

from . import send_goal
from .demo_drive import Observer
from .launcher import given_arguments, launch_arguments, own_stack, say

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
        result["picture"] = _leave(values["picture"], lambda path: picture.save(drive, path))
        result["animation"] = _leave(values["animation"], lambda path: animation.save(drive, outline, path))
    print(json.dumps(result), flush=True)
    return 0 if result["success"] else 1


def prepare(words):
    """(values of all arguments, those for the launch file, Robot, World) from the command line. Raises ApplrError."""
    known = launch_arguments()
    given = given_arguments(words, (*known, *OWN))
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
    scan = robot.topics.scan if values["scan_topic"] == "auto" else values["scan_topic"]
    observer = Observer(robot, world, scan, frame_prefix(values["tf_prefix"]) + robot.frames.odom)
    for part, up in observer.parts():
        stack.wait_until_up(part, up)
        say(f"{part:12} up after {time.monotonic() - began:.1f} s")
    success, timeout, seconds, text = observer.drive(values["sent"], values["limit"], stack.check)
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
