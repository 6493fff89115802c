"""Finds out below which namespaces a robot's launch file loads its parameter files, and what they say of the robot.

training/new_robot.py calls `read_parameter_files`; parameter_files.py reads each file.
"""

from __future__ import annotations

import os
import re
from dataclasses import dataclass, field
from functools import lru_cache
from math import isfinite
from pathlib import Path
from typing import Any, Dict, Iterator, List, Mapping, Optional, Sequence, Set, Tuple

from applr_ros1.common.errors import ApplrError
from applr_ros1.common.trees import branch, merged
from applr_ros1.common.yaml_files import yaml_value
from applr_ros1.planner.parameters.declarations import OLDER, SERVERS, STATIC
from applr_ros1.planner.parameters.layers import (
    FOUND_ABOVE,
    INFLATION_LAYER,
    INHERITED,
    OBSTACLE_LAYER,
    TYPES,
    replaced,
)
from applr_ros1.robots.owner.urdf import Packages
from applr_ros1.robots.parameter_files import MOVE_BASE, move_bases, of_move_base, read_levels
from applr_ros1.robots.robot import number_at

_COSTMAPS = ("local_costmap", "global_costmap")
_SEES = re.compile("ObstacleLayer|VoxelLayer'")  # the type of a layer
_NAVFN = "navfn/NavfnROS"
_PLANNERS = ("TrajectoryPlannerROS", "DWAPlannerROS")
# what other local planners call them, the most usual name last
_NAMES = {
    "max_vel_x": ("max_x_vel", "max_vel_lin", "max_vel_x"),
    "max_vel_theta": ("max_rotation_vel", "max_vel_th", "max_rot_vel", "max_vel_theta"),
    "acc_lim_x": ("max_acceleration", "acc_lim_x"),
    "acc_lim_theta": ("max_rotational_acceleration", "acc_lim_th", "acc_lim_theta"),
}
# the names that each place knows; sections of a planner are told by those of speeds and limits
_OF_LAYER = {name for p in TYPES[OBSTACLE_LAYER].live + TYPES[OBSTACLE_LAYER].static for name in p.names}
_KNOWN: Dict[str, Set[str]] = {
    place: {name for p in SERVERS.get(place, ()) + STATIC.get(place, ()) for name in p.names}
    for place in ("", *_COSTMAPS, *_PLANNERS)
}
_KNOWN[""] |= MOVE_BASE | set(FOUND_ABOVE)
_COSTMAP = _KNOWN[_COSTMAPS[0]] | set(INHERITED) | _OF_LAYER
_PLANNER = {name for names in _NAMES.values() for name in names} | {"sim_time", "xy_goal_tolerance"}
_PLANNER.update(*(_KNOWN[planner] | set(OLDER[planner]) for planner in _PLANNERS))
FEW = 4  # names of a local planner by which one that is not here is known


@dataclass
class Parameters:
    """Content of parameter files.

    files: (path, namespace below move_base), in their order. tree: their values, nested, as move_base has them.
    added: what robot.yaml has to say beside them. limits: of a diff_drive_controller, by field of robot.yaml's section
    base. driven: joints of wheels that a controller names. stated: values of a local planner that is not here. changed:
    values by path of the files with something put in place of $(...). notes: sentences for people.
    """

    files: List[Tuple[str, str]] = field(default_factory=list)
    tree: Dict[str, Any] = field(default_factory=dict)
    added: Dict[str, Any] = field(default_factory=dict)
    limits: Dict[str, float] = field(default_factory=dict)
    driven: Set[str] = field(default_factory=set)
    stated: Dict[str, Any] = field(default_factory=dict)
    changed: Dict[str, Dict[str, Any]] = field(default_factory=dict)
    notes: List[str] = field(default_factory=list)

    def frame(self, costmap: str, default: str = "") -> str:
        """The global frame of a costmap, without a leading slash."""
        return str(branch(self.tree, costmap).get("global_frame", default)).lstrip("/")

    @property
    def base_frame(self) -> str:
        """The base frame that a costmap names; "" where none does."""
        named = [branch(self.tree, costmap).get("robot_base_frame") for costmap in _COSTMAPS]
        return str(next(filter(None, named), "")).lstrip("/")

    def scans(self) -> List[Dict[str, Any]]:
        """The laser scans among the observation sources of the costmaps."""
        found = [source for costmap in used(self.tree).values() for source in _sources(costmap)]
        return [source for source in found if source.get("data_type") == "LaserScan"]

    def planner(self) -> Dict[str, Any]:
        """The values of the local planner."""
        return branch(self.tree, str(self.tree.get("base_local_planner", _PLANNERS[0])).rpartition("/")[2])


