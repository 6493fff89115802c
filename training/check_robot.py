"""Checks the description of a robot and says in short what the package makes of it.

Started as `rosrun applr_ros1 check_robot.py` or `python -m training.check_robot`. Lines that begin with "remark" name
what is given in vain or looks like a slip; the description can be used all the same. docs/tutorials/your_robot.md says
how to write one.
"""

from __future__ import annotations

import sys
from math import degrees
from typing import Any, Dict, List, Optional, Sequence

import numpy as np

from applr_ros1.common.errors import run_main
from applr_ros1.planner.costmap.grid import INSCRIBED
from applr_ros1.planner.move_base import MoveBase
from applr_ros1.planner.parameters.check import warnings
from applr_ros1.planner.parameters.declarations import LOCAL_PLANNERS, namespace
from applr_ros1.policy.observation import layout_of
from applr_ros1.policy.parameter_space import space_of
from applr_ros1.robots import NAMES, Robot
from applr_ros1.robots.geometry import bounding_box
from sim_bridge.mechanics import mechanics
from training.common.command_line import AnyRobot, parsed
from training.common.options import Options, argument

WIDTH = 0.53  # of the Jackal's padded footprint [m], for which the recipe of the worlds was made
SCALE_OFF = 0.15  # share by which world_scale may differ from the one that follows from the footprint
OUTSIDE = 0.01  # m by which body and wheels may reach beyond the padded footprint


def summary(described: Robot) -> List[str]:
    """Lines about a robot, for people.

    Raises an ApplrError of one line for what the planner, the parameter space or the simulators refuse.
    """
    base, laser, tree = described.base, described.laser, described.parameters()
    planner = MoveBase(tree)
    mechanics(described)
    outline = np.asarray(planner.local_costmap.footprint)
    length, width = np.ptp(outline, axis=0)
    fitting = width / WIDTH
    space, layout = space_of(described), layout_of(described)
    with_map = described.move_base.with_map
    lines = [
        f"{described.name}: {base.drive}, {base.max_speed:g} m/s, {base.max_yaw_rate:g} rad/s",
        f"footprint with padding: {length:.2f} x {width:.2f} m; worlds at {described.world_scale:g} of the Jackal's",
        f"laser: {laser.beams} beams, {degrees(laser.first_angle):.0f} to {degrees(laser.last_angle):.0f} degrees, "
        f"{laser.range_min:g} to {laser.range_max:g} m, {laser.rate:g} Hz; a policy sees {layout.beams} beams up to "
        f"{layout.range_cap:.1f} m",
        f"move_base: {namespace(tree.get('base_local_planner', LOCAL_PLANNERS[0]))}, "
        f"{planner.configuration('')['controller_frequency']:g} commands per second, "
        f"{'without a map only' if with_map is None else 'with and without a map'}",
        "parameter space, default and range:",
    ]
    lines += [
        f"  {parameter.name:24} {start:<6g} {parameter.low:g} to {parameter.high:g}"
        for parameter, start in zip(described.space, space.theta0)
    ]
    lines += ["remark: " + line for line in warnings(tree) + traps(planner.parameters)]
    frames = {planner.parameters[name]["global_frame"].lstrip("/") for name in planner.costmaps}
    if planner.missing_map or frames != {described.frames.odom}:
        lines.append(
            "remark: without a map both costmaps need the frame %s and no static layer: say so in "
            "move_base.without_map" % described.frames.odom
        )
    if with_map is not None:
        MoveBase(with_map)
        lines += ["remark, with a map: " + line for line in warnings(with_map) if "remark: " + line not in lines]
    if abs(described.world_scale / fitting - 1.0) > SCALE_OFF:
        lines.append(f"remark: world_scale is {described.world_scale:g}; by the footprint's width it is {fitting:.3f}")
    low_x, high_x, low_y, high_y = bounding_box(described)
    beyond = max(*(outline.min(axis=0) - (low_x, low_y)), *((high_x, high_y) - outline.max(axis=0)))
    if beyond > OUTSIDE:
        lines.append(f"remark: body and wheels reach {beyond:.2f} m beyond the padded footprint: compare them")
    return lines


def traps(tree: Dict[str, Any]) -> List[str]:
    """What DWAPlannerROS makes of the values of a complete parameter tree though nothing is wrong with them."""
    if namespace(tree["base_local_planner"]) != "DWAPlannerROS":
        return []
    p, lines = tree["DWAPlannerROS"], []
    change = p["acc_lim_x"] / (p["controller_frequency"] or 20.0)
    if p["min_vel_x"] <= -p["min_vel_trans"] and change < 2.0 * p["min_vel_trans"]:
        lines.append(
            "a robot that backs can neither stop nor drive ahead until a cycle fails: acc_lim_x / controller_frequency "
            f"is {change:.3g} m/s, and speeds below min_vel_trans {p['min_vel_trans']:g} are refused"
        )
    progress = 2.0 * p["goal_distance_bias"] * p["max_vel_trans"] * p["sim_time"]  # goal and nose to goal
    obstacle = p["occdist_scale"] * INSCRIBED
    if obstacle > progress:
        lines.append(
            f"before a narrow gap the robot turns or stands: an obstacle beside it costs {obstacle:.2f} "
            f"(occdist_scale), all progress of a trajectory counts {progress:.2f} (goal_distance_bias)"
        )
    return ["DWAPlannerROS: " + line for line in lines]


class CheckOptions(Options):
    """What to check."""

    robot: AnyRobot = argument(f"Folder with robot.yaml, or one of the included robots: {', '.join(NAMES)}.")


def main(arguments: Optional[Sequence[str]] = None) -> int:
    """Exit status 0 for a description that can be used; 1 and one line on stderr otherwise."""
    name = "check_robot.py"
    return run_main(lambda: print("\n".join(summary(parsed(CheckOptions, name, __doc__, arguments).robot))), name)


if __name__ == "__main__":
    sys.exit(main())
