"""Checks, converts and completes parameter trees against the declarations.

MoveBase completes what it is given; the node prints check()'s lines at start-up.
"""

from __future__ import annotations

import math
from collections import Counter
from typing import Any, Dict, List, Tuple

import numpy as np

from applr_ros1.common.errors import ApplrError, meant
from applr_ros1.common.files import MAX_CELLS
from applr_ros1.common.trees import branch
from applr_ros1.planner.costmap import footprint
from applr_ros1.planner.parameters.declarations import (
    GLOBAL_PLANNERS,
    LOCAL_PLANNERS,
    SERVERS,
    namespace,
    static_tables,
)
from applr_ros1.planner.parameters.dwa_planner_parameters import SAMPLES
from applr_ros1.planner.parameters.dwa_planner_parameters import warnings as dwa_warnings
from applr_ros1.planner.parameters.layers import (
    COSTMAPS,
    INHERITED,
    NAME,
    OBSTACLE_LAYER,
    TYPES,
    arranged,
    layers,
    sources,
)
from applr_ros1.planner.parameters.move_base_parameters import BEHAVIOUR, DEFAULT_RECOVERIES, RECOVERY_TYPES
from applr_ros1.planner.parameters.parameter import Parameter, ParameterError

MOST_SAMPLES = 1_000_000  # of one cycle; more are refused instead of filling the memory
MOST_POINTS = 100_000  # of one trajectory or turn; more are refused instead of taking minutes


def check_consistency(planner: str, values: Dict[str, Any]) -> None:
    """Refuse values of the local planner `planner` that cannot be run together: ParameterError, one line."""
    if planner == "DWAPlannerROS":
        _check_dwa(values)
    elif planner == "TrajectoryPlannerROS":
        _check_trajectory(values)


def check_turn(name: str, values: Dict[str, Any]) -> None:
    """Refuse a recovery behaviour whose turn would be checked at too many poses: ParameterError, one line."""
    spacing = values["sim_granularity"]
    if 2 * math.pi > MOST_POINTS * spacing:
        raise ParameterError(
            f"{name}/sim_granularity is {spacing:g}: a turn has more than {MOST_POINTS} poses, give a larger one"
        )


def _check_dwa(values):
    counts = tuple(values[name] for name in SAMPLES)
    most = math.prod(max(n, 2) + 1 for n in counts)  # each axis has two at least, and one more at zero
    if most > MOST_SAMPLES:
        raise ParameterError(
            f"{', '.join(SAMPLES)} are {counts}, up to {most} samples: give at most {MOST_SAMPLES} together"
        )
    for fastest, spacing in (("max_vel_trans", "sim_granularity"), ("max_vel_theta", "angular_sim_granularity")):
        _check_points(values, spacing, fastest, values[fastest])
    sideways = values["min_vel_y"], values["max_vel_y"]
    if sideways != (0.0, 0.0):
        raise ParameterError(f"min_vel_y, max_vel_y are {sideways}: give 0: no sideways velocity is commanded")


def _check_trajectory(values):
    if values["heading_scoring"]:
        _check_points(values, "sim_granularity", "heading_scoring, which counts seconds,", 1.0)
    for fastest in ("max_vel_x", "min_vel_x", "escape_vel"):
        _check_points(values, "sim_granularity", fastest, values[fastest])
    for fastest in ("max_vel_theta", "min_vel_theta", "min_in_place_vel_theta"):
        _check_points(values, "angular_sim_granularity", fastest, values[fastest], timed=False)


def _check_points(values, spacing, fastest, speed, timed=True):
    """Refuse trajectories of too many points. timed: whether their number grows with sim_time."""
    if abs(speed) * (values["sim_time"] if timed else 1.0) > MOST_POINTS * values[spacing]:
        time = f" and sim_time {values['sim_time']:g} s" if timed else ""
        raise ParameterError(
            f"{spacing} is {values[spacing]:g}: with {fastest} {speed:g}{time} a trajectory has more than "
            f"{MOST_POINTS} points, give a larger one"
        )


