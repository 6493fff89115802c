#!/usr/bin/env python3
"""rosrun applr_ros1 check_robot.py: checks the description of a robot (training/check_robot.py). See --help."""

from applr_ros1.common.errors import run_script

if __name__ == "__main__":
    run_script("training.check_robot")
