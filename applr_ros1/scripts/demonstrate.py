#!/usr/bin/env python3
"""rosrun applr_ros1 demonstrate.py: a scripted demonstration as a bag (training/demonstrate.py). See --help."""

import sys

sys.path.pop(0)  # this file's folder, whose sim_bridge.py would hide the package of that name

from training.demonstrate import main

if __name__ == "__main__":
    sys.exit(main())
