#!/usr/bin/env python3
"""Starts RViz with the configuration of this package; see applr_ros1/nodes/tools/rviz.py."""

from applr_ros1.common.errors import run_script

if __name__ == "__main__":
    run_script("applr_ros1.nodes.tools.rviz")
