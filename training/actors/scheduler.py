"""What the workers are to do next: training episodes, and before them the trials of an evaluation.

learner/run.py holds a TaskScheduler; the pool asks it for each worker's next task.
"""

from __future__ import annotations

import threading
from collections import deque
from typing import Callable, Deque, Dict, Optional, Sequence

import numpy as np

from training.actors.tasks import Collect, Task, Trial


class TaskScheduler:
    """The pool's next_task.

    Args:
        seed: of the run.
        worlds: how many there are to train in; None: the environment chooses.
        noise: transitions taken so far → standard deviation of the exploration noise.
        random: the number of transitions before which actions are uniformly random.
        first_episode: actor → number of its first episode, which is not 0 after a resume.
    """

    def __init__(
        self,
        seed: int,
        worlds: Optional[int],
        noise: Callable[[int], float],
        random: int = 0,
        first_episode: Callable[[str], int] = lambda actor: 0,
    ):
        self.seed, self.worlds, self.noise, self.random = seed, worlds, noise, random
        self.transitions = 0  # kept up to date by run.py
        self.ready = False  # whether there is a policy to drive
        self._next_episode: Dict[int, int] = {}
        self._first_episode = first_episode
        self._trials: Deque[Trial] = deque()  # not yet given
        self._lock = threading.Lock()

    def next_task(self, slot: int) -> Optional[Task]:
        """The next task of worker `slot`; None before there is a policy."""
        with self._lock:
            if not self.ready:
                return None
            return self._trials.popleft() if self._trials else self._training(slot)

    def evaluate(self, trials: Sequence[Trial]) -> None:
        """Trials that go before any training episode."""
        with self._lock:
            self._trials.extend(trials)

    def _training(self, slot: int) -> Collect:
        actor = f"actor-{slot}"
        episode = self._next_episode.get(slot, self._first_episode(actor))
        self._next_episode[slot] = episode + 1
        rng = np.random.default_rng([2, self.seed, slot, episode])
        world = int(rng.integers(self.worlds)) if self.worlds else None
        random = self.transitions < self.random
        return Collect(actor, episode, self.seed, self.noise(self.transitions), random, world)
