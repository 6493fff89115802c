"""Finds a robot's folder, reads robot.yaml and checks every value: `load`.

Included robots lie beside this file and are named after their folders.
"""

from __future__ import annotations

import os
from dataclasses import replace
from functools import lru_cache
from typing import Any, Dict, Optional

from pydantic import Field, ValidationError, model_validator
from typing_extensions import Literal

from applr_ros1.common.errors import ApplrError
from applr_ros1.robots import description as sections
from applr_ros1.robots import mistakes
from applr_ros1.robots.default_space import default_space
from applr_ros1.robots.description import Robot
from applr_ros1.robots.mistakes import RobotError
from applr_ros1.robots.parameter_files import FILE, MoveBaseSection, read_yaml

_HERE = os.path.dirname(os.path.abspath(__file__))
NAMES = tuple(sorted(name for name in os.listdir(_HERE) if os.path.isfile(os.path.join(_HERE, name, FILE))))


class RobotFile(sections.Section):
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
    world_scale: float = sections.real("", 0.05, 20.0, "size of its worlds beside the Jackal's")
    method: Literal["applr", "dwa", "static"] = "applr"
    parameter_space: Optional[Dict[sections.ParameterName, sections.SpaceParameter]] = Field(
        default=None, min_length=1, max_length=sections.MAX_PARAMETERS
    )

    @model_validator(mode="before")
    @classmethod
    def _named(cls, content: Any) -> Any:
        """Gives each parameter of the space the name that is its key, and its values that name where they have none."""
        space = content.get("parameter_space")
        if not isinstance(space, dict):
            return content
        named = {name: dict(given, name=name) if isinstance(given, dict) else given for name, given in space.items()}
        for name, given in named.items():
            if isinstance(given, dict) and isinstance(given.get("sets"), list):
                given["sets"] = [{"name": name, **one} if isinstance(one, dict) else one for one in given["sets"]]
        return dict(content, parameter_space=named)


def load(name_or_folder: str) -> Robot:
    """The description of an included robot by name, or of the robot in a folder.

    A name without a slash that is included means the included robot. The result is kept, so that a second call for the
    same folder reads nothing.

    Raises:
        RobotError: Its description cannot be used: a finding for each value that is missing, unknown, out of bounds or
            contradicts another.
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
    mistakes.refuse(mistakes.contradictions(changed))
    return changed


@lru_cache(maxsize=32)
def _read(folder: str) -> Robot:
    path = os.path.join(folder, FILE)
    content = read_yaml(path)
    try:
        given = RobotFile.model_validate(content)
    except ValidationError as error:
        raise RobotError(finding._replace(file=path) for finding in mistakes.of_schema(RobotFile, error)) from None
    values = dict(given, name=os.path.basename(folder), folder=folder, move_base=given.move_base.setup(folder))
    space = values.pop("parameter_space")
    robot = Robot(**values, space=tuple((space or {}).values()))
    if space is None:
        robot = replace(robot, space=default_space(given.base, given.body, robot.parameters()))
    mistakes.refuse(mistakes.contradictions(robot), path)
    return robot
