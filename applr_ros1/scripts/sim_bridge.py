#!/usr/bin/env python3
"""The simulated Jackal as a ROS node (sim_bridge/ros_bridge.py)."""

import sys

sys.path.pop(0)  # this file's folder, where `sim_bridge` would be this file

from sim_bridge.ros_bridge import main

if __name__ == "__main__":
    sys.exit(main())
