#!/usr/bin/env python3
"""The simulated Jackal as a ROS node (sim_bridge/ros_bridge.py)."""

from applr_ros1.common.errors import run_script

if __name__ == "__main__":
    run_script("sim_bridge.ros_bridge", node=True)
