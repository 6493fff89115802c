#!/usr/bin/env python3
"""rosrun applr_ros1 appld.py: contexts and parameters from demonstrations (training/appld.py). See --help."""

from applr_ros1.common.errors import run_script

if __name__ == "__main__":
    run_script("training.appld")
