"""Check of a robot: fields of robot.yaml, parameters of its move_base, and their consistency.

`check` returns errors, with which the robot cannot be driven. `remarks` returns values that degrade driving or have no
effect. Each line gives problem, value and remedy. Names with dots are fields of robot.yaml, and names with slashes are
parameters of move_base. check_robot.py prints all lines, while `load` of folder.py only raises the errors. Values on
ROS's parameter server, outside a robot's folder, are only checked by planner.parameters.check.
"""

from __future__ import annotations

from contextlib import suppress
from math import pi
from typing import Any, Dict, Iterator, List, NamedTuple, Tuple

import numpy as np
from pydantic import ValidationError

from applr_ros1.common.arrays import Array
from applr_ros1.common.errors import did_you_mean
from applr_ros1.common.trees import branch
from applr_ros1.planner.parameters import check as parameters
from applr_ros1.planner.parameters.declarations import LOCAL_PLANNERS, Server, namespace, of_kind, servers
from applr_ros1.planner.parameters.layers import COSTMAPS, STATIC_LAYER, layers
from applr_ros1.planner.parameters.parameter import ParameterError
from applr_ros1.robots import geometry
from applr_ros1.robots.parameter_files import observation_sources, too_deep
from applr_ros1.robots.robot import Robot, SpaceParameter, Target

WIDTH = 0.53  # width of the Jackal's padded footprint, for which the training worlds were made [m]
EIGHT = np.arange(8) * pi / 4  # directions of sides and corners in which outlines are compared [rad]
LIMITED = ((of_kind("speed"), "max_speed"), (of_kind("turn"), "max_yaw_rate"))  # parameters, limit in `base`
SLOWEST = {  # smallest command, and limit of the first command from rest if any, for speed and turn rate
    "TrajectoryPlannerROS": (("min_vel_x", ""), ("min_in_place_vel_theta", "acc_lim_theta")),
    "DWAPlannerROS": (("min_vel_trans", "acc_lim_x"), ("min_vel_theta", "acc_lim_theta")),
}
UNITS = 10.0  # ratio of two lengths above which one of them is not in metres
OUTSIDE = 0.01  # largest distance of body and wheels beyond the padded footprint [m]


class _Setup(NamedTuple):
    """Parameters of a robot with or without a map: `tree` from its files, `full` with all defaults."""

    robot: Robot
    with_map: bool
    tree: Dict[str, Any]
    full: Dict[str, Any]

    @property
    def planner(self) -> str:
        """Namespace of the local planner."""
        return self.robot.local_planner


def check(robot: Robot, with_map: bool = False) -> List[str]:
    """Return the errors of a robot, one line per value.

    Args:
        robot: Robot from `folder.read`.
        with_map: Whether to check its parameters with a map instead of those without.
    """
    tree = robot.parameters(with_map)
    errors = [*fields(robot), *too_deep(tree), *_planner_section(tree), *parameters.check(tree)]
    if errors:
        return errors
    setup = _Setup(robot, with_map, tree, parameters.complete(tree))
    errors = [line for costmap in COSTMAPS for line in _costmap(setup, costmap)]
    return [*errors, *_space_limits(setup), *space_errors(robot, setup.full)]


def remarks(robot: Robot, with_map: bool = False) -> List[str]:
    """Return values of a robot that degrade driving or have no effect, one line per value."""
    tree = robot.parameters(with_map)
    lines = []
    with suppress(ParameterError):  # check() returns this error.
        lines += parameters.remarks(tree)
        setup = _Setup(robot, with_map, tree, parameters.complete(tree))
        lines += _planner_remarks(setup)
        lines += [line for costmap in COSTMAPS for line in _costmap_remarks(setup, costmap)]
    return lines


def refused(error: ValidationError) -> List[str]:
    """Return pydantic's errors about a robot.yaml, one line per value."""
    lines = []
    for problem in error.errors():
        place = "".join(f"[{part}]" if isinstance(part, int) else f".{part}" for part in problem["loc"])[1:]
        if problem["type"] == "value_error":  # robot.py raised this error.
            lines.append(f"{place}: {problem['ctx']['error']}" if place else str(problem["ctx"]["error"]))
        elif problem["type"] == "missing":
            lines.append(f"{place} is missing: give it")
        else:
            lines.append(f"{place} is {problem['input']!r:.60}: {problem['msg'].replace('Input should be', 'give')}")
    return lines


