#!/usr/bin/env python3
"""rosrun applr_ros1 train.py: trains a parameter policy (training/train.py). See --help."""

import sys

sys.path.pop(0)  # this file's folder, whose sim_bridge.py would hide the package of that name

from training.train import main

if __name__ == "__main__":
    sys.exit(main())
