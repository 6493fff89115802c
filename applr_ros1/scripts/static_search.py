#!/usr/bin/env python3
"""rosrun applr_ros1 static_search.py: the best single parameter set (training/static_search.py). See --help."""

from applr_ros1.common.errors import run_script

if __name__ == "__main__":
    run_script("training.static_search")
