"""A robot's folder: `load` reads and checks it. Included robots lie beside this file, in folders of their names."""

from __future__ import annotations

import os
from dataclasses import replace
from functools import lru_cache
from typing import Iterable, Tuple

from pydantic import ValidationError

from applr_ros1.common.errors import ApplrError
from applr_ros1.robots import check
from applr_ros1.robots.learned import default_space
from applr_ros1.robots.parameter_files import read_yaml
from applr_ros1.robots.robot import FILE, Robot, RobotFile

_HERE = os.path.dirname(os.path.abspath(__file__))
NAMES = tuple(sorted(name for name in os.listdir(_HERE) if os.path.isfile(os.path.join(_HERE, name, FILE))))


class RobotError(ApplrError):
    """One or more mistakes in a robot's description: `lines`. The error's own text has the first of them."""

    def __init__(self, folder: str, lines: Iterable[str]):
        self.lines: Tuple[str, ...] = tuple(lines)
        more = len(self.lines) - 1
        listed = f" ({more} more: check_robot.py lists them)" if more else ""
        super().__init__(f"{folder}: {self.lines[0]}{listed}")


def load(name_or_folder: str, with_map: bool = False) -> Robot:
    """Return the description of an included robot by name, or of the robot in a folder, which is checked.

    Args:
        name_or_folder: A name without a slash that is included means the included robot, for which nothing is checked.
        with_map: Whether its files for a map are checked, instead of those without.

    Raises:
        RobotError: It has errors: a line for each.
        ApplrError: There is no such robot, or a file of it cannot be read; one line.
    """
    robot = read(name_or_folder)
    if name_or_folder in NAMES:
        return robot
    errors = check.check(robot, with_map)
    if errors:
        raise RobotError(robot.folder, errors)
    return robot


def read(name_or_folder: str) -> Robot:
    """Return a robot as its files describe it, without a check of how values fit together; errors as of `load`."""
    name = str(name_or_folder)
    if name in NAMES:
        return _read(os.path.join(_HERE, name))
    folder = os.path.abspath(name) if name else ""
    if not os.path.isdir(folder):
        raise ApplrError(f"robot {name or repr(name)}: give {', '.join(NAMES)}, or a folder with {FILE}")
    return _read(folder)


@lru_cache(maxsize=32)
def _read(folder: str) -> Robot:
    try:
        given = dict(RobotFile.model_validate(read_yaml(os.path.join(folder, FILE))))
    except ValidationError as error:
        raise RobotError(folder, check.refused(error)) from None
    space, move_base = given.pop("parameter_space"), given.pop("move_base").loaded(folder)
    name = os.path.basename(folder)
    robot = Robot(**given, name=name, folder=folder, space=tuple((space or {}).values()), move_base=move_base)
    if space is None:
        robot = replace(robot, space=default_space(robot.base, robot.body, robot.parameters()))
    return robot