TEXT_OR_LIST = ("footprint", "y_vels")  # texts that parameter files may give as lists


def convert(p: Parameter, value: Any, label: str = "") -> Any:
    """`value` as p's type, bounds aside. ParameterError for another type, NaN, infinity or a useless 0."""
    label = label or p.name
    number = isinstance(value, (int, float)) and not isinstance(value, bool)
    if p.type == "double" and number or p.type == "int" and number and value == value // 1:
        if not math.isfinite(value):
            raise ParameterError(f"{label} is {value!r}: give a finite number")
        if p.not_zero and value == 0:
            raise ParameterError(f"{label} is 0, which cannot work: give a number above it")
        return float(value) if p.type == "double" else int(value)
    if p.type == "bool" and isinstance(value, bool) or p.type == "list" and isinstance(value, list):
        return value
    if p.type == "str" and isinstance(value, (str, list) if p.name in TEXT_OR_LIST else str):
        text = value if isinstance(value, str) else str(value)
        if p.name == "footprint":
            _check_outline(text, label)
        return text
    kind = {"double": "a finite number", "int": "a whole number", "bool": "true or false", "str": "text"}
    raise ParameterError(f"{label} is {value!r}: give {kind.get(p.type, 'a list')}")


def clamp(p: Parameter, value: Any, label: str = "") -> Any:
    """`value` moved into p's bounds. ParameterError where that makes it a useless 0."""
    if p.type not in ("double", "int"):
        return value
    moved = min(max(value, p.min), p.max)
    if p.not_zero and moved == 0:
        raise ParameterError(f"{label or p.name} is {value!r}, which cannot work: give a number above 0")
    return moved


def _check_outline(text: str, label: str) -> None:
    """Raise ParameterError where a footprint parameter is no list of at least three points within 100 m."""
    try:
        good = bool((np.abs(footprint.parse(text)) < 100.0).all())
    except ApplrError:
        good = False
    if not good:
        shown = text if len(text) < 60 else text[:57] + "..."
        raise ParameterError(f"{label} is {shown}: give at least three points, [[x, y], ...] in metres")


Tables = Dict[str, Tuple[Parameter, ...]]
DATA_TYPES = ("LaserScan", "PointCloud2", "PointCloud")


def tables(tree: Dict[str, Any]) -> Tables:
    """All parameters by place, of a tree that is arranged (layers.arranged)."""
    live = {path: table for path, table in SERVERS.items() if "costmap/" not in path}
    for name in COSTMAPS:
        if isinstance(tree.get(name), dict):
            live.update({layer.path: TYPES[layer.kind].live for layer in layers(name, tree[name])})
    static = static_tables(tree)
    return {path: live.get(path, ()) + static.get(path, ()) for path in dict.fromkeys([*live, *static])}


def _behaviours(tree) -> List[str]:
    """The names that recovery_behaviors lists."""
    listed = tree.get("recovery_behaviors")
    named = [b.get("name") for b in listed if isinstance(b, dict)] if isinstance(listed, list) else []
    return [name for name in named if isinstance(name, str)]


def _repeated(names: List[str]) -> List[str]:
    return [name for name, times in Counter(names).items() if times > 1]


def check(tree: Dict[str, Any]) -> List[str]:
    """What is wrong with a nested parameter tree: one line each (what, value, remedy); [] if nothing is."""
    problems: List[str] = []
    try:
        tree = arranged(tree)
        _check(tree, "", tables(tree), _behaviours(tree), problems)
        if not problems:
            complete(tree)
    except ParameterError as problem:
        problems.append(str(problem))
    return problems


def warnings(tree: Dict[str, Any]) -> List[str]:
    """What has no effect in a tree without mistakes, or is a risk: one line each."""
    lines: List[str] = []
    if namespace(tree.get("base_local_planner", LOCAL_PLANNERS[0])) == "DWAPlannerROS":
        found = dwa_warnings(tree.get("DWAPlannerROS", {}), tree.get("latch_xy_goal_tolerance", False))
        lines += ["DWAPlannerROS/" + line for line in found]
    for name in _repeated(_behaviours(tree)):
        instead = "as in C++ the default behaviours take the place of the list; give each a name of its own"
        lines.append(f"recovery_behaviors has the name {name!r} more than once: {instead}")
    lines += _warn_of_behaviours(tree)
    tree = arranged(tree)
    _warn_of_layers(tree, tables(tree), lines)
    return lines