def used(tree: Dict[str, Any]) -> Dict[str, Dict[str, Any]]:
    """Return what has observation sources in a tree, by costmap: with `plugins` only the layers that these name."""
    found = {}
    for costmap in _COSTMAPS:
        found[costmap] = here = branch(tree, costmap)
        if isinstance(here.get("plugins"), list):
            names = [str(entry.get("name")) for entry in here["plugins"] if isinstance(entry, dict)]
            found[costmap] = {name: branch(here, name) for name in names}
    return found


def _inserted(value: Any, path: str, arguments: Mapping[str, str]) -> Any:
    """Values of a file in which $(...) is replaced as roslaunch does it, as far as that can be known."""
    if isinstance(value, dict):
        pairs = ((_inserted(name, path, arguments), below) for name, below in value.items())
        return {str(name): _inserted(below, path, arguments) for name, below in pairs}
    if isinstance(value, list):
        return [_inserted(below, path, arguments) for below in value]
    if not isinstance(value, str) or "$(" not in value:
        return value

    def instead(match: Any) -> str:
        kind, name, otherwise = match[1], match[2], match[3].strip()
        found: Optional[str] = None
        if kind in ("arg", "optenv"):
            found = arguments.get(name) if kind == "arg" else os.environ.get(name, otherwise)
        elif kind == "env":
            found = os.environ.get(name)
        elif kind == "find":
            found = _packages(path).get(name)
        return str(match[0]) if found is None else found

    text = re.sub(r"\$\((\w+)\s+([\w-]+)([^()]*)\)", instead, value.replace("$(dirname)", os.path.dirname(path)))
    return yaml_value(text, path) if "$(" not in text else text


@lru_cache(maxsize=8)
def _packages(path: str) -> Dict[str, str]:
    return Packages(Path(path)).found


def _insertions(files: Mapping[str, Dict[str, Any]]) -> None:
    """ApplrError, one line, for all that roslaunch would still replace."""
    words = {path: re.findall(r"\$\((\w*)\s*([^)]*)\)", str(values)) for path, values in files.items()}
    missing = []
    for kind, what, form, remedy in (
        ("arg", "the launch file gives arguments: add ", "{}:=VALUE", ""),
        ("env", "not set in the environment: ", "{}", "; export each"),
        ("find", "packages that are not there: ", "{}", "; source the workspace that has them"),
    ):
        names = sorted({word.strip() for held in words.values() for one, word in held if one == kind})
        missing += [what + " ".join(map(form.format, names)) + remedy] * bool(names)
    others = [f"$({one} {word})" for held in words.values() for one, word in held if one not in ("arg", "env", "find")]
    missing += [f"{others[0]} is for roslaunch alone: write the value in a copy of the file"] if others else []
    if missing:
        raise ApplrError(f"{', '.join(path for path, held in words.items() if held)}: {'; '.join(missing)}")


