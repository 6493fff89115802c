"""The check of a robot's folder: robot.yaml, its move_base parameters, and what they say of each other.

Errors are findings that the robot cannot drive with, remarks those that it will not drive well with, warnings are about
names that may be misspelt. What C++ does not read is one remark per file. check_robot.py prints all of them; `load` of
folder.py stops at errors. Values that are given beside a robot's folder, on ROS's parameter server, are checked by
planner.parameters.check alone, which allows what the C++ node allows.
"""

from __future__ import annotations

import os
import re
from contextlib import suppress
from itertools import chain
from math import ceil, inf, isnan, pi
from types import SimpleNamespace
from typing import Any, Dict, Iterable, Iterator, List, Tuple, get_args

import numpy as np
from pydantic import ValidationError

from applr_ros1.common.errors import Finding, meant
from applr_ros1.common.trees import branch
from applr_ros1.planner.parameters.check import UNREAD_NAME, check, complete, warnings, without
from applr_ros1.planner.parameters.declarations import LOCAL_PLANNERS, namespace, servers
from applr_ros1.planner.parameters.layers import (
    COSTMAPS,
    INFLATION_LAYER,
    OBSTACLE_LAYER,
    STATIC_LAYER,
    layers,
    sources,
)
from applr_ros1.planner.parameters.parameter import ParameterError
from applr_ros1.robots import geometry, rules
from applr_ros1.robots.robot import FILE, Robot, SpaceParameter, number_at

SEVERITIES = ("error", "warning", "remark")
WIDTH = 0.53  # of the Jackal's padded footprint [m], for which the recipe of the worlds was made
EIGHT = np.arange(8) * pi / 4  # directions, to sides and corners
_MAPPING = "give a mapping of names and values"
_GIVE = {  # by pydantic's kind of mistake; otherwise its own words count
    "string_pattern_mismatch": "give a name such as front/scan",
    "tuple_type": "give a list",
    "dict_type": _MAPPING,
    "model_type": _MAPPING,
    "greater_than_equal": "give at least {ge:g} {unit}",
    "less_than_equal": "give at most {le:g} {unit}",
    "too_short": "give at least {min_length} of them",
    "too_long": "give at most {max_length} of them",
}


def findings(robot: Robot, found: Iterable[Finding] = (), setups: Iterable[bool] = (False, True)) -> List[Finding]:
    """Return all that there is to say about a robot's folder: errors, warnings, and one remark per file.

    Args:
        robot: As `folder.read` gives it, as far as its files can be read.
        found: What is wrong with its robot.yaml.
        setups: False is that without a map, True the one with it; those that it does not have are left out.
    """
    there = [with_map for with_map in setups if robot.move_base.with_map is not None or not with_map]
    found = [finding for with_map in there for finding in of_setup(robot, with_map, found)]
    found = list({finding._replace(file=""): finding for finding in reversed(found)}.values())[::-1]
    remarks = [finding for finding in found if finding.severity == "remark"]
    files = dict.fromkeys(finding.file for finding in remarks)
    joined = [in_one_line([finding for finding in remarks if finding.file == file]) for file in files]
    found = [finding for finding in found if finding.severity != "remark"] + joined
    return sorted(found, key=lambda finding: SEVERITIES.index(finding.severity))


