"""What the actors are to do next: training episodes, and between them the trials of an evaluation. train.py holds one;
the pool asks it for each actor's next task.
"""

from __future__ import annotations

import threading
import time
from collections import deque
from typing import Any, Dict, List, Optional

import numpy as np

from training.gorila.config import TrainConfig

FIRST_SHARE = 0.25  # of the worlds, easiest first, with which a curriculum begins
LOST_AFTER = 300.0  # seconds after which a trial whose actor must have died is given again


class Tasks:
    """worlds: how many there are to train in (None: the environment chooses); order: their indices, easiest first."""

    def __init__(
        self, config: TrainConfig, worlds: Optional[int], order: Optional[np.ndarray] = None, episodes=lambda actor: 0
    ):
        self.config, self.worlds, self.order = config, worlds, order
        self.transitions = 0  # kept up to date by train.py
        self._next: Dict[int, int] = {}
        self._episodes = episodes
        self._trials: deque = deque()  # evaluation tasks not yet given
        self._given: Dict[Any, Any] = {}
        self._lock = threading.Lock()

    def next(self, slot: int) -> Dict[str, Any]:
        with self._lock:
            self._give_lost_again()
            if self._trials:
                task = self._trials.popleft()
                self._given[_key(task)] = (time.monotonic(), task)
                return dict(task)
            return self._training(slot)

    def evaluate(self, tasks: List[Dict[str, Any]]) -> None:
        with self._lock:
            self._trials.extend(tasks)

    def done(self, task: Dict[str, Any]) -> bool:
        """An evaluation trial has come back. False: it had already."""
        with self._lock:
            return self._given.pop(_key(task), None) is not None

    def _training(self, slot):
        actor = "actor-%d" % slot
        episode = self._next.get(slot, self._episodes(actor))
        self._next[slot] = episode + 1
        task = {
            "kind": "train",
            "actor": actor,
            "episode": episode,
            "seed": self.config.seed,
            "sigma": self.config.noise(self.transitions),
            "random": self.transitions < self.config.warmup,
        }
        if self.worlds:
            rng = np.random.default_rng([2, self.config.seed, slot, episode])
            if self.order is not None:
                task["world"] = int(self.order[int(rng.random() * self._open_worlds())])
            else:
                task["world"] = int(rng.integers(self.worlds))
        return task

    def _open_worlds(self) -> float:
        """How many of the worlds, easiest first, the curriculum has opened."""
        over = self.config.curriculum * self.config.steps
        share = 1.0 if over <= 0 else min(1.0, FIRST_SHARE + (1.0 - FIRST_SHARE) * self.transitions / over)
        return max(1.0, share * self.worlds)

    def _give_lost_again(self):
        now = time.monotonic()
        for key, (since, task) in list(self._given.items()):
            if now - since > LOST_AFTER:
                del self._given[key]
                self._trials.appendleft(task)


def _key(task):
    return task["round"], task["world"], task["trial"]


def easiest_first(worlds) -> np.ndarray:
    """Indices of the worlds by the mean of their ranks in BARN's difficulty metrics."""
    from worlds.metrics import difficulty

    metrics = [difficulty(world) for world in worlds]
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


def spread(items: List[Any], count: int) -> List[Any]:
    """`count` of them, evenly spread; all for 0."""
    if not count or count >= len(items):
        return items
    return [items[i] for i in np.linspace(0, len(items) - 1, count).round().astype(int)]
