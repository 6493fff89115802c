"""Check of a robot: fields of robot.yaml, parameters of its move_base, and their consistency.

`check` returns errors, with which the robot cannot be driven. `remarks` returns values that degrade
driving or have no effect, with parameters that correct them. Each line gives problem, value and
remedy. Names with dots are fields of robot.yaml, and names with slashes are parameters of
move_base. ./applr check prints all lines, while `load` of folder.py only raises the errors. Values
on ROS's parameter server, outside a robot's folder, are only checked by planner.parameters.check.
"""

from __future__ import annotations

import re
from contextlib import suppress
from math import copysign, floor, pi
from typing import Dict, Iterator, List, NamedTuple, Sequence

import numpy as np
from pydantic import ValidationError

from applr_ros1.common.arrays import Array
from applr_ros1.common.errors import did_you_mean, remedy_of, shown
from applr_ros1.planner.costmap import footprint
from applr_ros1.planner.parameters import check as parameters
from applr_ros1.planner.parameters.declarations import (
    LOCAL_PLANNERS,
    Server,
    namespace,
    of_kind,
    servers,
)
from applr_ros1.planner.parameters.layers import (
    COSTMAPS,
    INFLATION_LAYER,
    STATIC_LAYER,
    layers,
    observation_sources,
    section_in_files,
)
from applr_ros1.planner.parameters.obstacle_range import laser_sources, ranges
from applr_ros1.planner.parameters.parameter import ParameterError
from applr_ros1.planner.parameters.trees import Tree, Values, branch
from applr_ros1.robots import geometry
from applr_ros1.robots.parameter_files import too_deep
from applr_ros1.robots.robot import Robot, SpaceParameter, Target

WIDTH = 0.53  # width of the Jackal's padded footprint, for which the training worlds were made [m]
# Directions of sides and corners (2, 8) in which outlines are compared
EIGHT = np.arange(8) * pi / 4
DIRECTIONS = np.array([np.cos(EIGHT), np.sin(EIGHT)])
# Names of the planners' parameters that a field of `base` limits
LIMITED = {"max_speed": of_kind("speed"), "max_yaw_rate": of_kind("turn")}
SIGHT_S = 2.0  # time at top speed for which obstacles ahead should be marked [s]
UNITS = 10.0  # ratio of two lengths above which one of them is not in metres
UNLIKE = 1.5  # ratio of the sizes of footprint and robot from which on one of them is doubted
OUTSIDE = 0.01  # largest distance of body and wheels beyond the padded footprint [m]
MOST = 0.5  # share of the weight from which on the driven wheels carry most of it
BALANCE_TOLERANCE = 1e-4  # share of the weight by which a support may pull, because of rounding


class _Slowest(NamedTuple):
    """Parameters of a local planner that determine its smallest command.

    command: Smallest command; first_limit: limit of the acceleration, with which the first command
    from rest is limited, or "".
    """

    command: str
    first_limit: str


SLOWEST = {  # for speed and turn rate, by local planner
    "TrajectoryPlannerROS": (
        _Slowest("min_vel_x", ""),
        _Slowest("min_in_place_vel_theta", "acc_lim_theta"),
    ),
    "DWAPlannerROS": (
        _Slowest("min_vel_trans", "acc_lim_x"),
        _Slowest("min_vel_theta", "acc_lim_theta"),
    ),
}


class LimitPair(NamedTuple):
    """Two limits of one quantity of a local planner, of which `low` should not exceed `high`.

    Attributes:
        low: Parameter with the smallest value.
        high: Parameter with the largest value.
        unless_zero: Parameter that switches the smallest value off if it is 0, or "".
        consequence: What the C++ planner then does if the robot cannot be driven, or "".
    """

    low: str
    high: str
    unless_zero: str = ""
    consequence: str = ""