# --- errors -----------------------------------------------------------------------------------------------------------


def fields(robot: Robot) -> Iterator[str]:
    """Yield contradictions between fields of robot.yaml."""
    base, body, laser, simulation = robot.base, robot.body, robot.laser, robot.simulation
    skids, ground = base.drive == "skid_steer", base.axle_height - base.wheel_radius
    if skids and not base.wheelbase:
        yield "base.wheelbase is 0: a skid_steer base has two axles, give the distance between them"
    elif skids and base.casters:
        yield "base.casters are given: a skid_steer base has no casters, remove them"
    elif not skids and not base.casters:
        yield "base.casters are missing: a two_wheel base has at least one, give their contact points with the ground"
    else:
        mass, _, loads = geometry.balance(robot)
        if loads.min() < -1e-4 * mass * geometry.GRAVITY:  # A centre of mass exactly above the axle is allowed.
            place = _list(body.centre_of_mass)
            yield f"body.com is {place}: it lies outside the wheels and casters; correct body.com or base.casters"
    if simulation.ground == "gazebo" and not (skids and simulation.track_multiplier):
        yield "simulation.ground is gazebo, which needs a skid_steer base with simulation.track_multiplier: give plain"
    for low, high in (("first_angle", "last_angle"), ("range_min", "range_max")):
        least, most = getattr(laser, low), getattr(laser, high)
        if most <= least:
            yield f"laser.{high} is {most:g}: give more than {low} ({least:g})"
    for name, limit in (("deceleration", "max_acceleration"), ("yaw_deceleration", "max_yaw_acceleration")):
        given, most = getattr(robot.monitor, name), getattr(base, limit)
        if given > most:
            yield f"monitor.{name} is {given:g}, larger than base.{limit} ({most:g}): lower monitor.{name}"
    if body.bottom < ground:
        yield (
            f"base.axle_height is {base.axle_height:g}: the ground is then at {ground:.3g} m, above body.bottom "
            f"({body.bottom:g}); give the height of the axles above the base frame"
        )
    back, front, right, left = geometry.bounding_box(robot)
    x, y, _ = laser.pose
    if max(back - x, x - front, right - y, y - left) > max(front - back, left - right):
        yield f"laser.pose is {_list(laser.pose)}: body and wheels end at x {front:.3g} m, y {left:.3g} m; give metres"


def _planner_section(tree: Dict[str, Any]) -> Iterator[str]:
    """Yield an error if the files only hold parameters of a planner that is not in use."""
    plugins = {namespace(plugin): plugin for plugin in LOCAL_PLANNERS}
    used = namespace(str(tree.get("base_local_planner", LOCAL_PLANNERS[0])))
    present = [name for name in plugins if name in tree]
    if used in plugins and present and used not in present:
        alone = f"but the files only hold parameters of {present[0]}"
        yield f"base_local_planner is {plugins[used]}, {alone}: give {plugins[present[0]]}, or the section {used}"


