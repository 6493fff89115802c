"""Checks the description of a robot, summarises it, and drives the robot on open floor.

Run it as `./applr check`, `rosrun applr_ros1 check_robot.py` or `python -m training.robot.check`.
Lines that begin with "error" report values with which the robot cannot drive, lines that begin with
"remark" report values that impair driving or have no effect. Each line has the name of a field, its
value and the remedy. If the robot does not drive on open floor with its default parameters, the
last lines give the reason and the remedy. docs/tutorials/your_robot.md explains how to write a
description.
"""

from __future__ import annotations

import sys
from math import degrees
from typing import List, Optional, Sequence

import numpy as np

from applr_ros1.common.errors import run_main
from applr_ros1.common.extras import extra
from applr_ros1.drives.columns import TopicNames
from applr_ros1.planner.move_base import MoveBase
from applr_ros1.policy.observation import layout_of
from applr_ros1.policy.parameter_space import space_of
from applr_ros1.robots import NAMES, Robot
from applr_ros1.robots import check as rules
from applr_ros1.robots.folder import RobotError, read
from applr_ros1.robots.geometry import radius
from training.common.command_line import parsed
from training.common.options import Options, argument, option
from training.robot import open_floor, rehearsal
from worlds.map_courses import Building


def summary(described: Robot) -> List[str]:
    """Return the lines that summarise a robot without errors."""
    base = described.base
    laser = described.laser
    layout = layout_of(described)
    planner = MoveBase(described.parameters())
    length, width = np.ptp(planner.local_costmap.footprint, axis=0)
    command_rate = planner.configuration("")["controller_frequency"]
    setups = "with and without a map"
    if described.move_base.with_map is None:
        setups = "without a map only"
    angles = f"{degrees(laser.first_angle):.0f} to {degrees(laser.last_angle):.0f} degrees"
    ranges = f"{laser.range_min:g} to {laser.range_max:g} m"
    seen = f"a policy sees {layout.beams} beams up to {layout.range_cap:.1f} m"
    scale = f"worlds at {described.world_scale:g} of the Jackal's"
    lines = [
        f"{described.name}: {base.drive}, {base.max_speed:g} m/s, {base.max_yaw_rate:g} rad/s",
        f"footprint with padding: {length:.2f} x {width:.2f} m; {scale}",
        f"laser: {laser.beams} beams, {angles}, {ranges}, {laser.rate:g} Hz; {seen}",
        f"move_base: {described.local_planner}, {command_rate:g} commands per second, {setups}",
        "parameter space, default and range:",
    ]
    for parameter, default in zip(described.space, space_of(described).theta0):
        limits = f"{parameter.low:g} to {parameter.high:g}"
        lines.append(f"  {parameter.name:24} {default:<6g} {limits}")
    return lines


def doors(described: Robot, path: str) -> str:
    """Return a line on the narrowest passage of all courses through the building of a map."""
    courses = Building(path, radius(described))
    narrowest = min(map(courses.passage, range(courses.count)))
    # The planner drives with the padded footprint, which is wider than the body.
    footprint = MoveBase(described.parameters()).local_costmap.footprint
    _, width = np.ptp(footprint, axis=0)
    if narrowest > width:
        fits = f"passes with {(narrowest - width) / 2:.2f} m on each side"
    else:
        fits = "does not pass: reduce footprint_padding"
    subject = f"the padded footprint of {width:.2f} m"
    return f"narrowest passage of {path}: {narrowest:.2f} m; {subject} {fits}"


def drive_lines(described: Robot, bag: str) -> List[str]:
    """Return lines on what the sensors show in the drive of a bag."""
    with extra(__name__):
        from training.bags.read import read
    names = TopicNames.of(described)
    drive = read(bag, described, names, rehearsal.COLUMNS)
    return [f"{bag}: {line}" for line in rehearsal.lines(rehearsal.rehearsed(drive, described))]


def check(name_or_folder: str, path: str = "", bag: str = "") -> int:
    """Print errors, remarks, summary, doors, bag and test drives. Return 1 if the robot fails."""
    errors: List[str] = []
    remarks: List[str] = []
    # Reading already refuses what no robot can be built from.
    try:
        described = read(name_or_folder)
    except RobotError as refused:
        errors += refused.lines
    else:
        setups = [described]
        if described.move_base.with_map is not None:
            setups.append(described.on_map())
        for setup in setups:
            errors += rules.check(setup)
            for remark in rules.remarks(setup):
                remarks.append(f"remark: {remark.line}")

    # Most lines of a setup with a map are those without one.
    for line in dict.fromkeys(errors):
        print(f"error: {line}", file=sys.stderr)
    lines: List[str] = []
    if not errors:
        lines += summary(described)
        if path:
            remarks.append(doors(described, path))
        if bag:
            remarks += drive_lines(described, bag)
    for line in [*lines, *dict.fromkeys(remarks)]:
        print(line, flush=True)
    # A robot with errors may not even start.
    if errors:
        return 1
    drives, floor_lines = open_floor.try_out(described)
    print("\n".join(floor_lines))
    return 0 if drives else 1


class CheckOptions(Options):
    """Robot to check."""

    robot: str = argument(
        f"Folder with robot.yaml, or one of the included robots: {', '.join(NAMES)}."
    )
    map: str = option(
        "", "Map of a building, MAP.yaml: report the narrowest passage on its courses."
    )
    bag: str = option(
        "", "Bag of a drive of the robot: report what its sensors show, and false alarms."
    )


def main(arguments: Optional[Sequence[str]] = None) -> int:
    """Run the command. Return 0 if the robot drives on open floor, else 1."""
    name = "./applr check"

    def run() -> int:
        options = parsed(CheckOptions, name, __doc__, arguments)
        return check(options.robot, options.map, options.bag)

    return run_main(run, name)


if __name__ == "__main__":
    sys.exit(main())
