"""Trials: their identity, result and seed, and the plan of an evaluation."""

from __future__ import annotations

import zlib
from dataclasses import dataclass
from typing import List, Optional, Sequence, Tuple

import numpy as np

BASELINE = "dwa"  # method that drives with the default parameters of the robot
POLICY = "policy"  # method_spec of the policy being learnt


@dataclass(frozen=True)
class Trial:
    """Trial to be driven, without exploration noise.

    Attributes:
        world: Name of the world, as in trials.csv.
        method: Name of the method, as in trials.csv.
        trial: Number of the trial of this method in this world.
        seed: Seed of the trial.
        world_spec: Specification from which the world is loaded.
        method_spec: Specification from which the method is made, or POLICY.
        trace: Whether the driven path is recorded.
        theta: Parameter set to drive instead of the method.
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
    """Result of a trial, in the order of the columns of trials.csv. training/env/outcome.py explains the fields.

    Attributes:
        time_s: Time [s]; the time limit if the trial timed out.
        min_clearance_m: Smallest laser range [m]. mean_clearance_m is the mean over time of the smallest range.
        mean_turn: Mean absolute yaw acceleration [rad/s^2].
        switching: Mean change of the parameters per decision, in action units.
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
    """Return the seed of a trial, the same for every method and independent of the other worlds."""
    return int(
        np.random.SeedSequence([base, zlib.crc32(world.encode()), trial]).generate_state(1)[0] >> 1
    )


def plan_trials(
    worlds: Sequence[Tuple[str, str]],
    chosen: Sequence[Tuple[str, str]],
    trials: int,
    seed: int,
    traces: int = 1,
) -> List[Trial]:
    """Return all trials in the order of trials.csv.

    The first trial of every method in every world comes before any second trial. A stopped run has therefore driven all
    worlds, and an evaluation that is continued with more trials only appends rows.

    Args:
        worlds: [(name, specification), ...] of the worlds.
        chosen: [(name, specification), ...] of the methods.
        trials: Number of trials per method and world.
        seed: Base seed of all trials.
        traces: Number of trials per method and world whose driven path is kept.
    """
    return [
        Trial(
            world,
            method,
            trial,
            seed_of(seed, world, trial),
            world_spec,
            method_spec,
            trial < traces,
        )
        for trial in range(trials)
        for world, world_spec in worlds
        for method, method_spec in chosen
    ]
