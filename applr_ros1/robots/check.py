"""The check of a robot's folder: its move_base parameters, and what they and robot.yaml say of each other.

Errors are findings that the robot cannot drive with, remarks those that it will not drive well with, warnings are about
names that may be misspelt. What C++ does not read is one remark per file. check_robot.py prints all of them. Commands
that drive a robot take it from `with_remarks`, the nodes from `usable`; they stop at errors. Values that are given
beside a robot's folder, on ROS's parameter server, are checked by planner.parameters.check alone, which allows what the
C++ node allows.
"""

from __future__ import annotations

import atexit
import os
import re
import sys
from contextlib import suppress
from functools import lru_cache
from itertools import chain
from math import isnan, pi
from types import SimpleNamespace
from typing import Any, Dict, Iterable, Iterator, List, Tuple

import numpy as np

from applr_ros1.common.errors import Finding, meant
from applr_ros1.common.trees import branch
from applr_ros1.planner.costmap import footprint
from applr_ros1.planner.costmap.grid import INSCRIBED
from applr_ros1.planner.dwa.samples import SLACK
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
from applr_ros1.robots import NAMES, Robot, geometry, load
from applr_ros1.robots.description import SpaceParameter, find
from applr_ros1.robots.mistakes import Rule, apply, at_most, in_one_line, refuse, same_name
from applr_ros1.robots.parameter_files import FILE
from applr_ros1.robots.reader import described

DWA = "DWAPlannerROS"
SPEEDS = ("max_vel_x", "min_vel_x", "max_vel_trans", "min_vel_trans", "max_trans_vel", "min_trans_vel", "escape_vel")
TURNS = (
    *("max_vel_theta", "min_vel_theta", "max_rot_vel", "min_rot_vel", "max_rotational_vel"),
    *("min_in_place_vel_theta", "min_in_place_rotational_vel"),
)
LIMITED = ((SPEEDS, "max_speed", "m/s"), (TURNS, "max_yaw_rate", "rad/s"))  # by a field of base
SEVERITIES = ("error", "warning", "remark")
UNITS = 10.0  # a length that is so many times another one is in centimetres or millimetres
WIDTH = 0.53  # of the Jackal's padded footprint [m], for which the recipe of the worlds was made
SCALE_OFF = 0.15  # share by which world_scale may differ from the one that follows from the footprint
EIGHT = np.arange(8) * pi / 4  # directions, to sides and corners
OUTSIDE = 0.01  # m by which body and wheels may reach beyond the padded footprint


def findings(robot: Robot, with_map: bool = False, found: Iterable[Finding] = ()) -> List[Finding]:
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


def _stops(finding: Finding) -> bool:
    return finding.severity == "error"


def examined(name_or_folder: str, setups: Iterable[bool] = (False, True)) -> Tuple[Robot, List[Finding]]:
    """A robot as far as its files can be read, and what there is to say about its folder in setups that it has.

    setups: False is that without a map, True the one with it.
    """
    robot, own = described(name_or_folder)
    there = [with_map for with_map in setups if robot.move_base.with_map is not None or not with_map]
    found = [finding for with_map in there for finding in findings(robot, with_map, own)]
    found = list({finding._replace(file=""): finding for finding in reversed(found)}.values())[::-1]
    remarks = [finding for finding in found if finding.severity == "remark"]
    files = dict.fromkeys(finding.file for finding in remarks)
    joined = [in_one_line([finding for finding in remarks if finding.file == file]) for file in files]
    found = [finding for finding in found if finding.severity != "remark"] + joined
    return robot, sorted(found, key=lambda finding: SEVERITIES.index(finding.severity))


def usable(name_or_folder: str, with_map: bool = False) -> Robot:
    """The robot, whose folder has been checked unless it is an included one. RobotError with each error."""
    if name_or_folder in NAMES:
        return load(name_or_folder)
    robot, found = examined(name_or_folder, [with_map])
    refuse(found)
    return robot


@lru_cache(maxsize=32)
def with_remarks(name_or_folder: str) -> Robot:
    """As `usable`; prints the remarks, once in a process."""
    if name_or_folder in NAMES:
        return load(name_or_folder)
    robot, found = examined(name_or_folder, [False])
    refuse(found)
    for finding in found:
        print(f"{finding.severity}: {finding}", file=sys.stderr)
    atexit.register(_repeat, [finding for finding in found if finding.severity == "warning"], os.getpid())
    return robot


