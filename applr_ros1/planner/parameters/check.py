"""Checks, converts and completes parameter trees against the declarations.

MoveBase completes what it is given; the node prints check()'s lines at start-up.
"""

from __future__ import annotations

import difflib
import math
from typing import Any, Dict, List, Optional, Tuple

import numpy as np

from applr_ros1.planner.costmap import footprint
from applr_ros1.planner.parameters.declarations import (
    BEHAVIOUR,
    GLOBAL_PLANNERS,
    LOCAL_PLANNERS,
    MAX_CELLS,
    PLUGINS,
    RECOVERY_TYPES,
    SERVERS,
    STATIC,
    Parameter,
    ParameterError,
    namespace,
)
from applr_ros1.planner.parameters.dwa_planner_parameters import check_together, remarks
from applr_ros1.planner.variant import Variant


def branch(tree: Dict[str, Any], path: str, create: bool = False) -> Optional[Dict[str, Any]]:
    """The sub-dict of a nested tree at "a/b" (the tree itself at ""); None where there is none."""
    here: Any = tree
    for part in filter(None, path.split("/")):
        here = here.setdefault(part, {}) if create else here.get(part)
        if not isinstance(here, dict):
            return None
    return here


def convert(p: Parameter, value: Any, label: str = "") -> Any:
    """`value` as p's type, bounds aside. ParameterError for another type, NaN, infinity or a useless 0."""
    label = label or p.name
    number = isinstance(value, (int, float)) and not isinstance(value, bool)
    if p.type == "double" and number or p.type == "int" and number and value == value // 1:
        if not math.isfinite(value):
            raise ParameterError("%s is %r: give a finite number" % (label, value))
        if p.not_zero and value == 0:
            raise ParameterError("%s is 0, which cannot work: give a number above it" % label)
        return float(value) if p.type == "double" else int(value)
    if p.type == "bool" and isinstance(value, bool) or p.type == "list" and isinstance(value, list):
        return value
    if p.type == "str" and isinstance(value, (str, list)):
        text = value if isinstance(value, str) else str(value)
        if p.name == "footprint":
            _check_outline(text, label)
        return text
    kind = {"double": "a finite number", "int": "a whole number", "bool": "true or false", "str": "text"}
    raise ParameterError("%s is %r: give %s" % (label, value, kind.get(p.type, "a list")))


def clamp(p: Parameter, value: Any) -> Any:
    """`value` moved into p's bounds."""
    return min(max(value, p.min), p.max) if p.type in ("double", "int") else value


def _check_outline(text: str, label: str) -> None:
    """Raise ParameterError where a footprint parameter is no list of at least three points within 100 m."""
    try:
        good = bool((np.abs(footprint.parse(text)) < 100.0).all())
    except footprint.FootprintError:
        good = False
    if not good:
        shown = text if len(text) < 60 else text[:57] + "..."
        raise ParameterError("%s is %s: give at least three points, [[x, y], ...] in metres" % (label, shown))


def table(path: str, sources: Optional[Dict[str, str]] = None) -> Optional[Tuple[Parameter, ...]]:
    """All parameters at one place of the tree, or None. `sources` names each obstacle layer's scan source."""
    sources = sources or {}
    layer, _, name = path.rpartition("/")
    if layer in sources and name == sources[layer]:
        path = layer + "/scan"
    if path in SERVERS or path in STATIC:
        return SERVERS.get(path, ()) + STATIC.get(path, ())
    return None


def _sources(tree) -> Dict[str, str]:
    found = {}
    for layer in ("global_costmap/obstacles_layer", "local_costmap/obstacles_layer"):
        name = (branch(tree, layer) or {}).get("observation_sources")
        found[layer] = name.strip() if isinstance(name, str) and name.strip() else "scan"
    return found


def _behaviours(tree) -> List[str]:
    listed = tree.get("recovery_behaviors")
    return [str(b.get("name")) for b in listed if isinstance(b, dict)] if isinstance(listed, list) else []


def check(tree: Dict[str, Any]) -> List[str]:
    """What is wrong with a nested parameter tree: one line each (what, value, remedy); [] if nothing is."""
    problems: List[str] = []
    _check(tree, "", _sources(tree), _behaviours(tree), problems)
    if not problems:
        try:
            complete(tree)
        except ParameterError as problem:
            problems.append(str(problem))
    return problems


def remark(tree: Dict[str, Any]) -> List[str]:
    """What a tree without mistakes gives in vain, or at a risk: one line each."""
    if namespace(tree.get("base_local_planner", LOCAL_PLANNERS[0])) != "DWAPlannerROS":
        return []
    lines = remarks(tree.get("DWAPlannerROS", {}), tree.get("latch_xy_goal_tolerance", False))
    return ["DWAPlannerROS/" + line for line in lines]


