#!/usr/bin/env python3
"""The collision monitor between move_base and the base (nodes/monitor/node.py)."""

from applr_ros1.common.errors import run_script

if __name__ == "__main__":
    run_script("applr_ros1.nodes.monitor.node", node=True)
