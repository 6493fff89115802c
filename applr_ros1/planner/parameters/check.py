"""Examines parameter trees: `check` says what is wrong with one, `warnings` what is in vain, `complete` adds defaults.

MoveBase completes what it is given; the node and robots/check.py print what is found. The names that there are come
from declarations.tables, what no values may say together from `contradictions` beside the declarations.
"""

from __future__ import annotations

import copy
import math
from typing import Any, Dict, Iterable, Iterator, List, Tuple

from applr_ros1.common.errors import MEANT, Finding, misspelt
from applr_ros1.common.trees import branch
from applr_ros1.planner.parameters.costmap_parameters import COSTMAP, DATA_TYPES, STATIC_COSTMAP
from applr_ros1.planner.parameters.declarations import (
    CONTRADICTIONS,
    GLOBAL_PLANNERS,
    LOCAL_PLANNERS,
    OLDER,
    SERVERS,
    STATIC,
    namespace,
    tables,
)
from applr_ros1.planner.parameters.dwa_planner_parameters import without_effect
from applr_ros1.planner.parameters.layers import (
    COSTMAPS,
    FOUND_ABOVE,
    INHERITED,
    NAME,
    OBSTACLE_LAYER,
    arranged,
    layers,
    replaced,
    sources,
)
from applr_ros1.planner.parameters.move_base_parameters import BEHAVIOUR, DEFAULT_RECOVERIES, RECOVERY_TYPES
from applr_ros1.planner.parameters.parameter import ParameterError, too_many_points

UNREAD_NAME = "is not read"
ELSEWHERE = {name for declared in (*SERVERS.values(), *STATIC.values()) for p in declared for name in p.names}
NAV2 = {  # names in ROS 2, with those that are read here
    **{"obstacle_max_range": "obstacle_range", "raytrace_max_range": "raytrace_range"},
    **{"max_speed_xy": "max_vel_trans", "min_speed_xy": "min_vel_trans", "min_speed_theta": "min_vel_theta"},
    **{"vtheta_samples": "vth_samples", "BaseObstacle.scale": "occdist_scale"},
    **{"PathDist.scale": "path_distance_bias", "GoalDist.scale": "goal_distance_bias"},
    **{"trans_stopped_velocity": "trans_stopped_vel", "rot_stopped_velocity": "theta_stopped_vel"},
    **{"expected_planner_frequency": "planner_frequency", "tolerance": "default_tolerance"},
    **{"controller_plugins": "base_local_planner", "planner_plugins": "base_global_planner"},
}
USUAL = tuple(behaviour["name"] for behaviour in DEFAULT_RECOVERIES)


def check(tree: Dict[str, Any]) -> List[Finding]:
    """What a robot cannot be driven with in a nested parameter tree: wrong values first, then contradictions."""
    try:
        placed = arranged(tree)
        found = [finding for finding in _walked(placed) if finding.severity == "error"]
        found += _contradictions(_completed(without(tree, found)))
    except ParameterError as problem:
        found = [problem.finding]
    return found


def without(tree: Dict[str, Any], findings: Iterable[Finding]) -> Dict[str, Any]:
    """A copy of a tree that lacks the values that findings are about."""
    left = copy.deepcopy(tree)
    for finding in findings:
        above, _, names = finding.key.rpartition("/")
        places = [above, above.rpartition("/")[0], ""]  # of a layer or source it may stand at the costmap
        for name in names.split(", "):
            next((branch(left, at) for at in places if name in branch(left, at)), {}).pop(name, None)
    return left


def _walked(tree: Dict[str, Any]) -> Iterator[Finding]:
    """What is found in the values of an arranged tree, one by one."""
    known, behaviours = tables(tree), _behaviours(tree)
    idle = {namespace(plugin) for plugin in LOCAL_PLANNERS} - {_local_planner(tree)}
    used = {name: value for name, value in tree.items() if name not in idle}
    return _names_and_values(used, "", known, behaviours)


def _local_planner(tree: Dict[str, Any]) -> str:
    return namespace(str(tree.get("base_local_planner", LOCAL_PLANNERS[0])))


