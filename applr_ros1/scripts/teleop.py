#!/usr/bin/env python3
"""rosrun applr_ros1 teleop.py: a person drives, by keyboard or joystick, and records it (nodes/tools/teleop.py)."""

from applr_ros1.common.errors import run_script

if __name__ == "__main__":
    run_script("applr_ros1.nodes.tools.teleop", node=True)
