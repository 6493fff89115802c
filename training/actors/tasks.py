"""What travels between a pool and its workers: tasks, policies and answers."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Dict, Optional, Tuple, Union

POLICY = "policy"  # as Trial.method_spec: the policy that the pool has pinned for evaluation


@dataclass(frozen=True)
class Collect:
    """Drive one training episode with exploration noise. The answer carries the packed trajectory.

    actor and episode identify the episode and seed its randomness; sigma is the standard deviation of the noise, random
    asks for uniform actions instead of the policy's; world is an index, None leaves the choice to the environment.
    version is the policy's, in gradient steps; the pool fills it in.
    """

    actor: str
    episode: int
    seed: int
    sigma: float
    random: bool
    world: Optional[int] = None
    version: int = -1


@dataclass(frozen=True)
class Trial:
    """Drive one evaluation trial without noise. The answer carries a TrialResult, and the trace if it was asked for.

    world and method are names, as they stand in trials.csv; world_spec and method_spec say how to get them. method_spec
    may be POLICY, and theta, where it is given, is a set of parameters that is driven instead. planner is
    MoveBase's (applr_ros1/planner/variant.py). robot names who drives where the runner does not know it.
    """

    world: str
    method: str
    trial: int
    seed: int
    world_spec: str
    method_spec: str
    planner: str
    trace: bool = False
    theta: Optional[Tuple[float, ...]] = None
    robot: str = ""


Task = Union[Collect, Trial]


@dataclass(frozen=True)
class TrialResult:
    """How a trial went. An environment that knows no courses leaves time_s at NaN and tells only the last two.

    time_s is the full limit where the trial timed out; clearance is the smallest laser range; mean_turn the mean
    |yaw acceleration|; switching the mean change of the parameters per decision, in action units.
    """

    success: bool = False
    collided: bool = False
    timeout: bool = False
    time_s: float = float("nan")
    path_length_m: float = 0.0
    reason: str = ""
    route_m: float = 0.0
    min_clearance_m: float = 0.0
    mean_jerk: float = 0.0  # [m/s^3]
    mean_turn: float = 0.0  # [rad/s^2]
    switching: float = 0.0
    decisions: int = 0
    total_reward: float = 0.0


@dataclass(frozen=True)
class Answer:
    """What became of a task: an error of one line, or a Trial's result; data is a packed trajectory or a trace."""

    task: Task
    error: str = ""
    result: Optional[TrialResult] = None
    data: bytes = b""


@dataclass(frozen=True)
class RunnerSpec:
    """Who does a kind of task: "module:Class", and the keyword arguments (JSON values) that it is made with."""

    runner: str
    options: Dict[str, Any]


@dataclass(frozen=True)
class WorkerSettings:
    """Who collects experience and who drives trials in a worker; None: this pool has no such tasks."""

    collect: Optional[RunnerSpec] = None
    trial: Optional[RunnerSpec] = None
