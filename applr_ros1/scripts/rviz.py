#!/usr/bin/env python3
"""Starts RViz with the configuration of this package; see applr_ros1/nodes/rviz.py."""

import sys

from applr_ros1.common.errors import run_script

if __name__ == "__main__":
    sys.exit(run_script("applr_ros1.nodes.rviz"))
