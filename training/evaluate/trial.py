"""Trials: their identity, result and seed, and the plan of an evaluation."""

from __future__ import annotations

import zlib
from dataclasses import dataclass, fields
from itertools import product
from typing import Any, Dict, List, Optional, Sequence, Tuple

import numpy as np

from applr_ros1.drives.outcome import Outcome

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
        obstacle_range: Range [m] with which theta is driven (policy.decision.Method), or None.
    """

    world: str
    method: str
    trial: int
    seed: int
    world_spec: str
    method_spec: str
    trace: bool = False
    theta: Optional[Tuple[float, ...]] = None
    obstacle_range: Optional[float] = None


@dataclass(frozen=True)
class Result:
    """Result of a trial, in the order of the columns of trials.csv.

    applr_ros1/drives/outcome.py explains the fields that are missing here.

    Attributes:
        time_s: Time [s]; the time limit if the trial timed out.
        route_m: Length of the course's reference path [m].
        min_clearance_m: Smallest laser range [m]. mean_clearance_m is the mean over time of the
            smallest range.
        mean_jerk: Mean magnitude of the jerk [m/s^3].
        mean_turn: Mean magnitude of the yaw acceleration [rad/s^2].
        switching: Mean change of the parameters per decision, in action units.
        total_reward: Sum of the rewards.
        contact_speed: True speed at the first contact [m/s]; NaN without one.
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
    mean_jerk: float = 0.0
    mean_turn: float = 0.0
    switching: float = 0.0
    mean_clearance_m: float = 0.0
    total_reward: float = 0.0
    contact_speed: float = float("nan")

    @classmethod
    def of(
        cls, outcome: Outcome, *, route_m: float, switching: float, total_reward: float
    ) -> Result:
        """Return the result of a trial that ended with an outcome."""
        values = {
            **vars(outcome),
            "route_m": route_m,
            "switching": switching,
            "total_reward": total_reward,
        }
        row: Dict[str, Any] = {}
        for column in fields(cls):
            # Python's types instead of numpy's, which the table would write differently
            default: Any = column.default
            row[column.name] = type(default)(values[column.name])
        return cls(**row)


def seed_of(base: int, world: str, trial: int) -> int:
    """Return the seed of a trial, equal for every method and independent of the other worlds."""
    sequence = np.random.SeedSequence([base, zlib.crc32(world.encode()), trial])
    return int(sequence.generate_state(1)[0] >> 1)  # 31 bits, as --seed has


def plan_trials(
    worlds: Sequence[Tuple[Any, ...]],
    chosen: Sequence[Tuple[str, str]],
    trials: int,
    seed: int,
    traces: int = 1,
) -> List[Trial]:
    """Return all trials in the order of trials.csv.

    The first trial of every method in every world comes before any second trial. A stopped run has
    therefore driven all worlds, and an evaluation that is continued with more trials only appends
    rows.

    Args:
        worlds: [(name, specification, ...), ...] of the worlds.
        chosen: [(name, specification), ...] of the methods.
        trials: Number of trials per method and world.
        seed: Base seed of all trials.
        traces: Number of trials per method and world whose driven path is kept.
    """
    planned = []
    for trial, named_world, (method, method_spec) in product(range(trials), worlds, chosen):
        world, world_spec = named_world[:2]
        drawn_seed = seed_of(seed, world, trial)
        planned.append(
            Trial(world, method, trial, drawn_seed, world_spec, method_spec, trial < traces)
        )
    return planned
