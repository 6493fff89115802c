#!/usr/bin/env python3
"""rosrun applr_ros1 evaluate.py: methods x worlds x trials, then the paper's tables and figures. See --help."""

from applr_ros1.common.errors import run_script

if __name__ == "__main__":
    run_script("training.evaluate")