def _costmap(setup: _Setup, costmap: str) -> Iterator[str]:
    """Yield errors in footprint, frames, size and observation sources of a costmap."""
    robot, own, local = setup.robot, setup.full[costmap], costmap == "local_costmap"
    back, front, right, left = geometry.bounding_box(robot)
    outline, width = _outline(own), left - right
    length, across = np.ptp(outline, axis=0)
    if not (_no_footprint(setup, costmap) or width / UNITS <= across <= width * UNITS):
        names = f"{costmap}/footprint, robot_radius, footprint_padding"
        size = f"{length:.3g} x {across:.3g} m; body and wheels are {front - back:.3g} x {width:.3g} m"
        yield f"{names}: the padded footprint is {size}; give all lengths in metres"
    frames = {"robot_base_frame": "base"} if not local else {}
    if not setup.with_map:
        frames["global_frame"] = "odom"
    elif not local:
        frames["global_frame"] = "map"
    for name, field in frames.items():
        wanted = getattr(robot.frames, field)
        if _differ(own[name], wanted):
            yield f"{costmap}/{name} is {own[name]}, but frames.{field} in robot.yaml is {wanted}: give {wanted}"
    for name, size in (("origin_x", own["width"]), ("origin_y", own["height"])):
        if not (setup.with_map or own["rolling_window"] or -size < own[name] < 0.0):
            start = f"the costmap, {size:g} m long, does not contain the robot's start at 0"
            yield f"{costmap}/{name} is {own[name]:g}: {start}, give {-size / 2:g}, or rolling_window: true"
    for layer in layers(costmap, own):
        if layer.kind == STATIC_LAYER and not setup.with_map:
            yield f"{costmap}/plugins has {layer.name}, but there is no map: remove this layer"
    blind = [_blind(f"{path}/{name}", source, robot) for path, name, source in observation_sources(setup.full, costmap)]
    if blind and all(blind):
        yield blind[0]
    if local and not blind:
        yield "local_costmap has no observation source: the robot would not see obstacles, add one"


def _blind(path: str, source: Dict[str, Any], robot: Robot) -> str:
    """Return why an observation source does not mark the points of the robot's laser; "" if it marks them."""
    lowest, highest, height = source["min_obstacle_height"], source["max_obstacle_height"], robot.laser.height
    if _differ(source["topic"], robot.topics.scan):
        scan = robot.topics.scan
        return f"{path}/topic is {source['topic']}, but topics.scan in robot.yaml is {scan}: give {scan}"
    if not lowest <= height <= highest:
        bounds = f"{path}/min_obstacle_height, max_obstacle_height are {lowest:g}, {highest:g}"
        return f"{bounds}: all points are dropped, as laser.height in robot.yaml is {height:g}; include {height:g}"
    return ""


def _space_limits(setup: _Setup) -> Iterator[str]:
    """Yield an error for each range of the parameter space that exceeds a limit of the base's controller."""
    for parameter in setup.robot.space:
        for names, field in LIMITED:
            if any(target.server == setup.planner and target.name in names for target in parameter.sets):
                start = parameter.sets[0].value_in(setup.full) or 0.0
                limit = max(getattr(setup.robot.base, field), abs(start))  # The range includes the initial value.
                if max(abs(parameter.low), abs(parameter.high)) > limit:
                    place = f"parameter_space.{parameter.name}.range is [{parameter.low:g}, {parameter.high:g}]"
                    yield f"{place}, but base.{field} of this base is {limit:g}: stay within {limit:g}"


def space_errors(robot: Robot, full: Dict[str, Any]) -> Iterator[str]:
    """Yield the first error of each parameter of a robot's space, compared with the servers of a complete tree."""
    known = servers(full)
    for parameter in robot.space:
        refusals = [_refusal(parameter, target, known) for target in parameter.sets]
        problem = next(filter(None, refusals), "")
        if not problem:
            start = parameter.sets[0].value_in(full)
            if not parameter.low <= start <= parameter.high:
                problem = f"move_base starts with {start:g}; include it in the range"
        if problem:
            yield f"parameter_space.{parameter.name}: {problem}"


def _refusal(parameter: SpaceParameter, target: Target, known: Dict[str, Server]) -> str:
    """Return why a parameter cannot set the value at an address; "" if there is no problem."""
    where = f"server {target.server} of move_base" if target.server else "move_base's own server"
    if target.server not in known:
        names = list(filter(None, known))
        return f"there is no {where}; {did_you_mean(target.server, names) or 'give ' + ', '.join(names)}"
    declared = known[target.server].declared(target.name)
    if declared is None or declared.type not in ("double", "int"):
        return f"{where} has no number {target.name}; docs/reference/parameters.md lists its parameters"
    if (declared.type == "int") != parameter.integer:
        kind = f"integer is {str(parameter.integer).lower()}, but {target.name} of {where} is of type {declared.type}"
        return f"{kind}: give integer: {str(declared.type == 'int').lower()}"
    low, high = sorted(map(target.signed, parameter.range))
    if not declared.min <= low <= high <= declared.max:
        return f"{where} takes {declared.min:g} to {declared.max:g}; stay within it"
    return ""