def of_setup(robot: Robot, with_map: bool = False, found: Iterable[Finding] = ()) -> List[Finding]:
    """All that there is to say about a robot's folder, each finding with its file: errors, warnings, remarks.

    What only follows from an error, such as a limit that is beyond a wrong speed, is left out.

    with_map: with its files for a map, instead of those without. found: what is wrong with its robot.yaml.
    """
    setup, found = _Setup(robot, with_map), list(found)
    own = [finding.key for finding in found if finding.file == setup.own]
    lacking = any(file.problem for file in robot.files(with_map))
    stages = (_parameters, _names) if lacking else (_parameters, _names, _rules, _space)
    for stage in stages if not any(key.startswith("move_base") for key in own) else ():
        wrong = [key if key in own else key.rpartition("/")[2] for key in (f.key for f in found if _stops(f))]
        follows = re.compile(rf"\b({'|'.join(map(re.escape, wrong))})\b" if wrong else "$^")
        found += [finding for finding in stage(setup) if not follows.search(f"{finding.key}: {finding.advice}")]
    stopped = {(finding.file, finding.key) for finding in found if _stops(finding)}
    found = [f for f in dict.fromkeys(found) if _stops(f) or (f.file, f.key) not in stopped]
    return sorted(found, key=lambda finding: SEVERITIES.index(finding.severity))


def place_of(robot: Robot, path: str) -> Tuple[str, str]:
    """Return file and key where a parameter of the set-up without a map stands, such as DWAPlannerROS/max_vel_x."""
    return _Setup(robot, False).place(path)


def _stops(finding: Finding) -> bool:
    return finding.severity == "error"


def in_one_line(findings: List[Finding]) -> Finding:
    """Join findings about one file to one, which says once what they say of several keys."""
    alike: Dict[Tuple[str, str], List[str]] = {}
    for finding in findings:
        alike.setdefault((finding.value, finding.advice), []).append(finding.key)
    texts = []
    for (value, advice), keys in alike.items():
        value = re.sub("^is ", "are ", re.sub("^has ", "have ", value)) if keys[1:] else value
        texts.append(str(Finding(", ".join(keys), value, advice)))
    return findings[0]._replace(key="; ".join(texts), value="", advice="")


# --- robot.yaml ------------------------------------------------------------------------------------------------------


def refused(model: Any, error: ValidationError) -> List[Finding]:
    """Return what pydantic refused in the values of a model, unknown names first."""
    found = sorted(error.errors(), key=lambda problem: problem["type"] != "extra_forbidden")
    return list(dict.fromkeys(_finding(model, problem) for problem in found))


def _finding(model: Any, problem: Any) -> Finding:
    kind, parts = problem["type"], [part for part in problem["loc"] if part != "[key]"]
    few = kind == "missing" and isinstance(parts[-1], int)  # numbers in a list
    label = "".join(f"[{part}]" if isinstance(part, int) else f".{part}" for part in parts[: -1 if few else None])[1:]
    if kind == "value_error":  # one of ours: "NAME is VALUE: ADVICE"
        key, _, rest = str(problem["ctx"]["error"]).partition(" ")
        value, _, advice = rest.partition(": ")
        return Finding(f"{label}.{key}", value, advice)
    known, unit = _declared(model, parts)
    if kind == "extra_forbidden":
        return Finding(label, "is unknown", meant(parts[-1], known, "there are " + ", ".join(known)))
    if kind == "missing" and not few:
        return Finding(label, "is missing", "give it")
    give = "give more numbers" if few else _GIVE.get(kind, problem["msg"].replace("Input should be", "give"))
    return Finding(label, f"is {problem['input']!r:.60}", give.format(**problem.get("ctx", {}), unit=unit).rstrip())


def _declared(kind: Any, parts: Iterable[Any]) -> Tuple[Dict[str, Any], str]:
    """The names that the last section on the way to a value knows, and the value's unit ("" for none)."""
    known: Dict[str, Any] = {}
    unit = ""
    for part in parts:
        while not hasattr(kind, "model_fields") and get_args(kind):  # Optional, Dict or Tuple of sections
            kind = next((one for one in reversed(get_args(kind)) if one not in (type(None), ...)), None)
        known = getattr(kind, "model_fields", known)
        if part in known:
            kind, unit = known[part].annotation, (known[part].json_schema_extra or {}).get("unit", "")
    return known, unit