def read_parameter_files(paths: Sequence[str], arguments: Mapping[str, str]) -> Parameters:
    """Read the parameter files of a navigation package.

    Args:
        paths: The files, in the order in which they are loaded.
        arguments: What the launch file puts in place of $(arg NAME), by name.

    Raises:
        ApplrError: A file cannot be read or lacks what roslaunch would put into it, or none is for move_base.
    """
    found = Parameters()
    whole = {path: read_levels(path) for path in paths}
    plain = {path: of_move_base(values) for path, values in whole.items()}
    read = {path: _inserted(values, path, arguments) for path, values in plain.items()}
    _insertions(read)
    found.changed = {path: values for path, values in read.items() if values != plain[path]}
    stated: List[Tuple[str, float]] = []
    for path, given in read.items():
        namespaces = _namespaces(os.path.basename(path), given)
        beside = {**whole[path], **given}  # such as a controller's parameters, where all of a robot's are in one file
        limits, driven = list(_limits(beside)), set(_driven(beside))
        stated += limits
        found.driven |= driven
        robots = move_bases(whole[path])
        if len(robots) > 1:
            found.notes.append(f"{path}: of {', '.join(robots)} the first is taken")
        if not namespaces and not limits and not driven:
            shared = ", ".join(name for name in given if name in _KNOWN[""] | _COSTMAP | _PLANNER)
            but = f", only {shared}, as other nodes do" * bool(shared)
            left = f"{path} is left out: it has no parameters of move_base or of a diff_drive_controller"
            found.notes.append(left + but)
        for namespace in namespaces:
            found.files.append((path, namespace))
            found.tree = merged(found.tree, {namespace: given} if namespace else given)
    _place_layers(found, read)
    found.limits.update(stated)
    for name, value in found.limits.items():
        differing = {f"{other:g}" for one, other in stated if one == name and other != value}
        if differing:
            found.notes.append(
                f"controllers state several values of {name}: {value:g} counts, not {', '.join(differing)}"
            )
    if not found.files:
        raise ApplrError("none of the parameter files is for move_base: give those that its launch file loads")
    if "base_local_planner" not in found.tree and "DWAPlannerROS" in found.tree:
        if "TrajectoryPlannerROS" not in found.tree:
            found.added["base_local_planner"] = "dwa_local_planner/DWAPlannerROS"
        else:
            first = "of TrajectoryPlannerROS and DWAPlannerROS in the files move_base takes the first"
            found.notes.append(f"{first}: where your launch file says another, give it in move_base.parameters")
    sections = _sections(found.tree)
    held = [name for name in _PLANNERS if name in found.tree] or list(sections) or [_PLANNERS[0]]
    local = str(found.tree.get("base_local_planner", held[0]))
    if local.rpartition("/")[2] not in _PLANNERS:
        name = local.rpartition("/")[2]
        name = name if name in sections else next(iter(sections), name)
        theirs = sections.get(name, {})
        ours = {ours: theirs[name] for ours, names in _NAMES.items() for name in names if name in theirs}
        found.stated = {**theirs, **ours}
        found.added.update(_instead(found.tree, found.stated))
        more = " and an inflation layer" * ("local_costmap" in found.added)
        others = ", ".join(other for other in sections if other != name)
        whose = f"the speeds of {name}, not of {others}" if others else "its speeds"
        found.notes.append(f"DWAPlannerROS drives here, not {local}: with {whose}{more}, in move_base.parameters")
    planner = found.tree.get("base_global_planner", _NAVFN)
    if planner != _NAVFN:
        found.added["base_global_planner"] = _NAVFN
        found.notes.append(f"{_NAVFN} plans the paths here, not {planner}")
    for costmap in _COSTMAPS:
        tree = branch(found.tree, costmap)
        # tf2 takes no leading slash
        added = {k: v[1:] for k, v in tree.items() if k.endswith("_frame") and str(v).startswith("/")}
        if added:
            found.added[costmap] = {**found.added.get(costmap, {}), **added}
    found.tree = merged(found.tree, found.added)
    found.notes += map(str, replaced(found.tree))
    return found


def _instead(tree: Dict[str, Any], theirs: Dict[str, Any]) -> Dict[str, Any]:
    """DWAPlannerROS where the files are for a local planner that is not here, with what they say of both."""
    shared = ("max_vel_x", "max_vel_theta", "acc_lim_x", "acc_lim_theta", "xy_goal_tolerance", "yaw_goal_tolerance")
    limits = {name: x for name in shared if (x := number_at(theirs, "", (name,))) is not None and isfinite(x)}
    limits.update({"max_vel_trans": limits["max_vel_x"]} if "max_vel_x" in limits else {})
    for limit, speed in (("acc_lim_x", "max_vel_x"), ("acc_lim_theta", "max_vel_theta")):
        if {limit, speed} <= set(limits):  # with less it overshoots a goal by metres
            limits[limit] = max(limits[limit], limits[speed])
    own = {"min_vel_y": 0.0, "max_vel_y": 0.0, "min_vel_trans": 0.0, "min_vel_theta": 0.0, **limits}
    own.update(path_distance_bias=32.0, goal_distance_bias=24.0)  # with its defaults robots oscillate before a box
    added = {
        "base_local_planner": "dwa_local_planner/DWAPlannerROS",
        "DWAPlannerROS": branch(tree, "DWAPlannerROS") or own,
    }
    local, world = (branch(tree, costmap).get("plugins") for costmap in _COSTMAPS)
    if isinstance(local, list) and "InflationLayer" not in str(local):  # which others do without
        usual = [{"name": "inflation_layer", "type": INFLATION_LAYER}]
        inflation = [layer for layer in world or [] if INFLATION_LAYER in str(layer)] or usual
        added["local_costmap"] = {"plugins": local + inflation}
    return added


