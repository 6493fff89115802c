"""What travels between a pool and its workers: tasks, answers, and their encoding. Nothing is pickled.

A message is the length of a JSON object, that object, and bytes that belong to it (weights, a trajectory, a trace).
"""

from __future__ import annotations

import json
import struct
from dataclasses import asdict, dataclass, fields
from typing import Any, Dict, Optional, Tuple, Type, TypeVar, Union, get_type_hints

from applr_ros1.common.errors import ApplrError

POLICY = "policy"  # as Trial.method_spec: the policy that the pool has pinned for evaluation


class MessageError(ApplrError):
    """Bytes that are no message of ours; one line."""


@dataclass(frozen=True)
class Collect:
    """Drive one training episode with exploration noise. The answer carries the packed trajectory.

    actor and episode identify the episode and seed its randomness; sigma is the standard deviation of the noise, random
    asks for uniform actions instead of the policy's; world is an index, None leaves the choice to the environment.
    version is the policy's, in gradient steps; the pool fills it in. mixed draws the episode's standard deviation from
    0 to twice sigma; held is the share of the noise's variance that stays the same during the episode.
    """

    actor: str
    episode: int
    seed: int
    sigma: float
    random: bool
    world: Optional[int] = None
    version: int = -1
    mixed: bool = False
    held: float = 0.0


@dataclass(frozen=True)
class Trial:
    """Drive one evaluation trial without noise. The answer carries a TrialResult, and the trace if it was asked for.

    world and method are names, as they stand in trials.csv; world_spec and method_spec say how to get them. method_spec
    may be POLICY, and theta, where it is given, is a set of parameters that is driven instead. weights and planner are
    MoveBase's (applr_ros1/planner/variant.py).
    """

    world: str
    method: str
    trial: int
    seed: int
    world_spec: str
    method_spec: str
    weights: str
    planner: str
    trace: bool = False
    theta: Optional[Tuple[float, ...]] = None


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


KINDS: Dict[str, Type[Any]] = {"collect": Collect, "trial": Trial}


def kind_of(task: Task) -> str:
    """The task's name in KINDS, which is also its field of WorkerSettings."""
    return "trial" if isinstance(task, Trial) else "collect"


def encode_task(task: Task, weights: bytes = b"") -> bytes:
    """A task, with the policy's weights where the worker does not have them yet."""
    return _frame({"kind": kind_of(task), "task": asdict(task)}, weights)


def decode_task(message: bytes) -> Tuple[Task, bytes]:
    """The inverse of encode_task. Raises MessageError."""
    head, weights = _unframe(message)
    kind = KINDS.get(str(head.get("kind")))
    if kind is None:
        raise MessageError("task of unknown kind %.40r" % (head.get("kind"),))
    return build(kind, head.get("task")), weights


def encode_answer(answer: Answer) -> bytes:
    """An answer without its task, which the pool knows."""
    result = None if answer.result is None else asdict(answer.result)
    return _frame({"error": answer.error, "result": result}, answer.data)


def decode_answer(message: bytes, task: Task) -> Answer:
    """The inverse of encode_answer. Raises MessageError."""
    head, data = _unframe(message)
    error, result = head.get("error"), head.get("result")
    if not isinstance(error, str) or (isinstance(task, Trial) and not error and result is None):
        raise MessageError("an answer without result and error")
    return Answer(task, error, None if result is None else build(TrialResult, result), data)


def encode_settings(settings: WorkerSettings) -> bytes:
    """A worker's settings."""
    return _frame(asdict(settings), b"")


def decode_settings(message: bytes) -> WorkerSettings:
    """The inverse of encode_settings. Raises MessageError."""
    head, _ = _unframe(message)
    specs = {name: None if spec is None else build(RunnerSpec, spec) for name, spec in head.items()}
    return build(WorkerSettings, specs)


def _frame(head: Dict[str, Any], data: bytes) -> bytes:
    text = json.dumps(head).encode()
    return struct.pack("<I", len(text)) + text + data


def _unframe(message: bytes) -> Tuple[Dict[str, Any], bytes]:
    try:
        (length,) = struct.unpack_from("<I", message)
        head = json.loads(message[4 : 4 + length])
    except (struct.error, ValueError, RecursionError):
        raise MessageError("not a message of a worker") from None
    if not isinstance(head, dict):
        raise MessageError("not a message of a worker")
    return head, message[4 + length :]


T = TypeVar("T")


def build(cls: Type[T], values: Any) -> T:
    """An object of a dataclass from JSON values, their types checked."""
    hints = get_type_hints(cls)
    if not isinstance(values, dict) or not set(values) <= set(hints):
        raise MessageError("%s: fields are %.80r" % (cls.__name__, values))
    found = {name: tuple(value) if isinstance(value, list) else value for name, value in values.items()}
    for name, value in found.items():
        if not _fits(value, hints[name]):
            raise MessageError("%s: %s is %.40r" % (cls.__name__, name, value))
    missing = {f.name for f in fields(cls)} - set(found)  # type: ignore[arg-type]
    try:
        return cls(**found)
    except TypeError:
        raise MessageError("%s: lacks %s" % (cls.__name__, ", ".join(sorted(missing)))) from None


def _fits(value: Any, hint: Any) -> bool:
    if hint in (bool, int, str):
        return type(value) is hint
    if hint is float:
        return type(value) in (int, float)
    if hint == Optional[int]:
        return value is None or type(value) is int
    if hint == Optional[Tuple[float, ...]]:
        return value is None or (isinstance(value, tuple) and all(_fits(number, float) for number in value))
    return True