def contradictions(robot: Robot) -> List[Finding]:
    """Return what the fields of robot.yaml say against each other."""
    base, body, laser = robot.base, robot.body, robot.laser
    (x, y, _), skids = laser.pose, base.drive == "skid_steer" or not base.drive and base.wheelbase
    m = SimpleNamespace(
        skids=skids,
        on_gazebo=robot.simulation.ground == "gazebo",
        turn=laser.last_angle - laser.first_angle,
        blind=laser.range_min,
    )
    m.ground = base.axle_height - base.wheel_radius
    m.back, m.front, m.right, m.left = geometry.bounding_box(robot)
    m.laser_off = max(m.back - x, x - m.front, m.right - y, y - m.left)
    stands = (base.wheelbase if skids else base.casters) and np.isfinite(geometry.supports(base)).all()
    mass, _, loads = geometry.balance(robot) if stands else (0.0, (), np.zeros(1))
    m.on_axle = not skids and bool(base.casters) and max(abs(x) for x, _ in base.casters) < rules.ON_AXLE
    m.casters = ", ".join(f"[{x:g}, {y:g}]" for x, y in base.casters)
    full = [body.mass * (sum(size**2 for size in body.size) - own**2) / 12 for own in body.size]
    m.full = ", ".join(f"{moment:.2g}" for moment in full)
    least, most = rules.UNLIKE
    m.unlike = any(not least < own / of_box < most for own, of_box in zip(body.inertia or (), full) if of_box > 0.0)
    m.tips = loads.min() < -1e-4 * mass * geometry.GRAVITY  # right above the axle it stands
    return list(rules.apply(rules.ROBOT, robot, m))


# --- its parameter files ----------------------------------------------------------------------------------------------


class _Setup:
    """A robot's parameters with or without a map, and where in its files each of them stands.

    Attributes:
        robot, with_map: As given.
        tree: What the files give, nested.
        full: The same with defaults, also in place of wrong values; {} where they cannot be used at all.
        planner: Name space of the local planner.
        box: Smallest x, largest x, smallest y, largest y of body and wheels [m]; length, width: of it.
    """

    def __init__(self, robot: Robot, with_map: bool):
        self.robot, self.with_map = robot, with_map
        self.tree, self.full = robot.parameters(with_map), {}  # type: Dict[str, Any], Dict[str, Any]
        self.planner = robot.local_planner
        back, front, right, left = self.box = geometry.bounding_box(robot)
        self.length, self.width = front - back, left - right
        self._places: Dict[str, Tuple[str, str]] = {}  # {path in the tree: (file, path in it)}
        for file in robot.files(with_map):
            start = file.namespace.strip("/")
            for path in _paths(file.values):
                full = "/".join(filter(None, (start, path)))
                if path or full not in self._places:
                    self._places[full] = (os.path.join(robot.folder, file.file), path)

    def place(self, path: str) -> Tuple[str, str]:
        """File and key of a parameter, such as ("/home/me/my_robot/costmap.yaml", "footprint").

        A layer's value may stand at its costmap, a planner's line may leave its name space out.
        """
        first, _, rest = path.partition("/")
        ends = (known for known in self._places if known.endswith("/" + path))
        for candidate in chain((path, f"{first}/{rest.rpartition('/')[2]}", f"{self.planner}/{path}"), ends):
            if candidate in self._places:
                file, key = self._places[candidate]
                return file, key or candidate
        above, _, name = path.rpartition("/")  # not given: where the rest of its section is
        if above:
            file, key = self.place(above)
            return file, f"{key}/{name}"
        return self.own, f"move_base: {path}"

    @property
    def own(self) -> str:
        """The robot.yaml."""
        return os.path.join(self.robot.folder, FILE)

    def placed(self, finding: Finding) -> Finding:
        """A finding whose key is a path in the tree, with file and key."""
        path, comma, others = finding.key.partition(",")
        file, key = self.place(path)
        return finding._replace(file=file, key=key + comma + others)

    def layers(self, costmap: str, kind: str) -> Iterator[Tuple[str, Dict[str, Any]]]:
        """Yield (path, values) of the layers of this kind in a costmap."""
        found = (layer.path for layer in layers(costmap, self.full[costmap]) if layer.kind == kind)
        return ((path, branch(self.full, path)) for path in found)

    def sources(self, costmap: str) -> Iterator[Tuple[str, Dict[str, Any]]]:
        """Yield (path, values) of the observation sources of a costmap."""
        for path, own in self.layers(costmap, OBSTACLE_LAYER):
            yield from ((f"{path}/{name}", own[name]) for name in sources(own))

    def judged(self, place: str, path: str, values: Dict[str, Any], **measures: Any) -> Iterator[Finding]:
        """Yield what the rules of a place say of the values at a path; measures are beside those of every place."""
        measures.update(vars(self.robot), with_map=self.with_map, length=self.length, width=self.width)
        given = (lambda key: key in branch(self.tree, path)) if path in COSTMAPS else bool
        for finding in rules.apply(place, SimpleNamespace(**values), SimpleNamespace(**measures), given):
            yield self.placed(finding.below(path))


