"""Test drives on open floor, at the end of check_robot.py and at the beginning of ./applr tune.

Four courses are driven with planner and collision monitor, each until move_base reports that its
goal is reached: straight on, a turn on the spot, around a box, and through a door. If a course
fails, the corrections that the robot's remarks ask for are driven first. Only if they do not
explain the failure, single parameters are changed. The first change with which all courses succeed
is the remedy. A planner that fails only by standing before the door gets a remark, not an error:
DWAPlannerROS does so with its default parameters.
"""

from __future__ import annotations

import math
from collections import Counter
from dataclasses import dataclass, field
from typing import Any, Dict, Iterator, List, NamedTuple, Sequence, Tuple

import numpy as np

import sim_bridge
from applr_ros1.common.trees import branch
from applr_ros1.monitor.monitor import Verdict
from applr_ros1.planner.move_base import MoveBase
from applr_ros1.robots import Robot, check
from applr_ros1.robots.check import Remark
from applr_ros1.stack.stack import Step
from training.env.episode import CONTROL_PERIOD, Episode, counting_cells
from training.env.outcome import Outcome
from worlds import Course, World

GOAL_DISTANCE_M = 5.0  # distance of the goals at the Jackal's scale [m]
WINDOW_SHARE = 0.45  # largest goal distance as a share of the size of a rolling global costmap
DOOR_MARGIN_M = 0.3  # margin of the door beyond the padded width of the footprint [m]
WALL_THICKNESS_M = 0.1  # thickness of the walls beside the door [m]
LIMIT_S = 60.0  # time limit of a drive [s]
STANDS = f"it turns or stands, and has not arrived after {LIMIT_S:g} s"
NO_REMEDY = (
    "no change of a single planner parameter helps: "
    "compare footprint, body, laser and base in robot.yaml"
)
REASON_SHARE = 0.1  # share of a drive above which an event counts as the reason of a failure
SEED = 1
FACTORS = (  # (parameter, factor on its value), in the order of the attempts
    ("occdist_scale", 0.1),
    ("occdist_scale", 0.01),
    ("sim_time", 1.5),
    ("sim_time", 0.6),
    ("max_vel_x", 0.5),
    ("goal_distance_bias", 3.0),
    ("path_distance_bias", 0.3),
    ("vx_samples", 3.0),
)
GOAL_TOLERANCE = 0.2  # tried tolerance of the goal [m, rad]


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
        path = np.array([(0.0, 0.0), (0.0, y)])
        no_circle = (
            -1.0
        )  # A course with a circle would end before the robot has turned to the goal's heading.
        way = Course((0.0, 0.0, ahead), (0.0, y, yaw), None, no_circle, path, planner_ends=True)
        return World(name, np.zeros((0, 3)), np.array(boxes, np.float64).reshape(-1, 5), way)

    return [
        course("drive straight on", [], distance, ahead),
        course("turn on the spot", [], 0.0, -ahead),
        course("drive around a box", [box], distance, ahead),
        course(f"drive through a door of {door:.2f} m", [left_wall, right_wall], distance, ahead),
    ]


@dataclass
class Events:
    """Actions of planner and monitor during a drive.

    Attributes:
        cycles: Number of control cycles.
        commands: Number of cycles in which the local planner ran.
        refused: Number of cycles in which the local planner rejected every sampled velocity.
        plans: Number of cycles with a new global plan.
        critics: Number of rejected velocities by critic.
        blocked: Number of cycles in which the monitor blocked the robot, by reason.
        commanded_m: Distance that the monitor's commands add up to [m].
    """

    cycles: int = 0
    commands: int = 0
    refused: int = 0
    plans: int = 0
    critics: Counter[str] = field(default_factory=Counter)
    blocked: Counter[str] = field(default_factory=Counter)
    commanded_m: float = 0.0


