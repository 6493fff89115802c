"""Checks the description of a robot, summarises the resulting configuration, and drives the robot on open floor.

Run it as `rosrun applr_ros1 check_robot.py` or `python -m training.robot.check`. Lines that begin with "error" report
values with which the robot cannot drive, lines that begin with "remark" report values that impair driving or have no
effect. Each line has the name of a field, its value and the remedy. If the robot does not drive on open floor with its
default parameters, the last lines give the reason and the remedy. docs/tutorials/your_robot.md explains how to write a
description.
"""

from __future__ import annotations

import sys
from math import degrees
from typing import List, Optional, Sequence

import numpy as np

from applr_ros1.common.errors import run_main
from applr_ros1.planner.move_base import MoveBase
from applr_ros1.policy.observation import layout_of
from applr_ros1.policy.parameter_space import space_of
from applr_ros1.robots import NAMES, Robot
from applr_ros1.robots import check as rules
from applr_ros1.robots.folder import RobotError, read
from applr_ros1.robots.geometry import radius
from training.common.command_line import parsed
from training.common.options import Options, argument, option
from training.robot import open_floor
from worlds.map_courses import Building


def summary(described: Robot) -> List[str]:
    """Return the lines that summarise a robot without errors."""
    base, laser = described.base, described.laser
    planner = MoveBase(described.parameters())
    length, width = np.ptp(planner.local_costmap.footprint, axis=0)
    space, layout = space_of(described), layout_of(described)
    without = "without a map only" if described.move_base.with_map is None else "with and without a map"
    lines = [
        f"{described.name}: {base.drive}, {base.max_speed:g} m/s, {base.max_yaw_rate:g} rad/s",
        f"footprint with padding: {length:.2f} x {width:.2f} m; worlds at {described.world_scale:g} of the Jackal's",
        f"laser: {laser.beams} beams, {degrees(laser.first_angle):.0f} to {degrees(laser.last_angle):.0f} degrees, "
        f"{laser.range_min:g} to {laser.range_max:g} m, {laser.rate:g} Hz; a policy sees {layout.beams} beams up to "
        f"{layout.range_cap:.1f} m",
        f"move_base: {described.local_planner}, {planner.configuration('')['controller_frequency']:g} commands per "
        f"second, {without}",
        "parameter space, default and range:",
    ]
    return lines + [
        f"  {parameter.name:24} {start:<6g} {parameter.low:g} to {parameter.high:g}"
        for parameter, start in zip(described.space, space.theta0)
    ]


def doors(described: Robot, path: str) -> str:
    """Return a line on the narrowest passage of all courses through the building of a map."""
    courses = Building(path, radius(described))
    narrowest = min(map(courses.passage, range(courses.count)))
    width = np.ptp(MoveBase(described.parameters()).local_costmap.footprint, axis=0)[1]
    fits = f"passes with {(narrowest - width) / 2:.2f} m on each side"
    fits = fits if narrowest > width else "does not pass: reduce footprint_padding"
    return f"narrowest passage of {path}: {narrowest:.2f} m; the padded footprint of {width:.2f} m {fits}"


def check(name_or_folder: str, path: str = "") -> int:
    """Print errors and remarks; without errors, also summary, doors and test drives. Return 1 if the robot fails."""
    remarks: List[str] = []
    try:
        described = read(name_or_folder)
        setups = [False] if described.move_base.with_map is None else [False, True]
        errors = [line for with_map in setups for line in rules.check(described, with_map)]
        remarks = [f"remark: {line}" for with_map in setups for line in rules.remarks(described, with_map)]
    except RobotError as refused:
        errors = list(refused.lines)
    for line in dict.fromkeys(errors):
        print(f"error: {line}", file=sys.stderr)
    if path and not errors:
        remarks.append(doors(described, path))
    for line in [*([] if errors else summary(described)), *dict.fromkeys(remarks)]:
        print(line, flush=True)
    if errors:
        return 1
    drives, lines = open_floor.try_out(described)
    print("\n".join(lines))
    return 0 if drives else 1


class CheckOptions(Options):
    """Robot to check."""

    robot: str = argument(f"Folder with robot.yaml, or one of the included robots: {', '.join(NAMES)}.")
    map: str = option("", "Map of a building, MAP.yaml: report the narrowest passage on its courses.")


def main(arguments: Optional[Sequence[str]] = None) -> int:
    """Run the command. Return 0 if the robot drives on open floor, else 1; errors are printed to stderr."""
    name = "check_robot.py"
    return run_main(lambda: check(*vars(parsed(CheckOptions, name, __doc__, arguments)).values()), name)


if __name__ == "__main__":
    sys.exit(main())
