#!/usr/bin/env python3
"""rosrun applr_ros1 record.py FILE.bag: records the stack of this namespace; see applr_ros1/nodes/tools/record.py."""

from applr_ros1.common.errors import run_script

if __name__ == "__main__":
    run_script("applr_ros1.nodes.tools.record")
