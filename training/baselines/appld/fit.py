"""The parameters of an APPLD context, found with CMA-ES.

The search looks for the parameters with which the planner, put in the place of the demonstrator at each instant,
commands what the demonstrator commanded. appld.py calls it.
"""

from __future__ import annotations

import copy
from dataclasses import dataclass
from typing import List, Sequence

import numpy as np

from applr_ros1.common.scan import LaserScan
from applr_ros1.planner.move_base import MoveBase
from applr_ros1.policy.encoding import PaperEncoding
from applr_ros1.policy.parameter_space import send, space_of
from training.baselines.appld.demonstration import Demonstration
from training.baselines.appld.segmentation import Segment
from training.env.episode import CONTROL_PERIOD, counting_cells, laser_pose

TURN_WEIGHT = 0.25  # of (rad/s)^2 beside (m/s)^2: H = diag(1, 1/4)
PULL = 1e-3  # towards theta_0, in the action's unit squared: decides where nothing else does
LONGEST = 100  # instants of a segment that are replayed at most
SETTLE = 5  # instants after a change of parameters that do not count


@dataclass
class Stretch:
    """A part of a demonstration to be replayed, and the planner as it stood there."""

    demonstration: Demonstration
    first: int
    last: int
    planner: MoveBase


@dataclass
class Fit:
    """A context's result, under the names of the log.

    Attributes:
        theta: (n,) the best parameters.
        loss: Their mean weighted squared error.
        loss_theta0: That of the default parameters.
        rms_v_w: Root mean square of the planner's (v, w) about the demonstrated [m/s, rad/s].
        rms_v_w_theta0: That of the default parameters.
        replays: Number of parameter sets that were tried.
        instants: Number of instants that each of them was replayed in.
    """

    theta: np.ndarray
    loss: float
    loss_theta0: float
    rms_v_w: List[float]
    rms_v_w_theta0: List[float]
    replays: int
    instants: int


def step(planner: MoveBase, d: Demonstration, i: int):
    """The planner's command (v [m/s], w [rad/s]) at instant i; (0, 0) if it has none.

    The planner gets the pose, twist and scan of the demonstration, and a clock of its own.
    """
    now, pose = clock(i), tuple(d.pose[i].tolist())
    scan = LaserScan(now, *d.scan, d.ranges[i], laser_pose(pose, d.robot.laser), d.robot.laser.height)
    cycle = planner.step(now, pose, tuple(d.twist[i].tolist()), scan)
    return cycle.command or (0.0, 0.0)


def clock(i: int) -> float:
    """The planner's time in instant i [s]: an instant is a cycle, whatever the laser's beat was."""
    return 1.0 + i * CONTROL_PERIOD


def stretches(d: Demonstration, spans: Sequence[Segment]) -> List[Stretch]:
    """Copies of the planner as it is where each span begins.

    The planner is led along the whole demonstration with theta_0.
    """
    planner, found, space = MoveBase(counting_cells(d.robot.parameters())), [], space_of(d.robot)
    send(space.requests(space.theta0), planner)
    step(planner, d, 0)
    planner.set_goal(d.goal, clock(0))
    first = {s.first: s for s in spans}
    for i in range(len(d.time)):
        if i in first:
            last = min(first[i].last, i + LONGEST)
            found.append(Stretch(d, i, last, copy.deepcopy(planner)))
        step(planner, d, i)
        if planner.goal is None:  # it gave up, or arrived: the demonstration goes on
            planner.set_goal(d.goal, clock(i))
    return found


def replay(stretch: Stretch, theta) -> np.ndarray:
    """(k, 2): the planner's (v, w) minus the demonstrator's, in the instants that count."""
    planner, d = copy.deepcopy(stretch.planner), stretch.demonstration
    send(space_of(d.robot).requests(theta), planner)
    given = np.array([step(planner, d, i) for i in range(stretch.first, stretch.last)])
    counts = d.driving[stretch.first : stretch.last].copy()
    counts[: min(SETTLE, len(counts) // 2)] = False
    return (given - d.command[stretch.first : stretch.last])[counts]


def loss(stretches_: Sequence[Stretch], theta):
    """(mean weighted squared error, [rms v, rms w]) over all stretches of a context."""
    errors = np.concatenate([replay(s, theta) for s in stretches_])
    if not len(errors):
        return 0.0, [0.0, 0.0]
    squares = (errors**2).mean(axis=0)
    return float(squares[0] + TURN_WEIGHT * squares[1]), np.sqrt(squares).round(4).tolist()


def fit(stretches_: Sequence[Stretch], evaluations: int, seed: int) -> Fit:
    """CMA-ES from theta_0 over what the paper's encoding chooses. evaluations: replays of the context, about."""
    import cma  # and with it scipy.stats and matplotlib

    encoding = PaperEncoding(stretches_[0].demonstration.robot)
    theta0 = encoding.space.theta0
    home = encoding.action(theta0)
    base, base_error = loss(stretches_, theta0)
    best = Fit(theta0.copy(), base, base, base_error, base_error, 1, sum(s.last - s.first for s in stretches_))
    strategy = cma.CMAEvolutionStrategy(home * 0.9, 0.4, {"bounds": [-1, 1], "seed": seed + 1, "verbose": -9})
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
