#!/usr/bin/env python3
"""rosrun applr_ros1 replay.py FILE.bag: plays a bag back with its clock; see applr_ros1/nodes/tools/replay.py."""

from applr_ros1.common.errors import run_script

if __name__ == "__main__":
    run_script("applr_ros1.nodes.tools.replay")
