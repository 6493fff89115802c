"""Reads the section parameter_space of robot.yaml: which values of move_base a policy or a search sets, and how far.

reader.py calls `space`.
"""

from __future__ import annotations

import re
from typing import Any, Tuple

from applr_ros1.robots.description import Setting, SpaceParameter
from applr_ros1.robots.kinds import ROS_NAME, RobotError, real, shown

MAX_PARAMETERS = 64
_NAME = re.compile(r"[A-Za-z]\w*", re.ASCII)
_KEYS = ("range", "integer", "sets")
_SET_KEYS = ("server", "name", "aliases", "mirrored")
_number = real(-1e6, 1e6).metadata["take"]


def space(section: Any, label: str) -> Tuple[SpaceParameter, ...]:
    """The parameters in the order of the file.

    section: {NAME: {range: [low, high], integer: BOOL, sets: [{server, name, aliases, mirrored}, ...]}, ...}; without
    a name a setting has that of the parameter; the server "" is move_base itself.
    """
    if not isinstance(section, dict) or not 1 <= len(section) <= MAX_PARAMETERS:
        raise RobotError("%s is %s: give one to %d parameters by name" % (label, shown(section), MAX_PARAMETERS))
    return tuple(_parameter(name, given, "%s.%s" % (label, name)) for name, given in section.items())


def _parameter(name, given, label):
    if not isinstance(name, str) or not _NAME.fullmatch(name):
        raise RobotError("%s: a parameter's name has letters, digits and _ only" % label)
    _known(given, _KEYS, label)
    bounds = given.get("range")
    if not isinstance(bounds, list) or len(bounds) != 2:
        raise RobotError("%s.range is %s: give [smallest, largest]" % (label, shown(bounds)))
    low, high = (_number(value, label + ".range") for value in bounds)
    if not low < high:
        raise RobotError("%s.range is [%g, %g]: give a smaller number and a larger one" % (label, low, high))
    integer = _flag(given.get("integer", False), label + ".integer")
    if integer and not (low.is_integer() and high.is_integer()):
        raise RobotError("%s.range is [%g, %g]: give whole numbers for an integer" % (label, low, high))
    sets = given.get("sets")
    if not isinstance(sets, list) or not 1 <= len(sets) <= 16:
        raise RobotError("%s.sets is %s: give a list of {server: SERVER, name: NAME}" % (label, shown(sets)))
    settings = tuple(_setting(entry, name, "%s.sets[%d]" % (label, i)) for i, entry in enumerate(sets))
    if settings[0].mirrored:
        raise RobotError("%s.sets[0] is mirrored: give the value that has the parameter's own sign first" % label)
    return SpaceParameter(name, low, high, integer, settings)


def _setting(given, name, label):
    _known(given, _SET_KEYS, label)
    server = given.get("server")
    aliases = given.get("aliases", [])
    names = [given.get("name", name)] + (aliases if isinstance(aliases, list) else [aliases])
    for key, value in [("server", server)] + [("name", value) for value in names]:
        if key == "server" and value == "":  # move_base itself
            continue
        if not isinstance(value, str) or not ROS_NAME.fullmatch(value) or value.startswith("/"):
            raise RobotError("%s.%s is %s: give a name of move_base's" % (label, key, shown(value)))
    return Setting(server, tuple(names), _flag(given.get("mirrored", False), label + ".mirrored"))


def _flag(value, label):
    if not isinstance(value, bool):
        raise RobotError("%s is %s: give true or false" % (label, shown(value)))
    return value


def _known(given, keys, label):
    if not isinstance(given, dict):
        raise RobotError("%s is %s: give a mapping of %s" % (label, shown(given), ", ".join(keys)))
    for key in given:
        if key not in keys:
            raise RobotError("%s.%s is unknown: there are %s" % (label, key, ", ".join(keys)))
