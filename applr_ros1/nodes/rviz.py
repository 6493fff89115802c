"""Starts RViz with this package's configuration, for the frames of the robot that is looked at.

Called by scripts/rviz.py, which the launch files start; it becomes RViz. The topics in the configuration are relative,
so that a robot's namespace reaches them; frames do not follow a namespace and are written into a copy.
"""

from __future__ import annotations

import argparse
import os
import sys
import tempfile
from typing import Any, Dict, List

import yaml

from applr_ros1.common.arguments import without_remappings
from applr_ros1.common.errors import run_main

from .processes import become


def main() -> int:
    """The command. Returns only with an error."""
    return run_main(lambda: _start(sys.argv[1:]), "rviz")


def _start(words: List[str]) -> None:
    import rospkg

    parser = argparse.ArgumentParser(prog="rviz.py", description="Start RViz with the configuration of this package.")
    parser.add_argument(
        "--odom", default="auto", help="Frame of the odometry, in which everything is shown; auto: PREFIX/odom."
    )
    parser.add_argument(
        "--base", default="auto", help="Frame of the robot, which the view follows; auto: PREFIX/base_link."
    )
    parser.add_argument("--prefix", default="none", help="Prefix of the robot's other frames; none: they have none.")
    options = parser.parse_args(without_remappings(words))
    folder = os.path.join(rospkg.RosPack().get_path("applr_ros1"), "applr_ros1", "rviz")
    prefix = "" if options.prefix == "none" else options.prefix.strip("/")
    odom, base = (
        (prefix + "/" if prefix else "") + default if name == "auto" else name
        for name, default in ((options.odom, "odom"), (options.base, "base_link"))
    )
    with open(os.path.join(folder, "applr.rviz"), encoding="utf-8") as file:
        chosen = configured(yaml.safe_load(file), odom, base, prefix)
    with tempfile.NamedTemporaryFile("w", prefix="applr_", suffix=".rviz", delete=False, encoding="utf-8") as copy:
        yaml.safe_dump(chosen, copy, sort_keys=False)
    become("rviz", "rviz", ["-d", copy.name, *(word for word in words if ":=" in word)])


def configured(tree: Dict[str, Any], odom: str, base: str, prefix: str) -> Dict[str, Any]:
    """RViz's configuration for a robot with other frames.

    Args:
        tree: The configuration; it is changed.
        odom: Frame in which everything is shown.
        base: Frame that the view follows.
        prefix: Of the frames of the robot's parts, without a slash; may be empty.
    """
    manager = tree["Visualization Manager"]
    manager["Global Options"]["Fixed Frame"] = odom
    manager["Views"]["Current"]["Target Frame"] = base
    for display in manager["Displays"]:
        if display["Class"] == "rviz/RobotModel":
            display["TF Prefix"] = prefix
    return tree