def _repeat(warnings: List[Finding], process: int) -> None:
    """The warnings once more, at the end of what was printed since."""
    for finding in warnings if os.getpid() == process else ():
        print(f"warning: {finding}", file=sys.stderr)


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
        """(path, values) of the layers of this kind in a costmap."""
        found = (layer.path for layer in layers(costmap, self.full[costmap]) if layer.kind == kind)
        return ((path, branch(self.full, path)) for path in found)

    def sources(self, costmap: str) -> Iterator[Tuple[str, Dict[str, Any]]]:
        """(path, values) of the observation sources of a costmap."""
        for path, own in self.layers(costmap, OBSTACLE_LAYER):
            yield from ((f"{path}/{name}", own[name]) for name in sources(own))

    def judged(self, rules: Tuple[Rule, ...], path: str, values: Dict[str, Any], **measures: Any) -> Iterator[Finding]:
        """What rules say of the values at a path; measures are attributes beside those of the robot's setup."""
        m = SimpleNamespace(**vars(self.robot), s=self, **measures)
        for finding in apply(rules, SimpleNamespace(**values), m):
            given = "/" in finding.key or path not in COSTMAPS or finding.key in branch(self.tree, path)
            value = finding.value if given else finding.value.replace("is ", "is not given, which means ", 1)
            yield self.placed(finding._replace(key=f"{path}/{finding.key}", value=value))


def _paths(tree: Dict[str, Any]) -> Iterator[str]:
    """The paths of a tree and of all that is in it; its own is empty."""
    yield ""
    for name, value in tree.items():
        for path in _paths(value) if isinstance(value, dict) else [""]:
            yield f"{name}/{path}".rstrip("/")


# --- stages ----------------------------------------------------------------------------------------------------------


def _parameters(setup: _Setup) -> Iterator[Finding]:
    """What the planner's own declarations say, and whether the files hold the parameters of the planner in use."""
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
    """What is not read, or in vain. A section that a list in the files names is read on the robot."""
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
    """The tables of this file."""
    yield from _limits(setup)
    if setup.planner not in setup.full:
        return
    topic = branch(setup.tree, setup.planner).get("odom_topic", setup.robot.topics.odometry)
    values = {**setup.full[setup.planner], "odom_topic": topic}
    yield from setup.judged(PLANNER, setup.planner, values)
    if setup.planner == DWA:
        yield from setup.judged(DWA_PLANNER, DWA, {**values, **_dwa_measures(values)})
    for costmap in COSTMAPS:
        yield from _costmap(setup, costmap)


def _limits(setup: _Setup) -> Iterator[Finding]:
    """Speeds in the files that the base's controller does not allow."""
    for names, limit, unit in LIMITED:
        most = getattr(setup.robot.base, limit)
        for name in names:
            given = find(setup.tree, setup.planner, (name,))
            if given is not None and abs(given) > most:
                advice = f"base.{limit} in robot.yaml is {most:g} {unit}, which the base will not exceed"
                yield setup.placed(Finding(f"{setup.planner}/{name}", f"is {given:g}", advice, "warning"))


def _dwa_measures(values: Dict[str, Any]) -> Dict[str, float]:
    """What DWAPlannerROS can reach from rest within its window, and what its critics weigh."""
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
        "progress": 2.0 * v.goal_distance_bias * v.max_vel_trans * v.sim_time,  # goal and nose to goal
        "obstacle": v.occdist_scale * INSCRIBED,
    }


def _costmap(setup: _Setup, costmap: str) -> Iterator[Finding]:
    """Footprint, frames, size, and whether the scans of the robot's laser reach a costmap."""
    own, (back, front, right, left) = setup.full[costmap], setup.box
    points = footprint.parse(own["footprint"])
    outline = footprint.pad(points if len(points) else footprint.circle(own["robot_radius"]), own["footprint_padding"])
    reach, fits, key = np.ptp(outline, axis=0), False, "footprint" if len(points) else "robot_radius"
    if not {"footprint", "robot_radius"} & {*branch(setup.tree, costmap), *setup.tree}:
        corners = [(back, right), (back, left), (front, left), (front, right)]
        box = ", ".join(f"[{x:.3g}, {y:.3g}]" for x, y in corners)
        value = f"is missing, which means a circle of {own['robot_radius']:g} m"
        advice = "give that of body and wheels" if isnan(setup.width) else f"body and wheels fill [{box}], give that"
        yield setup.placed(Finding(f"{costmap}/footprint", value, advice, "warning"))
    elif reach[1] < setup.width / UNITS or reach[1] > setup.width * UNITS:
        key = "footprint_padding" if abs(own["footprint_padding"]) > setup.length else key
        advice = f"with padding that is {reach[0]:.3g} x {reach[1]:.3g} m, body and wheels are {setup.length:.3g} x "
        advice += f"{setup.width:.3g} m, give metres"
        yield setup.placed(Finding(f"{costmap}/{key}", f"is {own[key]!s:.60}", advice))
    else:
        fits = True
    measures = {"local": costmap == "local_costmap", "fixed": not (setup.with_map or own["rolling_window"])}
    measures.update(centred_x=-own["width"] / 2, centred_y=-own["height"] / 2)
    yield from setup.judged(COSTMAP, costmap, own, **measures)
    for path, values in setup.layers(costmap, INFLATION_LAYER):
        yield from setup.judged(INFLATION, path, values)
    for path, _ in setup.layers(costmap, STATIC_LAYER) if not setup.with_map else ():
        value = f"has {path.rpartition('/')[2]}"
        advice = "there is no map here, leave it out in without_map"
        yield setup.placed(Finding(f"{costmap}/plugins", value, advice))
    found = list(setup.sources(costmap))
    blind = [list(setup.judged(BLIND, path, values)) for path, values in found]
    if found and all(blind):
        yield from blind[0]
    for path, values in found:
        yield from setup.judged(SOURCE, path, values)
    local = costmap == "local_costmap"
    if not found and (local or not any(setup.layers(costmap, STATIC_LAYER))):
        advice = "the robot would not see obstacles, give one" if local else "paths lead through obstacles, give one"
        yield setup.placed(Finding(costmap, "has no observation source", advice, "error" if local else "warning"))
    if local and fits:
        yield from _size_of_the_robot(setup, key, outline)