# By local planner. DWAPlannerROS refuses samples that are slower than min_vel_trans and also turn
# more slowly than min_vel_theta, and those that are faster than max_vel_trans
# (simple_trajectory_generator.cpp, generateTrajectory).
LIMITS = {
    "TrajectoryPlannerROS": (
        LimitPair("min_vel_x", "max_vel_x"),
        # Turns in place are raised to the smallest one, beyond the largest.
        LimitPair("min_in_place_vel_theta", "max_vel_theta"),
    ),
    "DWAPlannerROS": (
        LimitPair("min_vel_x", "max_vel_x"),
        LimitPair("min_vel_x", "max_vel_trans", consequence="no lasting speed is allowed"),
        LimitPair(
            "min_vel_trans",
            "max_vel_trans",
            unless_zero="min_vel_theta",
            consequence="no straight command is allowed",
        ),
        LimitPair(
            "min_vel_trans",
            "max_vel_x",
            unless_zero="min_vel_theta",
            consequence="no straight command ahead is allowed",
        ),
        LimitPair("min_vel_theta", "max_vel_theta", unless_zero="min_vel_trans"),
    ),
}


class _Setup(NamedTuple):
    """Parameters of a robot: `tree` from its files, `full` with all defaults."""

    robot: Robot
    tree: Tree
    full: Tree

    @property
    def planner(self) -> str:
        """Namespace of the local planner."""
        return self.robot.local_planner


class Remark(NamedTuple):
    """A value that degrades driving or has no effect.

    Attributes:
        line: Problem, value and remedy.
        correction: Parameters of move_base that follow the remedy, nested; empty if it names no
            value.
    """

    line: str
    correction: Tree = {}


def check(robot: Robot) -> List[str]:
    """Return the errors of a robot from `folder.read`, one line per value.

    Of its parameters, those in use are checked (Robot.on_map).
    """
    tree = robot.parameters()
    errors = [*fields(robot), *too_deep(tree), *_planner_section(tree), *parameters.check(tree)]
    # The other checks need values that these ones have accepted.
    if errors:
        return errors
    setup = _Setup(robot, tree, parameters.complete(tree))
    errors += crossing_outlines(setup.full)
    for costmap in COSTMAPS:
        errors += _costmap(setup, costmap)
    errors += _limit_errors(setup)
    return [*errors, *_space_limits(setup), *space_errors(robot, setup.full)]


def remarks(robot: Robot) -> List[Remark]:
    """Return the values of a robot that degrade driving or have no effect."""
    tree = robot.parameters()
    found_remarks: List[Remark] = []
    with suppress(ParameterError):  # check() returns this error.
        found_remarks += map(Remark, parameters.remarks(tree))
        setup = _Setup(robot, tree, parameters.complete(tree))
        found_remarks += _planner_remarks(setup)
        found_remarks += _linked_remarks(setup)
        found_remarks += _odometry_remarks(setup)
        found_remarks += _range_remarks(setup)
        found_remarks += _inflation_remarks(setup)
        for costmap in COSTMAPS:
            found_remarks += _costmap_remarks(setup, costmap)
    return found_remarks


def crossed_limits(planner: str, values: Values) -> List[LimitPair]:
    """Return the limits of a local planner whose smallest value exceeds the largest one.

    Args:
        planner: Name of the local planner.
        values: {name: value} of its parameters.
    """
    crossed = []
    for limits in LIMITS[planner]:
        is_off = bool(limits.unless_zero) and values[limits.unless_zero] == 0.0
        if values[limits.low] > values[limits.high] and not is_off:
            crossed.append(limits)
    return crossed


def refused(error: ValidationError) -> List[str]:
    """Return pydantic's errors about a robot.yaml, one line per value."""
    messages = []
    for problem in error.errors():
        # pydantic's location ("base", "casters", 0) is base.casters[0] in the file.
        field_path = re.sub(r"\.(\d+)(?=\.|$)", r"[\1]", ".".join(map(str, problem["loc"])))
        if problem["type"] == "value_error":  # robot.py raised this error, which names its values.
            message = remedy_of(problem)
            messages.append(f"{field_path}: {message}" if field_path else message)
        elif problem["type"] == "missing":
            messages.append(f"{field_path} is missing: give it")
        else:
            messages.append(f"{field_path} is {shown(problem['input'])}: {remedy_of(problem)}")
    return messages


# --- errors ---------------------------------------------------------------------------------------


