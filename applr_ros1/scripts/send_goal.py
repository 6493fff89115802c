#!/usr/bin/env python3
"""rosrun applr_ros1 send_goal.py _goal:='x y yaw' (or auto, with _world:=generated:7): sends a goal and waits."""

import sys

from applr_ros1.nodes import goal

if __name__ == "__main__":
    sys.exit(goal.main())