def _paths(tree: Dict[str, Any]) -> Iterator[str]:
    """The paths of a tree and of all that is in it; its own is empty."""
    yield ""
    for name, value in tree.items():
        for path in _paths(value) if isinstance(value, dict) else [""]:
            yield f"{name}/{path}".rstrip("/")


# --- stages ----------------------------------------------------------------------------------------------------------


def _parameters(setup: _Setup) -> Iterator[Finding]:
    """Yield what the planner's declarations say, and that the files are for another planner than that in use."""
    plugins = {namespace(plugin): plugin for plugin in LOCAL_PLANNERS}
    held = [name for name in plugins if name in setup.tree]
    if held and setup.planner not in held:
        given = setup.tree.get("base_local_planner", f"not given, which means {LOCAL_PLANNERS[0]}")
        value = f"is {given}, but the files hold the parameters of {held[0]} alone"
        advice = f"give {plugins[held[0]]}" + f", or a file with the section {setup.planner}" * (
            setup.planner in plugins
        )
        yield setup.placed(Finding("base_local_planner", value, advice))
        setup.tree["base_local_planner"], setup.planner = plugins[held[0]], held[0]
    found = check(setup.tree)
    yield from map(setup.placed, found)
    setup.tree["base_local_planner"] = plugins.get(setup.planner, LOCAL_PLANNERS[0])  # for all other findings
    with suppress(ParameterError):
        setup.full = complete(without(setup.tree, [f for f in found if f.key != "base_local_planner"]))


def _names(setup: _Setup) -> Iterator[Finding]:
    """Yield what is not read, or in vain. A section that a list in the files names is read on the robot."""
    listed = {name for file in setup.robot.files(setup.with_map) for name in _listed(file.values)}
    with suppress(ParameterError):  # one of _parameters
        for finding in warnings(setup.tree):
            if finding.value != UNREAD_NAME:
                yield setup.placed(finding)
            elif finding.key.rpartition("/")[2] not in listed:
                here = " here" * (finding.severity == "remark")
                yield setup.placed(finding)._replace(value=finding.value + here)


def _listed(tree: Dict[str, Any]) -> Iterator[str]:
    """The layers and observation sources that lists in a tree name."""
    yield from str(tree.get("observation_sources", "")).split()
    plugins = tree.get("plugins")
    for entry in plugins if isinstance(plugins, list) else ():
        yield str(entry.get("name")) if isinstance(entry, dict) else ""
    for below in tree.values():
        yield from _listed(below) if isinstance(below, dict) else ()


