#!/usr/bin/env python3
"""Run by roslaunch while it loads jackal_applr.launch: prints "checked", or one line about the wrong argument."""

import sys

from applr_ros1.common.errors import run_script

if __name__ == "__main__":
    sys.exit(run_script("applr_ros1.nodes.arguments"))
