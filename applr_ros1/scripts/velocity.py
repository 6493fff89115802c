#!/usr/bin/env python3
"""A method that commands velocities in the place of the local planner (nodes/applr/velocity_node.py)."""

from applr_ros1.common.errors import run_script

if __name__ == "__main__":
    run_script("applr_ros1.nodes.applr.velocity_node", node=True)
