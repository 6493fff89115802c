#!/usr/bin/env python3
"""rosrun applr_ros1 measure_braking.py --free 6 --yes: how the robot brakes; see nodes/tools/measure_braking.py."""

from applr_ros1.common.errors import run_script

if __name__ == "__main__":
    run_script("applr_ros1.nodes.tools.measure_braking")
