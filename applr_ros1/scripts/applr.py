#!/usr/bin/env python3
"""The applr node: sets the planner's parameters at every decision (nodes/applr_node.py)."""

import sys

from applr_ros1.common.errors import run_script

if __name__ == "__main__":
    sys.exit(run_script("applr_ros1.nodes.applr_main", node=True))
