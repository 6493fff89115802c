"""Test drives on open floor, at the end of ./applr check and at the beginning of ./applr tune.

Four courses are driven with planner and collision monitor, each until move_base reports that its
goal is reached: straight on, a turn on the spot, around a box, and through a door. If a course
fails, the corrections that the robot's remarks ask for are driven first. Only if they do not
explain the failure, single parameters are changed. The first changes with which all courses succeed
are the remedies. A planner that fails only by standing before the door gets a remark, not an error:
DWAPlannerROS does so with its default parameters.
"""

from __future__ import annotations

import math
from functools import partial
from itertools import chain, islice
from typing import Any, Dict, List, Sequence, Tuple

import numpy as np

import sim_bridge
from applr_ros1.common.progress import announced
from applr_ros1.drives import simulate
from applr_ros1.drives.drive import Drive
from applr_ros1.drives.end_rules import Rules
from applr_ros1.planner.move_base import MoveBase
from applr_ros1.planner.parameters import check as parameters
from applr_ros1.robots import Robot, check
from applr_ros1.robots.check import Remark
from applr_ros1.stack.simulated import SimulatedRobot
from applr_ros1.stack.stack import Stack
from training.attempts.candidates import (
    Candidate,
    advice_of,
    candidates_of,
    mildest_first,
    with_changes,
)
from training.robot.failure import STANDS, failure_of
from worlds import Course, World
from worlds.world import NO_CIRCLE_M

GOAL_DISTANCE_M = 5.0  # distance of the goals at the Jackal's scale [m]
WINDOW_SHARE = 0.45  # largest goal distance as a share of the size of a rolling global costmap
DOOR_MARGIN_M = 0.3  # margin of the door beyond the padded width of the footprint [m]
WALL_THICKNESS_M = 0.1  # thickness of the walls beside the door [m]
# A course ends when the robot has also turned to the heading of the goal, or after a minute.
RULES = Rules(ends_at_tolerance=False, limit=60.0)
NO_REMEDY = (
    "none of {count} changes that were tried helps: compare footprint, body, "
    "laser and base in robot.yaml, and the parameter files with those of an included robot"
)
MOST_CHANGES = 40  # largest number of changes; a drive of some seconds takes place for each
MOST_REMEDIES = 3  # number of changes that help after which no further one is tried
SEED = 6
SEARCH_S = 60.0  # interval between progress lines of the search for a remedy [s]
show = partial(print, flush=True)


def courses(robot: Robot) -> List[World]:
    """Return the four courses. Each one ends only when the planner reports its goal as reached."""
    length, width = np.ptp(MoveBase(robot.parameters()).local_costmap.footprint, axis=0)
    global_costmap = robot.all_parameters()["global_costmap"]
    distance = GOAL_DISTANCE_M * robot.world_scale
    if global_costmap["rolling_window"]:  # There is no plan to a goal outside a rolling costmap.
        window = min(global_costmap["width"], global_costmap["height"])
        distance = min(distance, WINDOW_SHARE * window)

    # Obstacles are boxes (x, y, yaw, length along x, length along y). The robot starts at the
    # origin and faces along y.
    ahead = math.pi / 2
    box = (0.0, distance / 2, 0.0, length / 2, length / 2)
    door = width + DOOR_MARGIN_M
    wall_length = 2 * distance
    wall_x = (door + wall_length) / 2
    left_wall = (-wall_x, distance / 2, 0.0, wall_length, WALL_THICKNESS_M)
    right_wall = (wall_x, distance / 2, 0.0, wall_length, WALL_THICKNESS_M)

    def course(name: str, boxes: Sequence[Any], y: float, yaw: float) -> World:
        # A course with a circle would end before the robot has turned to the goal's heading.
        way = Course(
            start=(0.0, 0.0, ahead),
            goal=(0.0, y, yaw),
            finish_y=None,
            goal_tolerance=NO_CIRCLE_M,
            path=np.array([(0.0, 0.0), (0.0, y)]),
            planner_ends=True,
        )
        no_cylinders = np.zeros((0, 3))
        obstacles = np.array(boxes, np.float64).reshape(-1, 5)
        return World(name, no_cylinders, obstacles, way)

    return [
        course("drive straight on", [], distance, ahead),
        course("turn on the spot", [], 0.0, -ahead),
        course("drive around a box", [box], distance, ahead),
        course(f"drive through a door of {door:.2f} m", [left_wall, right_wall], distance, ahead),
    ]


