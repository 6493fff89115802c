"""Writes a parameter set into copies of a robot's own move_base files, ready for its navigation package.

static_search.py calls it. Only the values change: comments, order and names stay as the robot's maker has them.
"""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any, Dict, Iterator, List, Optional, Tuple

import numpy as np
import yaml

from applr_ros1.common.files import write_bytes
from applr_ros1.common.trees import branch
from applr_ros1.policy.parameter_space import Space, space_of
from applr_ros1.robots import Robot, parameter_files, yaml_file
from applr_ros1.robots.description import find
from training.common.folders import make_folder

DESCRIPTION = "robot.yaml"
Path_ = Tuple[str, ...]
Place = Tuple[Path_, Path_]  # of a part of a file: where it stands in the file, and where its values go in move_base
Edit = Tuple[int, int, str]  # from, to, the new text


def write(robot: Robot, theta: np.ndarray, folder) -> List[str]:
    """Copies of robot.yaml and of the files that it names, with the set in them.

    Args:
        robot: The robot.
        theta: (n,) the set, in the robot's parameter space.
        folder: Where FOLDER/NAME is written, NAME the robot's: a description of the robot that starts with the set.

    Returns:
        The parameters for which no file has a place, to be entered by hand; none as a rule.

    Raises:
        RobotError, StorageError: A file cannot be read or written.
    """
    space, into = space_of(robot), Path(folder) / robot.name
    texts = {name: Path(robot.folder, name).read_text() for name in _places(robot)}
    for server, values in space.requests(theta).items():
        for name, value in values.items():
            names = next(t.names for _, t in space.targets_of(server) if t.names[0] == name)
            _enter(texts, robot, server, names, _text(value))
    for name, text in texts.items():
        make_folder((into / name).parent)
        write_bytes(into / name, text.encode())
    return _missing(robot, space, theta, into)


def _places(robot: Robot) -> Dict[str, List[Place]]:
    """{file: places in it} of all that the description loads, in the order in which it loads them."""
    found: Dict[str, List[Place]] = {DESCRIPTION: []}
    setup = yaml_file.read(os.path.join(robot.folder, DESCRIPTION))["move_base"]
    for keys in ((), ("with_map",), ("without_map",)):
        group = branch(setup, keys[0]) if keys else setup
        for entry in group.get("files", []):
            namespace = tuple(filter(None, entry.get("namespace", "").split("/")))
            found.setdefault(entry["file"], []).append(((), namespace))
        if "parameters" in group:
            found[DESCRIPTION].append((("move_base", *keys, "parameters"), ()))
    return found


def _enter(texts: Dict[str, str], robot: Robot, server: str, names: Path_, value: str) -> None:
    """Replaces a server's value in every file that has it, else enters it where the server's other values stand."""
    homes = [tuple(filter(None, server.split("/")))]
    if len(homes[0]) == 2 and "plugins" not in branch(robot.parameters(), homes[0][0]):
        homes.append(homes[0][:1])  # as before ROS hydro: a layer's values stand beside those of its costmap
    places = _places(robot)
    entered = False
    for file, text in texts.items():
        edits = {_replaced(node, value) for node in _nodes(text, places[file], homes, names) if node is not None}
        texts[file] = _edited(text, edits)
        entered |= bool(edits)
    for file, text in texts.items() if not entered else ():
        mappings = [m for m in _nodes(text, places[file], homes, ("",)) if isinstance(m, yaml.MappingNode) and m.value]
        if mappings:
            texts[file] = _edited(text, {_added(mappings[0], names[0], value)})
            return


def _nodes(text: str, places: List[Place], homes: List[Path_], names: Path_) -> Iterator[Optional[yaml.Node]]:
    """The nodes of a file at home + name, for every place, home and name; the home's own mapping for the name ""."""
    root = yaml.compose(text, yaml.SafeLoader)
    for prefix, namespace in places:
        for home in homes:
            if home[: len(namespace)] == namespace:
                for name in names:
                    yield _at(root, prefix + home[len(namespace) :] + ((name,) if name else ()))


def _at(node: Optional[yaml.Node], path: Path_) -> Optional[yaml.Node]:
    for key in path:
        values = node.value if isinstance(node, yaml.MappingNode) else []
        node = next((value for name, value in values if name.value == key), None)
    return node


def _replaced(node: yaml.Node, value: str) -> Edit:
    return node.start_mark.index, node.end_mark.index, value


def _added(mapping: yaml.MappingNode, name: str, value: str) -> Edit:
    first = mapping.value[0][0].start_mark
    behind = ", " if mapping.flow_style else "\n" + " " * first.column
    return first.index, first.index, "%s: %s%s" % (name, value, behind)


def _edited(text: str, edits) -> str:
    for begin, end, new in sorted(edits, reverse=True):
        text = text[:begin] + new + text[end:]
    return text


def _text(value: Any) -> str:
    """A number as YAML reads it back as a number of its type."""
    text = repr(value)
    return "%.12f" % value if isinstance(value, float) and "e" in text else text


def _missing(robot: Robot, space: Space, theta: np.ndarray, into: Path) -> List[str]:
    """The parameters that the written files do not start with."""
    setup = yaml_file.read(str(into / DESCRIPTION))["move_base"]
    tree = parameter_files.setup(setup, str(into), "move_base").without_map
    found = [find(tree, t.server, t.names) for t in (space.targets[name][0] for name in space.names)]
    return [name for name, has, value in zip(space.names, found, space.clip(theta)) if has != value]
