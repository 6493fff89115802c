"""The local planner's parameters: the planner that they are for, the base's limits, contradictions, traps."""

from __future__ import annotations

from math import pi
from typing import Iterator

from applr_ros1.common.errors import ApplrError
from applr_ros1.planner.costmap.grid import INSCRIBED
from applr_ros1.planner.dwa.samples import SLACK
from applr_ros1.planner.parameters.check import warnings
from applr_ros1.planner.parameters.declarations import LOCAL_PLANNERS, namespace
from applr_ros1.policy.parameter_space import space_of
from applr_ros1.robot_check.parameters import Setup
from applr_ros1.robots.description import find

DWA = "DWAPlannerROS"
SPEEDS = ("max_vel_x", "min_vel_x", "max_vel_trans", "min_vel_trans", "max_trans_vel", "min_trans_vel", "escape_vel")
TURNS = (
    ("max_vel_theta", "min_vel_theta", "max_rot_vel", "min_rot_vel", "max_rotational_vel", "min_in_place_vel_theta")
    + ("min_in_place_rotational_vel",)
)  # fmt: skip


def another_one(setup: Setup) -> Iterator[str]:
    """Whether the files hold the parameters of another planner alone."""
    plugins = {namespace(plugin): plugin for plugin in LOCAL_PLANNERS}
    held = [name for name in plugins if name in setup.tree]
    if setup.planner in plugins and held and setup.planner not in held:
        given = setup.tree.get("base_local_planner", f"not given, which means {LOCAL_PLANNERS[0]}")
        yield setup.placed(
            f"base_local_planner is {given}, but the files hold the parameters of {held[0]} alone: give "
            f"{plugins[held[0]]}, or a file with the section {setup.planner}"
        )


def errors(setup: Setup) -> Iterator[str]:
    """What the planner cannot drive with."""
    base, name, value = setup.robot.base, setup.planner, setup.value
    for names, limit, unit in ((SPEEDS, "max_speed", "m/s"), (TURNS, "max_yaw_rate", "rad/s")):
        most = getattr(base, limit)
        for speed in names:
            given = find(setup.tree, name, (speed,))
            if given is not None and abs(given) > most:
                yield setup.placed(
                    f"{name}/{speed} is {given:g}: base.{limit} in robot.yaml is {most:g} {unit}, give at most that"
                )
    pairs = [("min_vel_x", "max_vel_x"), ("min_vel_theta", "max_vel_theta")]
    for low, high in pairs + [("min_vel_trans", "max_vel_trans")] * (name == DWA):
        if value(low) > value(high):
            yield setup.placed(f"{name}/{low} is {value(low):g}: {high} is {value(high):g}, give at most that")
    if value("sim_time") == 0.0:
        yield setup.placed(f"{name}/sim_time is 0: no velocity is legal then, give about 1.5 s")
    if name == DWA:
        yield from _window(setup)


def space(setup: Setup) -> Iterator[str]:
    """What no parameter space can be made of, where all else is right."""
    base, planner = setup.robot.base, setup.planner
    for parameter in setup.robot.space:
        for setting in parameter.settings:
            for names, limit in ((SPEEDS, "max_speed"), (TURNS, "max_yaw_rate")):
                most = getattr(base, limit)
                beyond = max(abs(parameter.low), abs(parameter.high)) > most
                if beyond and setting.server == planner and setting.names[0] in names:
                    yield setup.own(
                        f"parameter_space.{parameter.name}.range is [{parameter.low:g}, {parameter.high:g}]: "
                        f"base.{limit} of this base is {most:g}, stay within it"
                    )
    try:
        space_of(setup.robot)
    except ApplrError as error:
        yield setup.own(str(error).partition(": ")[2])


def _window(setup: Setup) -> Iterator[str]:
    """Whether a robot that stands reaches, within the dynamic window, a velocity that is not refused as too small."""
    value = setup.value
    rate = value("controller_frequency") or 20.0
    seconds = 1.0 / rate if value("use_dwa") else value("sim_time")
    speed = min(value("acc_lim_x") * seconds, max(value("max_vel_x"), -value("min_vel_x")))
    turn = min(value("acc_lim_theta") * seconds, value("max_vel_theta"))
    if speed + SLACK < value("min_vel_trans") and turn + SLACK < value("min_vel_theta"):
        yield setup.placed(
            f"{DWA}/acc_lim_theta is {value('acc_lim_theta'):g}: within {seconds:g} s a robot that stands reaches "
            f"{turn:.3g} rad/s and {speed:.3g} m/s, below min_vel_theta {value('min_vel_theta'):g} and min_vel_trans "
            f"{value('min_vel_trans'):g}, so that every sample is refused: give acc_lim_theta "
            f"{value('min_vel_theta') / seconds:.3g}, or smaller speeds"
        )


def remarks(setup: Setup) -> Iterator[str]:
    """What is in vain, or a trap though nothing is wrong with it."""
    name, value, topics = setup.planner, setup.value, setup.robot.topics
    yield from (setup.placed(str(finding)) for finding in warnings(setup.tree))
    if name == DWA:
        yield from map(setup.placed, _traps(setup))
    if value("yaw_goal_tolerance") > pi:
        yield setup.placed(
            f"{name}/yaw_goal_tolerance is {value('yaw_goal_tolerance'):g}: every heading is within it, give radians"
        )
    topic = setup.tree.get(name, {}).get("odom_topic", topics.odometry)
    if topic.lstrip("/") != topics.odometry.lstrip("/"):
        wanted = f"topics.odometry in robot.yaml is {topics.odometry}"
        yield setup.placed(f"{name}/odom_topic is {topic}: {wanted}, give that or leave it out")


def _traps(setup: Setup) -> Iterator[str]:
    value, planner = setup.value, setup.planner
    change = value("acc_lim_x") / (value("controller_frequency") or 20.0)
    if value("min_vel_x") <= -value("min_vel_trans") and change < 2.0 * value("min_vel_trans"):
        yield (
            f"{planner}/min_vel_x is {value('min_vel_x'):g}: a robot that backs can neither stop nor drive ahead until "
            f"a cycle fails, for acc_lim_x / controller_frequency is {change:.3g} m/s, and speeds below min_vel_trans "
            f"{value('min_vel_trans'):g} are refused"
        )
    if value("max_vel_x") > value("max_vel_trans") + SLACK:
        yield (
            f"{planner}/max_vel_x is {value('max_vel_x'):g}: samples above max_vel_trans {value('max_vel_trans'):g} "
            "are refused, give at most that"
        )
    progress = 2.0 * value("goal_distance_bias") * value("max_vel_trans") * value("sim_time")  # goal and nose to goal
    obstacle = value("occdist_scale") * INSCRIBED
    if obstacle > progress:
        yield (
            f"{planner}/occdist_scale is {value('occdist_scale'):g}: before a narrow gap the robot turns or stands, "
            f"for an obstacle beside it costs {obstacle:.2f}, all progress of a trajectory counts {progress:.2f} "
            "(goal_distance_bias)"
        )
