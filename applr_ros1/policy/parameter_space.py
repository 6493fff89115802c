"""The action space of APPLR: the eight planner parameters theta, their ranges and theta_0.

Called by the applr node (actions to parameters), the meta-environment and the trainer. Ranges and theta_0 are
those of the authors' final code and of Clearpath's Jackal.
"""
import json
from dataclasses import dataclass, field
from typing import Dict, Tuple

import numpy as np


class SpaceError(ValueError):
    """An action or a parameter vector that must not reach the planner; one line says which value and why."""


@dataclass(frozen=True)
class Target:
    """One dynamic_reconfigure value that follows a parameter of theta.

    server: "planner", "local_inflation" or "global_inflation"; names: accepted names, the newest first
    (servers differ: `path_distance_bias` was `pdist_scale` in kinetic); sign: -1 where the value is mirrored.
    """
    server: str
    names: Tuple[str, ...]
    sign: float = 1.0


@dataclass(frozen=True)
class Space:
    """A box of n planner parameters. names: the paper's; low, high, theta0: (n,) in the parameter's own unit;
    integer: (n,) bool, True for sample counts; targets: which servers' values each parameter sets."""
    names: Tuple[str, ...]
    low: np.ndarray
    high: np.ndarray
    integer: np.ndarray
    theta0: np.ndarray
    targets: Dict[str, Tuple[Target, ...]] = field(default_factory=dict)

    def __len__(self):
        return len(self.names)

    def clip(self, theta):
        """theta (n,) → (n,) float64 inside the ranges, counts rounded to the nearest integer.

        Raises SpaceError when the length is wrong or a value is not finite (1e9 is clipped, NaN is refused).
        """
        theta = np.asarray(theta, dtype=np.float64)
        self._check(theta, "parameter")
        theta = np.clip(theta, self.low, self.high)
        return np.where(self.integer, np.rint(theta), theta)

    def to_theta(self, action):
        """action (n,) in [-1, 1] → theta (n,) float64: scaled to the ranges, clipped, counts rounded.

        Raises SpaceError for NaN, inf and wrong lengths.
        """
        action = np.asarray(action, dtype=np.float64)
        self._check(action, "action")
        action = np.clip(action, -1.0, 1.0)
        return self.clip(self.low + 0.5 * (action + 1.0) * (self.high - self.low))

    def to_action(self, theta):
        """theta (n,) → (n,) float64 in [-1, 1]. Values beyond the ranges (a person may set them) are
        clipped."""
        theta = np.asarray(theta, dtype=np.float64)
        self._check(theta, "parameter")
        return np.clip(2.0 * (theta - self.low) / (self.high - self.low) - 1.0, -1.0, 1.0)

    def as_dict(self, theta):
        """theta (n,) → {name: value}, counts as int."""
        return {name: int(value) if whole else float(value)
                for name, value, whole in zip(self.names, theta, self.integer)}

    def from_dict(self, values, base=None):
        """{name: value} → theta (n,), missing names taken from `base` (theta_0). Raises SpaceError when a
        name is unknown, a value is no number, or one lies outside its range."""
        theta = np.array(self.theta0 if base is None else base, dtype=np.float64)
        for name, value in values.items():
            if name not in self.names:
                raise SpaceError(f"unknown parameter {name!r}: use {', '.join(self.names)}")
            if isinstance(value, bool) or not isinstance(value, (int, float)):
                raise SpaceError(f"parameter {name} is {value!r}: give a number")
            i = self.names.index(name)
            if not self.low[i] <= value <= self.high[i]:
                raise SpaceError(f"parameter {name} is {value}: give {self.low[i]:g} to {self.high[i]:g}")
            theta[i] = value
        return self.clip(theta)

    def to_json(self):
        """The space as a JSON string (what an actor file's metadata hold)."""
        return json.dumps({"names": list(self.names), "low": self.low.tolist(), "high": self.high.tolist(),
                           "integer": self.integer.tolist(), "theta0": self.theta0.tolist()})

    def _check(self, vector, what):
        if vector.shape[-1:] != (len(self.names),):
            raise SpaceError(f"{what} vector has shape {vector.shape}: {len(self.names)} values are needed")
        if not np.all(np.isfinite(vector)):
            bad = np.argwhere(~np.isfinite(vector))[0]
            raise SpaceError(f"{what} {self.names[bad[-1]]} is {vector[tuple(bad)]}: refused, not finite")


def _planner(*names, sign=1.0):
    return Target("planner", names, sign)


# name: (low, high, integer, theta_0, targets)
_TABLE = {
    "max_vel_x": (0.2, 2.0, False, 0.5, (_planner("max_vel_x"),)),
    "max_vel_theta": (0.314, 3.14, False, 1.57, (_planner("max_vel_theta"),
                                                 _planner("min_vel_theta", sign=-1.0))),
    "vx_samples": (4, 20, True, 6, (_planner("vx_samples"),)),
    "vtheta_samples": (4, 60, True, 20, (_planner("vtheta_samples"),)),
    "occdist_scale": (0.05, 1.0, False, 0.1, (_planner("occdist_scale"),)),
    "pdist_scale": (0.1, 1.5, False, 0.75, (_planner("path_distance_bias", "pdist_scale"),)),
    "gdist_scale": (0.1, 2.0, False, 1.0, (_planner("goal_distance_bias", "gdist_scale"),)),
    "inflation_radius": (0.1, 0.6, False, 0.30, (Target("local_inflation", ("inflation_radius",)),
                                                 Target("global_inflation", ("inflation_radius",)))),
}

SPACE = Space(names=tuple(_TABLE),
              low=np.array([row[0] for row in _TABLE.values()], dtype=np.float64),
              high=np.array([row[1] for row in _TABLE.values()], dtype=np.float64),
              integer=np.array([row[2] for row in _TABLE.values()]),
              theta0=np.array([row[3] for row in _TABLE.values()], dtype=np.float64),
              targets={name: row[4] for name, row in _TABLE.items()})
THETA_0 = SPACE.theta0
for _array in (SPACE.low, SPACE.high, SPACE.integer, SPACE.theta0):
    _array.setflags(write=False)
