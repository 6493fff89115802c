#!/usr/bin/env python3
"""What ./applr demo runs: one course, headless, with progress, a result line and a picture."""

from applr_ros1.common.errors import run_script

if __name__ == "__main__":
    run_script("applr_ros1.nodes.tools.demo")