def fields(robot: Robot) -> Iterator[str]:
    """Yield contradictions between fields of robot.yaml."""
    yield from _support_errors(robot)
    base = robot.base
    laser = robot.laser
    simulation = robot.simulation
    has_multiplier = base.drive == "skid_steer" and simulation.track_multiplier
    if simulation.ground == "gazebo" and not has_multiplier:
        requirement = "a skid_steer base with simulation.track_multiplier"
        yield f"simulation.ground is gazebo, which needs {requirement}: give plain"
    for low_field, high_field in (("first_angle", "last_angle"), ("range_min", "range_max")):
        smallest = getattr(laser, low_field)
        largest = getattr(laser, high_field)
        if largest <= smallest:
            yield f"laser.{high_field} is {largest:g}: give more than {low_field} ({smallest:g})"
    for monitor_field, base_field in (
        ("deceleration", "max_acceleration"),
        ("yaw_deceleration", "max_yaw_acceleration"),
    ):
        # The monitor would stop too late if the base brakes less than it assumes.
        deceleration = getattr(robot.monitor, monitor_field)
        acceleration_limit = getattr(base, base_field)
        if deceleration > acceleration_limit:
            label = f"monitor.{monitor_field}"
            comparison = f"larger than base.{base_field} ({acceleration_limit:g})"
            yield f"{label} is {deceleration:g}, {comparison}: lower {label}"
    ground = base.axle_height - base.wheel_radius
    if robot.body.bottom < ground:
        problem = f"the ground is then at {ground:.3g} m, above body.bottom ({robot.body.bottom:g})"
        remedy = "give the height of the axles above the base frame"
        yield f"base.axle_height is {base.axle_height:g}: {problem}; {remedy}"
    box = geometry.bounding_box(robot)
    x, y, _ = laser.pose
    excess = max(box.back - x, x - box.front, box.right - y, y - box.left)
    # A laser farther from the robot than its size is given in another unit.
    if excess > max(box.front - box.back, box.left - box.right):
        robot_extent = f"body and wheels end at x {box.front:.3g} m, y {box.left:.3g} m"
        yield f"laser.pose is {_list(laser.pose)}: {robot_extent}; give metres"


def _support_errors(robot: Robot) -> Iterator[str]:
    """Yield an error if the robot does not stand on its wheels and casters, or slips with them."""
    base = robot.base
    body = robot.body
    is_skid_steer = base.drive == "skid_steer"
    if is_skid_steer and not base.wheelbase:
        advice = "a skid_steer base has two axles, give the distance between them"
        yield f"base.wheelbase is 0: {advice}"
    elif is_skid_steer and base.casters:
        yield "base.casters are given: a skid_steer base has no casters, remove them"
    elif not is_skid_steer and not any(caster_x for caster_x, _ in base.casters):
        requirement = "a two_wheel base has at least one ahead of its axle or behind it"
        yield f"base.casters are missing: {requirement}, give their contact points with the ground"
    else:
        balance = geometry.balance(robot)
        # A centre of mass exactly above the axle is allowed.
        if balance.loads.min() < -BALANCE_TOLERANCE * balance.mass * geometry.GRAVITY:
            problem = "it lies outside the wheels and casters; correct body.com or base.casters"
            yield f"body.com is {_list(body.centre_of_mass)}: {problem}"
        else:
            yield from _grip_errors(robot, balance)