def _size_of_the_robot(setup: _Setup, key: str, outline: np.ndarray) -> Iterator[Finding]:
    """Whether the local costmap's padded footprint (n, 2) [m], which a key gives, fits world_scale, body and wheels."""
    fitting, given = np.ptp(outline[:, 1]) / WIDTH, setup.robot.world_scale
    if abs(given / fitting - 1.0) > SCALE_OFF:
        advice = f"by the footprint's width it is {fitting:.3f}, give that"
        yield Finding("world_scale", f"is {given:g}", advice, "remark", setup.own)
    directions = np.array([np.cos(EIGHT), np.sin(EIGHT)])
    beyond = ((geometry.corners(setup.robot) @ directions).max(axis=0) - (outline @ directions).max(axis=0)).max()
    if beyond > OUTSIDE:
        advice = f"the box around body and wheels, at which the monitor stops, reaches {beyond:.2f} m beyond it, padded"
        yield setup.placed(Finding(f"local_costmap/{key}", "is too small", advice, "remark"))


def _space(setup: _Setup) -> Iterator[Finding]:
    """What no parameter space can be made of; nothing where it is for another planner than the files."""
    if setup.planner != setup.robot.local_planner or setup.planner not in setup.full:
        return
    for parameter in setup.robot.space:
        for names, limit, _ in LIMITED:
            first = parameter.sets[0]  # the range includes what the files start with
            start = find(setup.full, first.server, first.names) or 0.0
            most = max(getattr(setup.robot.base, limit), abs(start))
            beyond = max(abs(parameter.low), abs(parameter.high)) > most
            if beyond and any(s.server == setup.planner and s.name in names for s in parameter.sets):
                value = f"is [{parameter.low:g}, {parameter.high:g}]"
                advice = f"base.{limit} of this base is {most:g}, stay within it"
                yield Finding(f"parameter_space.{parameter.name}.range", value, advice, file=setup.own)
    yield from (finding._replace(file=setup.own) for finding in space_findings(setup.robot, setup.full))


def space_findings(robot: Robot, full: Dict[str, Any]) -> Iterator[Finding]:
    """What the servers of a complete tree do not take of a robot's parameter space: the first of each parameter."""
    known = servers(full)
    for parameter in robot.space:
        key = f"parameter_space.{parameter.name}"
        advice = next(filter(None, (_refusal(parameter, setting, known) for setting in parameter.sets)), "")
        if not advice:
            start = branch(full, parameter.sets[0].server)[parameter.sets[0].name]
            if not parameter.low <= start <= parameter.high:
                advice = f"move_base starts with {start:g}; include it in the range"
        if advice:
            yield Finding(key, advice=advice)


def _refusal(parameter: SpaceParameter, setting: Any, known: Dict[str, Any]) -> str:
    """Why a parameter cannot set a value of a server; "" where it can."""
    where = f"server {setting.server} of move_base" if setting.server else "move_base's own server"
    if setting.server not in known:
        names = list(filter(None, known))
        return f"there is no {where}; {meant(setting.server, names, 'give ' + ', '.join(names))}"
    declared = next((p for p in known[setting.server].parameters if setting.name in p.names), None)
    if declared is None:
        return f"{where} has no parameter {setting.name}; docs/reference/parameters.md lists them"
    if declared.type not in ("double", "int"):
        return f"{setting.name} is no number in {where}; take another parameter"
    if (declared.type == "int") != parameter.integer:
        return f"give integer: {str(declared.type == 'int').lower()}, as in {where}"
    low, high = (-parameter.high, -parameter.low) if setting.negated else (parameter.low, parameter.high)
    if not declared.min <= low <= high <= declared.max:
        return f"{where} takes {declared.min:g} to {declared.max:g}; stay within it"
    return ""


