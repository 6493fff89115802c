"""The playground (./applr play): a simulated robot on a ROS master of its own, and a page in a browser to play with it.

It starts jackal_applr.launch with viewer:=true, says where the page is, and ends every process at Ctrl-C.
"""

import argparse
import math
import os
import re
import webbrowser

import rospy
from dynamic_reconfigure import find_reconfigure_services

import worlds
from applr_ros1.nodes.viewer import admission
from applr_ros1.robots import load

from .launcher import given_arguments, launch_arguments, private_stack, say


def main():
    """Exit status: 130 after Ctrl-C, 1 where a part of the stack ends by itself or an argument is wrong (one line)."""
    parser = argparse.ArgumentParser(
        prog="./applr play",
        description="Start a simulated robot and a page in a browser: drive it, tune it, see why it does what it does. "
        "Ctrl-C ends it.",
    )
    add = parser.add_argument
    add("--no-browser", action="store_true", help="Only say where the page is.")
    words = "Arguments of jackal_applr.launch, such as robot:=jackal and world:=generated:0; goal:=auto sends a goal."
    add("words", nargs="*", metavar="ARG:=VALUE", help=words)
    options = parser.parse_intermixed_args()
    given = {"viewer": "true", "goal": "none"}
    defaults = launch_arguments()
    given.update(given_arguments(options.words, defaults))
    load(given.get("robot", defaults["robot"]))  # what is wrong with these two ends here, in one line
    worlds.load(given.get("world", defaults["world"]))
    token = os.environ[admission.TOKEN] = admission.token()
    # any local user, and a website in a browser, can write on the parameter server: nothing but the port is from there
    known = re.compile(rf"http://127\.0\.0\.1:\d+/{re.escape(token)}/")
    with private_stack(given) as stack:
        found = []

        def there():
            found.extend(known.findall(str(rospy.get_param("/viewer/address", ""))))
            return found

        stack.wait_until_up("the page", there)
        address = found[0]
        say(f"the page is at {address}")
        if not options.no_browser and (os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")):
            webbrowser.open(address)
        stack.wait_until_up("move_base", find_reconfigure_services, math.inf, pause=0.5)
        stack.wait(lambda: False, math.inf, "", pause=0.2)