def _grip_errors(robot: Robot, balance: geometry.Balance) -> Iterator[str]:
    """Yield an error for each acceleration that tyres and casters cannot give under their loads.

    A controller may allow more acceleration than the tyres give, as those of all included robots
    do: wheels that carry most of the weight slip only for a moment. If the casters carry most of
    it, the wheels slip at every start, and the odometry arrives before the robot. The monitor
    counts on its deceleration in any case.
    """
    base = robot.base
    grip_limit = robot.simulation.grip_limit
    tyres = (
        f"with simulation.grip_limit {grip_limit:g} and base.wheel_friction {base.wheel_friction:g}"
    )
    caster_share = balance.loads[base.wheels :].sum() / (balance.mass * geometry.GRAVITY)
    wheel_share = 1.0 - caster_share

    # The friction limit is that of tyres under the whole weight.
    wheel_friction = geometry.GRAVITY * base.wheel_friction * wheel_share
    pulling = _rounded_down(min(grip_limit * wheel_share, wheel_friction))
    if base.max_acceleration > pulling and wheel_share < MOST:
        problem = (
            f"{tyres}, driven wheels that carry {100 * wheel_share:.0f} % of the weight give at "
            f"most {pulling:g} m/s^2, and would slip"
        )
        remedy = f"correct body.com or base.casters, or lower base.max_acceleration to {pulling:g}"
        yield f"base.max_acceleration is {base.max_acceleration:g}: {problem}: {remedy}"

    # Casters brake, too.
    caster_friction = geometry.GRAVITY * base.caster_friction * caster_share
    braking = _rounded_down(min(grip_limit, wheel_friction + caster_friction))
    deceleration = robot.monitor.deceleration
    # fields() reports a deceleration beyond the controller's limit.
    if braking < deceleration <= base.max_acceleration:
        problem = f"{tyres}, the base brakes with at most {braking:g} m/s^2"
        remedy = "lower monitor.deceleration, or raise the other fields if more was measured"
        yield f"monitor.deceleration is {deceleration:g}: {problem}: {remedy}"


def _planner_section(tree: Tree) -> Iterator[str]:
    """Yield an error if the files only hold parameters of a planner that is not in use."""
    plugins = {namespace(plugin): plugin for plugin in LOCAL_PLANNERS}
    used_planner = namespace(str(tree.get("base_local_planner", LOCAL_PLANNERS[0])))
    present_planners = [planner for planner in plugins if planner in tree]
    if used_planner in plugins and present_planners and used_planner not in present_planners:
        problem = f"but the files only hold parameters of {present_planners[0]}"
        remedy = f"give {plugins[present_planners[0]]}, or the section {used_planner}"
        yield f"base_local_planner is {plugins[used_planner]}, {problem}: {remedy}"


def _costmap(setup: _Setup, costmap: str) -> Iterator[str]:
    """Yield errors in footprint, frames, size and observation sources of a costmap."""
    values = setup.full[costmap]
    yield from _outline_errors(setup, costmap)
    yield from _frame_errors(setup, costmap)
    if not setup.robot.uses_map:
        yield from _start_errors(costmap, values)
        for layer in layers(costmap, values, STATIC_LAYER):
            yield f"{costmap}/plugins has {layer.name}, but there is no map: remove this layer"
    problems = []
    for source in observation_sources(costmap, values):
        problems.append(_blind(source.path, source.values, setup.robot))
    if problems and all(problems):
        yield problems[0]
    if costmap == "local_costmap" and not problems:
        yield "local_costmap has no observation source: the robot would not see obstacles, add one"


def crossing_outlines(full: Tree) -> Iterator[str]:
    """Yield an error for each costmap of a complete tree whose footprint is no simple polygon.

    The C++ planner takes it and drives too close to obstacles: the inscribed radius is that of the
    point where two sides cross.
    """
    for costmap in COSTMAPS:
        corners = full[costmap]["footprint"]
        if footprint.crosses_itself(footprint.parse(corners)):
            problem = "two of its sides cross each other"
            remedy = "give the corners in their order around the robot"
            yield f"{costmap}/footprint is {corners!s:.60}: {problem}: {remedy}"


def _start_errors(costmap: str, values: Tree) -> Iterator[str]:
    """Yield an error for each side of a fixed costmap beyond which the robot starts."""
    if values["rolling_window"]:
        return
    # Without a map, the robot starts at (0, 0).
    for origin_name, size_name in (("origin_x", "width"), ("origin_y", "height")):
        side_length = values[size_name]
        if not -side_length < values[origin_name] < 0.0:
            problem = (
                f"the costmap, {side_length:g} m long, does not contain the robot's start at 0"
            )
            remedy = f"give {-side_length / 2:g}, or rolling_window: true"
            yield f"{costmap}/{origin_name} is {values[origin_name]:g}: {problem}, {remedy}"


