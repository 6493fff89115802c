"""The rules about a robot's folder, beside what its schema and the planner's declarations refuse.

check.py applies them: to robot.yaml, and to the move_base parameters that are in force with its files.
"""

from __future__ import annotations

from math import pi
from operator import attrgetter
from typing import Any, Callable, Iterator, NamedTuple, Tuple

from applr_ros1.common.errors import Finding
from applr_ros1.planner.parameters.declarations import of_kind
from applr_ros1.planner.parameters.dwa_planner_parameters import SLACK

# places of values: robot.yaml, the numbers that files give the local planner, the local planner with defaults,
# DWAPlannerROS, a costmap, an inflation layer, a static layer, an observation source
ROBOT, GIVEN, PLANNER, DWA, COSTMAP, INFLATION, STATIC, SOURCE = (
    *("robot.yaml", "given", "local planner", "DWAPlannerROS"),
    *("costmap", "inflation layer", "static layer", "source"),
)
BLIND = "blind source"  # why a source does not show what the laser sees
LIMITED = ((of_kind("speed"), "max_speed", "m/s"), (of_kind("turn"), "max_yaw_rate", "rad/s"))  # by a field of base
UNITS = 10.0  # ratio of lengths from which on one is in centimetres or millimetres
SCALE_OFF = 0.15  # share by which world_scale may differ from the one that follows from the footprint
ON_AXLE = 0.01  # m from the axle within which a caster holds nothing up
UNLIKE = 0.05, 4.0  # times that of a full box: less has a mass in one point, more one in the corners of the box
GOAL_AHEAD_M = 10.45  # of the courses in built-in worlds, at the Jackal's scale
OUTSIDE = 0.01  # m by which body and wheels may reach beyond the padded footprint


class Rule(NamedTuple):
    """One thing to look at.

    place, key: of the value. when: whether there is something to say, of the place's values v and measures m. advice:
    why it is wrong and what to give; value: what stands there, where that is not the value itself. Both are format
    strings of v and m.
    """

    place: str
    key: str
    when: Callable[[Any, Any], Any]
    advice: str
    severity: Any = "error"
    value: str = ""


def _always(v: Any, m: Any) -> bool:
    return True


def _at_most(place: str, key: str, limit: str, severity: str = "error", when: Callable[..., Any] = _always) -> Rule:
    """Return the rule that one of the values is not larger than another."""
    low, high = attrgetter(key), attrgetter(limit)
    advice = f"{limit} is {{v.{limit}:g}}, give at most that"
    return Rule(place, key, lambda v, m: when(v, m) and low(v) > high(v), advice, severity)


def _same(place: str, key: str, field: str, severity: str = "error", when: Callable[..., Any] = _always) -> Rule:
    """Return the rule that a value is the topic or frame that a field of robot.yaml names."""
    given, wanted = attrgetter(key), attrgetter(field)
    advice = f"{field} in robot.yaml is {{m.{field}}}, give that" + " or leave it out" * (severity == "remark")
    return Rule(place, key, lambda v, m: when(v, m) and _differ(given(v), wanted(m)), advice, severity)


def _within(name: str, limit: str, unit: str) -> Rule:
    """Return the rule that a number that files give the planner is at most what the base's controller allows."""
    advice = f"base.{limit} in robot.yaml is {{m.base.{limit}:g}} {unit}, which the base will not exceed"
    return Rule(GIVEN, name, lambda v, m: abs(getattr(v, name, 0.0)) > getattr(m.base, limit), advice, "warning")


def _in_metres(key: str) -> Rule:
    """Return the rule that what makes a footprint too large or too small is in metres."""
    advice = "with padding that is {m.reach[0]:.3g} x {m.reach[1]:.3g} m, body and wheels are {m.length:.3g} x "
    advice += "{m.width:.3g} m, give metres"
    return Rule(COSTMAP, key, lambda v, m: m.wrong_units == key, advice, value=f"is {{v.{key}!s:.60}}")


def _differ(given: str, wanted: str) -> bool:
    return bool(wanted) and given.strip("/") != wanted.strip("/")


def apply(place: str, v: Any, m: Any, given: Callable[[str], bool] = bool) -> Iterator[Finding]:
    """Yield what the rules of a place say.

    Args:
        place: One of those above.
        v: Its values; their attributes are the rules' keys.
        m: Measures that the rules compare them with.
        given: Tells whether somebody gave the value of a key, which otherwise is a default.
    """
    for rule in RULES:
        if rule.place == place and rule.when(v, m):
            value = rule.value.format(v=v, m=m) or _stated(attrgetter(rule.key)(v))
            if not (rule.value or given(rule.key)):
                value = value.replace("is ", "is not given, which means ", 1)
            yield Finding(rule.key, value, rule.advice.format(v=v, m=m), rule.severity)


