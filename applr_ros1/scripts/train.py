#!/usr/bin/env python3
"""rosrun applr_ros1 train.py: trains a parameter policy (training/train.py). See --help."""

from applr_ros1.common.errors import run_script

if __name__ == "__main__":
    run_script("training.train")