def _outline_errors(setup: _Setup, costmap: str) -> Iterator[str]:
    """Yield an error if the padded footprint of a costmap is given in another unit than metres."""
    if _has_no_footprint(setup, costmap):
        return
    robot = geometry.corners(setup.robot)
    sizes = unlike_sizes(footprint.padded(setup.full[costmap]), robot, UNITS)
    if sizes:
        parameter_names = f"{costmap}/footprint, robot_radius, footprint_padding"
        yield f"{parameter_names}: {sizes}; give all lengths in metres"


def _frame_errors(setup: _Setup, costmap: str) -> Iterator[str]:
    """Yield an error for each frame of a costmap that differs from the frames of robot.yaml."""
    # The global costmap's frame of the robot is also that of move_base.
    is_global = costmap == "global_costmap"
    frame_fields = {}
    if is_global:
        frame_fields["robot_base_frame"] = "base"
    if not setup.robot.uses_map:
        frame_fields["global_frame"] = "odom"
    elif is_global:
        frame_fields["global_frame"] = "map"
    for parameter_name, frame_field in frame_fields.items():
        frame = setup.full[costmap][parameter_name]
        expected = getattr(setup.robot.frames, frame_field)
        if _differ(frame, expected):
            problem = f"but frames.{frame_field} in robot.yaml is {expected}"
            yield f"{costmap}/{parameter_name} is {frame}, {problem}: give {expected}"


def _blind(path: str, source: Tree, robot: Robot) -> str:
    """Return why an observation source does not mark the laser's points; "" if it does."""
    topic = source["topic"]
    scan = robot.topics.scan
    if _differ(topic, scan):
        return f"{path}/topic is {topic}, but topics.scan in robot.yaml is {scan}: give {scan}"
    # The obstacle layer drops points outside these heights (observation_buffer.cpp).
    lowest = source["min_obstacle_height"]
    highest = source["max_obstacle_height"]
    height = robot.laser.height
    if not lowest <= height <= highest:
        bounds = f"{path}/min_obstacle_height, max_obstacle_height are {lowest:g}, {highest:g}"
        problem = f"all points are dropped, as laser.height in robot.yaml is {height:g}"
        return f"{bounds}: {problem}; include {height:g}"
    return ""


def _limit_errors(setup: _Setup) -> Iterator[str]:
    """Yield an error for crossed limits of the local planner with which it cannot drive."""
    planner = setup.planner
    values = setup.full[planner]
    for limits in crossed_limits(planner, values):
        if limits.consequence:
            problem = f"{planner}/{limits.high} is {values[limits.high]:g}"
            comparison = f"below {limits.low} ({values[limits.low]:g})"
            remedy = f"raise {limits.high} or lower {limits.low}"
            yield f"{problem}, {comparison}: {limits.consequence}, {remedy}"


def _space_limits(setup: _Setup) -> Iterator[str]:
    """Yield an error for each range of the space that exceeds a limit of the base."""
    for parameter in setup.robot.space:
        target_names = {target.name for target in parameter.sets if target.server == setup.planner}
        for base_field, limited_names in LIMITED.items():
            if target_names.isdisjoint(limited_names):
                continue
            start_value = parameter.sets[0].value_in(setup.full) or 0.0
            # The range includes an initial value beyond the limit.
            limit = max(getattr(setup.robot.base, base_field), abs(start_value))
            if max(abs(parameter.low), abs(parameter.high)) > limit:
                range_field = f"parameter_space.{parameter.name}.range"
                problem = f"but base.{base_field} of this base is {limit:g}"
                yield f"{range_field} is {_list(parameter.range)}, {problem}: stay within {limit:g}"


def space_errors(robot: Robot, full: Tree) -> Iterator[str]:
    """Yield the first error of each parameter of a robot's space, compared with a complete tree."""
    known_servers = servers(full)
    for parameter in robot.space:
        problem = _space_problem(parameter, known_servers, full)
        if problem:
            yield f"parameter_space.{parameter.name}: {problem}"


def _space_problem(parameter: SpaceParameter, known: Dict[str, Server], full: Tree) -> str:
    """Return the first problem of a parameter of a space; "" if there is none."""
    for target in parameter.sets:
        refusal = _refusal(parameter, target, known)
        if refusal:
            return refusal
    start_value = parameter.sets[0].value_in(full)
    if not parameter.low <= start_value <= parameter.high:
        return f"move_base starts with {start_value:g}; include it in the range"
    return ""