def _names_and_values(here, path, known, behaviours) -> Iterator[Finding]:
    """Values that their declarations do not take: errors; names that are not declared: remarks, or warnings."""
    mine = {name: p for p in known.get(path, BEHAVIOUR) for name in p.names}
    if path in COSTMAPS:
        mine = dict(INHERITED, **mine)
    elif not path:
        mine.update((p.name, p) for p in COSTMAP + STATIC_COSTMAP if p.name in FOUND_ABOVE)
    start = f"{path}/" if path else ""
    below = [name[len(start) :] for name in [*known, *behaviours] if name.startswith(start)]
    for key, value in here.items():
        label = f"{start}{key}"
        if isinstance(value, dict) and (label in known or label in behaviours):
            yield from _names_and_values(value, label, known, behaviours)
        elif key in mine and not isinstance(value, dict):
            p = mine[key]
            if not p.reads(value):
                if p.type != "list":  # _recoveries says so
                    yield Finding(label, f"is {value!r}", f"{p.default!r} counts, as in C++; {p.give}", "warning")
                continue
            if key != p.name and here.get(p.name, value) != value:
                yield Finding(label, "is an older name", f"{p.name} counts", "remark")
            try:
                converted, taken = p.convert(value, label), p.taken(value, label)
                bounds = f"{p.min!r} to {p.max!r}"
                if taken != converted and p.beyond:
                    advice = f"give a value from {bounds}" if p.beyond == "error" else f"{taken!r} counts, of {bounds}"
                    yield Finding(label, f"is {converted!r}", advice, p.beyond)
            except ParameterError as problem:
                yield problem.finding
        elif not path and label in known and value is not None:
            yield Finding(label, f"is {value!r}", "give a mapping of names and values")
        elif value is not None:
            other = misspelt(str(key), below if isinstance(value, dict) else mine)
            if NAV2.get(key) in mine and NAV2[key] not in here:
                yield Finding(label, UNREAD_NAME, f"it is Nav2's name of {NAV2[key]}, give that", "warning")
            elif other and key not in ELSEWHERE:
                yield Finding(label, UNREAD_NAME, f"{MEANT} {other}?", "warning")
            else:
                yield Finding(label, UNREAD_NAME, severity="remark")


def warnings(tree: Dict[str, Any]) -> List[Finding]:
    """What has no effect in a tree without mistakes, or is a risk."""
    found: List[Finding] = []
    if namespace(tree.get("base_local_planner", LOCAL_PLANNERS[0])) == "DWAPlannerROS":
        given = without_effect(branch(tree, "DWAPlannerROS"), tree.get("latch_xy_goal_tolerance", False))
        found += [finding.below("DWAPlannerROS") for finding in given]
    for planner, names in OLDER.items():
        values = branch(tree, planner) if planner == _local_planner(tree) else {}
        for old in filter(values.__contains__, names):
            value, advice = "is no longer read", f"give {names[old]}"
            found.append(Finding(f"{planner}/{old}", value, advice, "remark"))
    found += [*_recoveries(tree)[1], *replaced(tree)]
    tree = arranged(tree)
    found += [finding for finding in _walked(tree) if finding.severity != "error"]
    return found + list(_clearings(tree)) + list(_risks(tree))


def _clearings(tree: Dict[str, Any]) -> Iterator[Finding]:
    """What recovery behaviours of C++ would clear otherwise."""
    usual = {p.name: p.default for p in BEHAVIOUR if p.name in ("affected_maps", "invert_area_to_clear")}
    for path in dict.fromkeys([*USUAL, *_behaviours(tree)]):
        for name, value in usual.items():
            if branch(tree, path).get(name, value) != value:
                why = "a clearing clears both costmaps outside of its square"
                yield Finding(f"{path}/{name}", "is without effect", why, "remark")


def _risks(tree: Dict[str, Any]) -> Iterator[Finding]:
    """A robot that sees nothing, or has two base frames."""
    world, local = (branch(tree, name).get("robot_base_frame", "base_link") for name in COSTMAPS)
    if world != local:
        value = f"is {local} in local_costmap and {world} in global_costmap"
        yield Finding("local_costmap/robot_base_frame", value, f"{world} counts for both, give that", "warning")
    seen = [layer for layer in layers("local_costmap", branch(tree, "local_costmap")) if layer.kind == OBSTACLE_LAYER]
    if not any(sources(branch(tree, layer.path)) for layer in seen):
        yield Finding("local_costmap", "has no observation source", "the robot will not see obstacles", "remark")


def complete(tree: Dict[str, Any]) -> Dict[str, Any]:
    """The tree with every absent parameter at its default and both names of each alias; a new nested dict.

    The parameters of layers and sources stand where C++ has them in the end (layers.arranged), and `plugins` is always
    there. What layers inherit from their costmap stands at the layers alone, but for a track_unknown_space that was
    given. ParameterError, one line, for what cannot be run.
    """
    full = _completed(tree)
    for finding in _contradictions(full):
        raise ParameterError(finding)  # the first
    return full


def _completed(tree: Dict[str, Any]) -> Dict[str, Any]:
    """As `complete`, whatever the values say against each other."""
    full: Dict[str, Any] = {}
    tree = arranged(tree)
    known = tables(tree)
    idle = {namespace(plugin) for plugin in LOCAL_PLANNERS} - {_local_planner(tree)}
    for path, parameters in known.items():
        have, here = branch(tree, path), branch(full, path, create=True)
        for p in parameters:
            if f"{path}/{p.name}" in known:
                continue  # a layer has this name, and nothing reads the parameter
            named = [have[name] for name in p.names if p.reads(have.get(name))]
            if not named and p.name == "controller_frequency" and p.reads(tree.get(p.name)):
                named = [tree[p.name]]  # looked for from the planner's name space upwards
            if path in COSTMAPS and p.name in INHERITED and not (named and p.name == "track_unknown_space"):
                continue  # the layers have it
            label = f"{path}/{p.name}" if path else p.name
            try:
                value = p.taken(named[0] if named else p.default, label)
            except ParameterError:
                if path not in idle:
                    raise
                value = p.default
            here.update(dict.fromkeys(p.names, value))
    _complete_behaviours(tree, full)
    return full


