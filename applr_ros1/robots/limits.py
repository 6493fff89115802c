"""What a description may not say against itself: ranges beyond the base's limits, a laser that sees nothing.

reader.py calls `problems` last.
"""

from __future__ import annotations

from math import pi
from typing import Iterator, Tuple

from applr_ros1.common.trees import branch
from applr_ros1.robots.description import Robot, Setting, find

# the last part of a server's name is that of a local planner; its speeds by the base's limits
_SPEEDS = ("max_vel_x", "min_vel_x", "max_vel_trans", "min_vel_trans", "max_trans_vel", "min_trans_vel", "escape_vel")
_TURNS = (
    ("max_vel_theta", "min_vel_theta", "max_rot_vel", "min_rot_vel", "max_rotational_vel", "min_in_place_vel_theta")
    + ("min_in_place_rotational_vel",)
)  # fmt: skip
_PLANNERS = ("TrajectoryPlannerROS", "DWAPlannerROS")


def problems(robot: Robot) -> Iterator[str]:
    """A line for each contradiction in a description."""
    yield from _base(robot)
    yield from _ground(robot)
    yield from _laser(robot)
    yield from _files(robot)
    yield from _space(robot)
    for name, limit in (("deceleration", "max_acceleration"), ("yaw_deceleration", "max_yaw_acceleration")):
        asked, most = getattr(robot.monitor, name), getattr(robot.base, limit)
        if asked > most:
            yield f"monitor.{name} is {asked:g}: the base brakes with base.{limit} {most:g}, give at most that"


def _base(robot: Robot) -> Iterator[str]:
    base = robot.base
    if base.drive == "skid_steer" and base.wheelbase == 0.0:
        yield "base.wheelbase is missing: a skid_steer base has two axles, give their distance"
    if base.drive == "two_wheel" and base.wheelbase != 0.0:
        yield f"base.wheelbase is {base.wheelbase:g}: a two_wheel base has one axle, leave it out"
    if base.drive == "skid_steer" and base.casters:
        yield "base.casters: a skid_steer base has none, leave them out"
    if base.drive == "two_wheel" and not base.casters:
        yield "base.casters is missing: a two_wheel base stands on one at least, give where they touch the ground"


def _ground(robot: Robot) -> Iterator[str]:
    if robot.simulation.ground == "gazebo":
        if robot.base.drive != "skid_steer":
            yield "simulation.ground is gazebo: it is for a skid_steer base, give plain"
        if robot.simulation.track_multiplier is None:
            yield "simulation.track_multiplier is missing: ground gazebo needs the one of the wheels' controller"


def _laser(robot: Robot) -> Iterator[str]:
    laser = robot.laser
    if not laser.first_angle < laser.last_angle:
        yield f"laser.last_angle is {laser.last_angle:g}: give more than first_angle {laser.first_angle:g}"
    elif laser.last_angle - laser.first_angle > 2 * pi + 1e-3:
        yield (
            f"laser.last_angle is {laser.last_angle:g}: from first_angle {laser.first_angle:g} that is more than a "
            "full turn"
        )
    if not laser.range_min < laser.range_max:
        yield f"laser.range_max is {laser.range_max:g}: give more than range_min {laser.range_min:g}"
    elif laser.no_return is not None and laser.range_min <= laser.no_return < laser.range_max:
        yield f"laser.no_return is {laser.no_return:g}: between range_min and range_max it would hide obstacles"


def _space(robot: Robot) -> Iterator[str]:
    for parameter in robot.space:
        label = f"parameter_space.{parameter.name}"
        for setting in parameter.settings:
            limit, most = _limit(robot, setting)
            if limit and max(abs(parameter.low), abs(parameter.high)) > most:
                yield (
                    f"{label}.range is [{parameter.low:g}, {parameter.high:g}]: {limit} of this base is {most:g}, "
                    "stay within it"
                )
        start = robot.start_value(parameter)
        if start is not None and not parameter.low <= start <= parameter.high:
            yield (
                f"{label}.range is [{parameter.low:g}, {parameter.high:g}]: the parameter files start with {start:g}, "
                "include it"
            )
        elif start is not None and parameter.integer and not start.is_integer():
            yield f"{label} is an integer, but the parameter files start with {start:g}: give a whole number"


def _limit(robot: Robot, setting: Setting) -> Tuple[str, float]:
    """Name and value of the base's limit that bounds a setting; ("", 0) where none does."""
    if setting.server.rpartition("/")[2] in _PLANNERS:
        if setting.names[0] in _SPEEDS:
            return "base.max_speed", robot.base.max_speed
        if setting.names[0] in _TURNS:
            return "base.max_yaw_rate", robot.base.max_yaw_rate
    return "", 0.0


def _files(robot: Robot) -> Iterator[str]:
    """Speeds in the parameter files that the base cannot drive, and frames that differ."""
    tree = robot.move_base.without_map
    planner = robot.local_planner
    for names, limit in ((_SPEEDS, "max_speed"), (_TURNS, "max_yaw_rate")):
        most = getattr(robot.base, limit)
        for name in names:
            value = find(tree, planner, (name,))
            if value is not None and abs(value) > most:
                yield f"{planner}/{name} is {value:g} in the parameter files: base.{limit} is {most:g}"
    for costmap in ("local_costmap", "global_costmap"):
        frame = branch(tree, costmap).get("robot_base_frame", robot.frames.base)
        if frame != robot.frames.base:
            yield f"{costmap}/robot_base_frame is {frame} in the parameter files: frames.base is {robot.frames.base}"
