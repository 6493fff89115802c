"""What the workers are to do next: training episodes, and before them the trials of an evaluation.

run.py holds a TaskScheduler; the pool asks it for each worker's next task.
"""

from __future__ import annotations

import threading
from collections import deque
from typing import Callable, Deque, Dict, Optional, Sequence

import numpy as np

from training.gorila.config import TrainConfig
from training.workers.tasks import Collect, Task, Trial
from worlds import World, WorldError
from worlds.metrics import difficulty

FIRST_SHARE = 0.25  # of the worlds, easiest first, with which a curriculum begins


class TaskScheduler:
    """The pool's next_task.

    Args:
        config: options of the run.
        worlds: how many there are to train in; None: the environment chooses.
        order: indices of the worlds, easiest first, for a curriculum.
        episodes: actor → number of its first episode, which is not 0 after a resume.
    """

    def __init__(
        self,
        config: TrainConfig,
        worlds: Optional[int],
        order: Optional[np.ndarray] = None,
        episodes: Callable[[str], int] = lambda actor: 0,
    ):
        self.config, self.worlds, self.order = config, worlds, order
        self.transitions = 0  # kept up to date by run.py
        self.ready = False  # whether there is a policy to drive
        self._next_episode: Dict[int, int] = {}
        self._episodes = episodes
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
        actor = "actor-%d" % slot
        episode = self._next_episode.get(slot, self._episodes(actor))
        self._next_episode[slot] = episode + 1
        return Collect(
            actor,
            episode,
            self.config.seed,
            self.config.noise(self.transitions),
            self.transitions < self.config.warmup and not self.config.start,
            self._world(slot, episode),
            mixed=self.config.noise_mixed,
            held=self.config.noise_held,
        )

    def _world(self, slot: int, episode: int) -> Optional[int]:
        if not self.worlds:
            return None
        rng = np.random.default_rng([2, self.config.seed, slot, episode])
        if self.order is not None:
            return int(self.order[int(rng.random() * self._open_worlds(self.worlds))])
        return int(rng.integers(self.worlds))

    def _open_worlds(self, worlds: int) -> float:
        """How many of the worlds, easiest first, the curriculum has opened."""
        over = self.config.curriculum * self.config.steps
        share = 1.0 if over <= 0 else min(1.0, FIRST_SHARE + (1.0 - FIRST_SHARE) * self.transitions / over)
        return max(1.0, share * worlds)


def easiest_first(worlds: Sequence[World]) -> np.ndarray:
    """Indices of the worlds by the mean of their ranks in BARN's difficulty metrics.

    Raises:
        WorldError: one of the worlds is not on BARN's grid.
    """
    try:
        metrics = [difficulty(world) for world in worlds]
    except WorldError as error:
        raise WorldError("a curriculum orders worlds by BARN's difficulty: %s" % error) from None
    easier_when_larger = {
        "closest_obstacle": True,
        "visibility": True,
        "dimension": True,
        "dispersion": False,
        "tortuosity": False,
    }
    ranks = np.zeros(len(metrics))
    for name, larger in easier_when_larger.items():
        values = np.array([m[name] for m in metrics]) * (-1.0 if larger else 1.0)
        ranks += np.argsort(np.argsort(values, kind="stable"), kind="stable")
    return np.argsort(ranks, kind="stable")
