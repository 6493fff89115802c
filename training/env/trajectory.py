"""Trajectory of one episode, as an actor sends it to the learner; layout of its observations."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, ClassVar, Dict, Optional, Tuple

import numpy as np
import pydantic.dataclasses
from numpy.typing import ArrayLike

from applr_ros1.common.errors import ApplrError
from applr_ros1.policy.encoding import Encoding, Mirror


@pydantic.dataclasses.dataclass(frozen=True)
class TransitionLayout:
    """Sizes of the parts of an observation and an action. Its vars() are stored as JSON.

    Attributes:
        scan: Number of beams, whose values in [-1, 1] are stored as multiples of `step` (uint8).
            With the paper's cap of 2 m, a step is 7.8 mm, a sixth of a costmap cell.
        rest: Number of further entries (phi, theta), stored as float32.
        action: Number of entries of an action (float32 in [-1, 1]).
        scans: Number of successive scans into which the beams are divided.
        odd: Indices, counted after the scans, of the entries that change sign when left and right
            are exchanged.
        hidden: Number of trailing entries that only the critics receive.
    """

    scan: int = 720
    rest: int = 9
    action: int = 8
    scans: int = 1
    odd: Tuple[int, ...] = (0,)
    hidden: int = 0

    step: ClassVar[float] = 2.0 / 255  # resolution of a stored beam, in units of the observation

    @classmethod
    def of(cls, encoding: Encoding) -> TransitionLayout:
        """Return the layout of an encoding's observations and actions."""
        return cls(
            scan=encoding.scan,
            rest=encoding.size - encoding.scan,
            action=encoding.actions,
            scans=encoding.scans,
            odd=encoding.mirror_sign,
        )

    @property
    def mirror(self) -> Optional[Mirror]:
        """Left-right reflection of an observation; None for an observation without a scan."""
        # Only a scan shows on which side obstacles are.
        if not (self.scan and self.rest):
            return None
        return Mirror.of(self.scan, self.rest, self.scans, self.odd)

    @property
    def policy_mirror(self) -> Optional[Mirror]:
        """Left-right reflection of the policy's part of an observation."""
        return self.mirror and Mirror(*(entries[: self.seen] for entries in self.mirror))

    @property
    def seen(self) -> int:
        """Number of leading entries that the policy receives."""
        return self.size - self.hidden

    @property
    def size(self) -> int:
        """Number of entries of an observation."""
        return self.scan + self.rest

    def quantise(self, observations: np.ndarray) -> np.ndarray:
        """Return the scans of observations (n, size) as (n, scan) uint8."""
        capped_beams = np.clip(observations[:, : self.scan], -1.0, 1.0)
        beam_steps: np.ndarray = np.rint((capped_beams + 1.0) / self.step)
        return beam_steps.astype(np.uint8)

    def restore(self, scan: np.ndarray, rest: np.ndarray) -> np.ndarray:
        """Return observations (n, size) float32 from quantised scans and the rest."""
        beams = scan.astype(np.float32) * np.float32(self.step) - np.float32(1.0)
        return np.concatenate((beams, rest), axis=1)


@dataclass
class Trajectory:
    """T transitions with T + 1 observations: s' of a transition, s of the next, is stored once.

    Attributes:
        scan: (T+1, beams) uint8.
        rest: (T+1, k) float32.
        action: (T, m) float32.
        reward: (T,) float32.
        terminated: Whether the last observation is a terminal state; otherwise it is truncated and
            bootstrapped.
        info: JSON values about the episode (workers/collect.py).
    """

    scan: np.ndarray
    rest: np.ndarray
    action: np.ndarray
    reward: np.ndarray
    terminated: bool
    info: Dict[str, Any] = field(default_factory=dict)

    def __len__(self) -> int:
        return len(self.reward)

    @classmethod
    def of(
        cls,
        layout: TransitionLayout,
        observations: ArrayLike,
        actions: ArrayLike,
        rewards: ArrayLike,
        terminated: bool,
        info: Optional[Dict[str, Any]] = None,
    ) -> Trajectory:
        """Return a trajectory of observations (T+1, size), actions (T, m) and rewards (T,).

        Raises:
            ApplrError: A value is not finite.
        """
        observations = np.asarray(observations, dtype=np.float32).reshape(-1, layout.size)
        # A value that is not finite would spoil the networks without a trace of where it came from.
        parts_by_name = {"an observation": observations, "an action": actions, "a reward": rewards}
        for part_name, values in parts_by_name.items():
            if not np.isfinite(values).all():
                raise ApplrError(f"{part_name} contains NaN or inf")
        return cls(
            layout.quantise(observations),
            np.ascontiguousarray(observations[:, layout.scan :]),
            np.asarray(actions, dtype=np.float32).reshape(-1, layout.action),
            np.asarray(rewards, dtype=np.float32),
            bool(terminated),
            dict(info or {}),
        )
