"""A robot's folder: `load` is the door, over `read`, which gives what its files hold and what is wrong with robot.yaml.

Included robots lie beside this file and are named after their folders.
"""

from __future__ import annotations

import atexit
import os
import sys
from contextlib import suppress
from dataclasses import replace
from functools import lru_cache
from math import nan
from typing import Any, Callable, Dict, Iterable, List, Set, Tuple, get_args

from pydantic import TypeAdapter, ValidationError
from typing_extensions import Annotated

from applr_ros1.common.errors import ApplrError, Finding
from applr_ros1.robots import check
from applr_ros1.robots.learned import default_space
from applr_ros1.robots.parameter_files import read_yaml
from applr_ros1.robots.robot import FILE, MoveBaseSection, Robot, RobotFile, Section

_HERE = os.path.dirname(os.path.abspath(__file__))
NAMES = tuple(sorted(name for name in os.listdir(_HERE) if os.path.isfile(os.path.join(_HERE, name, FILE))))
_told: Set[Finding] = set()


class RobotError(ApplrError):
    """One or more mistakes in a robot's description: `findings`. The error's own text is the first of them."""

    def __init__(self, findings: Iterable[Finding]):
        self.findings: Tuple[Finding, ...] = tuple(findings)
        super().__init__(self.findings)

    def __str__(self) -> str:
        more = len(self.findings) - 1
        return str(self.findings[0]) + (f" ({more} more: check_robot.py lists them)" if more else "")


def raise_(found: Iterable[Finding]) -> None:
    """Raise RobotError where there is an error among findings."""
    errors = [finding for finding in found if finding.severity == "error"]
    if errors:
        raise RobotError(errors)


def tell(found: Iterable[Finding]) -> None:
    """Do as `raise_`, and print all else on stderr, once in a process; warnings come again at its end."""
    raise_(found)
    new = [finding for finding in found if finding not in _told]
    _told.update(new)
    for finding in new:
        print(f"{finding.severity}: {finding}", file=sys.stderr)
    atexit.register(_repeat, [finding for finding in new if finding.severity == "warning"], os.getpid())


def _repeat(warnings: List[Finding], process: int) -> None:
    """Print warnings once more, at the end of what was printed since."""
    for finding in warnings if os.getpid() == process else ():
        print(f"warning: {finding}", file=sys.stderr)


def load(name_or_folder: str, on_problem: Callable[[List[Finding]], None] = raise_, with_map: bool = False) -> Robot:
    """Return the description of an included robot by name, or of the robot in a folder, which is checked.

    Args:
        name_or_folder: A name without a slash that is included means the included robot, for which nothing is checked.
        on_problem: Takes what there is to say about the folder: `raise_`, `tell`, or a list's extend, with which the
            robot is whole only as far as its files can be read.
        with_map: With its files for a map, instead of those without.

    Raises:
        RobotError: By `raise_` and `tell`, where it has errors: a finding for each value that is missing, unknown, out
            of bounds or contradicts another.
        ApplrError: There is no such robot, or robot.yaml cannot be read at all; one line.
    """
    robot, found = read(name_or_folder)
    on_problem(found if name_or_folder in NAMES else check.findings(robot, found, [with_map]))
    return robot


def on_ground(robot: Robot, ground: str) -> Robot:
    """Return the robot on another simulated ground (Simulation.ground); RobotError where it cannot stand on that."""
    changed = replace(robot, simulation=robot.simulation.model_copy(update={"ground": ground}))
    raise_(check.contradictions(changed))
    return changed


def read(name_or_folder: str) -> Tuple[Robot, List[Finding]]:
    """Read a robot as far as its files can be read, with a finding for each mistake in robot.yaml or unreadable file.

    What robot.yaml lacks or has wrong is nan or None, of which no rule has anything to say. Without a section move_base
    that can be read the robot has no parameter files. The result is kept. ApplrError where there is nothing to read.
    """
    name = str(name_or_folder)
    if name in NAMES:
        return _read(os.path.join(_HERE, name))
    folder = os.path.abspath(name) if name else ""
    if not os.path.isdir(folder):
        raise ApplrError(f"robot {name or repr(name)}: give {', '.join(NAMES)}, or a folder with {FILE}")
    return _read(folder)


@lru_cache(maxsize=32)
def _read(folder: str) -> Tuple[Robot, List[Finding]]:
    path = os.path.join(folder, FILE)
    content = read_yaml(path)
    found: List[Finding] = []
    try:
        given = dict(RobotFile.model_validate(content))
    except ValidationError as error:
        found = check.refused(RobotFile, error)
        given = _as_far_as_right(RobotFile, {name: value for name, value in content.items() if value is not None})
        given["move_base"] = given["move_base"] or MoveBaseSection()
    setup = given["move_base"].setup(folder)
    values = dict(given, name=os.path.basename(folder), folder=folder, move_base=setup)
    space = values.pop("parameter_space")
    robot = Robot(**values, space=tuple((space or {}).values()))
    if space is None and not found:
        robot = replace(robot, space=default_space(given["base"], given["body"], robot.parameters()))
    files = {file.problem: Finding(file.problem) for file in (*setup.without_map, *(setup.with_map or ()))}
    found += [finding for finding in check.contradictions(robot) if finding.key not in {f.key for f in found}]
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
    if isinstance(kind, type) and issubclass(kind, Section):
        return kind.model_construct(**_as_far_as_right(kind, given))
    if getattr(kind, "__origin__", None) is tuple:
        return () if ... in get_args(kind) else (nan,) * len(get_args(kind))
    return nan if kind in (float, int) else None
