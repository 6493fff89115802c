"""Checks of parameter trees: `check` returns errors, `remarks` warnings about ignored values, `complete` adds defaults.

MoveBase completes its parameter tree; the node and robots/check.py print the messages. Names and bounds come from
declarations.tables, conflicts between values from the functions `contradictions`.
"""

from __future__ import annotations

import math
from typing import Any, Dict, Iterator, List, Tuple

from applr_ros1.common.errors import did_you_mean
from applr_ros1.common.trees import branch
from applr_ros1.planner.parameters.costmap_parameters import COSTMAP, DATA_TYPES, STATIC_COSTMAP
from applr_ros1.planner.parameters.declarations import (
    CONTRADICTIONS,
    GLOBAL_PLANNERS,
    LOCAL_PLANNERS,
    namespace,
    tables,
)
from applr_ros1.planner.parameters.layers import (
    COSTMAPS,
    FOUND_ABOVE,
    INHERITED,
    OBSTACLE_LAYER,
    arranged,
    layers,
    replaced,
    sources,
)
from applr_ros1.planner.parameters.move_base_parameters import (
    BEHAVIOUR,
    DEFAULT_RECOVERIES,
    RECOVERY_TYPES,
)
from applr_ros1.planner.parameters.parameter import Parameter, ParameterError, too_many_points

USUAL = tuple(behaviour["name"] for behaviour in DEFAULT_RECOVERIES)


def check(tree: Dict[str, Any]) -> List[str]:
    """Return the errors of a nested parameter tree: invalid values or, if none is invalid, conflicting values."""
    try:
        errors, _ = _inspect(arranged(tree))
        return errors or list(_contradictions(_completed(tree)))
    except ParameterError as problem:
        return [str(problem)]


def remarks(tree: Dict[str, Any]) -> List[str]:
    """Return warnings about a tree without errors: values that are ignored, replaced or risky."""
    planner = _local_planner(tree)
    own = branch(tree, planner)
    lines = [*_recoveries(tree)[1], *replaced(tree), *_inspect(arranged(tree))[1]]
    sideways = own.get("min_vel_y", -0.1), own.get("max_vel_y", 0.1)
    if planner == "DWAPlannerROS" and any(sideways):
        lines.append(
            f"{planner}/min_vel_y, max_vel_y are {sideways}: the base cannot drive sideways, give 0 for both"
        )
    return lines + list(_risks(arranged(tree)))


def _risks(tree: Dict[str, Any]) -> Iterator[str]:
    """Yield a warning if the local costmap has no sources or if the costmaps have different base frames."""
    world, local = (branch(tree, name).get("robot_base_frame", "base_link") for name in COSTMAPS)
    if world != local:
        yield f"local_costmap/robot_base_frame is {local}: both costmaps use {world} of global_costmap, give {world}"
    seen = [
        layer
        for layer in layers("local_costmap", branch(tree, "local_costmap"))
        if layer.kind == OBSTACLE_LAYER
    ]
    if not any(sources(branch(tree, layer.path)) for layer in seen):
        yield "local_costmap has no observation source: the robot will not detect obstacles, give a source"


def _inspect(tree: Dict[str, Any]) -> Tuple[List[str], List[str]]:
    """Return errors and warnings about the names and values of an arranged tree."""
    errors: List[str] = []
    lines: List[str] = []
    unread: List[str] = []
    idle = {namespace(plugin) for plugin in LOCAL_PLANNERS} - {_local_planner(tree)}
    used = {name: value for name, value in tree.items() if name not in idle}
    _walk(used, "", tables(tree), _behaviours(tree), errors, lines, unread)
    if unread:
        lines.append(f"{', '.join(unread)}: unknown, ignored")
    return errors, lines


