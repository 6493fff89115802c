#!/usr/bin/env python3
"""rosrun applr_ros1 teleop.py: a person drives, by keyboard or joystick, and records it (nodes/teleop.py)."""

import sys

sys.path.pop(0)  # this file's folder, whose sim_bridge.py would hide the package of that name

from applr_ros1.nodes.teleop import main

if __name__ == "__main__":
    sys.exit(main())
