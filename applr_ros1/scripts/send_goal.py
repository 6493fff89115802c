#!/usr/bin/env python3
"""rosrun applr_ros1 send_goal.py _goal:='x y yaw' (or auto, with _world:=generated:7): sends a goal and waits."""

from applr_ros1.common.errors import run_script

if __name__ == "__main__":
    run_script("applr_ros1.nodes.tools.send_goal", node=True)