def _walk(
    here: Any,
    path: str,
    known: Any,
    behaviours: Any,
    errors: List[str],
    lines: List[str],
    unread: List[str],
) -> None:
    """Append errors, warnings and unknown names of a section and of all sections below it."""
    mine = {name: p for p in known.get(path, BEHAVIOUR) for name in p.names}
    if path in COSTMAPS:
        mine = dict(INHERITED, **mine)
    elif not path:
        mine.update((p.name, p) for p in COSTMAP + STATIC_COSTMAP if p.name in FOUND_ABOVE)
    older = {old: p.name for p in mine.values() for old in p.older}
    start = f"{path}/" if path else ""
    below = [name[len(start) :] for name in [*known, *behaviours] if name.startswith(start)]
    for key, value in here.items():
        label = f"{start}{key}"
        if isinstance(value, dict) and (label in known or label in behaviours):
            _walk(value, label, known, behaviours, errors, lines, unread)
        elif key in mine and not isinstance(value, dict):
            _examine(mine[key], value, label, errors, lines)
        elif not path and label in known and value is not None:
            errors.append(f"{label} is {value!r}: give a mapping of names and values")
        elif value is not None:
            absent = [
                name for name in (below if isinstance(value, dict) else mine) if not here.get(name)
            ]
            advice = f"give {older[key]}" if key in older else did_you_mean(key, absent)
            if advice:
                lines.append(f"{label} is ignored: {advice}")
            elif not isinstance(value, dict):
                unread.append(label)


def _examine(p: Parameter, value: Any, label: str, errors: List[str], lines: List[str]) -> None:
    """Append an error or a warning if a value is not used as given."""
    if not p.reads(value):
        if p.type != "list":  # _recoveries reports lists.
            lines.append(
                f"{label} is {value!r}: the default {p.default!r} is used, as in C++; {p.give}"
            )
        return
    try:
        converted, taken = p.convert(value, label), p.taken(value, label)
    except ParameterError as problem:
        errors.append(str(problem))
        return
    if taken != converted and p.beyond == "error":
        errors.append(f"{label} is {converted!r}: give a value from {p.min!r} to {p.max!r}")
    elif taken != converted and p.beyond:
        lines.append(
            f"{label} is {converted!r}: {taken!r} is used, give a value from {p.min!r} to {p.max!r}"
        )


def _local_planner(tree: Dict[str, Any]) -> str:
    return namespace(str(tree.get("base_local_planner", LOCAL_PLANNERS[0])))


def complete(tree: Dict[str, Any]) -> Dict[str, Any]:
    """Return a new nested dict of the tree with defaults for all absent parameters and both names of each alias.

    The parameters of layers and sources are in the sections where C++ reads them (layers.arranged), and `plugins` is
    always present. Values that layers inherit from their costmap are given only at the layers, except for a
    track_unknown_space at the costmap.

    Raises:
        ParameterError: A value is invalid, or values conflict; the message is one line.
    """
    full = _completed(tree)
    for line in _contradictions(full):
        raise ParameterError(line)  # Only the first conflict is reported.
    return full


def _completed(tree: Dict[str, Any]) -> Dict[str, Any]:
    """Return the same as `complete`, without checking for conflicts between values."""
    full: Dict[str, Any] = {}
    tree = arranged(tree)
    known = tables(tree)
    idle = {namespace(plugin) for plugin in LOCAL_PLANNERS} - {_local_planner(tree)}
    for path, parameters in known.items():
        have, here = branch(tree, path), branch(full, path, create=True)
        for p in parameters:
            if f"{path}/{p.name}" in known:
                continue  # A layer has this name, so nothing reads the parameter.
            named = [have[name] for name in p.names if p.reads(have.get(name))]
            if not named and p.name == "controller_frequency" and p.reads(tree.get(p.name)):
                named = [tree[p.name]]  # C++ searches for it from the planner's name space upwards.
            if (
                path in COSTMAPS
                and p.name in INHERITED
                and not (named and p.name == "track_unknown_space")
            ):
                continue  # The parameter is completed at the layers.
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
    """Add the active recovery behaviours and the parameters of each behaviour that the tree lists."""
    names, full["recovery_behaviors"] = _behaviours(tree), _recoveries(tree)[0]
    for name in names:
        if name in full and name not in USUAL:
            raise ParameterError(
                f"recovery_behaviors has the name {name!r}, which is already in use: give another one"
            )
    full["conservative_reset"]["reset_distance"] = full["conservative_reset_dist"]
    full["aggressive_reset"]["reset_distance"] = 4 * full["local_costmap"]["circumscribed_radius"]
    for name in names:
        own = {**full.get(name, {}), **branch(tree, name)}
        full[name] = {
            p.name: p.taken(
                own[p.name] if p.reads(own.get(p.name)) else p.default, f"{name}/{p.name}"
            )
            for p in BEHAVIOUR
        }


