#!/usr/bin/env python3
"""What ./applr play runs: a simulated robot, and a page in a browser to play with it."""

from applr_ros1.common.errors import run_script

if __name__ == "__main__":
    run_script("applr_ros1.nodes.tools.play")
