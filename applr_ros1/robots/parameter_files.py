"""The section move_base of robot.yaml: joins parameter files as the robot's launch file loads them into one tree.

reader.py reads it and calls `setup`.
"""

from __future__ import annotations

import os
from typing import Any, Dict, Optional, Tuple

from pydantic import Field, model_validator
from typing_extensions import Annotated

from applr_ros1.common.trees import merged
from applr_ros1.robots import yaml_file
from applr_ros1.robots.description import LoadedFile, MoveBaseSetup
from applr_ros1.robots.field_types import PATH, Section

FILE = "robot.yaml"


class ParameterFile(Section):
    """A file in the robot's folder, and the namespace below which its parameters stand."""

    file: str
    namespace: Annotated[str, Field(pattern=f"^(/?{PATH})?$")] = ""

    @model_validator(mode="after")
    def _is_in_the_folder(self) -> ParameterFile:
        if os.path.isabs(self.file) or ".." in self.file.split("/"):
            raise ValueError(f"file is {self.file}: give the name of a file in the robot's folder")
        return self


class FileGroup(Section):
    """Files in the order in which they are loaded, and parameters that come after them; later values count."""

    files: Tuple[ParameterFile, ...] = ()
    parameters: Dict[str, Any] = {}


class MoveBaseSection(FileGroup):
    """What is always loaded, and what is loaded after it with and without a map."""

    with_map: Optional[FileGroup] = None
    without_map: FileGroup = FileGroup()


def setup(given: MoveBaseSection, folder: str) -> MoveBaseSetup:
    """The trees that the section describes, with the files in `folder`."""
    always = _loaded(given, folder)
    without_map = always + _loaded(given.without_map, folder)
    if given.with_map is None:
        return MoveBaseSetup(None, _tree(without_map), (), without_map)
    with_map = always + _loaded(given.with_map, folder)
    return MoveBaseSetup(_tree(with_map), _tree(without_map), with_map, without_map)


def _loaded(group: FileGroup, folder: str) -> Tuple[LoadedFile, ...]:
    trees = [yaml_file.read_parameters(os.path.join(folder, one.file)) for one in group.files]
    files = (LoadedFile(one.file, one.namespace, tree) for one, tree in zip(group.files, trees))
    return (*files, LoadedFile(FILE, "", group.parameters))


def _tree(files: Tuple[LoadedFile, ...]) -> Dict[str, Any]:
    joined: Dict[str, Any] = {}
    for file in files:
        tree = file.values
        for part in reversed(list(filter(None, file.namespace.split("/")))):
            tree = {part: tree}
        joined = merged(joined, tree)
    return joined
