"""Fit of the parameters of an APPLD context with CMA-ES, called by appld.py.

The search minimises the difference between the demonstrator's commands and those of the planner, given the same pose
and scan at each instant.
"""

from __future__ import annotations

import copy
from dataclasses import dataclass
from typing import List, Sequence, Tuple

import numpy as np

from applr_ros1.common.scan import LaserScan
from applr_ros1.drives.drive import Drive
from applr_ros1.planner.move_base import MoveBase
from applr_ros1.planner.parameters.settings import send
from applr_ros1.policy.encoding import PaperEncoding
from applr_ros1.policy.parameter_space import space_of
from applr_ros1.robots import Robot
from training.appld.demonstration import is_driving
from training.appld.segmentation import Segment
from training.env.episode import CONTROL_PERIOD, counting_cells

TURN_WEIGHT = 0.25  # weight of squared yaw rate [(rad/s)^2] relative to squared speed [(m/s)^2]: H = diag(1, 1/4)
PULL = 1e-3  # weight of an action's mean squared distance from that of theta_0, which decides between equal losses
LONGEST = 100  # largest number of instants of a segment that are replayed
SETTLE = 5  # number of ignored instants after a change of parameters


@dataclass
class Stretch:
    """Part of a demonstration to be replayed, and a copy of the planner at its start."""

    demonstration: Drive
    robot: Robot
    first: int
    last: int
    planner: MoveBase


@dataclass
class Fit:
    """Result for a context, with the field names of the log.

    Attributes:
        theta: (n,) best parameters.
        loss: Mean weighted squared error of the commands with the best parameters.
        loss_theta0: Mean weighted squared error with the default parameters.
        rms_v_w: Root mean square errors of the commands (v, w) with the best parameters [m/s, rad/s].
        rms_v_w_theta0: Root mean square errors with the default parameters [m/s, rad/s].
        replays: Number of evaluated parameter sets.
        instants: Number of instants in which each parameter set was replayed.
    """

    theta: np.ndarray
    loss: float
    loss_theta0: float
    rms_v_w: List[float]
    rms_v_w_theta0: List[float]
    replays: int
    instants: int


def step(planner: MoveBase, demonstration: Drive, robot: Robot, i: int) -> Tuple[float, float]:
    """Return the planner's command (v [m/s], w [rad/s]) at instant i, or (0, 0) if the planner has none.

    The planner gets the pose, twist and scan of the demonstration, and the time of clock().
    """
    assert demonstration.odometry is not None
    assert demonstration.scans is not None
    time = clock(i)
    pose = tuple(demonstration.odometry.pose[i].tolist())
    twist = tuple(demonstration.odometry.twist[i].tolist())
    first_angle, increment, range_min, range_max = demonstration.scans.fan[0].tolist()
    ranges = demonstration.scans.ranges[i]
    place = robot.laser.pose_at(pose)
    height = robot.laser.height
    scan = LaserScan(time, first_angle, increment, range_min, range_max, ranges, place, height)
    cycle = planner.step(time, pose, twist, scan)
    return cycle.command or (0.0, 0.0)


def clock(i: int) -> float:
    """Return the planner's time at instant i [s]. An instant lasts one cycle, independent of the laser's rate."""
    return 1.0 + i * CONTROL_PERIOD


def stretches(demonstration: Drive, robot: Robot, spans: Sequence[Segment]) -> List[Stretch]:
    """Return a Stretch for each segment, from a replay of the whole demonstration with theta_0."""
    assert demonstration.commands is not None
    goal = demonstration.sent[-1].pose
    planner = MoveBase(counting_cells(robot.parameters()))
    space = space_of(robot)
    send(space.settings(space.theta0), planner)
    step(planner, demonstration, robot, 0)
    planner.set_goal(goal, clock(0))
    parts = []
    span_of_first = {span.first: span for span in spans}
    for i in range(len(demonstration.commands)):
        if i in span_of_first:
            last = min(span_of_first[i].last, i + LONGEST)
            parts.append(Stretch(demonstration, robot, i, last, copy.deepcopy(planner)))
        step(planner, demonstration, robot, i)
        if planner.goal is None:  # The planner gave up or arrived, but the demonstration continues.
            planner.set_goal(goal, clock(i))
    return parts


def replay(stretch: Stretch, theta: np.ndarray) -> np.ndarray:
    """Return the errors (k, 2) of the planner's commands (v, w) at the k instants that are not ignored."""
    demonstration = stretch.demonstration
    assert demonstration.commands is not None
    planner = copy.deepcopy(stretch.planner)
    send(space_of(stretch.robot).settings(theta), planner)
    rows = range(stretch.first, stretch.last)
    planned = np.array([step(planner, demonstration, stretch.robot, i) for i in rows])
    errors = planned - demonstration.commands.twist[rows]
    counts = is_driving(demonstration)[rows]
    counts[: min(SETTLE, len(counts) // 2)] = False
    return np.asarray(errors[counts])


def loss(stretches_: Sequence[Stretch], theta: np.ndarray) -> Tuple[float, List[float]]:
    """Return the mean weighted squared error and [rms v, rms w] over all stretches of a context."""
    errors = np.concatenate([replay(s, theta) for s in stretches_])
    if not len(errors):
        return 0.0, [0.0, 0.0]
    squares = (errors**2).mean(axis=0)
    return float(squares[0] + TURN_WEIGHT * squares[1]), np.sqrt(squares).round(4).tolist()


def fit(stretches_: Sequence[Stretch], evaluations: int, seed: int) -> Fit:
    """Fit the parameters that the paper's encoding chooses with CMA-ES from theta_0, in about `evaluations` replays."""
    import cma  # slow, because it imports scipy.stats and matplotlib

    encoding = PaperEncoding(stretches_[0].robot)
    theta0 = encoding.space.theta0
    home = encoding.action(theta0)
    base, base_error = loss(stretches_, theta0)
    best = Fit(
        theta0.copy(),
        base,
        base,
        base_error,
        base_error,
        1,
        sum(s.last - s.first for s in stretches_),
    )
    strategy = cma.CMAEvolutionStrategy(
        home * 0.9, 0.4, {"bounds": [-1, 1], "seed": seed + 1, "verbose": -9}
    )
    while best.replays < evaluations and not strategy.stop():
        candidates = strategy.ask()
        values = []
        for candidate in candidates:
            theta = encoding.theta(candidate)
            value, error = loss(stretches_, theta)
            values.append(value + PULL * float(np.mean((np.asarray(candidate) - home) ** 2)))
            if value < best.loss:
                best.theta, best.loss, best.rms_v_w = theta, value, error
        strategy.tell(candidates, values)
        best.replays += len(candidates)
    return best
