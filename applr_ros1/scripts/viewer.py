#!/usr/bin/env python3
"""A page in a browser with robot, planner and parameters; see applr_ros1/nodes/viewer/node.py."""

from applr_ros1.common.errors import run_script

if __name__ == "__main__":
    run_script("applr_ros1.nodes.viewer.node", node=True)
