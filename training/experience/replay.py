"""The global replay: a ring of observations from which n-step transitions are drawn. learner.py fills and samples it.

One row holds s_t, a_t and r_t; s_{t+1} is the next row, so that no observation is stored twice. An episode of T
transitions takes T + 1 rows, the last of which has no action. Scans lie as uint8 (Layout). The paper's five million
transitions, 13 to an episode, take 4.3 GB.
"""

from __future__ import annotations

import os
from typing import Dict

import numpy as np
import torch

from training.experience.trajectory import Layout, Trajectory, TrajectoryError
from training.td3.td3 import Batch, LearnerError, decode, join

GOES_ON, TERMINATED, TRUNCATED, NO_ACTION = 0, 1, 2, 3  # what a row's transition leads to


class Replay:
    """capacity: rows. add() writes whole episodes, so the ring never cuts the newest one."""

    def __init__(self, layout: Layout, capacity: int):
        if capacity < 2:
            raise ValueError("replay of %r rows is too small; give at least 2" % (capacity,))
        self.layout, self.capacity = layout, int(capacity)
        _check_memory(self.capacity, layout.scan + 4 * (layout.rest + layout.action) + 5)
        self.scan = np.zeros((capacity, layout.scan), np.uint8)
        self.rest = np.zeros((capacity, layout.rest), np.float32)
        self.action = np.zeros((capacity, layout.action), np.float32)
        self.reward = np.zeros(capacity, np.float32)
        self.end = np.full(capacity, NO_ACTION, np.uint8)
        self.written = 0  # rows ever written; the next goes to written % capacity
        self.transitions = 0  # ever added
        self.held = 0  # of these, still there
        self._seen: Dict[str, _Numbers] = {}

    def __len__(self) -> int:
        """Rows in use."""
        return min(self.written, self.capacity)

    @property
    def nbytes(self) -> int:
        return sum(a.nbytes for a in (self.scan, self.rest, self.action, self.reward, self.end))

    def check(self, trajectory: Trajectory) -> None:
        """Raises TrajectoryError where add() would refuse: malformed, larger than the ring, or here already."""
        trajectory.check(self.layout)
        if len(trajectory) + 1 > self.capacity:
            raise TrajectoryError("%d transitions do not fit a replay of %d rows" % (len(trajectory), self.capacity))
        actor, episode = trajectory.info["actor"], trajectory.info["episode"]
        if actor in self._seen and episode in self._seen[actor]:
            raise TrajectoryError("episode %d of actor %s came twice" % (episode, actor))

    def add(self, trajectory: Trajectory) -> None:
        """Takes one episode in. Raises TrajectoryError, and changes nothing, where it is not fit."""
        self.check(trajectory)
        self._seen.setdefault(trajectory.info["actor"], _Numbers()).add(trajectory.info["episode"])
        t = len(trajectory)
        rows = (self.written + np.arange(t + 1)) % self.capacity
        self.held -= int(np.count_nonzero(self.end[rows] != NO_ACTION))
        self.scan[rows], self.rest[rows] = trajectory.scan, trajectory.rest
        self.action[rows[:-1]], self.reward[rows[:-1]] = trajectory.action, trajectory.reward
        self.end[rows] = GOES_ON
        self.end[rows[-2]] = TERMINATED if trajectory.terminated else TRUNCATED
        self.end[rows[-1]] = NO_ACTION
        self.written += t + 1
        self.transitions += t
        self.held += t

    def episodes_of(self, actor: str) -> int:
        """The next unused episode number of an actor."""
        return self._seen[actor].next if actor in self._seen else 0

    # -- checkpoints: the rows themselves are in the journal -----------------------------------------
    def begin_at(self, written: int, transitions: int) -> None:
        """Go on counting where a journal begins whose older segments are gone."""
        self.written, self.transitions = written, transitions

    def seen(self) -> Dict[str, list]:
        return {actor: [n.next, sorted(n.missing)] for actor, n in self._seen.items()}

    def see(self, seen: Dict[str, list]) -> None:
        for actor, (following, missing) in seen.items():
            self._seen[actor] = _Numbers(following, missing)

    # -- sampling ----------------------------------------------------------------------------------
    def draw(self, rng: np.random.Generator, size: int) -> np.ndarray:
        """(size,) rows of transitions, uniformly among those held."""
        if not self.held:
            raise ValueError("the replay is empty: nothing to draw from")
        rows = rng.integers(0, len(self), size)
        while True:
            bad = np.flatnonzero(self.end[rows] == NO_ACTION)
            if not len(bad):
                return rows
            rows[bad] = rng.integers(0, len(self), len(bad))

    def look_ahead(self, rows: np.ndarray, n: int, gamma: float):
        """n-step returns from `rows`: (rewards (B,), discounts (B,), rows of the observation after them).

        Sums gamma^k r_{t+k} until n steps or the episode's end. The discount is gamma^steps, and 0 where a terminal
        state was reached; a truncated episode is bootstrapped from its last observation.
        """
        following = rows.copy()
        total = np.zeros(len(rows), np.float64)
        discount = np.ones(len(rows), np.float64)
        alive = np.ones(len(rows), bool)
        terminal = np.zeros(len(rows), bool)
        for _ in range(n):
            total[alive] += discount[alive] * self.reward[following[alive]]
            discount[alive] *= gamma
            end = self.end[following]
            terminal |= alive & (end == TERMINATED)
            following[alive] += 1
            following %= self.capacity
            alive &= end == GOES_ON
        discount[terminal] = 0.0
        return total.astype(np.float32), discount.astype(np.float32), following

    def sample(
        self,
        rng: np.random.Generator,
        size: int,
        n: int,
        gamma: float,
        device=torch.device("cpu"),  # noqa: B008
        mirror: bool = False,
    ) -> Batch:
        """A batch for TD3.update, noise included: all randomness of an update comes from `rng`.

        mirror: half of the transitions as the robot's mirror image would have met them.
        """
        rows = self.draw(rng, size)
        reward, discount, following = self.look_ahead(rows, n, gamma)
        noise = rng.standard_normal((size, self.layout.action), dtype=np.float32)
        step = self.layout.step
        mirrored = size // 2 if mirror else 0
        return Batch(
            join(*self._decoded(rows, mirrored, device), step),
            decode(self.action[rows], device),
            decode(reward, device),
            decode(discount, device),
            join(*self._decoded(following, mirrored, device), step),
            decode(noise, device),
        )

    def _decoded(self, rows: np.ndarray, mirrored: int, device):
        """(scan, rest) of observations, the first `mirrored` left for right: beams in reverse, the local goal's angle
        negated. The parameters are the same on both sides, and so are robot and planner.
        """
        scan, rest = self.scan[rows], self.rest[rows]
        if mirrored:
            scan[:mirrored] = scan[:mirrored, ::-1].copy()
            rest[:mirrored, 0] *= -1.0
        return decode(scan, device), decode(rest, device)


def _check_memory(rows: int, row: int) -> None:
    """LearnerError where the replay, once full, would not fit this machine: better now than killed after days."""
    there = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    if rows * row > there:
        raise LearnerError(
            "a replay of %d rows takes %.1f GB, this machine has %.1f GB; give a smaller --capacity"
            % (rows, rows * row / 1e9, there / 1e9)
        )


class _Numbers:
    """A set of episode numbers in little memory: all below `next` but the missing ones."""

    def __init__(self, following: int = 0, missing=()):
        self.next, self.missing = following, set(missing)

    MOST_MISSING = 10_000

    def __contains__(self, number: int) -> bool:
        return number < self.next and number not in self.missing

    def add(self, number: int) -> None:
        if number >= self.next:
            gap = range(max(self.next, number - self.MOST_MISSING), number)
            self.missing.update(gap)
            self.next = number + 1
        self.missing.discard(number)