def _place_layers(found: Parameters, read: Mapping[str, Dict[str, Any]]) -> None:
    """Moves files that hold an obstacle layer's own names to the layer that has none, where a costmap lists layers."""
    for number, (path, costmap) in enumerate(found.files):
        given, plugins = read[path], branch(found.tree, costmap).get("plugins")
        own = {name for name, value in given.items() if not isinstance(value, dict)}
        if "observation_sources" not in own or not isinstance(plugins, list):
            continue
        names = [str(entry.get("name")) for entry in plugins if isinstance(entry, dict) and _SEES.search(str(entry))]
        free = [name for name in names if "observation_sources" not in branch(found.tree, f"{costmap}/{name}")]
        if own - _OF_LAYER:
            if free and free == names:
                found.notes.append(
                    f"{path}: the layers in plugins do not read the observation_sources of {costmap} itself, and it "
                    f"sees nothing; write them and what they name below {costmap}/{free[0]}"
                )
            continue
        named = [name for name in free if name in os.path.basename(path)]
        if len(named or free) != 1:
            which = ", ".join(names) or "none is there"
            found.notes.append(f"{path} holds a layer's own values: write them below its name in {costmap} ({which})")
            continue
        place = f"{costmap}/{(named or free)[0]}"
        found.files[number] = path, place
        tree = branch(found.tree, costmap)
        for name in given:
            tree.pop(name, None)
        branch(found.tree, place, create=True).update(given)
        found.notes.append(f"{path} is loaded below {place}, the layer that has no sources otherwise")


def _sections(tree: Dict[str, Any]) -> Dict[str, Dict[str, Any]]:
    """The sections that hold speeds and more, as a local planner's do."""
    found = {name: value for name, value in tree.items() if isinstance(value, dict)}
    speeds = set(_NAMES["max_vel_x"])
    return {
        n: v
        for n, v in found.items()
        if speeds & set(v) and (n.endswith("PlannerROS") or len(_PLANNER & set(v)) >= FEW)
    }


def _namespaces(name: str, given: Dict[str, Any]) -> List[str]:
    """Below which names move_base reads a file: "" is move_base itself; none: it is not for move_base.

    Other nodes have some of the names, too: at least half of a file's have to be known at the place.
    """
    sections = {key for key, value in given.items() if isinstance(value, dict)}
    keys, word = set(given) - sections, name.lower()

    def half(known: Set[str]) -> bool:
        return bool(keys & known) and 2 * len(keys & known) >= len(keys)

    if sections & MOVE_BASE or _sections(given) or half(_KNOWN[""] - set(FOUND_ABOVE)):
        return [""]
    sees = any("observation_sources" in given[section] for section in sections)
    if half(_COSTMAP) or sees and not keys:
        return [costmap for costmap in _COSTMAPS if costmap[:5] in word] or list(_COSTMAPS)
    if half(_PLANNER) or len(keys & _PLANNER) >= FEW:
        return [
            "DWAPlannerROS" if "dwa" in word or keys & {"max_vel_trans", "max_trans_vel"} else "TrajectoryPlannerROS"
        ]
    return []


def _driven(given: Dict[str, Any]) -> Iterator[str]:
    """Joints that controllers' files name: left_wheel, right_wheel or lists of them, or a joint's own velocity."""
    for name, value in given.items():
        if isinstance(value, dict):
            yield from _driven(value)
        elif re.fullmatch(r"(left|right)_wheel(s|_names)?", name) or (
            name == "joint" and "JointVelocityController" in str(given.get("type"))
        ):
            yield from map(str, value if isinstance(value, list) else [value])


