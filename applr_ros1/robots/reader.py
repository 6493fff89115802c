"""Finds a robot's folder, reads robot.yaml and checks every value: `load`.

Included robots lie beside this file and are named after their folders.
"""

from __future__ import annotations

import os
from contextlib import suppress
from dataclasses import replace
from functools import lru_cache
from math import nan
from typing import Any, Dict, List, Optional, Tuple, get_args

from pydantic import Field, TypeAdapter, ValidationError, model_validator
from typing_extensions import Annotated

from applr_ros1.common.errors import ApplrError, Finding
from applr_ros1.robots import description as sections
from applr_ros1.robots import mistakes
from applr_ros1.robots.default_space import default_space
from applr_ros1.robots.description import Robot
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
    parameter_space: Optional[Dict[sections.ParameterName, sections.SpaceParameter]] = Field(
        default=None, min_length=1, max_length=sections.MAX_PARAMETERS
    )

    @model_validator(mode="before")
    @classmethod
    def _named(cls, content: Any) -> Any:
        """Takes empty sections out, and gives each parameter of the space the name that is its key, its values too."""
        content = {name: value for name, value in content.items() if value is not None}
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
    robot, found = described(name_or_folder)
    mistakes.refuse(found)
    return robot


def described(name_or_folder: str) -> Tuple[Robot, List[Finding]]:
    """As `load`, with what is wrong: the robot as far as its files can be read, and a finding for each mistake.

    What robot.yaml lacks or has wrong is nan or None, of which no rule has anything to say. Without a section move_base
    that can be read the robot has no parameter files. ApplrError where there is nothing to read at all.
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
def _read(folder: str) -> Tuple[Robot, List[Finding]]:
    path = os.path.join(folder, FILE)
    content = read_yaml(path)
    found: List[Finding] = []
    try:
        given = dict(RobotFile.model_validate(content))
    except ValidationError as error:
        found = mistakes.of_schema(RobotFile, error)
        given = _as_far_as_right(RobotFile, {name: value for name, value in content.items() if value is not None})
        given["move_base"] = given["move_base"] or MoveBaseSection()
    setup = given["move_base"].setup(folder)
    values = dict(given, name=os.path.basename(folder), folder=folder, move_base=setup)
    space = values.pop("parameter_space")
    robot = Robot(**values, space=tuple((space or {}).values()))
    if space is None and not found:
        robot = replace(robot, space=default_space(given["base"], given["body"], robot.parameters()))
    files = {file.problem: Finding(file.problem) for file in (*setup.without_map, *(setup.with_map or ()))}
    found += [finding for finding in mistakes.contradictions(robot) if finding.key not in {f.key for f in found}]
    found = [finding._replace(file=path) for finding in found]
    return robot, found + [finding for problem, finding in files.items() if problem]


def _as_far_as_right(model: Any, content: Any) -> Dict[str, Any]:
    """The fields of a section, with stand-ins for those that are missing or wrong."""
    content = content if isinstance(content, dict) else {}
    return {name: _field(field, content.get(name, field.default)) for name, field in model.model_fields.items()}


def _field(field: Any, given: Any) -> Any:
    """A field's value; nan or None, in the form of the field, where the one that is given is wrong."""
    kind, bounded = field.annotation, Annotated[field.annotation, field]  # type: Any, Any
    with suppress(ValidationError):
        return TypeAdapter(bounded).validate_python(given)
    if isinstance(kind, type) and issubclass(kind, MoveBaseSection):
        return None
    if isinstance(kind, type) and issubclass(kind, sections.Section):
        return kind.model_construct(**_as_far_as_right(kind, given))
    if getattr(kind, "__origin__", None) is tuple:
        return () if ... in get_args(kind) else (nan,) * len(get_args(kind))
    return nan if kind in (float, int) else None
