"""Checks the description of a robot, says in short what the package makes of it, and drives it on open floor.

Started as `rosrun applr_ros1 check_robot.py` or `python -m training.check_robot`. Lines that begin with "error" name
what the robot cannot drive with, lines that begin with "remark" what it will not drive well with or what has no effect.
Each has the name, its value, and what to give. If the robot's own parameters do not drive it on open floor, the last
lines say why and what to change. docs/tutorials/your_robot.md says how to write a description.
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
from training.common.command_line import parsed
from training.common.options import Options, argument
from training.tuning import open_floor


def summary(described: Robot) -> List[str]:
    """Lines about a robot without errors, for people."""
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


def check(name_or_folder: str) -> int:
    """Print all that there is to say about a robot; exit status 1 where it has an error or does not drive."""
    try:
        described = read(name_or_folder)
        setups = [False] if described.move_base.with_map is None else [False, True]
        errors = [line for with_map in setups for line in rules.check(described, with_map)]
    except RobotError as refused:
        errors = list(refused.lines)
    if errors:
        print("\n".join(f"error: {line}" for line in dict.fromkeys(errors)), file=sys.stderr)
        return 1
    lines = [f"remark: {line}" for with_map in setups for line in rules.remarks(described, with_map)]
    print("\n".join(summary(described) + list(dict.fromkeys(lines))), flush=True)
    drives, lines = open_floor.try_out(described)
    print("\n".join(lines))
    return 0 if drives else 1


class CheckOptions(Options):
    """Robot to check."""

    robot: str = argument(f"Folder with robot.yaml, or one of the included robots: {', '.join(NAMES)}.")


def main(arguments: Optional[Sequence[str]] = None) -> int:
    """Exit status 0 for a robot that drives on open floor, else 1; errors of its description are lines on stderr."""
    name = "check_robot.py"
    return run_main(lambda: check(parsed(CheckOptions, name, __doc__, arguments).robot), name)


if __name__ == "__main__":
    sys.exit(main())
