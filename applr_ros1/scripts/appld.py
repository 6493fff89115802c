#!/usr/bin/env python3
"""rosrun applr_ros1 appld.py: contexts and parameters from demonstrations (training/appld.py). See --help."""

import sys

from applr_ros1.common.errors import run_script

if __name__ == "__main__":
    sys.exit(run_script("training.appld"))