def _rules(setup: _Setup) -> Iterator[Finding]:
    """Yield what the rules say of the parameters in force."""
    numbers = ((name, number_at(setup.tree, setup.planner, (name,))) for name in branch(setup.tree, setup.planner))
    given = {name: number for name, number in numbers if number is not None}
    yield from setup.judged(rules.GIVEN, setup.planner, given)
    if setup.planner not in setup.full:
        return
    topic = branch(setup.tree, setup.planner).get("odom_topic", setup.robot.topics.odometry)
    values = {**setup.full[setup.planner], "odom_topic": topic}
    yield from setup.judged(rules.PLANNER, setup.planner, values)
    if setup.planner == rules.DWA:
        yield from setup.judged(rules.DWA, rules.DWA, {**values, **_dwa_measures(values)})
    for costmap in COSTMAPS:
        yield from _costmap(setup, costmap)


def _dwa_measures(values: Dict[str, Any]) -> Dict[str, float]:
    """Return what DWAPlannerROS can reach from rest within its window."""
    v = SimpleNamespace(**values)
    period = 1.0 / (v.controller_frequency or 20.0)
    seconds = period if v.use_dwa else v.sim_time
    return {
        "seconds": seconds,
        "reached_speed": min(v.acc_lim_x * seconds, max(v.max_vel_x, -v.min_vel_x)),
        "reached_turn": min(v.acc_lim_theta * seconds, v.max_vel_theta),
        "enough": v.min_vel_theta / seconds if seconds else 0.0,
        "change": v.acc_lim_x * period,
        "braking": 2.0 * v.min_vel_trans / period,
    }


def _costmap(setup: _Setup, costmap: str) -> Iterator[Finding]:
    """Yield what there is to say of footprint, frames, size, and whether the laser's scans reach a costmap."""
    from applr_ros1.planner.costmap import footprint  # needs numba

    own, (back, front, right, left) = setup.full[costmap], setup.box
    local, points = costmap == "local_costmap", footprint.parse(own["footprint"])
    outline = footprint.pad(points if len(points) else footprint.circle(own["robot_radius"]), own["footprint_padding"])
    reach, key = np.ptp(outline, axis=0), "footprint" if len(points) else "robot_radius"
    missing = not {"footprint", "robot_radius"} & {*branch(setup.tree, costmap), *setup.tree}
    corners = [(back, right), (back, left), (front, left), (front, right)]
    box = ", ".join(f"[{x:.3g}, {y:.3g}]" for x, y in corners)
    fixed, goal = not (setup.with_map or own["rolling_window"]), rules.GOAL_AHEAD_M * setup.robot.world_scale
    ahead = own["width"] + own["origin_x"] if fixed else own["width"] / 2 if own["rolling_window"] else inf
    measures = {
        "local": local,
        "fixed": fixed,
        **{"ahead": ahead, "goal": goal, "wide": own["width"] + (2 - fixed) * ceil(max(0.0, goal - ahead) + 0.5)},
        **{"centred_x": -own["width"] / 2, "centred_y": -own["height"] / 2, "reach": reach, "missing": missing},
        "fill": "give that of body and wheels" if isnan(setup.width) else f"body and wheels fill [{box}], give that",
        "wrong_units": "",
    }
    if not missing and (reach[1] < setup.width / rules.UNITS or reach[1] > setup.width * rules.UNITS):
        measures["wrong_units"] = "footprint_padding" if abs(own["footprint_padding"]) > setup.length else key
    yield from setup.judged(rules.COSTMAP, costmap, own, **measures)
    for path, values in setup.layers(costmap, INFLATION_LAYER):
        yield from setup.judged(rules.INFLATION, path, values)
    for path, _ in setup.layers(costmap, STATIC_LAYER):
        yield from setup.judged(rules.STATIC, costmap, {"plugins": path.rpartition("/")[2]})
    found = list(setup.sources(costmap))
    blind = [list(setup.judged(rules.BLIND, path, values)) for path, values in found]
    if found and all(blind):
        yield from blind[0]
    for path, values in found:
        yield from setup.judged(rules.SOURCE, path, values)
    if not found and (local or not any(setup.layers(costmap, STATIC_LAYER))):
        advice = "the robot would not see obstacles, give one" if local else "paths lead through obstacles, give one"
        yield setup.placed(Finding(costmap, "has no observation source", advice, "error" if local else "warning"))
    if local and not (missing or measures["wrong_units"]):
        yield from _size_of_the_robot(setup, key, outline)