def _contradictions(full: Dict[str, Any]) -> Iterator[str]:
    """Yield the errors of a complete tree: plugins that are not available, and values that conflict."""
    known = {"base_global_planner": GLOBAL_PLANNERS, "base_local_planner": LOCAL_PLANNERS}
    for name, plugins in known.items():
        if full[name] not in plugins:
            yield f"{name} is {full[name]}: give {' or '.join(plugins)}"
    planner = namespace(full["base_local_planner"])
    for name in (planner, *COSTMAPS) if planner in full else COSTMAPS:
        yield from (f"{name}/{line}" for line in CONTRADICTIONS[name](full[name]))
    for name in dict.fromkeys(["rotate_recovery", *_behaviours(full)]):
        turn = {"sim_granularity": math.inf, **full[name], "a turn of": 2 * math.pi}
        yield from (
            f"{name}/{line}" for line in too_many_points(turn, "sim_granularity", ["a turn of"])
        )
    for layer in (
        layer
        for name in COSTMAPS
        for layer in layers(name, full[name])
        if layer.kind == OBSTACLE_LAYER
    ):
        for source in sources(branch(full, layer.path)):
            kind = branch(full, f"{layer.path}/{source}")["data_type"]
            if kind not in DATA_TYPES:
                yield f"{layer.path}/{source}/data_type is {kind}: give {' or '.join(DATA_TYPES)}"


def _recoveries(tree: Dict[str, Any]) -> Tuple[List[Dict[str, str]], List[str]]:
    """Return the active recovery behaviours, and warnings about the list of a tree.

    As in move_base.cpp, loadRecoveryBehaviors, the default behaviours replace an invalid list, and a type may be given
    without its package. Types that are not available are left out.
    """
    listed = tree.get("recovery_behaviors", DEFAULT_RECOVERIES)
    entries = listed if isinstance(listed, list) else [listed]
    names = [
        e.get("name") if isinstance(e, dict) and isinstance(e.get("type"), str) else None
        for e in entries
    ]
    for entry, name in zip(entries, names):
        again = names.count(name) > 1 and listed != DEFAULT_RECOVERIES
        if again or not isinstance(name, str):
            advice = "the default behaviours are used, as in C++; give each behaviour a unique name and a type"
            return DEFAULT_RECOVERIES, [f"recovery_behaviors has {entry!r}: {advice}"]
    types = {namespace(kind): kind for kind in RECOVERY_TYPES}
    here = [
        dict(entry, type=types.get(namespace(entry["type"]), entry["type"])) for entry in entries
    ]
    absent = [entry["type"] for entry in here if entry["type"] not in RECOVERY_TYPES]
    lines = [
        f"recovery_behaviors has {kind}: this type is not available, the others are used"
        for kind in absent
    ]
    return [entry for entry in here if entry["type"] in RECOVERY_TYPES], lines


def _behaviours(tree: Dict[str, Any]) -> List[str]:
    """Return the names in recovery_behaviors, or an empty list if the default behaviours are active."""
    behaviours, _ = _recoveries(tree)
    return (
        [] if behaviours == DEFAULT_RECOVERIES else [behaviour["name"] for behaviour in behaviours]
    )
