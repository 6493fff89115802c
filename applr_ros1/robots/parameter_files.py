"""Reader of the YAML files of a robot: parameters of move_base as rosparam reads them, of bounded size.

folder.py reads those in a robot's folder, owner/parameters.py those of a navigation package.
"""

from __future__ import annotations

import math
import re
from typing import Any, Callable, Dict, List

from applr_ros1.common import files
from applr_ros1.common.errors import ApplrError
from applr_ros1.common.trees import merged
from applr_ros1.common.yaml_files import Yaml, yaml_value

# names that stand at move_base itself alone
MOVE_BASE = {"base_local_planner", "base_global_planner", "recovery_behaviors", "NavfnROS"}
MOVE_BASE |= {"GlobalPlanner", "local_costmap", "global_costmap", "TrajectoryPlannerROS", "DWAPlannerROS"}


class Loader(Yaml):
    """YAML with the angles of rosparam: !degrees 90, !radians pi/2, deg(90), rad(pi/2)."""


def _angle(unit: float) -> Callable[[Any, Any], float]:
    """Return a reader of angles, one of whose units is so many radians."""

    def read(loader: Any, node: Any) -> float:
        text = re.sub(r"^(?:deg|rad)\((.*)\)$", r"\1", loader.construct_scalar(node).strip())
        if len(text) > 100 or not re.fullmatch(r"(?:[-+*/(). \deE]|pi)+", text) or "**" in text or "//" in text:
            raise ValueError(f"{text[:40]} is no angle: give a number, or a fraction of pi")
        try:
            return float(eval(text, {"__builtins__": {}}, {"pi": math.pi})) * unit  # numbers, pi and + - * / alone
        except (SyntaxError, TypeError, NameError, AttributeError, ArithmeticError) as error:
            raise ValueError(f"{text[:40]} is no angle ({error})") from None

    return read


for _name, _unit in (("degrees", math.pi / 180.0), ("radians", 1.0)):
    Loader.add_constructor(f"!{_name}", _angle(_unit))
    Loader.add_implicit_resolver(f"!{_name}", re.compile(rf"^{_name[:3]}\([^)]*\)$"), [_name[0]])


def read_yaml(path: Any) -> Dict[str, Any]:
    """Read the mapping in a YAML file; {} for an empty file. ApplrError of one line for everything else."""
    return mapping(_text(path), path)


def _text(path: Any) -> str:
    return files.read_bytes(path).decode("utf-8-sig", "replace")  # comments may be of another encoding


def mapping(text: str, path: Any) -> Dict[str, Any]:
    """Read the mapping in a YAML text, as `read_yaml` does."""
    found = yaml_value(text, path, Loader)
    if not isinstance(found or {}, dict):
        raise ApplrError(f"{path}: holds no mapping; give lines such as name: value")
    return found or {}


def read_parameters(path: str) -> Dict[str, Any]:
    """The parameters of move_base in a YAML file, without the levels above those of move_base."""
    return of_move_base(read_levels(path))


def read_levels(path: str) -> Dict[str, Any]:
    """The parameters in a YAML file, nested, as rosparam loads it."""
    found: Dict[str, Any] = {}
    text = re.sub(r"^%.*", "", _text(path), flags=re.MULTILINE)
    if text.lstrip().startswith("<"):
        raise ApplrError(f"{path} is no YAML; of a launch file give what this writes: roslaunch --dump-params {path}")
    if "ros__parameters:" in text:
        raise ApplrError(f"{path} is for ROS 2: give the parameter files of a move_base of ROS 1")
    for document in re.split(r"^---(?=\s|$)", text, flags=re.MULTILINE):
        content = mapping(document, path)
        space = str(content.pop("_ns", ""))  # rosparam's name of the level that a document is loaded below
        found = merged(found, _levels({f"{space}/{name}".strip("/"): value for name, value in content.items()}, path))
    return found


def of_move_base(found: Dict[str, Any]) -> Dict[str, Any]:
    """Return what is for move_base in nested parameters; all where no level is named after it or holds its names."""
    levels = _all_levels(found)
    named = (here["move_base"] for here in levels.values() if isinstance(here.get("move_base"), dict))
    return next(named, None) or next((here for here in levels.values() if MOVE_BASE & set(here)), found)


def move_bases(found: Dict[str, Any]) -> List[str]:
    """Return the names of the levels that are called move_base, in the order in which `of_move_base` takes one."""
    levels = _all_levels(found).items()
    return [f"{path}/move_base".strip("/") for path, here in levels if isinstance(here.get("move_base"), dict)]


def _all_levels(found: Dict[str, Any]) -> Dict[str, Dict[str, Any]]:
    """Nested parameters by path, the uppermost first."""
    levels, paths = {"": found}, [""]
    for path in paths:
        below = {f"{path}/{name}": value for name, value in levels[path].items() if isinstance(value, dict)}
        levels.update(below)
        paths += below
    return levels


def _levels(content: Dict[str, Any], path: str) -> Dict[str, Any]:
    """A mapping in which a/b: 1 is a: {b: 1}, as rosparam takes it; a name that begins with / is another node's."""
    found: Dict[str, Any] = {}
    for name, value in content.items():
        parts = [name] if str(name).startswith("/") else str(name).rstrip("/").split("/")
        value = _levels(value, path) if isinstance(value, dict) else value
        here = found
        for part in parts[:-1]:
            here[part] = here[part] if isinstance(here.get(part), dict) else {}
            here = here[part]
        here.update(merged({parts[-1]: here.get(parts[-1])}, {parts[-1]: value}))
    return found
