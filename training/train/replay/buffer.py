"""Replay buffer: a ring of observations from which learner.py draws transitions.

One row holds s_t, a_t and r_t. s_{t+1} is in the next row, so that no observation is stored twice.
An episode of T transitions takes T + 1 rows, the last of which has no action. Scans are stored as
uint8 (TransitionLayout). The paper's five million transitions, 13 per episode, take 4.3 GB.
"""

from __future__ import annotations

import os
from typing import Dict, Tuple

import numpy as np

from applr_ros1.common.errors import ApplrError
from training.env.trajectory import Trajectory, TransitionLayout

COLUMNS = ("scan", "rest", "action", "reward", "end")  # names of the ring's arrays
# Values of a row's end: how the episode continues after the row
GOES_ON, TERMINATED, TRUNCATED, NO_ACTION = 0, 1, 2, 3


class ReplayBuffer:
    """Ring of `capacity` rows, to which add() writes whole episodes: it never cuts the latest."""

    def __init__(self, layout: TransitionLayout, capacity: int):
        self.layout = layout
        self.capacity = int(capacity)
        self.mirror = layout.mirror
        # Zeros take memory only when they are written, so a buffer that is too large would fail
        # after days.
        uint8_bytes = layout.scan + 1  # beams and end, uint8
        float32_bytes = 4 * (layout.rest + layout.action + 1)  # with the reward, float32
        _check_memory(self.capacity, uint8_bytes + float32_bytes)
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
        transitions = len(trajectory)
        rows = (self.written + np.arange(transitions + 1)) % self.capacity
        rows_with_action = rows[:-1]  # The last row holds only the last observation.
        self.scan[rows] = trajectory.scan
        self.rest[rows] = trajectory.rest
        self.action[rows_with_action] = trajectory.action
        self.reward[rows_with_action] = trajectory.reward
        self.end[rows] = GOES_ON
        self.end[rows[-2]] = TERMINATED if trajectory.terminated else TRUNCATED
        self.end[rows[-1]] = NO_ACTION
        self.written += transitions + 1
        self.transitions += transitions

    def rows(self, since: int) -> Dict[str, np.ndarray]:
        """Return the rows from number `since` on that are still in the ring, for restore()."""
        oldest = self.written - self.capacity
        rows = np.arange(max(since, oldest), self.written) % self.capacity
        return {column: getattr(self, column)[rows] for column in COLUMNS}

    def restore_rows(self, rows: Dict[str, np.ndarray]) -> None:
        """Append rows that rows() returned, without counting their transitions again."""
        row_count = len(rows["end"])
        ring_rows = (self.written + np.arange(row_count)) % self.capacity
        for column in COLUMNS:
            getattr(self, column)[ring_rows] = rows[column]
        self.written += row_count

    # -- sampling ----------------------------------------------------------------------------------
    def draw(self, rng: np.random.Generator, size: int) -> np.ndarray:
        """Draw rows (size,) of transitions uniformly from the ring."""
        rows = rng.integers(0, len(self), size)
        # Rows without an action are drawn again. This keeps the others equally likely.
        while True:
            rejected = np.flatnonzero(self.end[rows] == NO_ACTION)
            if not len(rejected):
                return rows
            rows[rejected] = rng.integers(0, len(self), len(rejected))

    def following(self, rows: np.ndarray, gamma: float) -> Tuple[np.ndarray, np.ndarray]:
        """Return the rows (B,) that follow `rows`, and the discounts (B,) of their values.

        A discount is gamma, or 0 after a terminal state. A truncated episode is bootstrapped from
        its last observation.
        """
        is_terminal = self.end[rows] == TERMINATED
        discounts = np.where(is_terminal, np.float32(0.0), np.float32(gamma))
        return (rows + 1) % self.capacity, discounts

    def observations(self, rows: np.ndarray, mirrored: int) -> Tuple[np.ndarray, np.ndarray]:
        """Return the stored observations of `rows`, the first `mirrored` of them mirrored.

        Mirroring reverses beams and negates angles, but keeps parameters, because robot and planner
        are symmetric.

        Returns:
            scan (B, beams) uint8 in steps of the layout (TransitionLayout.step), and rest (B, k)
            float32.
        """
        scan = self.scan[rows]
        rest = self.rest[rows]
        if mirrored and self.mirror is not None:
            beams = self.layout.scan
            mirrored_order = self.mirror.order[:beams]
            scan[:mirrored] = scan[:mirrored, mirrored_order]
            rest[:mirrored] *= self.mirror.sign[beams:]
        return scan, rest


def _check_memory(rows: int, row_bytes: int) -> None:
    """Raise ApplrError if the full replay buffer would not fit into memory."""
    memory = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    needed = rows * row_bytes
    if needed > memory:
        raise ApplrError(
            f"a replay buffer of {rows} rows takes {needed / 1e9:.1f} GB, this machine has "
            f"{memory / 1e9:.1f} GB: give a smaller --total-timesteps"
        )
