"""Does tasks: in this process, as a child process (python -m training.actors.worker FD), or inside a Ray actor.

A worker needs no torch. It holds a runner for each kind of task (WorkerSettings), made when first asked for, and the
newest policy that it was sent.
"""

from __future__ import annotations

import importlib
import os
import signal
import sys
import traceback
from typing import Any, Dict, Optional, Protocol, Set

import numpy as np

from applr_ros1.common.tensors import unpack
from applr_ros1.policy.network import forward, layers_of
from training.actors.tasks import Answer, Task, Trial, WorkerSettings


class PolicyWeights:
    """The learnt policy in numpy, of any size, without noise: observation → action.

    Args:
        weights: safetensors of "0.weight" (out, in), "0.bias" (out,), "1.weight", ... in float32, or of several such
            networks side by side (applr_ros1/policy/network.py).
    """

    def __init__(self, weights: bytes):
        arrays, _ = unpack(weights, "weights")
        count = len(arrays) // 2
        ends = arrays["0.weight"].shape[-1], arrays[f"{count - 1}.weight"].shape[-2]
        self.layers = layers_of(arrays, *ends, "weights")

    def __call__(self, observation: np.ndarray) -> np.ndarray:
        """Observation (n,) → action (m,) float32 in [-1, 1]."""
        return np.tanh(forward(self.layers, observation))


class Runner(Protocol):
    """What does one kind of task."""

    def run(self, task: Any, policy: Optional[PolicyWeights]) -> Answer:
        """Do the task. Exceptions become an answer with an error."""


class Worker:
    """Does tasks one after the other."""

    def __init__(self, settings: WorkerSettings):
        self.settings = settings
        self.policy: Optional[PolicyWeights] = None
        self._runners: Dict[str, Runner] = {}
        self._printed: Set[str] = set()

    def run(self, task: Task, weights: bytes = b"") -> Answer:
        """Do a task; weights: a newer policy. What goes wrong is in the answer, so that no bad task ends a worker."""
        kind = "trial" if isinstance(task, Trial) else "collect"
        try:
            if weights:
                self.policy = PolicyWeights(weights)
            runner = self._runners.get(kind) or self._make(kind)
        except Exception as error:
            return Answer(task, f"the runner of {kind} tasks cannot start: {self._line(error)}")
        try:
            return runner.run(task, self.policy)
        except Exception as error:
            return Answer(task, self._line(error))

    def _make(self, kind: str) -> Runner:
        spec = getattr(self.settings, kind)
        module, _, name = spec.runner.partition(":")
        self._runners[kind] = runner = getattr(importlib.import_module(module), name)(**spec.options)
        return runner

    def _line(self, error: Exception) -> str:
        """The error in one line. One that is no user's mistake is also printed once, with where it happened."""
        line = (str(error).splitlines() or [""])[0]
        if isinstance(error, (ValueError, OSError)):
            return line
        line = f"{type(error).__name__}: {line}"
        if line not in self._printed:
            self._printed.add(line)
            traceback.print_exc()
        return line


def main(descriptor: int) -> None:
    """Serve tasks that arrive on a socket until the other end is gone."""
    from multiprocessing.connection import Connection

    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for the pool's process to answer
    os.dup2(2, 1)  # what libraries print goes to stderr
    with Connection(descriptor) as connection:
        try:
            worker = Worker(connection.recv())
            while True:
                connection.send(worker.run(*connection.recv()))
        except (EOFError, ConnectionError):
            return


if __name__ == "__main__":
    main(int(sys.argv[1]))
