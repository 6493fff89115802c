#!/usr/bin/env python3
"""The collision monitor between move_base and the base (nodes/collision_monitor_node.py)."""

import sys

from applr_ros1.common.errors import run_script

if __name__ == "__main__":
    sys.exit(run_script("applr_ros1.nodes.collision_monitor_node", node=True))
