#!/usr/bin/env python3
"""Prints the URDF of a robot, given by name or folder, for the parameter robot_description in launch files."""

from applr_ros1.common.errors import run_script

if __name__ == "__main__":
    run_script("applr_ros1.robots.urdf")
