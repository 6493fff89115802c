#!/usr/bin/env python3
"""What ./applr barn runs: the BARN Challenge's runner against the simulator; see applr_ros1/nodes/barn.py."""

import sys

from applr_ros1.common.errors import run_script

if __name__ == "__main__":
    sys.exit(run_script("applr_ros1.nodes.barn"))
