"""Joins a robot's move_base parameter files as its launch file loads them into one nested tree.

reader.py calls `setup` with the section move_base of robot.yaml.
"""

from __future__ import annotations

import os
from typing import Any, Dict

from applr_ros1.common.errors import ApplrError
from applr_ros1.common.trees import merged
from applr_ros1.robots import yaml_file
from applr_ros1.robots.description import MoveBaseSetup
from applr_ros1.robots.field_types import ROS_NAME, mapping, shown

_GROUP = ("files", "parameters")
_FILE = ("file", "namespace")


def setup(section: Any, folder: str, label: str) -> MoveBaseSetup:
    """The trees that the section move_base of robot.yaml describes.

    section: {files: [{file, namespace}, ...], parameters: {...}, with_map: {files, parameters}, without_map: {...}}.
    Files are read in their order below their namespaces, later values replace earlier ones; parameters come after the
    files.
    """
    groups = mapping(section, label, _GROUP + ("with_map", "without_map"))
    with_map = None
    if "with_map" in groups:
        with_map = _load([(groups, label), (groups["with_map"], label + ".with_map")], folder)
    without_map = _load([(groups, label), (groups.get("without_map", {}), label + ".without_map")], folder)
    return MoveBaseSetup(with_map, without_map)


def _load(groups, folder: str) -> Dict[str, Any]:
    tree: Dict[str, Any] = {}
    for group, label in groups:
        known = mapping(group, label, _GROUP + ("with_map", "without_map"))
        files = known.get("files", [])
        if not isinstance(files, list):
            raise ApplrError(f"{label}.files is {shown(files)}: give a list of {{file: NAME.yaml}}")
        for i, entry in enumerate(files):
            tree = merged(tree, _file(entry, folder, f"{label}.files[{i}]"))
        tree = merged(tree, mapping(known.get("parameters", {}), label + ".parameters"))
    return tree


def _file(entry: Any, folder: str, label: str) -> Dict[str, Any]:
    """The content of a file below its namespace."""
    entry = mapping(entry, label, _FILE)
    name, namespace = entry.get("file"), entry.get("namespace", "")
    if not isinstance(name, str) or os.path.isabs(name) or ".." in name.split("/"):
        raise ApplrError(f"{label}.file is {shown(name)}: give the name of a file in the robot's folder")
    if namespace and not (isinstance(namespace, str) and ROS_NAME.fullmatch(namespace)):
        raise ApplrError(f"{label}.namespace is {shown(namespace)}: give a name such as local_costmap")
    tree = yaml_file.read(os.path.join(folder, name))
    for part in reversed(list(filter(None, namespace.split("/")))):
        tree = {part: tree}
    return tree