def _refusal(parameter: SpaceParameter, target: Target, known: Dict[str, Server]) -> str:
    """Return why a parameter cannot set the value at an address; "" if there is no problem."""
    server_name = "move_base's own server"
    if target.server:
        server_name = f"server {target.server} of move_base"
    if target.server not in known:
        known_names = list(filter(None, known))
        advice = did_you_mean(target.server, known_names) or "give " + ", ".join(known_names)
        return f"there is no {server_name}; {advice}"
    declared = known[target.server].declared(target.name)
    if declared is None or declared.type not in ("double", "int"):
        advice = "docs/reference/parameters.md lists its parameters"
        return f"{server_name} has no number {target.name}; {advice}"
    is_count = declared.type == "int"
    if is_count != parameter.integer:
        setting = f"integer is {str(parameter.integer).lower()}"
        problem = f"but {target.name} of {server_name} is of type {declared.type}"
        return f"{setting}, {problem}: give integer: {str(is_count).lower()}"
    lowest, highest = sorted(map(target.signed, parameter.range))
    if not declared.min <= lowest <= highest <= declared.max:
        return f"{server_name} takes {declared.min:g} to {declared.max:g}; stay within it"
    return ""


# --- remarks --------------------------------------------------------------------------------------


def _planner_remarks(setup: _Setup) -> Iterator[Remark]:
    """Yield speeds that the base cannot reach, and inconsistent values of the local planner."""
    planner = setup.planner
    file_values = branch(setup.tree, planner)
    for base_field, limited_names in LIMITED.items():
        base_limit = getattr(setup.robot.base, base_field)
        for parameter_name in limited_names:
            file_value = file_values.get(parameter_name)
            if isinstance(file_value, (int, float)) and abs(file_value) > base_limit:
                problem = (
                    f"the base will not exceed base.{base_field} in robot.yaml ({base_limit:g})"
                )
                correction = {planner: {parameter_name: copysign(base_limit, file_value)}}
                yield Remark(f"{planner}/{parameter_name} is {file_value:g}: {problem}", correction)
    values = setup.full[planner]
    for limits in crossed_limits(planner, values):
        if limits.consequence:
            continue  # check() returns this error.
        largest = values[limits.high]
        comparison = f"larger than {limits.high} ({largest:g})"
        message = (
            f"{planner}/{limits.low} is {values[limits.low]:g}, {comparison}: lower {limits.low}"
        )
        yield Remark(message, {planner: {limits.low: largest}})
    yield from _dead_band_remarks(setup)


def _linked_remarks(setup: _Setup) -> Iterator[Remark]:
    """Yield parameters of the space that set values to which the files give different numbers."""
    known_servers = servers(setup.full)
    for parameter in setup.robot.space:
        if _space_problem(parameter, known_servers, setup.full):
            continue  # check() returns this error.
        numbers = set()
        values_in_words = []
        for target in parameter.sets:
            value = target.value_in(setup.full)
            numbers.add(target.signed(value))
            path = f"{target.server}/{target.name}".lstrip("/")
            values_in_words.append(f"{path} is {value:g}")
        if len(numbers) > 1:
            problem = "the defaults keep these values, but a policy or tuned set gives them one"
            remedy = "make them equal if they belong together"
            yield Remark(f"{', '.join(values_in_words)}: {problem}; {remedy}")


def _dead_band_remarks(setup: _Setup) -> Iterator[Remark]:
    """Yield parameters of the local planner with which it sends commands that the base ignores."""
    planner = setup.planner
    values = setup.full[planner]
    command_rate = setup.full["controller_frequency"]
    for slowest, dead_band in zip(SLOWEST[planner], setup.robot.base.dead_band):
        cause = f"the base ignores less than base.dead_band in robot.yaml ({dead_band:g})"
        smallest_command = values[slowest.command]
        if smallest_command < dead_band:
            label = f"{planner}/{slowest.command}"
            message = f"{label} is {smallest_command:g}, but {cause}: raise it to {dead_band:g}"
            yield Remark(message, {planner: {slowest.command: dead_band}})
        if slowest.first_limit:
            limit = values[slowest.first_limit]
            if limit < dead_band * command_rate:
                label = f"{planner}/{slowest.first_limit}"
                consequence = f"the first command from rest is at most {limit / command_rate:.3g}"
                enough = dead_band * command_rate
                message = (
                    f"{label} is {limit:g}: {consequence}, but {cause}; raise it to {enough:g}"
                )
                yield Remark(message, {planner: {slowest.first_limit: enough}})


