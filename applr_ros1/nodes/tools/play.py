"""The playground (./applr play): a simulated robot on a ROS master of its own, and a page in a browser to play with it.

It starts jackal_applr.launch with viewer:=true, says where the page is, and ends every process at Ctrl-C.
"""

import contextlib
import os
import shutil
import sys
import tempfile
import time
import webbrowser

import roslaunch
import roslaunch.arg_dump
import rospy

from applr_ros1.common.errors import ApplrError
from applr_ros1.common.progress import announced

from .demo import UP_WITHIN, Stack, own_master, say

USAGE = """usage: play.py [--no-browser] [--host ADDRESS] [ARG:=VALUE ...]

Starts a simulated robot and a page in a browser: drive it, tune it, see why it does what it does. Ctrl-C ends it.

  --no-browser     Only say where the page is.
  --host ADDRESS   Serve the page on this address instead of 127.0.0.1; 0.0.0.0 lets other computers open it.

The other arguments are those of the launch file: roslaunch --ros-args applr_ros1 jackal_applr.launch. The most
important ones are robot:=jackal and world:=generated:0. No goal is sent unless goal:=auto is given."""


def main():
    """Exit status: 130 after Ctrl-C, 1 where a part of the stack ends by itself or an argument is wrong (one line)."""
    words = sys.argv[1:]
    if {"-h", "--help"} & set(words):
        print(USAGE)
        return 0
    (file,) = roslaunch.rlutil.resolve_launch_arguments(["applr_ros1", "jackal_applr.launch"])
    browser, passed = prepare(words, file)
    folder = tempfile.mkdtemp(prefix="applr_play_")
    port = own_master(folder)
    stack, keep = Stack(file, passed, port), False
    try:
        with open(os.path.join(folder, "roslaunch.log"), "w", encoding="utf-8") as log, contextlib.redirect_stdout(log):
            try:
                with announced("starting ROS", say, first=5.0):
                    stack.start()
                with announced("waiting for the page", say, first=10.0):
                    stack.wait(lambda: rospy.get_param("/viewer/address", ""), UP_WITHIN, "the page does not come up")
                address = rospy.get_param("/viewer/address")
                say(f"the page is at {address}; for other ROS programs: ROS_MASTER_URI=http://localhost:{port}")
                if browser and (os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")):
                    webbrowser.open(address)
                while True:
                    stack.check()
                    time.sleep(0.2)
            finally:
                stack.stop()
    except ApplrError as problem:
        keep = True
        raise ApplrError(f"{problem}; what the nodes printed is in {folder}") from None
    finally:
        if not keep:
            shutil.rmtree(folder, ignore_errors=True)


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
            values[name] = os.path.abspath(value) if os.path.exists(value) else value  # nodes run in another folder
        else:
            raise ApplrError(f"{word} is no argument: give --no-browser, --host ADDRESS or ARG:=VALUE (--help)")
    return browser, [f"{name}:={value}" for name, value in values.items()]
