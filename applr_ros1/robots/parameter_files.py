"""Reader of YAML files with parameters of move_base. It accepts the syntax of rosparam.

folder.py reads the files of a robot's folder, and urdf_import/parameters.py those of a navigation
package.
"""

from __future__ import annotations

import math
import re
from typing import Any, Callable, Iterator

from applr_ros1.common import files
from applr_ros1.common.errors import ApplrError, shown
from applr_ros1.planner.parameters.declarations import LOCAL_PLANNERS, namespace
from applr_ros1.planner.parameters.layers import COSTMAPS
from applr_ros1.planner.parameters.trees import Tree, branch, merged
from applr_ros1.robots.file_kinds import kind_of

# Sections below move_base that have files of their own
PLACES = (*COSTMAPS, *map(namespace, LOCAL_PLANNERS))
# How to get the values that a launch file gives
DUMP = "give the output of roslaunch --dump-params PACKAGE FILE.launch"
# An angle such as "90", "pi/2", "deg(45)" or "0.5*pi"
_ANGLE = re.compile(
    r"(?:deg|rad)?\(?(?P<number>[-+]?[\d.]*(?:e[-+]?\d+)?)\s*\*?\s*"
    r"(?P<pi>pi)?\s*(?:/\s*(?P<divisor>[\d.]+))?\)?"
)
# Tag in files of rqt_reconfigure
_SAVED = "tag:yaml.org,2002:python/object/new:dynamic_reconfigure.encoding.Config"


class Loader(files.LimitedLoader):
    """YAML loader with rosparam's angles and rqt_reconfigure's tag.

    Angles are !degrees 90, !radians pi/2, deg(90) and rad(pi/2).
    """


def _saved(loader: Any, node: Any) -> Tree:
    """Return the values saved by `dynparam dump` or rqt_reconfigure as a plain mapping."""
    values: Tree = loader.construct_mapping(node, deep=True).get("dictitems", {})
    values.pop("groups", None)  # How rqt_reconfigure shows the parameters
    return values


def _angle(unit: float) -> Callable[[Any, Any], float]:
    """Return a YAML constructor that converts angles in a unit (1.0: rad) to rad."""

    def read(loader: Any, node: Any) -> float:
        """Return the angle [rad] in a node such as "pi/2" or "-90"."""
        match = _ANGLE.fullmatch(loader.construct_scalar(node).strip())
        if not match or not (match["number"] or match["pi"]):
            raise ApplrError(f"{shown(node.value)} is no angle: give a number or a fraction of pi")
        number_text = match["number"]
        if number_text in ("", "-", "+"):  # "pi" and "-pi" have no digits.
            number_text += "1"
        angle = float(number_text)
        if match["pi"]:
            angle *= math.pi
        return angle / float(match["divisor"] or 1.0) * unit

    return read


Loader.add_constructor(_SAVED, _saved)
for _name, _unit in (("degrees", math.pi / 180.0), ("radians", 1.0)):
    Loader.add_constructor(f"!{_name}", _angle(_unit))
    Loader.add_implicit_resolver(f"!{_name}", re.compile(rf"^{_name[:3]}\([^)]*\)$"), [_name[0]])


def read_yaml(path: Any) -> Tree:
    """Read the mapping in a YAML file, {} if the file is empty.

    Raise ApplrError if it holds anything else.
    """
    with files.reading(path):
        # Comments may have another encoding.
        yaml_text = files.read_bytes(path).decode("utf-8-sig", "replace")
        content = files.yaml_value(yaml_text, path, Loader)
        if not isinstance(content or {}, dict):
            raise ApplrError("contains no mapping; give lines such as name: value")
        return content or {}


def nested(path: str) -> Tree:
    """Read the nested parameters in a YAML file. As for rosparam, a/b: 1 means a: {b: 1}.

    Raise ApplrError if the file is of another kind, such as a launch file.
    """
    kind = kind_of(files.read_bytes(path))
    if kind:
        raise ApplrError(f"{path} is {kind}: {DUMP}")
    with files.reading(path):
        return _levels(read_yaml(path))


def of_move_base(tree: Tree, path: str) -> Tree:
    """Return the level named move_base in the nested parameters of a file, or all without one.

    Raise ApplrError if there are several, or if it has values that only roslaunch can resolve.
    """
    # A dump of the parameter server has the parameters of all nodes.
    move_base_levels = list(_move_bases(tree))
    if len(move_base_levels) > 1:
        problem = "the parameters contain more than one move_base"
        raise ApplrError(f"{path}: {problem}: give those of one robot")
    for level in move_base_levels:
        tree = level
    check_resolved(tree, path)
    return tree


def check_resolved(tree: Tree, path: str) -> None:
    """Raise ApplrError if names or values in nested parameters of a file have $(arg ...) or such.

    roslaunch replaces these in files with subst_value="true".
    """
    for name, value in tree.items():
        if isinstance(value, dict) and "$(" not in name:
            check_resolved(value, path)
        elif "$(" in f"{name} {value}":
            problem = f"{name} is {shown(value)}, which only roslaunch can resolve"
            raise ApplrError(f"{path}: {problem}: {DUMP}")


def too_deep(tree: Tree) -> Iterator[str]:
    """Yield an error for each section that move_base does not read, inside another one."""
    for parent in tree:
        for section_name in PLACES:
            if branch(tree, f"{parent}/{section_name}"):
                remedy = f"remove the level {parent} from the parameter file, or from its namespace"
                yield f"{parent}/{section_name} is one level too deep for move_base: {remedy}"


def _move_bases(tree: Tree) -> Iterator[Tree]:
    """Yield the levels named move_base in nested parameters."""
    for name, value in tree.items():
        if isinstance(value, dict) and name == "move_base":
            yield value
        elif isinstance(value, dict):
            yield from _move_bases(value)


def _levels(content: Tree) -> Tree:
    """Return a nested mapping with one level per part of each name."""
    tree: Tree = {}
    for name, value in content.items():
        # A file may have both a/b: 1 and a section a: both are merged.
        section_path, _, last_name = str(name).strip("/").rpartition("/")
        if isinstance(value, dict):
            value = _levels(value)
        section = branch(tree, section_path, create=True)
        section.update(merged({last_name: section.get(last_name)}, {last_name: value}))
    return tree
