#!/usr/bin/env python3
"""The navigation node /move_base; see applr_ros1/nodes/move_base_node.py."""

import sys

from applr_ros1.nodes.move_base_node import main

if __name__ == "__main__":
    sys.exit(main())
