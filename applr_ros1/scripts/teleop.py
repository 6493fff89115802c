#!/usr/bin/env python3
"""rosrun applr_ros1 teleop.py: a person drives, by keyboard or joystick, and records it (nodes/teleop.py)."""

import sys

from applr_ros1.common.errors import run_script

if __name__ == "__main__":
    sys.exit(run_script("applr_ros1.nodes.teleop", node=True))
