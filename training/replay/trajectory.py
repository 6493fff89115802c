"""One episode as it travels from an actor to the replay: arrays in safetensors, no pickle.

Actors pack, the learner unpacks and checks. The scan is stored in whole steps of its resolution.
"""

from __future__ import annotations

import json
from dataclasses import dataclass, field
from typing import Any, Dict, Optional, Tuple

import numpy as np
import safetensors.numpy

from applr_ros1.common.errors import ApplrError
from applr_ros1.common.files import StorageError
from applr_ros1.common.tensors import unpack
from applr_ros1.policy.form import Form, Mirror


class TrajectoryError(ApplrError):
    """A trajectory that must not enter the replay; one line with the reason."""


@dataclass(frozen=True)
class TransitionLayout:
    """Parts of one observation and one action.

    scan    beams, each in [-1, 1], stored as whole numbers of 2/levels (uint8: 255 steps. With the paper's cap of
            2 m that is 7.8 mm, a sixth of a costmap cell)
    rest    further numbers (phi, theta), stored as float32
    action  numbers in [-1, 1], float32
    scans   how many scans the beams are of, one behind the other
    odd     places in the rest of the numbers that turn round where left and right are exchanged
    hidden  how many of the last numbers only critics are shown, not the policy
    """

    scan: int = 720
    rest: int = 9
    action: int = 8
    scans: int = 1
    odd: Tuple[int, ...] = (0,)
    hidden: int = 0

    LEVELS = 255

    @classmethod
    def of(cls, form: Form) -> TransitionLayout:
        """Return the layout of a form's observations and actions."""
        return cls(form.scan, form.size - form.scan, form.actions, form.scans, form.odd)

    @property
    def mirror(self) -> Optional[Mirror]:
        """Return what exchanging left and right does to an observation; None for one without a scan."""
        return Mirror.of(self.scan, self.rest, self.scans, self.odd) if self.scan and self.rest else None

    @property
    def policy_mirror(self) -> Optional[Mirror]:
        """The same for what the policy is shown."""
        rest = self.rest - self.hidden
        odd = tuple(place for place in self.odd if place < rest)
        return Mirror.of(self.scan, rest, self.scans, odd) if self.scan and rest else None

    @property
    def seen(self) -> int:
        """Numbers that the policy is shown; they come first."""
        return self.size - self.hidden

    @property
    def size(self) -> int:
        """Numbers in an observation."""
        return self.scan + self.rest

    @property
    def step(self) -> float:
        """Resolution of a stored beam, in units of the observation."""
        return 2.0 / self.LEVELS

    def to_dict(self) -> Dict[str, Any]:
        """Its fields as JSON values; from_dict() is the inverse."""
        return dict(vars(self), odd=list(self.odd))

    @classmethod
    def from_dict(cls, values: Dict[str, Any]) -> TransitionLayout:
        """Raises KeyError or TypeError for values that describe none."""
        return cls(**dict(values, odd=tuple(values["odd"])))

    def quantise(self, observations: np.ndarray) -> np.ndarray:
        """(n, size) → (n, scan) uint8."""
        return np.rint((np.clip(observations[:, : self.scan], -1.0, 1.0) + 1.0) / self.step).astype(np.uint8)

    def restore(self, scan: np.ndarray, rest: np.ndarray) -> np.ndarray:
        """The inverse of quantise, with the rest: (n, size) float32."""
        return np.concatenate((scan.astype(np.float32) * np.float32(self.step) - np.float32(1.0), rest), axis=1)


@dataclass
class Trajectory:
    """T transitions with T + 1 observations: s' of one is s of the next, stored once.

    scan (T+1, beams) uint8, rest (T+1, k) float32, action (T, m), reward (T,) float32
    terminated: the last observation is a terminal state; otherwise the episode was cut there (truncated) and is
    bootstrapped. info: JSON values; "version" is the policy's, in gradient steps.
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
    def of(cls, layout: TransitionLayout, observations, actions, rewards, terminated: bool, info=None) -> "Trajectory":
        """From float observations (T+1, size), actions (T, m), rewards (T,)."""
        observations = np.asarray(observations, dtype=np.float32).reshape(-1, layout.size)
        if not np.isfinite(observations).all():
            raise TrajectoryError("observation holds NaN or inf")
        return cls(
            layout.quantise(observations),
            np.ascontiguousarray(observations[:, layout.scan :]),
            np.asarray(actions, dtype=np.float32).reshape(-1, layout.action),
            np.asarray(rewards, dtype=np.float32),
            bool(terminated),
            dict(info or {}),
        )

    def check(self, layout: TransitionLayout) -> None:
        """Raises TrajectoryError unless the arrays are of the layout, finite, and of one length."""
        t = len(self.reward) if self.reward.ndim == 1 else -1
        if t < 1:
            raise TrajectoryError(f"a trajectory of {t} transitions; 1 or more are needed")
        wanted = {
            "scan": (np.uint8, (t + 1, layout.scan)),
            "rest": (np.float32, (t + 1, layout.rest)),
            "action": (np.float32, (t, layout.action)),
            "reward": (np.float32, (t,)),
        }
        for name, (dtype, shape) in wanted.items():
            array = getattr(self, name)
            if array.dtype != dtype or array.shape != shape:
                raise TrajectoryError(f"{name} is {array.dtype} {array.shape}, {np.dtype(dtype)} {shape} is needed")
            if not np.isfinite(array).all():
                raise TrajectoryError(f"{name} holds NaN or inf")
        if (np.abs(self.action) > 1.0 + 1e-6).any():
            raise TrajectoryError("an action lies outside [-1, 1]")

    def pack(self) -> bytes:
        """The trajectory as safetensors bytes; unpack() is the inverse."""
        arrays = {"scan": self.scan, "rest": self.rest, "action": self.action, "reward": self.reward}
        header = {"info": json.dumps(self.info), "terminated": json.dumps(bool(self.terminated))}
        return safetensors.numpy.save({k: np.ascontiguousarray(v) for k, v in arrays.items()}, metadata=header)

    @classmethod
    def unpack(cls, blob: bytes, layout: TransitionLayout) -> "Trajectory":
        """The inverse of pack, checked. Raises TrajectoryError for bytes that are none, or none of the layout."""
        try:
            arrays, header = unpack(blob, "trajectory")
            info, terminated = json.loads(header["info"]), json.loads(header["terminated"])
            made = cls(arrays["scan"], arrays["rest"], arrays["action"], arrays["reward"], terminated, info)
        except StorageError as error:
            raise TrajectoryError(str(error)) from None
        except (KeyError, TypeError, ValueError):
            raise TrajectoryError("not a trajectory: arrays or header are missing or malformed") from None
        made.check(layout)
        return made
