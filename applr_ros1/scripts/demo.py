#!/usr/bin/env python3
"""What ./applr demo runs: one course, headless, with progress, a result line and a picture."""

import sys

from applr_ros1.nodes import demo

if __name__ == "__main__":
    sys.exit(demo.main(sys.argv[1:]))