def _warn_of_behaviours(tree):
    """What C++ would clear otherwise: one line each."""
    usual = {p.name: p.default for p in BEHAVIOUR if p.name in ("affected_maps", "invert_area_to_clear")}
    given = [(path, branch(tree, path)) for path in dict.fromkeys([*USUAL, *_behaviours(tree)])]
    return [
        f"{path}/{name} is without effect: a clearing clears both costmaps outside of its square"
        for path, own in given
        for name, value in usual.items()
        if own.get(name, value) != value
    ]


def _warn_of_layers(tree, known, lines):
    """Parameters of layers and sources that no list names, and a robot that sees nothing."""
    for path in [path for path in known if path.partition("/")[0] in COSTMAPS]:
        for name, value in branch(tree, path).items():
            label = f"{path}/{name}"
            if isinstance(value, dict) and label not in known:
                which = "observation_sources" if "/" in path else "plugins"
                used = [other[len(path) + 1 :] for other in known if other.startswith(path + "/")]
                lines.append(f"{label} has no effect: {which} of {path} does not name it; {meant(name, used)}")
    seen = [layer for layer in layers("local_costmap", tree.get("local_costmap", {})) if layer.kind == OBSTACLE_LAYER]
    if not any(sources(branch(tree, layer.path)) for layer in seen):
        lines.append("local_costmap has no observation source: the robot will not see obstacles")


def _check(here, path, known, behaviours, problems):
    mine = {name: p for p in known.get(path, BEHAVIOUR) for name in (p.name,) + p.aliases}
    if path in COSTMAPS:
        mine = dict(INHERITED, **mine)
    for key, value in here.items():
        label = f"{path}/{key}" if path else str(key)
        if isinstance(value, dict):
            if label in known or label in behaviours:
                _check(value, label, known, behaviours, problems)
                continue
            if path.partition("/")[0] in COSTMAPS and key not in mine:
                continue  # of a layer or source that is not in use: a warning
        if key not in mine:
            below = [name[len(path) + 1 if path else 0 :] for name in known if not path or name.startswith(path + "/")]
            problems.append(f"{label} is unknown: {meant(key, below if isinstance(value, dict) else mine)}")
        else:
            p = mine[key]
            try:
                value = convert(p, value, label)
                if clamp(p, value, label) != value and not p.clamps:
                    problems.append(f"{label} is {value!r}: give a value from {p.min!r} to {p.max!r}")
            except ParameterError as problem:
                problems.append(str(problem))


def complete(tree: Dict[str, Any]) -> Dict[str, Any]:
    """The tree with every absent parameter at its default and both names of each alias; a new nested dict.

    The parameters of layers and sources stand where C++ has them in the end (layers.arranged), and `plugins` is always
    there. What layers inherit from their costmap stands at the layers alone, but for a track_unknown_space that was
    given. ParameterError, one line, for what cannot be run.
    """
    full: Dict[str, Any] = {}
    tree = arranged(tree)
    for path, parameters in tables(tree).items():
        have, here = branch(tree, path), branch(full, path, create=True)
        assert here is not None  # it has just been created
        for p in parameters:
            label = f"{path}/{p.name}" if path else p.name
            named = [have[name] for name in (p.name,) + p.aliases if name in have]
            if not named and p.name == "controller_frequency" and p.name in tree:
                named = [tree[p.name]]  # looked for from the planner's name space upwards
            if path in COSTMAPS and p.name in INHERITED and not (named and p.name == "track_unknown_space"):
                continue  # the layers have it
            if any(other != named[0] for other in named[1:]):
                raise ParameterError(
                    f"{label} is {named[0]!r} but its other name {p.aliases[0]} is {named[1]!r}: give one of them"
                )
            value = convert(p, named[0] if named else p.default, label)
            here.update({name: value for name in (p.name,) + p.aliases})
    names = _behaviours(tree)
    if _repeated(names):  # C++ says so and takes the defaults (move_base.cpp, loadRecoveryBehaviors)
        names, full["recovery_behaviors"] = [], DEFAULT_RECOVERIES
    _check_behaviours(full, names)
    full["conservative_reset"]["reset_distance"] = full["conservative_reset_dist"]
    full["aggressive_reset"]["reset_distance"] = 4 * full["local_costmap"]["circumscribed_radius"]
    for name in names:
        own = branch(tree, name)
        usual = full.get(name, {})
        full[name] = {
            p.name: convert(p, own.get(p.name, usual.get(p.name, p.default)), f"{name}/{p.name}") for p in BEHAVIOUR
        }
    _check_whole(full)
    return full


