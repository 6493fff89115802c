"""Descriptions of robots: one folder per robot with robot.yaml and the parameter files of its move_base.

`load` reads a shipped robot by name, or a folder of one's own. The simulators, the policy's parameter space, training
and the launch file take what it returns. docs/tutorials/your_robot.md says how to describe another robot.
"""

from __future__ import annotations

from applr_ros1.robots.description import GROUNDS, Robot
from applr_ros1.robots.mistakes import RobotError
from applr_ros1.robots.reader import NAMES, load, on_ground

JACKAL = load("jackal")  # the robot where none is named

__all__ = ["GROUNDS", "JACKAL", "NAMES", "Robot", "RobotError", "load", "on_ground"]
