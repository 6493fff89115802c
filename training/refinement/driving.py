"""Drives a policy with shifts of its last layer: the runner of refine_policy.py's trials, and the file it reads."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any, Dict, List, Optional, Tuple

import numpy as np
import safetensors.numpy

from applr_ros1.common.errors import ApplrError
from applr_ros1.common.files import read_bytes, write_bytes
from applr_ros1.common.tensors import unpack
from applr_ros1.policy import methods
from applr_ros1.policy.actor import Actor
from training.actors.tasks import Trial
from training.actors.worker import PolicyWeights
from training.evaluation.trials import TrialRunner
from training.policy_file import weights_of
from training.refinement.directions import Directions

SHIFTED_RUNNER = "training.refinement.driving:ShiftedRunner"  # as workers are told
ORIGIN = "found_from"  # in the header of a file of directions


class ShiftedRunner(TrialRunner):
    """Runner of Trial tasks whose method_spec holds the coefficients of a shift, a JSON list; "" is the policy itself.

    Args:
        policy: file of the policy.
        directions: file of the directions (`write_directions`); None: only the policy itself can be driven.
        options: TrialRunner's.
    """

    def __init__(self, policy: str, directions: Optional[str] = None, **options: Any):
        super().__init__(**options)
        self.actor = Actor.load(policy, self.space)
        self.weights = weights_of(self.actor)
        self.directions = None if directions is None else read_directions(directions)
        self.observations: List[np.ndarray] = []  # of the newest trial's decisions

    def _method(self, task: Trial, policy: Optional[PolicyWeights]) -> methods.Method:
        self.observations = []
        weights = self.weights
        if task.method_spec:
            assert self.directions is not None
            coefficients = np.array(json.loads(task.method_spec), float).reshape(len(self.space), -1)
            weights = self.directions.shifted(weights, coefficients)
        return methods.ObservationPolicy(_Watched(weights, self.actor, self.observations))


class _Watched(Actor):
    """An actor that keeps what it is asked."""

    def __init__(self, weights: Any, like: Actor, observations: List[np.ndarray]):
        super().__init__(weights, like.space, like.metadata, like.layout)
        self.observations = observations

    def theta(self, obs: np.ndarray) -> np.ndarray:
        self.observations.append(np.array(obs, np.float32))
        return super().theta(obs)


def write_directions(path: str, directions: Directions, origin: Dict[str, Any]) -> None:
    """Writes directions as safetensors, with what they were found from, JSON values."""
    header = {ORIGIN: json.dumps(origin, sort_keys=True)}
    write_bytes(path, safetensors.numpy.save({"mean": directions.mean, "basis": directions.basis}, metadata=header))


def read_directions(path: str) -> Directions:
    """The directions in a file. Raises ApplrError."""
    return _read(path)[0]


def known_directions(path: str, origin: Dict[str, Any]) -> Optional[Directions]:
    """The directions in a file; None where there is no file, or it does not state that they were found from `origin`.

    Directions are read again rather than found again: their last bits depend on the machine and its number of cores.

    Raises:
        ApplrError: with one line, for a file that is damaged.
    """
    if not Path(path).exists():
        return None
    directions, stated = _read(path)
    return directions if stated == json.dumps(origin, sort_keys=True) else None


def _read(path: str) -> Tuple[Directions, Optional[str]]:
    """The directions in a file, and what it states of where they come from."""
    tensors, header = unpack(read_bytes(path), path)
    if set(tensors) != {"mean", "basis"}:
        raise ApplrError("%s: holds no directions of a refinement; give another --results" % path)
    return Directions(tensors["mean"], tensors["basis"]), header.get(ORIGIN)
