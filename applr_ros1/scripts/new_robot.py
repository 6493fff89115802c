#!/usr/bin/env python3
"""./applr robot: writes the folder of a robot from its URDF and parameter files (training/new_robot.py). See --help."""

from applr_ros1.common.errors import run_script

if __name__ == "__main__":
    run_script("training.new_robot")
