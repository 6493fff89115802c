"""Replay buffer: a ring of observations from which learner.py draws n-step transitions.

One row holds s_t, a_t and r_t. s_{t+1} is in the next row, so that no observation is stored twice. An episode of T
transitions takes T + 1 rows, the last of which has no action. Scans are stored as uint8 (TransitionLayout). The paper's
five million transitions, 13 per episode, take 4.3 GB.
"""

from __future__ import annotations

import os
from typing import Dict, Tuple

import numpy as np

from applr_ros1.common.errors import ApplrError
from training.env.trajectory import Trajectory, TransitionLayout

COLUMNS = ("scan", "rest", "action", "reward", "end")  # names of the ring's arrays
GOES_ON, TERMINATED, TRUNCATED, NO_ACTION = (
    0,
    1,
    2,
    3,
)  # values of a row's end: how the episode continues after the row


class Replay:
    """Ring of `capacity` rows. add() writes whole episodes, so that the ring never cuts the latest episode."""

    def __init__(self, layout: TransitionLayout, capacity: int):
        self.layout, self.capacity, self.mirror = layout, int(capacity), layout.mirror
        _check_memory(self.capacity, layout.scan + 4 * (layout.rest + layout.action) + 5)
        self.scan = np.zeros((capacity, layout.scan), np.uint8)
        self.rest = np.zeros((capacity, layout.rest), np.float32)
        self.action = np.zeros((capacity, layout.action), np.float32)
        self.reward = np.zeros(capacity, np.float32)
        self.end = np.full(capacity, NO_ACTION, np.uint8)
        self.written = 0  # number of rows ever written; the next row goes to written % capacity
        self.transitions = 0  # number of transitions ever added

    def __len__(self) -> int:
        """Return the number of rows in use."""
        return min(self.written, self.capacity)

    def add(self, trajectory: Trajectory) -> None:
        """Add an episode, which must have fewer rows than the ring."""
        t = len(trajectory)
        rows = (self.written + np.arange(t + 1)) % self.capacity
        self.scan[rows], self.rest[rows] = trajectory.scan, trajectory.rest
        self.action[rows[:-1]], self.reward[rows[:-1]] = trajectory.action, trajectory.reward
        self.end[rows] = GOES_ON
        self.end[rows[-2]] = TERMINATED if trajectory.terminated else TRUNCATED
        self.end[rows[-1]] = NO_ACTION
        self.written += t + 1
        self.transitions += t

    def rows(self, since: int) -> Dict[str, np.ndarray]:
        """Return the rows from number `since` on that are still in the ring, for restore()."""
        rows = np.arange(max(since, self.written - self.capacity), self.written) % self.capacity
        return {name: getattr(self, name)[rows] for name in COLUMNS}

    def restore(self, rows: Dict[str, np.ndarray]) -> None:
        """Append rows that rows() returned. The number of transitions ever added does not change."""
        count = len(rows["end"])
        places = (self.written + np.arange(count)) % self.capacity
        for name in COLUMNS:
            getattr(self, name)[places] = rows[name]
        self.written += count

    # -- sampling ----------------------------------------------------------------------------------
    def draw(self, rng: np.random.Generator, size: int) -> np.ndarray:
        """Draw rows (size,) of transitions uniformly from the ring."""
        rows = rng.integers(0, len(self), size)
        while True:
            bad = np.flatnonzero(self.end[rows] == NO_ACTION)
            if not len(bad):
                return rows
            rows[bad] = rng.integers(0, len(self), len(bad))

    def n_step_return(
        self, rows: np.ndarray, n: int, gamma: float
    ) -> Tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return n-step rewards (B,) from `rows` on, discounts (B,), and the rows (B,) of the observations that follow.

        A reward sums gamma^k r_{t+k} over n steps or until the episode's end. The discount of the next value is
        gamma^steps, or 0 after a terminal state. A truncated episode is bootstrapped from its last observation.
        """
        after = rows.copy()
        total = np.zeros(len(rows), np.float64)
        discount = np.ones(len(rows), np.float64)
        alive = np.ones(len(rows), bool)
        terminal = np.zeros(len(rows), bool)
        for _ in range(n):
            total[alive] += discount[alive] * self.reward[after[alive]]
            discount[alive] *= gamma
            end = self.end[after]
            terminal |= alive & (end == TERMINATED)
            after[alive] += 1
            after %= self.capacity
            alive &= end == GOES_ON
        discount[terminal] = 0.0
        return total.astype(np.float32), discount.astype(np.float32), after

    def observations(self, rows: np.ndarray, mirrored: int) -> Tuple[np.ndarray, np.ndarray]:
        """Return the stored observations of `rows`, the first `mirrored` of them with left and right exchanged.

        Mirroring reverses beams and negates angles, but keeps parameters, because robot and planner are symmetric.

        Returns:
            scan (B, beams) uint8 in steps of the layout (TransitionLayout.step), and rest (B, k) float32.
        """
        scan, rest, mirror, beams = self.scan[rows], self.rest[rows], self.mirror, self.layout.scan
        if mirrored and mirror is not None:
            scan[:mirrored] = scan[:mirrored][:, mirror.order[:beams]]
            rest[:mirrored] *= mirror.sign[beams:]
        return scan, rest


def _check_memory(rows: int, row: int) -> None:
    """Raise ApplrError if the full replay buffer would not fit into memory."""
    memory = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    if rows * row > memory:
        takes = f"a replay buffer of {rows} rows takes {rows * row / 1e9:.1f} GB"
        raise ApplrError(
            f"{takes}, this machine has {memory / 1e9:.1f} GB: give a smaller --total-timesteps"
        )
