"""Test drives on open floor, at the end of check_robot.py and at the beginning of ./applr tune.

Four courses are driven with planner and collision monitor, each until move_base reports that its goal is reached:
straight on, a turn on the spot, around a box, and through a door. If a course fails, single parameters are changed and
the courses driven again. The first change with which all courses succeed is the remedy. A planner that fails only
by standing before the door gets a remark, not an error: DWAPlannerROS does so with its default parameters.
"""

from __future__ import annotations

import math
from collections import Counter
from typing import Any, Dict, Iterator, List, Tuple

import numpy as np

import sim_bridge
from applr_ros1.common.trees import branch
from applr_ros1.planner.move_base import MoveBase
from applr_ros1.robots import Robot
from training.env.episode import CONTROL_PERIOD, Episode, counting_cells
from training.env.outcome import Outcome
from worlds import Course, World

GOAL_DISTANCE_M = 5.0  # distance of the goals at the Jackal's scale [m]
WINDOW_SHARE = 0.45  # largest goal distance as a share of the size of a rolling global costmap
DOOR_MARGIN_M = 0.3  # margin of the door beyond the padded width of the footprint [m]
LIMIT_S = 60.0  # time limit of a drive [s]
NO_REMEDY = "no change of a single planner parameter helps: compare footprint, body, laser and base in robot.yaml"
STANDS = f"it turns or stands, and has not arrived after {LIMIT_S:g} s"
REASON_SHARE = 0.1  # share of a drive above which an event counts as the reason of a failure
SEED = 1
FACTORS = (  # (parameter, factor on its value), in the order of the attempts
    *(("occdist_scale", 0.1), ("occdist_scale", 0.01), ("sim_time", 1.5), ("sim_time", 0.6), ("max_vel_x", 0.5)),
    *(("goal_distance_bias", 3.0), ("path_distance_bias", 0.3), ("vx_samples", 3.0)),
)
GOAL_TOLERANCE = 0.2  # tried tolerance of the goal [m, rad]


def courses(robot: Robot) -> List[World]:
    """Return the four courses. Each one ends only when the planner reports its goal as reached."""
    length, width = np.ptp(MoveBase(robot.parameters()).local_costmap.footprint, axis=0)
    way, door, ahead = GOAL_DISTANCE_M * robot.world_scale, width + DOOR_MARGIN_M, math.pi / 2
    world = robot.all_parameters()["global_costmap"]
    if world["rolling_window"]:  # There is no plan to a goal outside a rolling costmap.
        way = min(way, WINDOW_SHARE * min(world["width"], world["height"]))
    box = (0.0, way / 2, 0.0, length / 2, length / 2)
    walls = [(side * (door / 2 + way), way / 2, 0.0, 2 * way, 0.1) for side in (-1, 1)]

    def course(name: str, boxes: Any, y: float, yaw: float) -> World:
        goal, path = (0.0, y, yaw), np.array([(0.0, 0.0), (0.0, y)])
        shapes = np.zeros((0, 3)), np.array(boxes, np.float64).reshape(-1, 5)
        return World(name, *shapes, Course((0.0, 0.0, ahead), goal, None, -1.0, path, planner_ends=True))

    return [
        course("drive straight on", [], way, ahead),
        course("turn on the spot", [], 0.0, -ahead),
        course("drive around a box", box, way, ahead),
        course(f"drive through a door of {door:.2f} m", walls, way, ahead),
    ]


