"""Descriptions of robots: one folder per robot with robot.yaml and the parameter files of its move_base.

`load` reads an included robot by name, or a folder of one's own. The simulators, the policy's parameter space, training
and the launch file take what it returns. urdf_import/ makes a folder from what a robot's owner has.
docs/tutorials/your_robot.md says how to describe another robot.
"""
# Imports planner and common; no ROS.

from __future__ import annotations

from applr_ros1.robots.folder import NAMES, RobotError, load
from applr_ros1.robots.robot import FILE, Robot

JACKAL = load("jackal")  # the robot where none is named

__all__ = ["FILE", "JACKAL", "NAMES", "Robot", "RobotError", "load"]