def _range_remarks(setup: _Setup) -> Iterator[Remark]:
    """Yield lasers whose points mark obstacles for less than SIGHT_S at the planner's top speed.

    Also yield those that mark obstacles beyond the range in which they are cleared. A parameter set
    or a policy that drives faster has a range of its own (Method.obstacle_range).
    """
    top_speed = setup.full[setup.planner]["max_vel_x"]
    needed = min(SIGHT_S * top_speed, setup.robot.laser.range_max)
    for source in laser_sources(setup.tree):
        clearing_range = branch(setup.full, source.path)["raytrace_range"]
        if clearing_range < source.obstacle_range:
            comparison = f"below obstacle_range ({source.obstacle_range:g})"
            problem = "what is marked beyond it is not cleared from there"
            remedy = f"raise it to {source.obstacle_range:g}"
            label = f"{source.path}/raytrace_range"
            line = f"{label} is {clearing_range:g}, {comparison}: {problem}, {remedy}"
            corrected_values = {"raytrace_range": source.obstacle_range}
            yield Remark(line, _correction(setup, source.path, corrected_values))
        if source.obstacle_range >= needed:
            continue
        sight_s = source.obstacle_range / top_speed
        problem = f"obstacles are marked {sight_s:.2g} s ahead at max_vel_x ({top_speed:g})"
        # Rays that clear farther already keep their range.
        needed_values = ranges(needed)
        clearing_range = max(clearing_range, needed_values["raytrace_range"])
        needed_values["raytrace_range"] = clearing_range
        remedy = f"give {needed:g} and raytrace_range {clearing_range:g}"
        line = f"{source.path}/obstacle_range is {source.obstacle_range:g}: {problem}; {remedy}"

        # Another source may see farther, so that only this one is corrected.
        yield Remark(line, _correction(setup, source.path, needed_values))


def _inflation_remarks(setup: _Setup) -> Iterator[Remark]:
    """Yield layers of the global costmap that let plans lead through gaps that are too narrow."""
    costmap, _ = COSTMAPS
    values = setup.full[costmap]
    for layer in layers(costmap, values, INFLATION_LAYER):
        radius = branch(setup.full, layer.path)["inflation_radius"]
        smallest_radius = round(footprint.passing_radius(values), 3)
        if radius >= smallest_radius:
            continue
        problem = "plans lead through gaps that are narrower than the robot"
        remedy = f"raise it to {smallest_radius:g}, for the footprint's inscribed radius"
        line = f"{layer.path}/inflation_radius is {radius:g}: {problem}, {remedy}"
        correction = _correction(setup, layer.path, {"inflation_radius": smallest_radius})
        yield Remark(line, correction)


def _correction(setup: _Setup, path: str, values: Values) -> Tree:
    """Return the correction that sets values of a costmap's source or layer at a path."""
    correction: Tree = {}
    branch(correction, section_in_files(setup.tree, path), create=True).update(values)
    return correction


def _odometry_remarks(setup: _Setup) -> Iterator[Remark]:
    """Yield a local planner that reads another odometry than the collision monitor."""
    planner_topic = branch(setup.tree, setup.planner).get("odom_topic")
    topic = setup.robot.topics.odometry
    if planner_topic and _differ(str(planner_topic), topic):
        problem = (
            f"but topics.odometry in robot.yaml, which the collision monitor reads, is {topic}"
        )
        yield Remark(
            f"{setup.planner}/odom_topic is {planner_topic}, {problem}: give the same topic"
        )