class Floor(Episode):
    """Episode loop with a robot's default parameters, which counts the actions of planner and monitor."""

    def __init__(self, robot: Robot):
        planner = MoveBase(counting_cells(robot.parameters()))
        simulator = sim_bridge.make("kinematic", robot=robot)
        super().__init__(simulator, planner, robot, period=1.0, monitor=True, ends_at_tolerance=False, record=True)
        self.time_limit = LIMIT_S

    def attempt(self, world: World) -> str:
        """Drive one course to its end. Return the reason of a failure, or "" if the robot arrived."""
        self._counts: Counter[str] = Counter()  # number of cycles, and of cycles with each event
        self._critics: Counter[str] = Counter()  # number of rejected velocities by critic
        self._blocked: Counter[str] = Counter()  # number of cycles in which the monitor intervenes, by reason
        self._commanded = 0.0  # commanded distance [m]
        outcome = self.reset(world, SEED)
        while not outcome.over:
            outcome = self.decide(outcome.theta)
        self.driven_s = self.simulator.state.time - self.began
        if outcome.success and not outcome.collided:
            return ""
        return "it touches something, and " * outcome.collided + self._why(outcome)

    def _cycle(self) -> Tuple[Any, Any]:
        cycle, state = super()._cycle()
        planner = self.move_base.local_planner
        refusals = planner.refusals(self.move_base.local_costmap) if cycle.controlled else {}
        self._critics.update(refusals)
        self._counts.update(cycles=1, turns=cycle.controlled, refused=bool(refusals), plans=cycle.new_plan)
        if self._counts["turns"]:  # the monitor's last command holds until the next command
            verdicts, commands = self.drive.verdicts, self.drive.commands
            assert verdicts is not None
            assert commands is not None
            self._blocked[verdicts.reason[-1]] += verdicts.blocked[-1]
            self._commanded += abs(commands.twist[-1, 0]) * CONTROL_PERIOD
        return cycle, state

    def _why(self, outcome: Outcome) -> str:
        """Return the reason of a failure, by the most frequent event."""
        counts, way = self._counts, outcome.path_length_m
        if not counts["plans"]:
            return "the global planner finds no path"
        refused, blocked = counts["refused"] / max(1, counts["turns"]), sum(self._blocked.values()) / counts["cycles"]
        if refused > REASON_SHARE:
            del self._critics["samples"]
            critic = self._critics.most_common(1)[0][0]
            return f"the planner rejects every velocity in {100 * refused:.0f} % of its cycles, mostly by {critic}"
        if blocked > REASON_SHARE:
            reason = self._blocked.most_common(1)[0][0]
            return f"the collision monitor intervenes {100 * blocked:.0f} % of the time: {reason}"
        if self._commanded > 1.0 + 2.0 * way:
            return f"it moves {way:.1f} m although {self._commanded:.1f} m are commanded"
        if outcome.aborted:
            return "move_base ends with " + outcome.reason.partition(": ")[2]
        return STANDS


def try_out(robot: Robot) -> Tuple[bool, List[str]]:
    """Return whether the robot drives on open floor, and a line for each course and for a remark or remedy."""
    floor, lines = Floor(robot), []
    failed: Dict[str, str] = {}
    for world in courses(robot):
        why = floor.attempt(world)
        lines.append(f"{world.name}: {why or f'{floor.driven_s:.0f} s'}")
        failed.update({world.name: why} if why else {})
    if not failed:
        return True, lines

    def arrives(changed: Robot) -> bool:
        first = sorted(courses(changed), key=lambda world: world.name not in failed)
        return not any(map(Floor(changed).attempt, first))

    remedy = next((words for words, changed in changes(robot) if arrives(changed)), "")
    remedy = f"all four courses succeed if you {remedy}" if remedy else NO_REMEDY
    if failed == {world.name: STANDS}:
        return True, [*lines, f"remark: like the C++ planner, it does not {world.name}: {remedy}"]
    return False, [*lines, f"error: the set-up is wrong: {remedy}"]


def changes(robot: Robot) -> Iterator[Tuple[str, Robot]]:
    """Yield changes of a single parameter: the change in words, and the robot with this change."""
    tree, space = robot.all_parameters(), {parameter.name: parameter for parameter in robot.space}
    wanted: List[Tuple[List[Tuple[str, str]], float]] = []
    for parameter, factor in ((space[name], factor) for name, factor in FACTORS if name in space):
        places = [(one.server, name) for one in parameter.sets for name in one.names]
        value = float(f"{factor * branch(tree, places[0][0])[places[0][1]]:.2g}")
        wanted.append((places, min(max(value, parameter.low), parameter.high)))
    limits = ("acc_lim_x", robot.base.max_acceleration), ("acc_lim_theta", robot.base.max_yaw_acceleration)
    for name, value in (*limits, ("yaw_goal_tolerance", GOAL_TOLERANCE), ("xy_goal_tolerance", GOAL_TOLERANCE)):
        wanted.append(([(robot.local_planner, name)], value))
    wanted.append(([("", "planner_frequency")], 1.0))
    for places, value in wanted:
        now = branch(tree, places[0][0])[places[0][1]]
        made: Dict[str, Any] = {}
        for server, name in places:
            branch(made, server, create=True)[name] = type(now)(value)
        if value != now:
            path = "/".join(filter(None, places[0]))
            changed = robot.with_parameters(made, f"{robot.name} with {path} {value:g}")
            yield f"set {path} to {value:g} instead of {now:g}", changed
