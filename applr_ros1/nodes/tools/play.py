"""The playground (./applr play): a simulated robot, and a web page to control it.

The stack has its own ROS master.

The program starts jackal_applr.launch with viewer:=true, prints the address of the page, and ends
every process at Ctrl-C.
"""

from __future__ import annotations

import argparse
import os
import re
import time
import webbrowser

import rospy
from dynamic_reconfigure import find_reconfigure_services

from applr_ros1.nodes.viewer import admission

from .launcher import given_arguments, launch_arguments, private_nodes, report, scene_of


def main() -> None:
    """Run the playground until Ctrl-C.

    Raises:
        ApplrError: An argument is invalid, or the stack fails.
    """
    parser = argparse.ArgumentParser(
        prog="./applr play",
        description="Start a simulated robot and a web page to drive it, tune it and see its "
        "decisions. Ctrl-C ends both.",
    )
    add = parser.add_argument
    add("--no-browser", action="store_true", help="Only print the address of the page.")
    words_help = (
        "Arguments of jackal_applr.launch, such as robot:=jackal and world:=generated:0; "
        "goal:=auto sends a goal."
    )
    add("words", nargs="*", metavar="ARG:=VALUE", help=words_help)
    options = parser.parse_intermixed_args()
    defaults = launch_arguments()
    arguments = {"viewer": "true", "goal": "none", **given_arguments(options.words, defaults)}

    # An invalid robot or world is an error before anything starts.
    scene_of({**defaults, **arguments})

    # Any local user or website can write to the parameter server: only an address on 127.0.0.1 with
    # this program's token is accepted.
    token = admission.token()
    os.environ[admission.TOKEN] = token
    own_address = re.compile(rf"http://127\.0\.0\.1:\d+/{re.escape(token)}/")
    with private_nodes(arguments) as nodes:
        addresses = []

        def is_up() -> bool:
            addresses.extend(own_address.findall(str(rospy.get_param("/viewer/address", ""))))
            return bool(addresses)

        nodes.wait("the page", is_up)
        report(f"the page is at {addresses[0]}")
        # Without a display, webbrowser would open the page in the terminal.
        has_display = os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")
        if has_display and not options.no_browser:
            webbrowser.open(addresses[0])
        nodes.wait("move_base", find_reconfigure_services, pause=0.5)
        while True:
            nodes.check()
            time.sleep(0.2)
