#!/usr/bin/env python3
"""The applr node: sets the planner's parameters at every decision (nodes/applr/node.py)."""

from applr_ros1.common.errors import run_script

if __name__ == "__main__":
    run_script("applr_ros1.nodes.applr.main", node=True)
