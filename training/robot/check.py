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
from dataclasses import replace
from math import degrees
from typing import List, Optional, Sequence

import numpy as np

from applr_ros1.common.errors import ApplrError
from applr_ros1.common.extras import extra
from applr_ros1.drives.columns import TopicNames
from applr_ros1.drives.drive import Measured
from applr_ros1.drives.names import missing
from applr_ros1.planner.move_base import MoveBase
from applr_ros1.policy.observation import layout_of
from applr_ros1.policy.parameter_space import space_of
from applr_ros1.robots import NAMES, Robot
from applr_ros1.robots import check as rules
from applr_ros1.robots.folder import RobotError, read
from applr_ros1.robots.geometry import radius
from applr_ros1.why.fitting import placed_laser, without_prefix
from training.common.command_line import run_command
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
    setups = (
        "without a map only" if described.move_base.with_map is None else "with and without a map"
    )
    seen = f"a policy sees {layout.beams} beams up to {layout.range_cap:.1f} m"
    scale = f"worlds at {described.world_scale:g} of the Jackal's"
    lines = [
        f"{described.name}: {base.drive}, {base.max_speed:g} m/s, {base.max_yaw_rate:g} rad/s",
        f"footprint with padding: {length:.2f} x {width:.2f} m; {scale}",
        f"laser: {_fan(laser.beams, *laser.fan)}, {laser.rate:g} Hz; {seen}",
        f"move_base: {described.local_planner}, {command_rate:g} commands per second, {setups}",
        "parameter space, default and range:",
    ]
    for parameter, default in zip(described.space, space_of(described).theta0):
        limits = f"{parameter.low:g} to {parameter.high:g}"
        lines.append(f"  {parameter.name:24} {default:<6g} {limits}")
    return lines


def _fan(beams: int, first_angle: float, increment: float, nearest: float, farthest: float) -> str:
    """Return what the scans of a laser are like, for people."""
    last_angle = first_angle + increment * (beams - 1)
    angles = f"{degrees(first_angle):.0f} to {degrees(last_angle):.0f} degrees"
    return f"{beams} beams, {angles}, {nearest:g} to {farthest:g} m"


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
        from training.bags.read import bags_in, opened
    bags_in([bag])  # raises BagError if there is none
    names = TopicNames.of(described)
    with opened(bag) as content:
        drive = content.drive(described, names, rehearsal.COLUMNS)
        for column in Measured._fields:
            if not getattr(drive, column):
                raise ApplrError(missing(column, names, content.types))
    odometry, scans = drive.require(Measured)
    known = _fan(described.laser.beams, *described.laser.fan)
    recorded = _fan(len(scans.ranges[-1]), *scans.fan[-1])
    line = f"laser: {recorded}"
    if recorded != known:
        line += f"; robot.yaml has {known}: correct laser there, or give the robot that drove"
    # As on the robot, the laser is where tf has it.
    placed = placed_laser(without_prefix(drive, described), scans, described)
    laser = described.laser.model_copy(update={"pose": placed.pose})
    figures = rehearsal.rehearsed(odometry, placed.scans, replace(described, laser=laser))
    return [line, *placed.notes, *rehearsal.lines(figures)]


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


def check(options: CheckOptions) -> int:
    """Print errors, remarks, summary, doors, bag and test drives. Return 1 if the robot fails."""
    remarks = []
    # Reading already refuses what no robot can be built from.
    try:
        described = read(options.robot)
    except RobotError as refused:
        errors = list(refused.lines)
    else:
        errors = []
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
    if not errors:
        print("\n".join(summary(described)))
    for line in dict.fromkeys(remarks):
        print(line)
    # A robot with errors may not even start.
    if errors:
        return 1
    if options.map:
        print(doors(described, options.map))
    if options.bag:
        for line in drive_lines(described, options.bag):
            print(f"{options.bag}: {line}")
    drives, floor_lines = open_floor.try_out(described)
    print("\n".join(floor_lines))
    return 0 if drives else 1


def main(arguments: Optional[Sequence[str]] = None) -> int:
    """Run the command. Return 0 if the robot drives on open floor, else 1."""
    return run_command(CheckOptions, check, "./applr check", __doc__, arguments)


if __name__ == "__main__":
    sys.exit(main())
