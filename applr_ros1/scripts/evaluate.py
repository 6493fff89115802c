#!/usr/bin/env python3
"""rosrun applr_ros1 evaluate.py: methods x worlds x trials, then the paper's tables and figures. See --help."""

import sys

sys.path.pop(0)  # this file's folder, whose sim_bridge.py would hide the package of that name

from training.evaluate import main

if __name__ == "__main__":
    sys.exit(main())
