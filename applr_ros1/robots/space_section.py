"""Reads the section parameter_space of robot.yaml: which values of move_base a policy or a search sets, and how far.

reader.py calls `space`.
"""

from __future__ import annotations

import re
from typing import Any, Tuple

from applr_ros1.common.errors import ApplrError
from applr_ros1.robots.description import Setting, SpaceParameter
from applr_ros1.robots.field_types import ROS_NAME, mapping, number, shown

MAX_PARAMETERS = 64
_NAME = re.compile(r"[A-Za-z]\w*", re.ASCII)


def space(section: Any, label: str) -> Tuple[SpaceParameter, ...]:
    """The parameters in the order of the file.

    section: {NAME: {range: [low, high], integer: BOOL, sets: [{server, name, aliases, negated}, ...]}, ...}; without
    a name a setting has that of the parameter; the server "" is move_base itself.
    """
    if not 1 <= len(mapping(section, label)) <= MAX_PARAMETERS:
        raise ApplrError(f"{label} names {len(section)} parameters: give one to {MAX_PARAMETERS}")
    return tuple(_parameter(name, given, f"{label}.{name}") for name, given in section.items())


def _parameter(name: Any, given: Any, label: str) -> SpaceParameter:
    if not isinstance(name, str) or not _NAME.fullmatch(name):
        raise ApplrError(f"{label}: a parameter's name has letters, digits and _ only")
    given = mapping(given, label, ("range", "integer", "sets"))
    bounds = given.get("range")
    if not isinstance(bounds, list) or len(bounds) != 2:
        raise ApplrError(f"{label}.range is {shown(bounds)}: give [smallest, largest]")
    low, high = (number(-1e6, 1e6)(value, label + ".range") for value in bounds)
    if not low < high:
        raise ApplrError(f"{label}.range is [{low:g}, {high:g}]: give a smaller number and a larger one")
    integer = _flag(given, "integer", label)
    if integer and not (low.is_integer() and high.is_integer()):
        raise ApplrError(f"{label}.range is [{low:g}, {high:g}]: give whole numbers for an integer")
    sets = given.get("sets")
    if not isinstance(sets, list) or not sets:
        raise ApplrError(f"{label}.sets is {shown(sets)}: give a list of {{server: SERVER, name: NAME}}")
    settings = tuple(_setting(entry, name, f"{label}.sets[{i}]") for i, entry in enumerate(sets))
    if settings[0].negated:
        raise ApplrError(f"{label}.sets[0] is negated: give the value that has the parameter's own sign first")
    return SpaceParameter(name, low, high, integer, settings)


def _setting(given: Any, name: str, label: str) -> Setting:
    given = mapping(given, label, ("server", "name", "aliases", "negated"))
    server, aliases = given.get("server"), given.get("aliases", [])
    names = [given.get("name", name), *(aliases if isinstance(aliases, list) else [aliases])]
    for value in names + [server] * (server != ""):  # "": move_base itself
        if not isinstance(value, str) or not ROS_NAME.fullmatch(value) or value.startswith("/"):
            raise ApplrError(f"{label} has the name {shown(value)}: give server and name as move_base has them")
    return Setting(server, tuple(names), _flag(given, "negated", label))


def _flag(given: Any, key: str, label: str) -> bool:
    value = given.get(key, False)
    if not isinstance(value, bool):
        raise ApplrError(f"{label}.{key} is {shown(value)}: give true or false")
    return value