def _complete_behaviours(tree: Dict[str, Any], full: Dict[str, Any]) -> None:
    """Adds the recovery behaviours in force, and the parameters of each that the tree lists."""
    names, full["recovery_behaviors"] = _behaviours(tree), _recoveries(tree)[0]
    for name in names:
        if not NAME.fullmatch(name) or name in full and name not in USUAL:
            why = "something else has this name" if name in full else "a name has letters, digits and _ only"
            raise ParameterError(Finding("recovery_behaviors", f"has the name {name!r}", f"{why}, give another"))
    full["conservative_reset"]["reset_distance"] = full["conservative_reset_dist"]
    full["aggressive_reset"]["reset_distance"] = 4 * full["local_costmap"]["circumscribed_radius"]
    for name in names:
        own = {**full.get(name, {}), **branch(tree, name)}
        full[name] = {
            p.name: p.taken(own[p.name] if p.reads(own.get(p.name)) else p.default, f"{name}/{p.name}")
            for p in BEHAVIOUR
        }


def _contradictions(full: Dict[str, Any]) -> Iterator[Finding]:
    """What only shows in a complete tree: plugins that are not here, and values that cannot be run together."""
    known = {"base_global_planner": GLOBAL_PLANNERS, "base_local_planner": LOCAL_PLANNERS}
    for name, plugins in known.items():
        if full[name] not in plugins:
            yield Finding(name, f"is {full[name]}", f"give {' or '.join(plugins)}")
    planner = namespace(full["base_local_planner"])
    for name in (planner, *COSTMAPS) if planner in full else COSTMAPS:
        yield from (finding.below(name) for finding in CONTRADICTIONS[name](full[name]))
    for name in dict.fromkeys(["rotate_recovery", *_behaviours(full)]):
        turn = {"sim_granularity": math.inf, **full[name], "a turn of": 2 * math.pi}
        yield from (finding.below(name) for finding in too_many_points(turn, "sim_granularity", ["a turn of"]))
    yield from _sources(full)


def _sources(full: Dict[str, Any]) -> Iterator[Finding]:
    """Data types that are not here, and topics of which two sources take different ones."""
    types: Dict[str, str] = {}
    for layer in (layer for name in COSTMAPS for layer in layers(name, full[name]) if layer.kind == OBSTACLE_LAYER):
        for name, own in ((name, branch(full, f"{layer.path}/{name}")) for name in sources(branch(full, layer.path))):
            topic, kind = own["topic"], own["data_type"]
            if kind not in DATA_TYPES:
                yield Finding(f"{layer.path}/{name}/data_type", f"is {kind}", f"give {' or '.join(DATA_TYPES)}")
            if types.setdefault(topic, kind) != kind:
                value = f"takes {kind} from the topic {topic}, another source takes {types[topic]}"
                yield Finding(f"{layer.path}/{name}", value, "give one type")


def _recoveries(tree: Dict[str, Any]) -> Tuple[List[Dict[str, str]], List[Finding]]:
    """The recovery behaviours in force, and what there is to say of a tree's list.

    As in move_base.cpp, loadRecoveryBehaviors, the default ones take the place of a list with a mistake, and a type may
    lack its package. Types that are not here are left out.
    """
    listed = tree.get("recovery_behaviors", DEFAULT_RECOVERIES)
    entries = listed if isinstance(listed, list) else [listed]
    names = [e.get("name") if isinstance(e, dict) and isinstance(e.get("type"), str) else None for e in entries]
    for entry, name in zip(entries, names):
        again = names.count(name) > 1 and listed != DEFAULT_RECOVERIES
        if again or not isinstance(name, str):
            value = f"has the name {name!r} more than once" if isinstance(name, str) else f"has {entry!r}"
            instead = "as in C++ the default behaviours count; give each a name of its own and a type"
            return DEFAULT_RECOVERIES, [Finding("recovery_behaviors", value, instead, "warning")]
    types = {namespace(kind): kind for kind in RECOVERY_TYPES}
    here = [dict(entry, type=types.get(namespace(entry["type"]), entry["type"])) for entry in entries]
    absent = [f"has {entry['type']}" for entry in here if entry["type"] not in RECOVERY_TYPES]
    left = "that behaviour is not here, the rest counts"
    found = [Finding("recovery_behaviors", value, left, "warning") for value in absent]
    return [entry for entry in here if entry["type"] in RECOVERY_TYPES], found


def _behaviours(tree: Dict[str, Any]) -> List[str]:
    """The names that recovery_behaviors lists; none where the default ones are in force."""
    found, _ = _recoveries(tree)
    return [] if found == DEFAULT_RECOVERIES else [behaviour["name"] for behaviour in found]