class FloorDrive(NamedTuple):
    """A finished drive on one course: its outcome, duration [s] and events."""

    outcome: Outcome
    seconds: float
    events: Events

    @property
    def failure(self) -> str:
        """Reason of the failure in words, or "" if the robot arrived without a contact."""
        if not self.outcome.collided:
            return "" if self.outcome.success else self._reason()
        return f"it touches something, and {self._reason()}"

    def _reason(self) -> str:
        """Return the most frequent event in words."""
        events, driven_m = self.events, self.outcome.path_length_m
        # Causes come before what follows from them: without a plan nothing is commanded.
        if not events.plans:
            return "the global planner finds no path"
        refused_share = events.refused / max(1, events.commands)
        if refused_share > REASON_SHARE:
            # "samples" counts the velocities themselves.
            critics = Counter({name: n for name, n in events.critics.items() if name != "samples"})
            critic = critics.most_common(1)[0][0]
            percent = f"{100 * refused_share:.0f} %"
            return (
                f"the planner rejects every velocity in {percent} of its cycles, mostly by {critic}"
            )
        blocked_share = sum(events.blocked.values()) / events.cycles
        if blocked_share > REASON_SHARE:
            cause = events.blocked.most_common(1)[0][0]
            return (
                f"the collision monitor intervenes {100 * blocked_share:.0f} % of the time: {cause}"
            )
        # Wheels that slip turn without moving the robot.
        if events.commanded_m > 1.0 + 2.0 * driven_m:
            return f"it moves {driven_m:.1f} m although {events.commanded_m:.1f} m are commanded"
        if self.outcome.aborted:
            return "move_base ends with " + self.outcome.reason.partition(": ")[2]
        return STANDS


class Floor:
    """Open floor in the kinematic simulator, on which a robot drives with its default parameters.

    Args:
        robot: Robot to drive.
        physics: Randomisation of the simulator (sim_bridge.Randomisation); by default none.
    """

    def __init__(self, robot: Robot, **physics: Any):
        self.episode = Episode(
            sim_bridge.make("kinematic", robot=robot, **physics),
            MoveBase(counting_cells(robot.parameters())),
            robot,
            period=1.0,
            time_limit=LIMIT_S,
            monitor=True,
            ends_at_tolerance=False,
            observer=self._count,
        )
        self._events = Events()
        self._verdict = Verdict((0.0, 0.0))

    def drive(self, world: World) -> FloorDrive:
        """Drive one course to its end."""
        episode = self.episode
        self._events = Events()
        outcome = episode.reset(world, SEED)
        while not outcome.over:
            outcome = episode.decide(outcome.theta)
        return FloorDrive(outcome, episode.seconds, self._events)

    def _count(self, step: Step) -> None:
        """Count the events of a control cycle."""
        events, move_base = self._events, self.episode.move_base
        events.cycles += 1
        events.plans += step.cycle.new_plan
        if step.cycle.controlled:
            refusals = move_base.local_planner.refusals(move_base.local_costmap)
            events.commands += 1
            events.refused += bool(refusals)
            events.critics.update(refusals)
        if step.verdict is not None:
            self._verdict = step.verdict
        if events.commands:  # The monitor's last command holds until the next command.
            events.blocked[self._verdict.reason] += self._verdict.blocked
            events.commanded_m += abs(self._verdict.command[0]) * CONTROL_PERIOD


def try_out(robot: Robot) -> Tuple[bool, List[str]]:
    """Return whether the robot drives on open floor, and a line for each course and a remedy."""
    floor = Floor(robot)
    failures: Dict[str, str] = {}  # reason by course
    lines: List[str] = []
    for world in courses(robot):
        drive = floor.drive(world)
        lines.append(f"{world.name}: {drive.failure or f'{drive.seconds:.0f} s'}")
        if drive.failure:
            failures[world.name] = drive.failure
    if not failures:
        return True, lines

    # A fault that is known explains the failure better than a parameter that happens to avoid it.
    known = []
    for remark in check.remarks(robot):
        if remark.correction and _is_within_space(corrected(robot, [remark])):
            known.append(remark)
    advice = remedy(robot, known, list(failures))
    course, reason = next(iter(failures.items()))
    only_at_the_door = course.startswith("drive through a door")
    if only_at_the_door and reason == STANDS:
        as_in_cpp = "" if known else "like the C++ planner, "
        return True, [*lines, f"remark: {as_in_cpp}it does not {course}: {advice}"]
    return False, [*lines, f"error: it does not {course}: {advice}"]