def _size_of_the_robot(setup: _Setup, key: str, outline: np.ndarray) -> Iterator[Finding]:
    """Yield what does not fit the local costmap's padded footprint (n, 2) [m], which a key gives."""
    fitting, given = np.ptp(outline[:, 1]) / WIDTH, setup.robot.world_scale
    if abs(given / fitting - 1.0) > rules.SCALE_OFF:
        advice = f"by the footprint's width it is {fitting:.3f}, give that"
        yield Finding("world_scale", f"is {given:g}", advice, "remark", setup.own)
    directions = np.array([np.cos(EIGHT), np.sin(EIGHT)])
    beyond = ((geometry.corners(setup.robot) @ directions).max(axis=0) - (outline @ directions).max(axis=0)).max()
    if beyond > rules.OUTSIDE:
        advice = f"the box around body and wheels, at which the monitor stops, reaches {beyond:.2f} m beyond it, padded"
        yield setup.placed(Finding(f"local_costmap/{key}", "is too small", advice, "remark"))


def _space(setup: _Setup) -> Iterator[Finding]:
    """Yield what no parameter space can be made of; nothing where it is for another planner than the files."""
    if setup.planner != setup.robot.local_planner or setup.planner not in setup.full:
        return
    for parameter in setup.robot.space:
        for names, limit, _ in rules.LIMITED:
            first = parameter.sets[0]  # the range includes what the files start with
            start = number_at(setup.full, first.server, first.names) or 0.0
            most = max(getattr(setup.robot.base, limit), abs(start))
            beyond = max(abs(parameter.low), abs(parameter.high)) > most
            if beyond and any(s.server == setup.planner and s.name in names for s in parameter.sets):
                value = f"is [{parameter.low:g}, {parameter.high:g}]"
                advice = f"base.{limit} of this base is {most:g}, stay within it"
                yield Finding(f"parameter_space.{parameter.name}.range", value, advice, file=setup.own)
    yield from (finding._replace(file=setup.own) for finding in space_findings(setup.robot, setup.full))


def space_findings(robot: Robot, full: Dict[str, Any]) -> Iterator[Finding]:
    """Yield what servers of a complete tree do not take of a robot's parameter space: the first of each parameter."""
    known = servers(full)
    for parameter in robot.space:
        key = f"parameter_space.{parameter.name}"
        advice = next(filter(None, (_refusal(parameter, one, known) for one in parameter.sets)), "")
        if not advice:
            start = branch(full, parameter.sets[0].server)[parameter.sets[0].name]
            if not parameter.low <= start <= parameter.high:
                advice = f"move_base starts with {start:g}; include it in the range"
        if advice:
            yield Finding(key, advice=advice)


def _refusal(parameter: SpaceParameter, one: Any, known: Dict[str, Any]) -> str:
    """Return why a parameter cannot set a value of a server; "" where it can."""
    where = f"server {one.server} of move_base" if one.server else "move_base's own server"
    if one.server not in known:
        names = list(filter(None, known))
        return f"there is no {where}; {meant(one.server, names, 'give ' + ', '.join(names))}"
    declared = next((p for p in known[one.server].parameters if one.name in p.names), None)
    if declared is None:
        return f"{where} has no parameter {one.name}; docs/reference/parameters.md lists them"
    if declared.type not in ("double", "int"):
        return f"{one.name} is no number in {where}; take another parameter"
    if (declared.type == "int") != parameter.integer:
        return f"give integer: {str(declared.type == 'int').lower()}, as in {where}"
    low, high = (-parameter.high, -parameter.low) if one.negated else (parameter.low, parameter.high)
    if not declared.min <= low <= high <= declared.max:
        return f"{where} takes {declared.min:g} to {declared.max:g}; stay within it"
    return ""
