"""A parameter set as files: JSON for this package's methods, YAML for any move_base. tune_robot.py writes it."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Mapping

import yaml

from applr_ros1.common.files import write_bytes, write_json
from applr_ros1.robots import Robot
from applr_ros1.robots.learned import TRAJECTORY
from training.evaluation.loaded import move_base_parameters

HEAD = """# Parameters of move_base for {robot}, to be loaded after its own files:
#   <rosparam file="{file}" command="load" ns="move_base"/>
# Its distance biases count {unit}.
"""
UNITS = {
    TRAJECTORY: "cells, as the C++ planner does unless it was unlucky at its start\n# (docs/howto/cpp_move_base.md)",
    "DWAPlannerROS": "metres, as the C++ planner does",
}


def write(robot: Robot, values: Mapping[str, Any], as_json: Path, as_yaml: Path) -> None:
    """Writes {name: value} of a set as both files; last the JSON, with which a later search begins."""
    head = HEAD.format(robot=robot.name, file=as_yaml.name, unit=UNITS[robot.local_planner])
    write_bytes(as_yaml, (head + yaml.safe_dump(move_base_parameters(robot, values))).encode())
    write_json(as_json, {"meter_scoring": False, "parameters": dict(values)})
