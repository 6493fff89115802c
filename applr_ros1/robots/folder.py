"""Reader of a robot's folder: `load` reads and checks it.

Folders of the included robots lie beside this file.
"""

from __future__ import annotations

import logging
import os
from functools import lru_cache
from typing import Any, Dict, Iterable, Tuple

from pydantic import BaseModel, ValidationError

from applr_ros1.common.errors import ApplrError
from applr_ros1.robots import check
from applr_ros1.robots.learned import default_space
from applr_ros1.robots.parameter_files import read_yaml
from applr_ros1.robots.robot import FILE, Robot, RobotFile

_LOGGER = logging.getLogger(__name__)
_HERE = os.path.dirname(os.path.abspath(__file__))
NAMES = tuple(
    sorted(name for name in os.listdir(_HERE) if os.path.isfile(os.path.join(_HERE, name, FILE)))
)


class RobotError(ApplrError):
    """Errors in a robot's description, one per item of `lines`. The message has the first error."""

    def __init__(self, folder: str, lines: Iterable[str]) -> None:
        self.lines: Tuple[str, ...] = tuple(lines)
        first_error, *other_errors = self.lines
        message = f"{folder}: {first_error}"
        if other_errors:
            message += f" ({len(other_errors)} more: ./applr check lists them)"
        super().__init__(message)


def load(name_or_folder: str, with_map: bool = False) -> Robot:
    """Return an included robot by name, or the checked robot of a folder.

    Args:
        name_or_folder: Name of an included robot, which is not checked again, or path of a folder.
        with_map: Whether the robot is to drive with its parameters for a map (Robot.on_map).

    Raises:
        RobotError: The description has errors, with one line each.
        ApplrError: There is no such robot, or one of its files cannot be read.
    """
    robot = read(name_or_folder)
    is_included = name_or_folder in NAMES
    # An included robot without files for a map may drive with a move_base that has others.
    if with_map and not (is_included and robot.move_base.with_map is None):
        robot = robot.on_map()
    # Tests check the included robots.
    if is_included:
        return robot
    errors = check.check(robot)
    if errors:
        raise RobotError(robot.folder, errors)
    return robot


def read(name_or_folder: str) -> Robot:
    """Return a robot as described by its files.

    Raise the errors of `load`, but do not check consistency.
    """
    name_or_folder = str(name_or_folder)
    if name_or_folder in NAMES:
        return _read(os.path.join(_HERE, name_or_folder))
    folder = os.path.abspath(name_or_folder)
    # Without a name, the path would be the current folder.
    if not (name_or_folder and os.path.isdir(folder)):
        choices = f"{', '.join(NAMES)}, or a folder with {FILE}"
        raise ApplrError(f"robot {name_or_folder or repr(name_or_folder)}: give {choices}")
    return _read(folder)


def forget() -> None:
    """Read every folder anew from now on, for a process in which files change."""
    _read.cache_clear()


@lru_cache(maxsize=32)
def _read(folder: str) -> Robot:
    """Return the robot in a folder, read once per process."""
    return described(read_yaml(os.path.join(folder, FILE)), os.path.basename(folder), folder)


def described(content: Dict[str, Any], name: str, folder: str) -> Robot:
    """Return the robot that the content of a robot.yaml describes.

    Args:
        content: What the file holds (RobotFile).
        name: Name of the robot.
        folder: Where its other files are, also if there is no such folder.

    Raises:
        RobotError: The content has errors.
    """
    try:
        fields = dict(RobotFile.model_validate(content))
    except ValidationError as error:
        raise RobotError(folder, check.refused(error)) from None
    move_base = fields.pop("move_base").loaded(folder)
    # Without a parameter_space, the robot has the learnable parameters of its planner.
    space = fields.pop("parameter_space")
    if space is None:
        space = default_space(fields["base"], fields["body"], move_base.without_map)
    else:
        space = tuple(space.values())
    _LOGGER.info("robot %s: %d parameters to set", folder, len(space))
    return Robot(**fields, name=name, folder=folder, space=space, move_base=move_base)


def content_of(robot: Robot) -> Dict[str, Any]:
    """Return the content of a robot.yaml of which `described` makes the robot, in plain values.

    The parameters of move_base that are in use stand in it, so that it needs no other file.
    """
    content: Dict[str, Any] = {}
    for section_name in RobotFile.model_fields:
        section = getattr(robot, section_name, None)
        if isinstance(section, BaseModel):
            content[section_name] = section.model_dump(mode="json")
    space = {}
    for parameter in robot.space:
        space[parameter.name] = parameter.model_dump(mode="json")
    content["world_scale"] = robot.world_scale
    content["parameter_space"] = space
    content["move_base"] = {"parameters": robot.parameters()}
    return content
