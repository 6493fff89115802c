#!/usr/bin/env python3
"""./applr try: whether the policy pays on a robot, by simulated drives (training/try_robot.py). See --help."""

from applr_ros1.common.errors import run_script

if __name__ == "__main__":
    run_script("training.try_robot")