def remedy(robot: Robot, known: Sequence[Remark], failed: Sequence[str]) -> str:
    """Return in words with what all four courses succeed: corrections, or another value.

    Args:
        robot: Robot that does not drive all courses.
        known: Remarks on the robot that name a correction.
        failed: Names of the courses that failed, which are driven first.
    """

    def succeeds(changed: Robot) -> bool:
        if not _is_within_space(changed):
            return False
        floor = Floor(changed)
        # A change that does not help is noticed soonest on the courses that failed.
        first = sorted(courses(changed), key=lambda world: world.name not in failed)
        return not any(floor.drive(world).failure for world in first)

    attempts = [[remark] for remark in known]
    if len(known) > 1:
        attempts.append([*known])
    for attempt in attempts:
        if succeeds(corrected(robot, attempt)):
            return f"{_lines(attempt)}; once this is corrected, all four courses succeed"

    faults = f"{_lines(known)}; once this is corrected, " if known else ""
    for words, changed in changes(corrected(robot, known)):
        if succeeds(changed):
            return f"{faults}all four courses succeed if you {words}"
    return faults + NO_REMEDY


def corrected(robot: Robot, remarks: Sequence[Remark]) -> Robot:
    """Return the robot with the parameters that remarks ask for."""
    for remark in remarks:
        # The name distinguishes the corrections: parameter spaces are cached by it.
        robot = robot.with_parameters(remark.correction, f"{robot.name} without: {remark.line}")
    return robot


def _is_within_space(robot: Robot) -> bool:
    """Return whether the robot's values lie within its parameter space, as a drive requires."""
    return not any(check.space_errors(robot, robot.all_parameters()))


def _lines(remarks: Sequence[Remark]) -> str:
    return "; ".join(remark.line for remark in remarks)


def changes(robot: Robot) -> Iterator[Tuple[str, Robot]]:
    """Yield changes of a single parameter: the change in words, and the robot with this change."""
    tree = robot.all_parameters()
    for places, wanted in _values(robot, tree):
        server, name = places[0]
        default = branch(tree, server)[name]
        if wanted == default:
            continue
        # A parameter of the space may stand in several places, which follow it together.
        made: Dict[str, Any] = {}
        for place, alias in places:
            branch(made, place, create=True)[alias] = type(default)(wanted)
        path = f"{server}/{name}" if server else name
        changed = robot.with_parameters(made, f"{robot.name} with {path} {wanted:g}")
        yield f"set {path} to {wanted:g} instead of {default:g}", changed


def _values(robot: Robot, tree: Dict[str, Any]) -> Iterator[Tuple[List[Tuple[str, str]], float]]:
    """Yield the values to try, each with all its places [(server, name), ...] in move_base."""
    space = {parameter.name: parameter for parameter in robot.space}
    for name, factor in FACTORS:
        if name not in space:
            continue
        parameter = space[name]
        places = [(setting.server, alias) for setting in parameter.sets for alias in setting.names]
        server, first = places[0]
        value = float(f"{factor * branch(tree, server)[first]:.2g}")
        yield places, min(max(value, parameter.low), parameter.high)

    planner, base = robot.local_planner, robot.base
    yield [(planner, "acc_lim_x")], base.max_acceleration
    yield [(planner, "acc_lim_theta")], base.max_yaw_acceleration
    yield [(planner, "yaw_goal_tolerance")], GOAL_TOLERANCE
    yield [(planner, "xy_goal_tolerance")], GOAL_TOLERANCE
    yield [("", "planner_frequency")], 1.0