def _limits(given: Dict[str, Any]) -> Iterator[Tuple[str, float]]:
    """Limits in velocity controllers' files: {NAME: {linear: {x: ...}, angular: {z: ...}}}, below any levels."""
    for controller in (value for value in given.values() if isinstance(value, dict)):
        found: Dict[str, Any] = {}
        for axis, speed, change in (
            ("linear/x", "max_speed", "max_acceleration"),
            ("angular/z", "max_yaw_rate", "max_yaw_acceleration"),
        ):
            stated = branch(controller, axis)
            for kind, ours in (("velocity", speed), ("acceleration", change)):
                if stated.get(f"has_{kind}_limits") is True and f"max_{kind}" in stated:
                    found[ours] = stated[f"max_{kind}"]
        usual = 0.5 if "diff_drive_controller" in str(controller.get("type")) else None
        timeout = controller.get("cmd_vel_timeout", usual)
        if found and isinstance(timeout, (int, float)):  # 0: it never stops, nor does it within a drive
            found["command_timeout"] = timeout if timeout <= 60.0 else 0.0
        numbers = {name: number_at(found, "", (name,)) for name in found}
        yield from ((name, x) for name, x in numbers.items() if x is not None and isfinite(x))
        yield from _limits(controller)


def one_scan(tree: Dict[str, Any], topic: str) -> Tuple[Dict[str, Any], Set[str]]:
    """Return what differs where a laser scan is all that the robot publishes, as the simulated robots do.

    Args:
        tree: Parameters of costmaps.
        topic: The scan's.

    Returns:
        observation_sources of the layers that wait for other topics as well, nested as in `tree`, and those topics.
    """
    changes: Dict[str, Any] = {}
    others: Set[str] = set()
    names = str(tree.get("observation_sources", "")).split()
    topics = {name: str(branch(tree, name).get("topic", name)).lstrip("/") for name in names}
    topic = topic.lstrip("/")
    if set(topics.values()) - {topic}:
        changes["observation_sources"] = " ".join(name for name in names if topics[name] == topic)
        others |= set(topics.values()) - {topic}
    for name, below in tree.items():
        found, more = one_scan(below, topic) if isinstance(below, dict) else ({}, set())
        changes.update({name: found} if found else {})
        others |= more
    return changes, others


def _sources(tree: Dict[str, Any]) -> Iterator[Dict[str, Any]]:
    """The observation sources in a costmap's tree, each with its topic."""
    for name in str(tree.get("observation_sources", "")).split():
        yield {"topic": name, **branch(tree, name)}
    for below in tree.values():
        if isinstance(below, dict):
            yield from _sources(below)


def without_map(given: Parameters, odom: str, size: int) -> Dict[str, Any]:
    """Return what differs on a course without a map: the laser fills an empty costmap in the frame of the odometry.

    Args:
        given: The files' parameters.
        odom: Name of that frame.
        size: Width and height of the global costmap [m].

    Returns:
        By costmap, and for the planner of paths; {} where the files already are for driving without a map.
    """
    changes: Dict[str, Any] = {}
    for costmap in _COSTMAPS:
        tree = branch(given.tree, costmap)
        change: Dict[str, Any] = {}
        if given.frame(costmap, "map") != odom:
            change["global_frame"] = odom
        if tree.get("static_map") and "plugins" not in tree:
            change["static_map"] = False
        layers = tree.get("plugins")
        if isinstance(layers, list) and any("StaticLayer" in str(layer) for layer in layers):
            change["plugins"] = _with_obstacles([e for e in layers if "StaticLayer" not in str(e)], given.tree)
        if change and costmap == "global_costmap":
            change.update(rolling_window=False, width=size, height=size, origin_x=-size / 2, origin_y=-size / 2)
        if change:
            changes[costmap] = change
    if changes and branch(given.tree, "NavfnROS").get("allow_unknown") is False:
        changes["NavfnROS"] = {"allow_unknown": True}  # all is unknown at first
    return changes


def _with_obstacles(layers: List[Any], tree: Dict[str, Any]) -> List[Any]:
    """Layers of a global costmap without its map: with the local costmap's obstacles where it had the map alone."""
    if any(_SEES.search(str(layer)) for layer in layers):
        return layers
    local = branch(tree, "local_costmap").get("plugins", [])
    return [layer for layer in local if _SEES.search(str(layer))] + layers