# --- tables ----------------------------------------------------------------------------------------------------------
# v: the values at the key's place. m: the robot's sections, and m.s, the setup.

START = (
    "the costmap, {{v.{0}:g}} m long, does not hold the robot's start at 0, give {{m.centred_{1}:g}}, or "
    "rolling_window: true"
)
WIDE = "the robot is {m.s.width:.3g} m wide, give metres"
DROPPED = "laser.height in robot.yaml is {{m.laser.height:g}}, so that all points are dropped, give at {} that"
PLANNER = (
    same_name("odom_topic", "topics.odometry", severity="remark"),
    at_most("min_vel_x", "max_vel_x", severity="warning"),
    at_most("min_vel_theta", "max_vel_theta", severity="warning"),
    Rule("sim_time", lambda v, m: v.sim_time == 0.0, "no velocity is legal then, give about 1.5 s"),
    Rule(
        "yaw_goal_tolerance",
        lambda v, m: v.yaw_goal_tolerance > pi,
        "all headings are within it, give radians",
        "remark",
    ),
)
DWA_PLANNER = (
    at_most("min_vel_trans", "max_vel_trans"),
    Rule(
        "acc_lim_theta",
        lambda v, m: v.reached_speed + SLACK < v.min_vel_trans and v.reached_turn + SLACK < v.min_vel_theta,
        "within {v.seconds:g} s a robot that stands reaches {v.reached_turn:.3g} rad/s and {v.reached_speed:.3g} m/s, "
        "below min_vel_theta {v.min_vel_theta:g} and min_vel_trans {v.min_vel_trans:g}, so that every sample is "
        "refused: give acc_lim_theta {v.enough:.3g}, or smaller speeds",
    ),
    Rule(
        "min_vel_x",
        lambda v, m: v.min_vel_x <= -v.min_vel_trans and v.change < 2.0 * v.min_vel_trans,
        "a robot that backs can neither stop nor drive ahead until a cycle fails, for acc_lim_x / controller_frequency "
        "is {v.change:.3g} m/s, and speeds below min_vel_trans {v.min_vel_trans:g} are refused: give acc_lim_x "
        "{v.braking:.3g}",
        "remark",
    ),
    at_most("max_vel_x", "max_vel_trans", lambda v, m: v.max_vel_x > v.max_vel_trans + SLACK, "remark"),
    Rule(
        "occdist_scale",
        lambda v, m: v.obstacle > v.progress,
        "before a narrow gap the robot turns or stands, for an obstacle beside it costs {v.obstacle:.2f}, all progress "
        "of a trajectory counts {v.progress:.2f} (goal_distance_bias)",
        "remark",
    ),
)
COSTMAP = (
    same_name("robot_base_frame", "frames.base", lambda v, m: not m.local),
    same_name("global_frame", "frames.odom", lambda v, m: not m.s.with_map),
    same_name("global_frame", "frames.map", lambda v, m: m.s.with_map and not m.local),
    Rule("resolution", lambda v, m: v.resolution > m.s.width, WIDE),
    Rule(
        "update_frequency",
        lambda v, m: m.local and v.update_frequency == 0.0,
        "the costmap is never updated, give that of the scans",
    ),
    Rule("origin_x", lambda v, m: m.fixed and not -v.width < v.origin_x < 0.0, START.format("width", "x")),
    Rule("origin_y", lambda v, m: m.fixed and not -v.height < v.origin_y < 0.0, START.format("height", "y")),
)
INFLATION = (Rule("inflation_radius", lambda v, m: v.inflation_radius > 2 * UNITS * m.s.width, WIDE, "warning"),)
BLIND = (  # why a source does not show what the laser sees
    same_name("topic", "topics.scan"),
    Rule("data_type", lambda v, m: v.data_type != "LaserScan", "the robot's laser publishes LaserScan, give that"),
    Rule("marking", lambda v, m: not v.marking, "nothing would mark obstacles, give true"),
    Rule("min_obstacle_height", lambda v, m: v.min_obstacle_height > m.laser.height, DROPPED.format("most")),
    Rule("max_obstacle_height", lambda v, m: v.max_obstacle_height < m.laser.height, DROPPED.format("least")),
)
SOURCE = (
    same_name("sensor_frame", "laser.frame", lambda v, m: v.sensor_frame and not any(apply(BLIND[:1], v, m)), "remark"),
    Rule(
        "obstacle_range",
        lambda v, m: v.obstacle_range > v.raytrace_range,
        "what is marked beyond raytrace_range {v.raytrace_range:g} is never cleared, give at most that",
        "remark",
    ),
)
