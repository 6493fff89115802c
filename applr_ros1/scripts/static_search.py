#!/usr/bin/env python3
"""rosrun applr_ros1 static_search.py: the best single parameter set (training/static_search.py). See --help."""

import sys

sys.path.pop(0)  # this file's folder, whose sim_bridge.py would hide the package of that name

from training.static_search import main

if __name__ == "__main__":
    sys.exit(main())
