#!/usr/bin/env python3
"""What ./applr barn runs: the BARN Challenge's runner against the simulator; see applr_ros1/nodes/tools/barn.py."""

from applr_ros1.common.errors import run_script

if __name__ == "__main__":
    run_script("applr_ros1.nodes.tools.barn")