def _check(here, path, sources, behaviours, problems):
    known = {name: p for p in table(path, sources) or BEHAVIOUR for name in (p.name,) + p.aliases}
    for key, value in here.items():
        label = "%s/%s" % (path, key) if path else str(key)
        if isinstance(value, dict) and (
            table(label, sources) is not None
            or label in behaviours
            or any(other.startswith(label + "/") for other in STATIC)
        ):
            _check(value, label, sources, behaviours, problems)
        elif key not in known:
            close = difflib.get_close_matches(str(key), known, 1)
            problems.append(
                "%s: no such parameter; %s" % (label, "did you mean %s?" % close[0] if close else "remove it")
            )
        else:
            p = known[key]
            try:
                value = convert(p, value, label)
                if clamp(p, value) != value and not p.clamps:
                    problems.append("%s is %r: give a value from %r to %r" % (label, value, p.min, p.max))
            except ParameterError as problem:
                problems.append(str(problem))


def complete(tree: Dict[str, Any]) -> Dict[str, Any]:
    """The tree with every absent parameter at its default and both names of each alias; a new nested dict.

    A scan source always stands under "scan". ParameterError, one line, for what cannot be run.
    """
    full: Dict[str, Any] = {}
    sources = _sources(tree)
    for path in dict.fromkeys(list(SERVERS) + list(STATIC)):
        given = path
        if path.endswith("/scan"):
            given = path[:-4] + sources[path[:-5]]
        have, here = branch(tree, given) or {}, branch(full, path, create=True)
        assert here is not None  # it has just been created
        for p in table(path) or ():
            label = "%s/%s" % (given, p.name) if given else p.name
            named = [have[name] for name in (p.name,) + p.aliases if name in have]
            if not named and p.name == "controller_frequency" and p.name in tree:
                named = [tree[p.name]]  # looked for from the planner's name space upwards
            if any(other != named[0] for other in named):
                raise ParameterError(
                    "%s is %r but its other name %s is %r: give one of them" % (label, named[0], p.aliases[0], named[1])
                )
            value = convert(p, named[0] if named else p.default, label)
            here.update({name: value for name in (p.name,) + p.aliases})
    full["conservative_reset"]["reset_distance"] = full["conservative_reset_dist"]
    full["aggressive_reset"]["reset_distance"] = 4 * full["local_costmap"]["circumscribed_radius"]
    for name in _behaviours(tree):
        own = branch(tree, name) or {}
        usual = full.get(name, {})
        full[name] = {p.name: own.get(p.name, usual.get(p.name, p.default)) for p in BEHAVIOUR}
    _check_whole(full)
    return full


def _check_whole(full):
    """What only shows when several parameters are looked at together, and the plugins there are."""
    Variant(full["applr"]["weights"] or None).checked()
    known = {"base_global_planner": GLOBAL_PLANNERS, "base_local_planner": LOCAL_PLANNERS}
    for name, plugins in known.items():
        if full[name] not in plugins:
            raise ParameterError("%s is %s: give %s" % (name, full[name], " or ".join(plugins)))
    if namespace(full["base_local_planner"]) == "DWAPlannerROS":
        check_together(full["DWAPlannerROS"])
    for name in ("global_costmap", "local_costmap"):
        costmap = full[name]
        cells = costmap["width"] * costmap["height"] / costmap["resolution"] ** 2
        if cells > MAX_CELLS:
            raise ParameterError(
                "%s/width, height are %d x %d m at %g m, %.3g cells: give at most %g"
                % (name, costmap["width"], costmap["height"], costmap["resolution"], cells, MAX_CELLS)
            )
        if costmap["plugins"] != PLUGINS:
            raise ParameterError("%s/plugins is %r: give %r" % (name, costmap["plugins"], PLUGINS))
        layer = costmap["obstacles_layer"]
        if layer["scan"]["data_type"] != "LaserScan" or " " in layer["observation_sources"].strip():
            raise ParameterError(
                "%s/obstacles_layer: give one source in observation_sources, with data_type LaserScan" % name
            )
    topics = [full[name]["obstacles_layer"]["scan"]["topic"] for name in ("global_costmap", "local_costmap")]
    if topics[0] != topics[1]:
        raise ParameterError("the costmaps' scans have the topics %s and %s: give the same" % tuple(topics))
    for key in ("global_frame", "robot_base_frame"):
        if full["global_costmap"][key] != full["local_costmap"][key]:
            raise ParameterError(
                "%s is %s in global_costmap and %s in local_costmap: give the same"
                % (key, full["global_costmap"][key], full["local_costmap"][key])
            )
    for behaviour in full["recovery_behaviors"]:
        if not isinstance(behaviour, dict) or behaviour.get("type") not in RECOVERY_TYPES:
            raise ParameterError(
                "recovery_behaviors has %r: give a name and a type of %s" % (behaviour, " or ".join(RECOVERY_TYPES))
            )
