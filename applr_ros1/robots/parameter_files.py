"""Joins a robot's move_base parameter files as its launch file loads them into one nested tree.

reader.py calls `setup` with the section move_base of robot.yaml.
"""

from __future__ import annotations

import os
from typing import Any, Dict, List

from applr_ros1.robots import yaml_file
from applr_ros1.robots.description import MoveBaseSetup
from applr_ros1.robots.kinds import ROS_NAME, RobotError, shown

_GROUP = ("files", "parameters")
_FILE = ("file", "namespace")


def setup(section: Any, folder: str, label: str) -> MoveBaseSetup:
    """The trees that the section move_base of robot.yaml describes.

    section: {files: [{file, namespace}, ...], parameters: {...}, with_map: {files, parameters}, without_map: {...}}.
    Files are read in their order below their namespaces, later values replace earlier ones; parameters come after the
    files.
    """
    groups = _mapping(section, label, _GROUP + ("with_map", "without_map"))
    with_map = None
    if "with_map" in groups:
        with_map = _load([(groups, label), (groups["with_map"], label + ".with_map")], folder)
    without_map = _load([(groups, label), (groups.get("without_map", {}), label + ".without_map")], folder)
    return MoveBaseSetup(with_map, without_map)


def _load(groups, folder: str) -> Dict[str, Any]:
    tree: Dict[str, Any] = {}
    for group, label in groups:
        known = _mapping(group, label, _GROUP + ("with_map", "without_map"))
        files = known.get("files", [])
        if not isinstance(files, list):
            raise RobotError("%s.files is %s: give a list of {file: NAME.yaml}" % (label, shown(files)))
        for i, entry in enumerate(files):
            _load_file(tree, entry, folder, "%s.files[%d]" % (label, i))
        _merge(tree, _mapping(known.get("parameters", {}), label + ".parameters"))
    return tree


def _load_file(tree, entry, folder, label):
    entry = _mapping(entry, label, _FILE)
    name, namespace = entry.get("file"), entry.get("namespace", "")
    if not isinstance(name, str) or os.path.isabs(name) or ".." in name.split("/"):
        raise RobotError("%s.file is %s: give the name of a file in the robot's folder" % (label, shown(name)))
    if namespace and not (isinstance(namespace, str) and ROS_NAME.fullmatch(namespace)):
        raise RobotError("%s.namespace is %s: give a name such as local_costmap" % (label, shown(namespace)))
    here = tree
    for part in filter(None, namespace.split("/")):
        if here.get(part) is None:  # an empty section
            here[part] = {}
        here = here[part]
        if not isinstance(here, dict):
            raise RobotError(
                "%s.namespace is %s: %s is %s in the files before, give a mapping there"
                % (label, namespace, part, shown(here))
            )
    _merge(here, yaml_file.read(os.path.join(folder, name)))


def _merge(tree: Dict[str, Any], more: Dict[str, Any]) -> None:
    for name, value in more.items():
        if isinstance(value, dict) and isinstance(tree.get(name), dict):
            _merge(tree[name], value)
        elif value is not None or not isinstance(tree.get(name), dict):  # an empty section takes nothing away
            tree[str(name)] = value if not isinstance(value, dict) else _copied(value)


def _copied(value: Dict[str, Any]) -> Dict[str, Any]:
    new: Dict[str, Any] = {}
    _merge(new, value)
    return new


def _mapping(value: Any, label: str, known: Any = ()) -> Dict[str, Any]:
    """`value` if it is a mapping of the known names (any without), else RobotError."""
    if not isinstance(value, dict):
        raise RobotError("%s is %s: give a mapping of names and values" % (label, shown(value)))
    unknown: List[str] = [str(name) for name in value if known and name not in known]
    if unknown:
        raise RobotError("%s has no %s: there are %s" % (label, unknown[0], ", ".join(known)))
    return value
