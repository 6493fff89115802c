#!/usr/bin/env python3
"""The navigation node /move_base; see applr_ros1/nodes/move_base/node.py."""

from applr_ros1.common.errors import run_script

if __name__ == "__main__":
    run_script("applr_ros1.nodes.move_base.node", node=True)