def _stated(value: Any) -> str:
    """Return how a finding names a value."""
    if value is None or value == ():
        return "is missing"
    if isinstance(value, tuple):
        return f"is [{', '.join(f'{number:g}' for number in value)}]"
    if isinstance(value, bool):
        return f"is {str(value).lower()}"
    return f"is {value:g}" if isinstance(value, float) else f"is {value!s:.60}"


_START = (
    "the costmap, {{v.{0}:g}} m long, does not hold the robot's start at 0, give {{m.centred_{1}:g}}, or "
    "rolling_window: true"
)
_WIDE = "the robot is {m.width:.3g} m wide, give metres"
_DROPPED = "laser.height in robot.yaml is {{m.laser.height:g}}, so that all points are dropped, give at {} that"

# Read the rules as: place, key, when there is something to say, and below that why and what to give.
# fmt: off
RULES: Tuple[Rule, ...] = (
    Rule(ROBOT, "base.wheelbase", lambda v, m: m.skids and not v.base.wheelbase,
        "a skid_steer base has two axles, give their distance"),
    Rule(ROBOT, "base.wheelbase", lambda v, m: not m.skids and v.base.wheelbase,
        "a two_wheel base has one axle, leave it out"),
    Rule(ROBOT, "base.casters", lambda v, m: m.skids and v.base.casters,
        "a skid_steer base has none, leave them out"),
    Rule(ROBOT, "base.casters", lambda v, m: not m.skids and not v.base.casters,
        "a two_wheel base stands on one at least, give where they touch the ground"),
    Rule(ROBOT, "base.casters", lambda v, m: m.on_axle,
        "all are below the axle, where they hold nothing up, give those ahead or behind", value="is {m.casters}"),
    Rule(ROBOT, "simulation.ground", lambda v, m: m.on_gazebo and not m.skids,
        "it is for a skid_steer base, give plain"),
    Rule(ROBOT, "simulation.track_multiplier", lambda v, m: m.on_gazebo and v.simulation.track_multiplier is None,
        "ground gazebo needs the one of the wheels' controller"),
    Rule(ROBOT, "laser.last_angle", lambda v, m: m.turn <= 0.0, "give more than first_angle {v.laser.first_angle:g}"),
    Rule(ROBOT, "laser.last_angle", lambda v, m: m.turn > 2 * pi + 1e-3,
        "from first_angle that is more than a full turn"),
    Rule(ROBOT, "laser.range_max", lambda v, m: v.laser.range_max <= m.blind, "give more than range_min {m.blind:g}"),
    Rule(ROBOT, "laser.no_return",
        lambda v, m: v.laser.no_return is not None and m.blind <= v.laser.no_return < v.laser.range_max,
        "between range_min and range_max it would hide obstacles"),
    _at_most(ROBOT, "monitor.deceleration", "base.max_acceleration"),
    _at_most(ROBOT, "monitor.yaw_deceleration", "base.max_yaw_acceleration"),
    Rule(ROBOT, "base.axle_height", lambda v, m: v.body.bottom < m.ground,
        "the ground is then at {m.ground:.3g} m, above the body's underside body.bottom {v.body.bottom:g}; give the "
        "axles' height above the base frame"),
    Rule(ROBOT, "laser.height", lambda v, m: v.laser.height < m.ground <= v.body.bottom,
        "that is below the ground at {m.ground:.3g} m, give metres"),
    Rule(ROBOT, "laser.pose", lambda v, m: m.laser_off > max(m.front - m.back, m.left - m.right),
        "body and wheels end at {m.front:.3g} m ahead and {m.left:.3g} m to the left, give metres"),
    Rule(ROBOT, "body.com", lambda v, m: m.tips,
        "the centre of mass of body and wheels lies outside the wheels and casters; check base.casters, too"),
    Rule(ROBOT, "body.inertia", lambda v, m: m.unlike,
        "a full box of that mass and size has {m.full}; compare body.mass, or leave it out", "warning"),

    *(_within(name, limit, unit) for names, limit, unit in LIMITED for name in names),
    _same(PLANNER, "odom_topic", "topics.odometry", "remark"),
    _at_most(PLANNER, "min_vel_x", "max_vel_x", "warning"),
    _at_most(PLANNER, "min_vel_theta", "max_vel_theta", "warning"),
    Rule(PLANNER, "sim_time", lambda v, m: v.sim_time == 0.0, "no velocity is legal then, give about 1.5 s"),
    Rule(PLANNER, "yaw_goal_tolerance", lambda v, m: v.yaw_goal_tolerance > pi,
        "all headings are within it, give radians", "remark"),
    _at_most(DWA, "min_vel_trans", "max_vel_trans"),
    Rule(DWA, "acc_lim_theta",
        lambda v, m: v.reached_speed + SLACK < v.min_vel_trans and v.reached_turn + SLACK < v.min_vel_theta,
        "within {v.seconds:g} s a robot that stands reaches {v.reached_turn:.3g} rad/s and {v.reached_speed:.3g} m/s, "
        "below min_vel_theta {v.min_vel_theta:g} and min_vel_trans {v.min_vel_trans:g}, so that every sample is "
        "refused: give acc_lim_theta {v.enough:.3g}, or smaller speeds"),
    Rule(DWA, "min_vel_x", lambda v, m: v.min_vel_x <= -v.min_vel_trans and v.change < 2.0 * v.min_vel_trans,
        "a robot that backs can neither stop nor drive ahead until a cycle fails, for acc_lim_x / controller_frequency "
        "is {v.change:.3g} m/s, and speeds below min_vel_trans {v.min_vel_trans:g} are refused: give acc_lim_x "
        "{v.braking:.3g}", "remark"),
    _at_most(DWA, "max_vel_x", "max_vel_trans", "remark", lambda v, m: v.max_vel_x > v.max_vel_trans + SLACK),

    Rule(COSTMAP, "footprint", lambda v, m: m.missing, "{m.fill}", "warning",
        "is missing, which means a circle of {v.robot_radius:g} m"),
    *map(_in_metres, ("footprint", "robot_radius", "footprint_padding")),
    _same(COSTMAP, "robot_base_frame", "frames.base", when=lambda v, m: not m.local),
    _same(COSTMAP, "global_frame", "frames.odom", when=lambda v, m: not m.with_map),
    _same(COSTMAP, "global_frame", "frames.map", when=lambda v, m: m.with_map and not m.local),
    Rule(COSTMAP, "resolution", lambda v, m: v.resolution > m.width, _WIDE),
    Rule(COSTMAP, "update_frequency", lambda v, m: m.local and v.update_frequency == 0.0,
        "the costmap is never updated, give that of the scans"),
    Rule(COSTMAP, "origin_x", lambda v, m: m.fixed and not -v.width < v.origin_x < 0.0, _START.format("width", "x")),
    Rule(COSTMAP, "origin_y", lambda v, m: m.fixed and not -v.height < v.origin_y < 0.0, _START.format("height", "y")),
    Rule(COSTMAP, "width", lambda v, m: not m.local and m.ahead < m.goal,
        "goals more than {m.ahead:g} m ahead are off the global costmap and have no plan, those of demo and tune are "
        "{m.goal:.1f} m ahead: give {m.wide:g} for those", "warning"),
    Rule(INFLATION, "inflation_radius", lambda v, m: v.inflation_radius > 2 * UNITS * m.width, _WIDE, "warning"),
    Rule(STATIC, "plugins", lambda v, m: not m.with_map,
        "there is no map here, leave it out in without_map", value="has {v.plugins}"),

    _same(BLIND, "topic", "topics.scan"),
    Rule(BLIND, "data_type", lambda v, m: v.data_type != "LaserScan",
        "the robot's laser publishes LaserScan, give that"),
    Rule(BLIND, "marking", lambda v, m: not v.marking, "nothing would mark obstacles, give true"),
    Rule(BLIND, "min_obstacle_height", lambda v, m: v.min_obstacle_height > m.laser.height, _DROPPED.format("most")),
    Rule(BLIND, "max_obstacle_height", lambda v, m: v.max_obstacle_height < m.laser.height, _DROPPED.format("least")),
    _same(SOURCE, "sensor_frame", "laser.frame", "remark",
        lambda v, m: v.sensor_frame and not _differ(v.topic, m.topics.scan)),
    Rule(SOURCE, "obstacle_range", lambda v, m: v.obstacle_range > v.raytrace_range,
        "what is marked beyond raytrace_range {v.raytrace_range:g} is never cleared, give at most that", "remark"),
)
# fmt: on
