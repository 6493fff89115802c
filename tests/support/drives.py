"""Drives for tests: made of numbers, simulated with a C++-like planner, and written message by
message.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any, Dict, Sequence, Tuple

import numpy as np

import worlds
from applr_ros1.drives.columns import PREEMPTED, Sender
from applr_ros1.drives.drive import (
    Changes,
    Commands,
    Decision,
    Drive,
    Goal,
    Motion,
    Plans,
    Rows,
    Scans,
    SentGoal,
    Transforms,
    Verdicts,
)
from applr_ros1.drives.end_rules import Rules
from applr_ros1.drives.outcome import Outcome
from applr_ros1.drives.simulate import CourseDrive
from applr_ros1.planner.move_base import MoveBase
from applr_ros1.planner.variant import CPP_LIKE
from applr_ros1.policy.decision import Seen
from applr_ros1.robots import Robot
from applr_ros1.senses.standing import ACTIVE
from applr_ros1.stack.simulated import SimulatedRobot
from applr_ros1.stack.stack import Stack
from sim_bridge.kinematic_simulator import KinematicSimulator
from training.bags.write import BagWriter

# Inputs of a decision that no test reads.
NOTHING_SEEN = Seen(
    scan=(np.zeros(3, np.float32), 0.0, 1.0),
    time=0.0,
    pose=(0.0, 0.0, 0.0),
    twist=(0.0, 0.0),
    goal=(0.0, 0.0, 0.0),
    plan=np.zeros((0, 2)),
    movers=np.zeros((0, 4)),
)


def driven(time, pose, twist=None, theta=(), decided=()):
    """Return a drive along true poses (n, 3), with parameter sets theta (k, p) from the times
    decided (k,) on.
    """
    time = np.asarray(time, float)
    if twist is None:
        twist = np.zeros((len(time), 2))
    decisions = []
    for decision_time, values in zip(decided, theta):
        after = dict(enumerate(values))
        decisions.append(Decision("goal", decision_time, decision_time, {}, after, None))
    twist = np.asarray(twist, float)
    return Drive(truth=Motion(time, time, np.asarray(pose, float), twist), decisions=decisions)


def changed(robot: Robot, change: Dict[str, Dict[str, Any]]) -> Robot:
    """Return the robot with {server: {name: value}} changed in its files."""
    parameters: Dict[str, Any] = {}
    for server, values in change.items():
        section = parameters
        for section_name in server.split("/"):
            section = section.setdefault(section_name, {})
        section.update(values)
    return robot.with_parameters(parameters, robot.name)


def simulated(
    robot: Robot,
    world: Any,
    limit: float = 60.0,
    seed: int = 0,
    simulator: Any = KinematicSimulator,
    clearings: Sequence[int] = (),
) -> Tuple[Drive, Outcome]:
    """Drive a robot through a world, or the world of a name in its scale, with the parameters of
    its files.

    The costmaps are cleared after some seconds, as decisions do.
    """
    if isinstance(world, str):
        world = worlds.scaled(worlds.load(world), robot.world_scale)
    move_base = MoveBase(robot.driven_parameters(), planner=CPP_LIKE, seed=seed)
    stack = Stack(robot, move_base, monitor=False, escapes=False)
    # Without decisions, the parameters of the files stay, even out of the ranges of robot.yaml.
    course_drive = CourseDrive(
        SimulatedRobot(simulator(robot), stack), world, seed, Rules(limit=limit), record=True
    )
    decisions = []
    while not course_drive.has_ended:
        seconds = course_drive.seconds
        if round(seconds) in clearings:
            move_base.clear_costmaps()
            goal_id = course_drive.drive.goals[-1].id
            seen = course_drive.seen
            decisions.append(Decision(goal_id, seconds, seconds, {}, {}, seen, cleared=True))
        course_drive.advance()
    # As a bag of move_base alone, without an applr node
    drive = replace(course_drive.drive, decisions=decisions, changes=None)
    return drive, course_drive.outcome


def whole_drive(robot):
    """Return a drive of three seconds with all columns that a bag has."""
    # Motion and scans in three rows. A beam returns nothing, and a plan is empty.
    times = np.array([0.0, 1.0, 2.5])
    poses = np.array(
        [
            [0.0, 0.0, 0.1],
            [1.0, -0.5, 0.4],
            [2.0, 0.5, -3.0],
        ]
    )
    twists = np.array([[0.0, 0.5], [1.0, -0.5], [0.25, 0.0]])
    fan = np.tile([-0.5, 0.5, 0.1, 30.0], (3, 1))
    ranges = np.array(
        [
            [1.0, 2.0, 3.0],
            [0.5, 2.0, np.inf],
            [3.0, 0.7, 2.0],
        ],
        np.float32,
    )
    plans = [poses, np.zeros((0, 3))]
    places = np.array([[1.0, 2.0, 0.0, 0.0, 0.0, 0.6, 0.8], [0.1, 0.0, 0.2, 0.0, 0.0, 0.0, 1.0]])

    # A person's changes: a number, a switch and a text
    changed_values = [
        {
            "max_vel_x": 0.75,
            "prune_plan": True,
            "base_frame_id": "base_link",
        },
        {"width": 6.0},
        {"controller_frequency": 10.0},
    ]

    # A decision in the second row
    seen = Seen(
        scan=(ranges[1], -0.5, 0.5),
        time=1.0,
        pose=(1.0, -0.5, 0.4),
        twist=(1.0, -0.5),
        goal=(5.0, 1.0, 0.2),
        plan=poses[:, :2],
        movers=np.array([[1.0, 2.0, -0.5, 0.25], [3.0, 4.0, 0.0, 1.0]]),
    )
    values = {"DWAPlannerROS/max_vel_x": 0.5, "inflation_radius": 0.25}
    decided_values = {**values, "inflation_radius": 0.5}

    return Drive(
        frame="map",
        planners=[robot.local_planner],
        odometry=Motion(times, times, poses, twists),
        scans=Scans(times, times, fan, list(ranges)),
        transforms=Transforms(
            times[:2],
            times[:2],
            ["map", "base_link"],
            ["base_link", "laser"],
            places,
            [False, True],
        ),
        plans=Plans(times[:2], plans),
        planned=Commands(times, twists),
        commands=Commands(times[1:], 0.5 * twists[1:]),
        verdicts=Verdicts(times[:2], ["stop", "pass"], ["a wall is near: 0.1 m", ""]),
        changes=Changes(times[:3], ["DWAPlannerROS", "local_costmap", ""], changed_values),
        decisions=[
            Decision("first", 1.0, 1.0, values, decided_values, seen),
            Decision("first", 1.2, 1.2, decided_values, values, seen, cleared=True),
        ],
        ends=[Decision("first", 1.5, 1.5, values, {}, seen)],
        sent=[
            SentGoal(0.0, (5.0, 1.0, 0.2), "odom"),
            SentGoal(2.0, (1.0, 1.0, 0.0), "map"),
        ],
        goals=[
            Goal("first", 0.0, 1.5, "reached"),
            Goal("second", 2.0, 2.5, "aborted"),
        ],
        contacts=np.array([0.5, 2.25]),
        recoveries=np.array([0.75]),
        source={"driver": "a person", "course": 3},
    )


def until(drive: Drive, seconds: float) -> Drive:
    """Return the beginning of a drive."""
    shortened_rows = {}
    for field, recorded in vars(drive).items():
        if isinstance(recorded, Rows):
            shortened_rows[field] = recorded.between(-np.inf, seconds)
    return replace(drive, **shortened_rows)


def before_a_monitor(drive: Drive) -> Drive:
    """Return a drive whose collision monitor lets no command pass."""
    assert drive.planned is not None
    return replace(drive, commands=Commands(drive.planned.time, np.zeros_like(drive.planned.twist)))


def decided(values: Dict[str, float], time: float = 0.0) -> Decision:
    """Return a decision for some parameters {name: value}."""
    return Decision("", time, time, {}, values, NOTHING_SEEN)


class Messages(BagWriter):
    """BagWriter with a method for each message of a stack, for drives that no stack would
    record.
    """

    def message(self, column, time, part="", **values):
        """Write a message of a topic of COLUMNS."""
        sender = Sender(self.robot, self.robot.frames.odom)
        self.put(column, {"time": time, **values}, sender, part)

    def goal(self, time, pose, frame=""):
        self.message("sent", time, pose=pose, frame=frame or self.robot.frames.odom)

    def scan(self, time, ranges):
        self.message("scans", time, stamp=time, fan=self.robot.laser.fan, ranges=ranges)

    def odometry(self, time, pose, twist):
        self.message("odometry", time, stamp=time, pose=pose, twist=twist)

    def status(self, time, goal, running=True, ended=0):
        """Write a goal that is active, or has ended with the status code `ended`; without both, no
        goal.
        """
        code = ACTIVE if running else ended or PREEMPTED
        self.message("goals", time, id=goal, code=code)

    def result(self, time, goal, code):
        self.message("results", time, id=goal, code=code)

    def contact(self, time):
        self.message("contacts", time)

    def decision(self, time, number, goal, seen, before, after=None):
        """Write a decision; without `after`, the end of a course."""
        decision = Decision(goal, time, time, before, after or {}, seen)
        sender = Sender(self.robot, self.robot.frames.odom, number=number)
        self.put("ends" if after is None else "decisions", decision._asdict(), sender)
