#!/usr/bin/env python3
"""A method that commands velocities in the place of the local planner (nodes/velocity_node.py)."""

import sys

from applr_ros1.common.errors import run_script

if __name__ == "__main__":
    sys.exit(run_script("applr_ros1.nodes.velocity_node", node=True))
