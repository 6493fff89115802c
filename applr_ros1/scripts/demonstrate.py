#!/usr/bin/env python3
"""rosrun applr_ros1 demonstrate.py: a scripted demonstration as a bag (training/demonstrate.py). See --help."""

from applr_ros1.common.errors import run_script

if __name__ == "__main__":
    run_script("training.demonstrate")