class OpenFloor:
    """Open floor in the kinematic simulator, on which a robot drives with its default parameters.

    Args:
        robot: Robot to drive.
        physics: Randomisation of the simulator (sim_bridge.Randomisation); by default none.
    """

    def __init__(self, robot: Robot, **physics: Any):
        parameters = robot.in_matched_frame().driven_parameters()
        stack = Stack(robot, MoveBase(parameters), monitor=True)
        simulator = sim_bridge.make("kinematic", robot=robot, **physics)
        self._simulated_robot = SimulatedRobot(simulator, stack)

    def drive(self, world: World) -> Drive:
        """Drive one course to its end."""
        return simulate.drive(self._simulated_robot, world, SEED, rules=RULES, record=True)


def try_out(robot: Robot) -> Tuple[bool, List[str]]:
    """Return whether the robot drives on open floor, and a line for each course and a remedy."""
    failures: Dict[str, str] = {}  # reason by course
    lines: List[str] = []
    driving = "driving on open floor (compiles kernels the first time, about a minute)"
    with announced(driving, show):
        floor = OpenFloor(robot)
        for world in courses(robot):
            drive = floor.drive(world)
            failure = failure_of(drive)
            lines.append(f"{world.name}: {failure or f'{drive.goals[-1].end:.0f} s'}")
            if failure:
                failures[world.name] = failure
    if not failures:
        return True, lines

    # A fault that is known explains the failure better than a parameter that happens to avoid it.
    known_faults = []
    for remark in check.remarks(robot):
        if remark.correction and _is_accepted(corrected(robot, [remark])):
            known_faults.append(remark)
    course, reason = next(iter(failures.items()))
    searching = f"searching for a remedy, because it does not {course} ({reason})"
    with announced(searching, show, every=SEARCH_S):
        advice = remedy(robot, known_faults, list(failures))
    only_at_the_door = course.startswith("drive through a door")
    if only_at_the_door and reason.startswith(STANDS):
        as_in_cpp = "" if known_faults else "like the C++ planner, "
        return True, [*lines, f"remark: {as_in_cpp}it does not {course}: {advice}"]
    return False, [*lines, f"error: it does not {course}: {advice}"]


def remedy(robot: Robot, known_faults: Sequence[Remark], failed: Sequence[str]) -> str:
    """Return in words with what all four courses succeed: corrections, or other values.

    Args:
        robot: Robot that does not drive all courses.
        known_faults: Remarks on the robot that name a correction.
        failed: Names of the courses that failed, which are driven first.
    """

    def succeeds(changed: Robot) -> bool:
        floor = OpenFloor(changed)
        # A change that does not help is noticed soonest on the courses that failed.
        first = sorted(courses(changed), key=lambda world: world.name not in failed)
        return not any(failure_of(floor.drive(world)) for world in first)

    # Each fault alone, and all together
    attempts = [[remark] for remark in known_faults]
    if len(known_faults) > 1:
        attempts.append([*known_faults])
    for attempt in attempts:
        changed = corrected(robot, attempt)
        if _is_accepted(changed) and succeeds(changed):
            return f"{_lines(attempt)}; once this is corrected, all four courses succeed"

    # A single parameter, on top of all corrections
    corrections_first = ""
    if known_faults:
        corrections_first = f"{_lines(known_faults)}; once this is corrected, "
    without_faults = corrected(robot, known_faults)
    count = 0
    remedies: List[Candidate] = []
    for candidate in islice(chain(*candidates_of(without_faults)), MOST_CHANGES):
        name = f"{without_faults.name} with {candidate}"
        changed = with_changes(without_faults, candidate.changes, name)
        is_new = candidate.names not in [remedy.names for remedy in remedies]
        if not is_new or not _is_accepted(changed):
            continue
        count += 1
        if succeeds(changed):
            remedies.append(candidate)
        if len(remedies) == MOST_REMEDIES:
            break
    if not remedies:
        return corrections_first + NO_REMEDY.format(count=count)

    # The mildest first: the values of most robots, then those nearest to the robot's own
    remedies.sort(key=mildest_first(without_faults))
    advice = ", or ".join(advice_of(without_faults, remedy) for remedy in remedies)
    return f"{corrections_first}all four courses succeed if you {advice}"


def corrected(robot: Robot, remarks: Sequence[Remark]) -> Robot:
    """Return the robot with the parameters that remarks ask for."""
    for remark in remarks:
        # The name distinguishes the corrections: parameter spaces are cached by it.
        robot = robot.with_parameters(remark.correction, f"{robot.name} without: {remark.line}")
    return robot


def _is_accepted(robot: Robot) -> bool:
    """Return whether the robot's values agree and lie within its space, as a drive requires."""
    if parameters.check(robot.parameters()):
        return False
    return not any(check.space_errors(robot, robot.all_parameters()))


def _lines(remarks: Sequence[Remark]) -> str:
    return "; ".join(remark.line for remark in remarks)
