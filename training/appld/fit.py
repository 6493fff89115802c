"""Fit of the parameters of an APPLD context with CMA-ES, called by appld.py.

The search minimises the difference between the demonstrator's commands and those of the planner,
given the same pose and scan at each instant.
"""

from __future__ import annotations

import copy
from dataclasses import dataclass
from typing import List, Sequence

import numpy as np

from applr_ros1.common.angles import Twist
from applr_ros1.planner.move_base import MoveBase
from applr_ros1.policy.encoding import PaperEncoding
from applr_ros1.policy.parameter_space import space_of
from applr_ros1.robots import Robot
from applr_ros1.stack.simulated import CONTROL_PERIOD
from training.appld.demonstration import Demonstration, is_driving
from training.appld.segmentation import Segment

# Weight of squared yaw rate [(rad/s)^2] relative to squared speed [(m/s)^2]: H = diag(1, 1/4)
TURN_WEIGHT = 0.25
# Weight of an action's mean squared distance from that of theta_0: it decides between equal losses
PULL = 1e-3
EVALUATIONS = 150  # number of parameter sets that the search of a context tries
LONGEST = 100  # largest number of instants of a segment that are replayed
SETTLE = 5  # number of ignored instants after a change of parameters
SPREAD = 0.4  # initial standard deviation of the search, in action units
INSIDE = 0.9  # factor of the first mean of the search, which CMA-ES wants inside the bounds


@dataclass
class DemonstrationStretch:
    """Part of a demonstration to be replayed, and a copy of the planner at its start."""

    demonstration: Demonstration
    robot: Robot
    first: int
    last: int
    planner: MoveBase


@dataclass
class ContextFit:
    """Result for a context, with the field names of the log.

    Attributes:
        theta: (n,) best parameters.
        loss: Mean weighted squared error of the commands with the best parameters.
        loss_theta0: Mean weighted squared error with the default parameters.
        replays: Number of evaluated parameter sets.
        instants: Number of instants in which each parameter set was replayed.
    """

    theta: np.ndarray
    loss: float
    loss_theta0: float
    replays: int
    instants: int


def step(planner: MoveBase, demonstration: Demonstration, robot: Robot, i: int) -> Twist:
    """Return the planner's command (v, w) [m/s, rad/s] at instant i, or (0, 0) if it has none.

    The planner gets the pose, twist and scan of the demonstration, and the time of clock().
    """
    planner_time = clock(i)
    pose = tuple(demonstration.odometry.pose[i].tolist())
    twist = tuple(demonstration.odometry.twist[i].tolist())
    laser_pose = robot.laser.pose_for(pose)
    scan = demonstration.scans.scan(i, planner_time, laser_pose, robot.laser)
    cycle = planner.step(planner_time, pose, twist, scan)
    return cycle.command or (0.0, 0.0)


def clock(i: int) -> float:
    """Return the planner's time at instant i [s].

    An instant lasts one cycle, independent of the laser's rate.
    """
    return 1.0 + i * CONTROL_PERIOD


def stretches(
    demonstration: Demonstration, robot: Robot, spans: Sequence[Segment]
) -> List[DemonstrationStretch]:
    """Return a stretch for each segment, from a replay of the whole demonstration with theta_0."""
    goal_pose = demonstration.goal_pose
    planner = MoveBase(robot.driven_parameters())
    space = space_of(robot)
    planner.put_in_force(space.settings(space.theta0))
    step(planner, demonstration, robot, i=0)
    planner.set_goal(goal_pose, clock(0))

    segment_stretches = []
    for i in range(len(demonstration.commands)):
        for segment in spans:
            if segment.first == i:
                # The costmap at its start depends on everything before.
                end_instant = min(segment.last, i + LONGEST)
                stretch = DemonstrationStretch(
                    demonstration, robot, i, end_instant, copy.deepcopy(planner)
                )
                segment_stretches.append(stretch)
        step(planner, demonstration, robot, i)
        if planner.goal is None:
            # The planner gave up or arrived, but the demonstration continues.
            planner.set_goal(goal_pose, clock(i))
    return segment_stretches


def replay(stretch: DemonstrationStretch, theta: np.ndarray) -> np.ndarray:
    """Return the errors (k, 2) of the planner's commands (v, w) [m/s, rad/s].

    k is the number of instants that are not ignored.
    """
    demonstration = stretch.demonstration
    planner = copy.deepcopy(stretch.planner)
    planner.put_in_force(space_of(stretch.robot).settings(theta))
    replayed_instants = range(stretch.first, stretch.last)
    planned_commands = [step(planner, demonstration, stretch.robot, i) for i in replayed_instants]
    errors = np.array(planned_commands) - demonstration.commands.twist[replayed_instants]
    # Errors count where the demonstrator drives, and once the planner has taken its parameters up.
    is_counted = is_driving(demonstration)[replayed_instants]
    ignored = min(SETTLE, len(is_counted) // 2)
    is_counted[:ignored] = False
    return np.asarray(errors[is_counted])


def loss(parts: Sequence[DemonstrationStretch], theta: np.ndarray) -> float:
    """Return the loss of a parameter set (n,) over all stretches of a context.

    It is the mean weighted squared error of the commands.
    """
    errors = np.concatenate([replay(stretch, theta) for stretch in parts])
    if not len(errors):
        return 0.0
    v_square, w_square = (errors**2).mean(axis=0)
    return float(v_square + TURN_WEIGHT * w_square)


def fit(parts: Sequence[DemonstrationStretch], seed: int) -> ContextFit:
    """Fit the parameters that the paper's encoding chooses, with CMA-ES from theta_0.

    Args:
        parts: Stretches of a context.
        seed: Seed of the search.
    """
    import cma  # slow, because it imports scipy.stats and matplotlib

    encoding = PaperEncoding(parts[0].robot)
    theta0 = encoding.space.theta0
    default_action = encoding.action(theta0)
    default_loss = loss(parts, theta0)
    best_fit = ContextFit(
        theta=theta0.copy(),
        loss=default_loss,
        loss_theta0=default_loss,
        replays=1,
        instants=sum(stretch.last - stretch.first for stretch in parts),
    )
    options = {"bounds": [-1, 1], "seed": seed + 1, "verbose": -9}  # cma draws a seed for 0.
    strategy = cma.CMAEvolutionStrategy(default_action * INSIDE, SPREAD, options)
    while best_fit.replays < EVALUATIONS and not strategy.stop():
        candidates = strategy.ask()
        penalised_losses = []
        for candidate in candidates:
            theta = encoding.theta(candidate)
            candidate_loss = loss(parts, theta)
            # Sets that drive alike are kept near the defaults.
            distance = float(np.mean((candidate - default_action) ** 2))
            penalised_losses.append(candidate_loss + PULL * distance)
            if candidate_loss < best_fit.loss:
                best_fit.theta = theta
                best_fit.loss = candidate_loss
        strategy.tell(candidates, penalised_losses)
        best_fit.replays += len(candidates)
    return best_fit
