"""A trial: what identifies it, its result, its seed, and the plan of an evaluation."""

from __future__ import annotations

import zlib
from dataclasses import dataclass
from typing import List, Optional, Sequence, Tuple

import numpy as np

BASELINE = "dwa"  # the method that drives with the robot's own parameters
POLICY = "policy"  # as Trial.method_spec: the policy that is being learnt
TRACED = ("time", "pose", "twist", "theta", "decided")  # what is kept of a drive's Trace (training/env/outcome.py)


@dataclass(frozen=True)
class Trial:
    """A trial to be driven, without noise.

    world and method are names, as they stand in trials.csv; world_spec and method_spec say how to get them. method_spec
    may be POLICY, and theta, where it is given, is a set of parameters that is driven instead. trace asks for the
    driven path.
    """

    world: str
    method: str
    trial: int
    seed: int
    world_spec: str
    method_spec: str
    trace: bool = False
    theta: Optional[Tuple[float, ...]] = None


@dataclass(frozen=True)
class Result:
    """The result of a trial, in the order of the columns of trials.csv.

    time_s is the full limit where the trial timed out; min_clearance_m is the smallest laser range, mean_clearance_m
    its mean over time (training/env/outcome.py); mean_turn the mean |yaw acceleration|; switching the mean change of
    the parameters per decision, in action units.
    """

    success: bool = False
    collided: bool = False
    timeout: bool = False
    time_s: float = float("nan")
    decisions: int = 0
    path_length_m: float = 0.0
    reason: str = ""
    route_m: float = 0.0
    min_clearance_m: float = 0.0
    mean_jerk: float = 0.0  # [m/s^3]
    mean_turn: float = 0.0  # [rad/s^2]
    switching: float = 0.0
    mean_clearance_m: float = 0.0
    total_reward: float = 0.0


def seed_of(base: int, world: str, trial: int) -> int:
    """Return the trial's seed: the same for every method, and whatever other worlds are driven."""
    return int(np.random.SeedSequence([base, zlib.crc32(world.encode()), trial]).generate_state(1)[0] >> 1)


def plan_trials(
    worlds: Sequence[Tuple[str, str]],
    chosen: Sequence[Tuple[str, str]],
    trials: int,
    seed: int,
    traces: int = 1,
) -> List[Trial]:
    """Return all trials in the order of trials.csv.

    First every world's first trial with each method, then every second one, so that a run that is stopped has driven
    all worlds, and more trials of the same evaluation only append.

    Args:
        worlds: [(name, specification), ...].
        chosen: the methods, [(name, specification), ...].
        trials: of each method in each world.
        seed: of all of them.
        traces: of so many trials of each method in each world the driven path is kept.
    """
    return [
        Trial(world, method, trial, seed_of(seed, world, trial), world_spec, method_spec, trial < traces)
        for trial in range(trials)
        for world, world_spec in worlds
        for method, method_spec in chosen
    ]
