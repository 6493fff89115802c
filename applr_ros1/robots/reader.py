"""Finds a robot's folder, reads robot.yaml and checks every value: `load`.

Shipped robots lie beside this file and are named after their folders.
"""

from __future__ import annotations

import os
from dataclasses import MISSING, fields, replace
from functools import lru_cache
from typing import Any, Dict

from applr_ros1.common.errors import ApplrError
from applr_ros1.robots import description as sections
from applr_ros1.robots import limits, parameter_files, yaml_file
from applr_ros1.robots.default_space import default_space
from applr_ros1.robots.description import Robot
from applr_ros1.robots.field_types import mapping, number
from applr_ros1.robots.space_section import space

FILE = "robot.yaml"
_HERE = os.path.dirname(os.path.abspath(__file__))
NAMES = tuple(sorted(name for name in os.listdir(_HERE) if os.path.isfile(os.path.join(_HERE, name, FILE))))
_SECTIONS = {
    "base": sections.Base,
    "body": sections.Body,
    "laser": sections.Laser,
    "topics": sections.Topics,
    "frames": sections.Frames,
    "odometry": sections.OdometryErrors,
    "monitor": sections.Monitoring,
    "simulation": sections.Simulation,
}
_OPTIONAL = ("topics", "odometry", "monitor", "parameter_space")
_OTHERS = ("world_scale", "move_base", "parameter_space")


def load(name_or_folder: str) -> Robot:
    """The description of a shipped robot by name, or of the robot in a folder.

    A name without a slash that is shipped means the shipped robot. The result is kept, so that a second call for the
    same folder reads nothing.

    Raises:
        ApplrError: There is no such robot, or its description cannot be used: one line with what is missing, unknown,
            out of bounds or contradicts the base.
    """
    name = str(name_or_folder)
    if name in NAMES:
        return _read(os.path.join(_HERE, name))
    folder = os.path.abspath(name) if name else ""
    if not os.path.isdir(folder):
        raise ApplrError(f"robot {name or repr(name)}: give {', '.join(NAMES)}, or a folder with {FILE}")
    return _read(folder)


def on_ground(robot: Robot, ground: str) -> Robot:
    """The robot on another simulated ground (Simulation.ground); ApplrError where it cannot stand on that."""
    changed = replace(robot, simulation=replace(robot.simulation, ground=ground))
    limits.check(changed)
    return changed


@lru_cache(maxsize=32)
def _read(folder: str) -> Robot:
    path = os.path.join(folder, FILE)
    given = yaml_file.read(path)
    try:
        return _robot(folder, given)
    except ApplrError as error:
        raise ApplrError(str(error) if str(error).startswith(folder) else f"{path}: {error}") from None


def _robot(folder: str, given: Dict[str, Any]) -> Robot:
    mapping(given, "", (*_SECTIONS, *_OTHERS))
    for key in (*_SECTIONS, *_OTHERS):
        if key not in given and key not in _OPTIONAL:
            raise ApplrError(f"{key} is missing: give it")
    parts = {key: _section(kind, given.get(key, {}), key) for key, kind in _SECTIONS.items()}
    setup = parameter_files.setup(given["move_base"], folder, "move_base")
    stated = given.get("parameter_space")
    robot = Robot(
        name=os.path.basename(folder),
        folder=folder,
        world_scale=number(0.05, 20.0)(given["world_scale"], "world_scale"),
        space=default_space(parts["base"], parts["body"], setup.without_map)
        if stated is None
        else space(stated, "parameter_space"),
        move_base=setup,
        **parts,
    )
    limits.check(robot)
    return robot


def _section(kind: Any, given: Any, label: str) -> Any:
    """One of the dataclasses of description.py from a mapping."""
    mapping(given, label, [f.name for f in fields(kind)])
    values = {}
    for f in fields(kind):
        if f.name in given:
            values[f.name] = f.metadata["take"](given[f.name], f"{label}.{f.name}")
        elif f.default is MISSING:
            raise ApplrError(f"{label}.{f.name} is missing: give it")
    return kind(**values)
