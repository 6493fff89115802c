"""Starts RViz with this package's configuration, for the robot that is looked at.

The command rviz.py, which the launch files start, becomes RViz. The configuration is the Jackal's: the topics of
another robot's laser and local planner, and its frames, are written into a copy. Topics are relative, so that a robot's
namespace reaches them; frames do not follow a namespace and get its prefix.
"""

from __future__ import annotations

import argparse
import os
import sys
import tempfile
from typing import Any, Dict

import yaml

from applr_ros1.common.arguments import frame_prefix, without_remappings
from applr_ros1.robots import JACKAL, NAMES, Robot, load

from .record import become


def main() -> None:
    """The command. Returns only with an error."""
    import rospkg

    words = sys.argv[1:]
    parser = argparse.ArgumentParser(prog="rviz.py", description="Start RViz with the configuration of this package.")
    parser.add_argument("--robot", default=JACKAL.name, help=f"{', '.join(NAMES)}, or the folder of a description.")
    parser.add_argument("--prefix", default="none", help="Prefix of the robot's frames; none: they have none.")
    options = parser.parse_args(without_remappings(words))
    robot = load(options.robot)
    folder = os.path.join(rospkg.RosPack().get_path("applr_ros1"), "applr_ros1", "rviz")
    with open(os.path.join(folder, "applr.rviz"), encoding="utf-8") as file:
        chosen = configured(yaml.safe_load(file), robot, frame_prefix(options.prefix))
    with tempfile.NamedTemporaryFile("w", prefix="applr_", suffix=".rviz", delete=False, encoding="utf-8") as copy:
        yaml.safe_dump(chosen, copy, sort_keys=False)
    become("rviz", "rviz", ["-d", copy.name, *(word for word in words if ":=" in word)])


def configured(tree: Dict[str, Any], robot: Robot, prefix: str) -> Dict[str, Any]:
    """The Jackal's configuration of RViz, changed to a robot's scan, local planner, and frames with a prefix."""
    manager = tree["Visualization Manager"]
    manager["Global Options"]["Fixed Frame"] = prefix + robot.frames.odom
    manager["Views"]["Current"]["Target Frame"] = prefix + robot.frames.base
    for display in manager["Displays"]:
        if display["Class"] == "rviz/RobotModel":
            display["TF Prefix"] = prefix.strip("/")
        elif display["Class"] == "rviz/LaserScan":
            display["Topic"] = robot.topics.scan
        elif "Topic" in display:
            display["Topic"] = display["Topic"].replace(JACKAL.local_planner, robot.local_planner)
    return tree