USUAL = tuple(behaviour["name"] for behaviour in DEFAULT_RECOVERIES)


def _check_behaviours(full, names):
    """Refuse names of recovery behaviours that cannot be, or that stand for something else in the tree."""
    for name in names:
        if not NAME.fullmatch(name) or name in full and name not in USUAL:
            why = "something else has this name" if name in full else "a name has letters, digits and _ only"
            raise ParameterError(f"recovery_behaviors has the name {name!r}: {why}, give another")


def _check_whole(full):
    """What only shows when several parameters are looked at together, and the plugins there are."""
    known = {"base_global_planner": GLOBAL_PLANNERS, "base_local_planner": LOCAL_PLANNERS}
    for name, plugins in known.items():
        if full[name] not in plugins:
            raise ParameterError(f"{name} is {full[name]}: give {' or '.join(plugins)}")
    planner = namespace(full["base_local_planner"])
    check_consistency(planner, full[planner])
    for name in dict.fromkeys(["rotate_recovery", *_behaviours(full)]):
        if "sim_granularity" in full[name]:
            check_turn(name, full[name])
    types: Dict[str, str] = {}
    for name in COSTMAPS:
        costmap = full[name]
        columns, rows = (costmap[side] / costmap["resolution"] for side in ("width", "height"))
        if not (columns >= 1 and rows >= 1):
            raise ParameterError(
                f"{name}/width, height are {costmap['width']} x {costmap['height']} m at a resolution of "
                f"{costmap['resolution']:g} m, which has no cells: give at least one each way"
            )
        if columns * rows > MAX_CELLS:
            raise ParameterError(
                f"{name}/width, height are {costmap['width']} x {costmap['height']} m at {costmap['resolution']:g} m, "
                f"{columns * rows:.3g} cells: give at most {MAX_CELLS:g}"
            )
        for layer in layers(name, costmap):
            if layer.kind == OBSTACLE_LAYER:
                _check_sources(layer, costmap[layer.name], types)
    world, local = (full[name]["robot_base_frame"] for name in COSTMAPS)
    if world != local:
        raise ParameterError(
            f"robot_base_frame is {world} in global_costmap and {local} in local_costmap: give the same"
        )
    for behaviour in full["recovery_behaviors"]:
        named = isinstance(behaviour, dict) and isinstance(behaviour.get("name"), str)
        if not named or behaviour.get("type") not in RECOVERY_TYPES:
            raise ParameterError(
                f"recovery_behaviors has {behaviour!r}: give a name and a type of {' or '.join(RECOVERY_TYPES)}"
            )


def _check_sources(layer, own, types):
    """Data types that there are, and one for each topic; `types` collects {topic: data type}."""
    for name in sources(own):
        topic, kind = own[name]["topic"], own[name]["data_type"]
        label = f"{layer.path}/{name}"
        if kind not in DATA_TYPES:
            raise ParameterError(f"{label}/data_type is {kind}: give {' or '.join(DATA_TYPES)}")
        if types.setdefault(topic, kind) != kind:
            raise ParameterError(
                f"{label} takes {kind} from the topic {topic}, another source takes {types[topic]}: give one type"
            )
