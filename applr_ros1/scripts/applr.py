#!/usr/bin/env python3
"""The applr node: sets the planner's parameters every two seconds (nodes/applr_node.py)."""

import sys

from applr_ros1.nodes.applr_node import main

if __name__ == "__main__":
    sys.exit(main())
