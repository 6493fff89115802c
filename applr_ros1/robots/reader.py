"""Finds a robot's folder, reads robot.yaml and checks every value: `load`.

Shipped robots lie beside this file and are named after their folders.
"""

from __future__ import annotations

import os
from dataclasses import MISSING, fields
from functools import lru_cache
from typing import Any, Dict, Tuple

from applr_ros1.robots import description as sections
from applr_ros1.robots import limits, parameter_files, yaml_file
from applr_ros1.robots.description import Robot
from applr_ros1.robots.kinds import RobotError, real, shown
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
_OPTIONAL = ("topics", "odometry", "monitor")
_OTHERS = ("world_scale", "move_base", "parameter_space")


def load(name_or_folder: str) -> Robot:
    """The description of a shipped robot by name, or of the robot in a folder.

    A name without a slash that is shipped means the shipped robot. The result is kept, so that a second call for the
    same folder reads nothing.

    Raises:
        RobotError: There is no such robot, or its description cannot be used: one line with what is missing, unknown,
            out of bounds or contradicts the base.
    """
    name = str(name_or_folder)
    if name in NAMES:
        return _read(os.path.join(_HERE, name))
    folder = os.path.abspath(name) if name else ""
    if not os.path.isdir(folder):
        raise RobotError("robot %s: give %s, or a folder with %s" % (name or "''", ", ".join(NAMES), FILE))
    return _read(folder)


@lru_cache(maxsize=32)
def _read(folder: str) -> Robot:
    path = os.path.join(folder, FILE)
    given = yaml_file.read(path)
    name = os.path.basename(folder)
    try:
        return _robot(name, folder, given)
    except RobotError as error:
        raise RobotError("%s: %s" % (path, error)) if not str(error).startswith(folder) else error from None


def _robot(name: str, folder: str, given: Dict[str, Any]) -> Robot:
    known = tuple(_SECTIONS) + _OTHERS
    for key in given:
        if key not in known:
            raise RobotError("%s is unknown: there are %s" % (key, ", ".join(known)))
    for key in known:
        if key not in given and key not in _OPTIONAL:
            raise RobotError("%s is missing: give it" % key)
    made = {key: _section(kind, given.get(key, {}), key) for key, kind in _SECTIONS.items()}
    scale = real(0.05, 20.0).metadata["take"](given["world_scale"], "world_scale")
    setup = parameter_files.setup(given["move_base"], folder, "move_base")
    robot = Robot(
        name=name,
        folder=folder,
        world_scale=scale,
        space=space(given["parameter_space"], "parameter_space"),
        move_base=setup,
        **made,
    )
    limits.check(robot)
    return robot


def _section(kind: Any, given: Any, label: str) -> Any:
    """One of the dataclasses of description.py from a mapping."""
    if not isinstance(given, dict):
        raise RobotError("%s is %s: give a mapping of names and values" % (label, shown(given)))
    known: Tuple[str, ...] = tuple(f.name for f in fields(kind))
    for key in given:
        if key not in known:
            raise RobotError("%s.%s is unknown: there are %s" % (label, key, ", ".join(known)))
    values = {}
    for f in fields(kind):
        if f.name in given:
            values[f.name] = f.metadata["take"](given[f.name], "%s.%s" % (label, f.name))
        elif f.default is MISSING:
            raise RobotError("%s.%s is missing: give it" % (label, f.name))
    return kind(**values)