# --- remarks ----------------------------------------------------------------------------------------------------------


def _planner_remarks(setup: _Setup) -> Iterator[str]:
    """Yield speeds that the base cannot reach, and inconsistent values of the local planner."""
    robot, planner, own = setup.robot, setup.planner, setup.full[setup.planner]
    given = branch(setup.tree, planner)
    for names, limit in LIMITED:
        for name in names:
            most, value = getattr(robot.base, limit), given.get(name)
            if isinstance(value, (int, float)) and abs(value) > most:
                yield f"{planner}/{name} is {value:g}: the base will not exceed base.{limit} in robot.yaml ({most:g})"
    for low, high in (("min_vel_x", "max_vel_x"), ("min_vel_theta", "max_vel_theta")):
        if own[low] > own[high]:
            yield f"{planner}/{low} is {own[low]:g}, larger than {high} ({own[high]:g}): lower {low}"
    yield from _dead_band_remarks(setup)


def _dead_band_remarks(setup: _Setup) -> Iterator[str]:
    """Yield parameters of the local planner with which it sends commands that the base ignores."""
    planner, own, rate = setup.planner, setup.full[setup.planner], setup.full["controller_frequency"]
    for (slowest, limit), least in zip(SLOWEST[planner], setup.robot.base.dead_band):
        ignores = f"the base ignores less than base.dead_band in robot.yaml ({least:g})"
        if own[slowest] < least:
            yield f"{planner}/{slowest} is {own[slowest]:g}, but {ignores}: raise it to {least:g}"
        if limit and own[limit] < least * rate:
            first = f"the first command from rest is at most {own[limit] / rate:.3g}"
            yield f"{planner}/{limit} is {own[limit]:g}: {first}, but {ignores}; raise it to {least * rate:g}"


def _costmap_remarks(setup: _Setup, costmap: str) -> Iterator[str]:
    """Yield inconsistent values in footprint and observation sources of a costmap."""
    robot, own = setup.robot, setup.full[costmap]
    back, front, right, left = geometry.bounding_box(robot)
    if _no_footprint(setup, costmap):
        box = ", ".join(f"[{x:.3g}, {y:.3g}]" for x, y in ((back, right), (back, left), (front, left), (front, right)))
        circle = f"a circle of {own['robot_radius']:g} m is used"
        yield f"{costmap}/footprint is missing: {circle}, but body and wheels fill [{box}]; give this outline"
    elif costmap == "local_costmap":
        directions, outline = np.array([np.cos(EIGHT), np.sin(EIGHT)]), _outline(own)
        beyond = ((geometry.corners(robot) @ directions).max(axis=0) - (outline @ directions).max(axis=0)).max()
        if beyond > OUTSIDE:
            box = "the box around body and wheels, at which the monitor stops"
            yield f"local_costmap/footprint is too small: {box}, reaches {beyond:.2f} m beyond it with padding"
    for path, name, source in observation_sources(setup.full, costmap):
        frame, wanted = source["sensor_frame"], robot.laser.frame
        if frame and not _differ(source["topic"], robot.topics.scan) and _differ(frame, wanted):
            place = f"{path}/{name}/sensor_frame is {frame}"
            yield f"{place}, but laser.frame in robot.yaml is {wanted}: give {wanted} or omit it"


# --- helpers ----------------------------------------------------------------------------------------------------------


def _outline(own: Dict[str, Any]) -> Array:
    """Return the padded footprint (n, 2) of a costmap [m]."""
    from applr_ros1.planner.costmap import footprint  # The import is slow, because it needs numba.

    return footprint.padded(own)


def _no_footprint(setup: _Setup, costmap: str) -> bool:
    return not {"footprint", "robot_radius"} & {*branch(setup.tree, costmap), *setup.tree}


def _differ(given: str, wanted: str) -> bool:
    return given.strip("/") != wanted.strip("/")


def _list(numbers: Tuple[float, ...]) -> str:
    return f"[{', '.join(f'{number:g}' for number in numbers)}]"