def _costmap_remarks(setup: _Setup, costmap: str) -> Iterator[Remark]:
    """Yield inconsistent values in footprint and observation sources of a costmap."""
    robot = setup.robot
    values = setup.full[costmap]
    outline = geometry.box_outline(robot)
    if _has_no_footprint(setup, costmap):
        corners = ", ".join(map(_list, outline))
        substitute = f"a circle of {values['robot_radius']:g} m is used"
        advice = f"body and wheels fill [{corners}]; give this outline"
        message = f"{costmap}/footprint is missing: {substitute}, but {advice}"
        yield Remark(message, {costmap: {"footprint": outline}})
    elif costmap == "local_costmap":
        # Distances of both outlines in eight directions
        robot_reach = (geometry.corners(robot) @ DIRECTIONS).max(axis=0)
        footprint_reach = (footprint.padded(values) @ DIRECTIONS).max(axis=0)
        excess = (robot_reach - footprint_reach).max()
        without_padding = footprint.padded({**values, "footprint_padding": 0.0})
        sizes = unlike_sizes(without_padding, geometry.corners(robot))
        if sizes:
            advice = "correct the footprint, or body in robot.yaml"
            yield Remark(f"local_costmap/footprint: {sizes}: {advice}")
        if excess > OUTSIDE:
            box_reach = "the box around body and wheels, at which the monitor stops, reaches"
            problem = f"{box_reach} {excess:.2f} m beyond it with padding"
            advice = f"[{', '.join(map(_list, outline))}] contains them"
            # The global costmap needs the same footprint, or its plans lead through too narrow
            # gaps.
            correction = dict.fromkeys(COSTMAPS, {"footprint": outline})
            yield Remark(f"local_costmap/footprint is too small: {problem}; {advice}", correction)
    laser_frame = robot.laser.frame
    for source in observation_sources(costmap, values):
        sensor_frame = source.values["sensor_frame"]
        is_scan = not _differ(source.values["topic"], robot.topics.scan)
        if sensor_frame and is_scan and _differ(sensor_frame, laser_frame):
            problem = f"but laser.frame in robot.yaml is {laser_frame}"
            remedy = f"give {laser_frame} or omit it"
            yield Remark(f"{source.path}/sensor_frame is {sensor_frame}, {problem}: {remedy}")


def unlike_sizes(outline: Array, robot: Array, ratio: float = UNLIKE) -> str:
    """Return the sizes of a footprint and a robot in words if they differ by a ratio, or "".

    Args:
        outline: Footprint (n, 2) [m]; empty if there is none.
        robot: Points (n, 2) of body and wheels, whose bounds are those of all of them [m].
        ratio: Ratio of two lengths or widths from which on the sizes are unlike.
    """
    if not len(outline):
        return ""
    footprint_size = np.ptp(outline, axis=0)
    robot_size = np.ptp(robot, axis=0)
    fitting_size = robot_size
    if geometry.is_oval(outline):  # A circle contains the corners of a robot.
        centre = (robot.min(axis=0) + robot.max(axis=0)) / 2
        fitting_size = 2 * np.hypot(*(robot - centre).T).max()
    ratios = footprint_size / fitting_size
    if max(ratios.max(), 1.0 / ratios.min()) < ratio:
        return ""
    length, width = footprint_size
    robot_length, robot_width = robot_size
    return (
        f"the footprint is {length:.2f} x {width:.2f} m, but body and wheels are "
        f"{robot_length:.2f} x {robot_width:.2f} m"
    )


# --- helpers --------------------------------------------------------------------------------------


def _has_no_footprint(setup: _Setup, costmap: str) -> bool:
    """Return whether the files give a costmap neither an outline nor a radius of the robot.

    A costmap finds both also at the top of the tree.
    """
    parameter_names = {*branch(setup.tree, costmap), *setup.tree}
    return "footprint" not in parameter_names and "robot_radius" not in parameter_names


def _rounded_down(acceleration: float) -> float:
    """Return an acceleration rounded down to three decimals, which a user may enter [m/s^2]."""
    return floor(1000.0 * acceleration) / 1000.0


def _differ(name: str, expected: str) -> bool:
    """Return whether two names of topics or frames differ, except for slashes at their ends."""
    return name.strip("/") != expected.strip("/")


def _list(numbers: Sequence[float]) -> str:
    words = map("{:g}".format, numbers)
    return f"[{', '.join(words)}]"
