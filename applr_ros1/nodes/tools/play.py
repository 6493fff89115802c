"""The playground (./applr play): a simulated robot on a ROS master of its own, and a page in a browser to play with it.

It starts jackal_applr.launch with viewer:=true, says where the page is, and ends every process at Ctrl-C. Where the
page has put other arguments into PLAYED, such as another robot, everything starts anew with them.
"""

import os
import sys
import time
import webbrowser

import roslaunch.arg_dump
import rospy

from applr_ros1.common.errors import ApplrError
from applr_ros1.common.progress import announced
from applr_ros1.nodes.viewer.world import PLAYED

from .demo import UP_WITHIN, launch_file, own_stack, say, with_folders

USAGE = """usage: play.py [--no-browser] [--host ADDRESS] [ARG:=VALUE ...]

Starts a simulated robot and a page in a browser: drive it, tune it, see why it does what it does. Ctrl-C ends it.

  --no-browser     Only say where the page is.
  --host ADDRESS   Serve the page on this address instead of 127.0.0.1; 0.0.0.0 lets other computers open it.

The other arguments are those of the launch file: roslaunch --ros-args applr_ros1 jackal_applr.launch. The most
important ones are robot:=jackal and world:=generated:0. No goal is sent unless goal:=auto is given."""


def main():
    """Exit status: 130 after Ctrl-C, 1 where a part of the stack ends by itself or an argument is wrong (one line)."""
    browser, passed = prepare(sys.argv[1:], launch_file())
    with own_stack(passed) as stack:
        with announced("waiting for the page", say, first=10.0):
            stack.wait(lambda: rospy.get_param("/viewer/address", ""), UP_WITHIN, "the page does not come up")
        address = rospy.get_param("/viewer/address")
        say(f"the page is at {address}")
        if browser and (os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")):
            webbrowser.open(address)
        rospy.set_param(PLAYED, passed)
        wanted = passed
        while wanted == passed:
            stack.check()
            time.sleep(0.2)
            wanted = rospy.get_param(PLAYED)
    os.execv(sys.executable, [sys.executable, sys.argv[0], "--no-browser", *wanted])


def prepare(words, file):
    """(whether to open a browser, words for the launch file) from the command line. Raises ApplrError."""
    known = {name: default for name, (_, default) in roslaunch.arg_dump.get_args([file]).items()}
    values, browser, words = {"viewer": "true", "goal": "none"}, True, list(words)
    while words:
        word = words.pop(0)
        name, separator, value = word.partition(":=")
        if word == "--no-browser":
            browser = False
        elif word == "--host" and words:
            values["viewer_host"] = words.pop(0)
        elif separator and name in known:
            values[name] = value
        else:
            raise ApplrError(f"{word} is no argument: give --no-browser, --host ADDRESS or ARG:=VALUE (--help)")
    return browser, [f"{name}:={value}" for name, value in with_folders(values).items()]
