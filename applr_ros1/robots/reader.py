"""Finds a robot's folder, reads robot.yaml and checks every value: `load`.

Shipped robots lie beside this file and are named after their folders.
"""

from __future__ import annotations

import os
from dataclasses import replace
from functools import lru_cache
from typing import Dict, Optional

from pydantic import Field, ValidationError
from typing_extensions import Literal

from applr_ros1.common.errors import ApplrError
from applr_ros1.robots import description as sections
from applr_ros1.robots import limits, parameter_files, yaml_file
from applr_ros1.robots.default_space import default_space
from applr_ros1.robots.description import Robot
from applr_ros1.robots.field_types import Section, real
from applr_ros1.robots.parameter_files import FILE, MoveBaseSection
from applr_ros1.robots.problems import RobotError, lines_of, refuse
from applr_ros1.robots.space_section import MAX_PARAMETERS, ParameterName, SpaceEntry, space

_HERE = os.path.dirname(os.path.abspath(__file__))
NAMES = tuple(sorted(name for name in os.listdir(_HERE) if os.path.isfile(os.path.join(_HERE, name, FILE))))


class RobotFile(Section):
    """The content of robot.yaml."""

    base: sections.Base
    body: sections.Body
    laser: sections.Laser
    frames: sections.Frames
    simulation: sections.Simulation
    move_base: MoveBaseSection
    topics: sections.Topics = sections.Topics()
    odometry: sections.OdometryErrors = sections.OdometryErrors()
    monitor: sections.Monitoring = sections.Monitoring()
    world_scale: float = real("", 0.05, 20.0)
    method: Literal["applr", "dwa", "static"] = "applr"
    parameter_space: Optional[Dict[ParameterName, SpaceEntry]] = Field(
        default=None, min_length=1, max_length=MAX_PARAMETERS
    )


def load(name_or_folder: str) -> Robot:
    """The description of a shipped robot by name, or of the robot in a folder.

    A name without a slash that is shipped means the shipped robot. The result is kept, so that a second call for the
    same folder reads nothing.

    Raises:
        RobotError: Its description cannot be used: a line for each value that is missing, unknown, out of bounds or
            contradicts the base.
        ApplrError: There is no such robot, or a file cannot be read; one line.
    """
    name = str(name_or_folder)
    if name in NAMES:
        return _read(os.path.join(_HERE, name))
    folder = os.path.abspath(name) if name else ""
    if not os.path.isdir(folder):
        raise ApplrError(f"robot {name or repr(name)}: give {', '.join(NAMES)}, or a folder with {FILE}")
    return _read(folder)


def on_ground(robot: Robot, ground: str) -> Robot:
    """The robot on another simulated ground (Simulation.ground); RobotError where it cannot stand on that."""
    changed = replace(robot, simulation=robot.simulation.model_copy(update={"ground": ground}))
    refuse(limits.problems(changed))
    return changed


@lru_cache(maxsize=32)
def _read(folder: str) -> Robot:
    path = os.path.join(folder, FILE)
    content = yaml_file.read_yaml(path)
    try:
        given = RobotFile.model_validate(content)
    except ValidationError as error:
        raise RobotError(f"{path}: {line}" for line in lines_of(RobotFile, error)) from None
    values = dict(given, name=os.path.basename(folder), folder=folder)
    stated, setup = values.pop("parameter_space"), parameter_files.setup(given.move_base, folder)
    chosen = default_space(given.base, given.body, setup.without_map) if stated is None else space(stated)
    robot = Robot(**dict(values, move_base=setup, space=chosen))
    refuse(f"{path}: {line}" for line in limits.problems(robot))
    return robot
