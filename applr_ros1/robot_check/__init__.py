"""The check of a robot's folder: robot.yaml, its move_base parameter files, and what they say of each other.

`errors` are lines about what the robot cannot drive with, `remarks` about what it will not drive well with; each names
file, key, value, and what to give. check_robot.py prints all of them. Commands that drive a robot take it from
`with_remarks`, the nodes from `usable`; they stop at errors. Values that are given beside a robot's folder, on
ROS's parameter server, are checked by planner.parameters.check alone, which allows what the C++ node allows.
"""

from __future__ import annotations

import sys
from functools import lru_cache
from typing import List

from applr_ros1.common.errors import MEANT
from applr_ros1.planner.parameters.check import check, complete, warnings
from applr_ros1.robot_check import body, costmaps, local_planner
from applr_ros1.robot_check.parameters import Setup
from applr_ros1.robots import NAMES, Robot, load
from applr_ros1.robots.problems import refuse

__all__ = ["errors", "remarks", "usable", "with_remarks"]


def errors(robot: Robot, with_map: bool = False) -> List[str]:
    """What the robot cannot drive with: a line each. with_map: with its files for a map, instead of those without."""
    setup = Setup(robot, with_map)
    found = list(local_planner.another_one(setup)) or [setup.placed(str(finding)) for finding in check(setup.tree)]
    if not found:
        found = [setup.placed(str(found)) for found in warnings(setup.tree) if MEANT in found.advice]
        setup.full = complete(setup.tree)
        for part in (local_planner, costmaps, body):
            found += part.errors(setup)
    if not found:
        found = list(local_planner.space(setup))
    return list(dict.fromkeys(found))


def remarks(robot: Robot, with_map: bool = False) -> List[str]:
    """What a robot without errors will not drive well with: a line each."""
    setup = Setup(robot, with_map)
    setup.full = complete(setup.tree)
    found = [line for part in (local_planner, costmaps, body) for line in part.remarks(setup)]
    return list(dict.fromkeys(found))


def usable(name_or_folder: str, with_map: bool = False) -> Robot:
    """The robot, whose folder has been checked unless it is an included one. RobotError with a line for each error."""
    robot = load(name_or_folder)
    if name_or_folder not in NAMES:
        refuse(errors(robot, with_map))
    return robot


@lru_cache(maxsize=32)
def with_remarks(name_or_folder: str) -> Robot:
    """As `usable`; prints the remarks, once in a process."""
    robot = usable(name_or_folder)
    for line in remarks(robot) if name_or_folder not in NAMES else ():
        print(f"remark: {line}", file=sys.stderr)
    return robot
