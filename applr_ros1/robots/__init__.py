"""Descriptions of robots: a folder each, with robot.yaml and the files of its move_base.

`load` reads an included robot by name, or a user's folder. The simulators, the policy's parameter
space, training and the launch file use the result. urdf_import/ makes a folder from a URDF and the
files of a navigation package. docs/tutorials/your_robot.md explains how to describe another robot.
"""

from __future__ import annotations

from applr_ros1.robots.folder import NAMES, RobotError, load
from applr_ros1.robots.robot import FILE, Robot

JACKAL = load("jackal")  # default robot

__all__ = ["FILE", "JACKAL", "NAMES", "Robot", "RobotError", "load"]
