"""The action space of APPLR: the eight planner parameters theta, their ranges and theta_0.

Called by the applr node (actions to parameters), the meta-environment and the trainer. Ranges and theta_0 are
those of the authors' final code and of Clearpath's Jackal; types, aliases and theta_0 come from the planner's
declarations.
"""

import json
from dataclasses import dataclass, field
from typing import Dict, Tuple

import numpy as np

from applr_ros1.common import files
from applr_ros1.common.errors import ApplrError
from applr_ros1.planner.parameters.declarations import SERVERS

ROLES = {  # the servers of move_base that hold the parameters, below its name
    "planner": "TrajectoryPlannerROS",
    "local_inflation": "local_costmap/inflater_layer",
    "global_inflation": "global_costmap/inflater_layer",
}
MAX_SET_BYTES = 2**16  # of a JSON file with one set of parameters


class SpaceError(ApplrError):
    """An action or a parameter vector that must not reach the planner; one line says which value and why."""


@dataclass(frozen=True)
class Target:
    """One dynamic_reconfigure value that follows a parameter of theta.

    server: a key of ROLES; names: accepted names, the newest first
    (servers differ: `path_distance_bias` was `pdist_scale` in kinetic); sign: -1 where the value is mirrored.
    """

    server: str
    names: Tuple[str, ...]
    sign: float = 1.0


@dataclass(frozen=True)
class Space:
    """A box of n planner parameters.

    Attributes:
        names: The paper's names.
        low: (n,) smallest values, in each parameter's own unit.
        high: (n,) largest values.
        integer: (n,) bool, True for sample counts.
        theta0: (n,) the Jackal's defaults.
        targets: Which servers' values each parameter sets.
    """

    names: Tuple[str, ...]
    low: np.ndarray
    high: np.ndarray
    integer: np.ndarray
    theta0: np.ndarray
    targets: Dict[str, Tuple[Target, ...]] = field(default_factory=dict)

    def __len__(self):
        return len(self.names)

    def clip(self, theta):
        """The nearest parameters (n,) float64 inside the ranges, counts rounded to whole numbers.

        Raises SpaceError when the length is wrong or a value is not finite (1e9 is clipped, NaN is refused).
        """
        theta = np.asarray(theta, dtype=np.float64)
        self._check(theta, "parameter")
        theta = np.clip(theta, self.low, self.high)
        return np.where(self.integer, np.rint(theta), theta)

    def to_theta(self, action):
        """The parameters (n,) float64 for an action (n,) in [-1, 1]: scaled to the ranges, clipped, counts rounded.

        Raises SpaceError for NaN, inf and wrong lengths.
        """
        action = np.asarray(action, dtype=np.float64)
        self._check(action, "action")
        action = np.clip(action, -1.0, 1.0)
        return self.clip(self.low + 0.5 * (action + 1.0) * (self.high - self.low))

    def to_action(self, theta):
        """The action (n,) float64 in [-1, 1] for parameters; values beyond the ranges (a person may set them) clip."""
        theta = np.asarray(theta, dtype=np.float64)
        self._check(theta, "parameter")
        return np.clip(2.0 * (theta - self.low) / (self.high - self.low) - 1.0, -1.0, 1.0)

    def as_dict(self, theta):
        """The parameters (n,) as {name: value}, counts as int."""
        return {
            name: int(value) if whole else float(value) for name, value, whole in zip(self.names, theta, self.integer)
        }

    def from_dict(self, values, base=None):
        """The parameters (n,) of {name: value}; missing names are taken from `base` (theta_0).

        Raises:
            SpaceError: A name is unknown, a value is no number, or one lies outside its range.
        """
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

    def targets_of(self, role):
        """[(index into theta, Target), ...] of the values that the server of a role holds."""
        return [(i, t) for i, name in enumerate(self.names) for t in self.targets[name] if t.server == role]

    def requests(self, theta):
        """One request for each of move_base's servers, {server: {name: value}}, for parameters (n,), clipped.

        Raises SpaceError, before there is any request, for a wrong length or a value that is not finite.
        """
        values = list(self.as_dict(self.clip(theta)).values())
        return {
            server: {t.names[0]: type(values[i])(t.sign * values[i]) for i, t in self.targets_of(role)}
            for role, server in ROLES.items()
        }

    def places(self):
        """[(server, name), ...]: where the value of each parameter of theta is read back from move_base."""
        return [(ROLES[self.targets[name][0].server], self.targets[name][0].names[0]) for name in self.names]

    def read(self, path):
        """The parameters (n,) in a JSON file: {name: value}, or {"parameters": {name: value}, ...}.

        Names left out keep theta_0. "weights" beside "parameters" says what the set's distance weights count
        (distance_weights.weights_of_set). Raises SpaceError.
        """
        values = files.read_json(path, MAX_SET_BYTES, SpaceError)
        values = values.get("parameters", values) if isinstance(values, dict) else values
        if not isinstance(values, dict):
            raise SpaceError(f'{path}: holds no object; give one such as {{"max_vel_x": 1.0}}')
        try:
            return self.from_dict(values)
        except SpaceError as e:
            raise SpaceError(f"{path}: {e}") from None

    def to_json(self):
        """The space as a JSON string (what an actor file's metadata hold)."""
        return json.dumps(
            {
                "names": list(self.names),
                "low": self.low.tolist(),
                "high": self.high.tolist(),
                "integer": self.integer.tolist(),
                "theta0": self.theta0.tolist(),
            }
        )

    def _check(self, vector, what):
        if vector.shape[-1:] != (len(self.names),):
            raise SpaceError(f"{what} vector has shape {vector.shape}: {len(self.names)} values are needed")
        if not np.all(np.isfinite(vector)):
            bad = np.argwhere(~np.isfinite(vector))[0]
            raise SpaceError(f"{what} {self.names[bad[-1]]} is {vector[tuple(bad)]}: refused, not finite")


# ranges in the authors' final code; what else is to say of each parameter stands in planner/parameters
_RANGES = {
    "max_vel_x": (0.2, 2.0),
    "max_vel_theta": (0.314, 3.14),
    "vx_samples": (4, 20),
    "vtheta_samples": (4, 60),
    "occdist_scale": (0.05, 1.0),
    "pdist_scale": (0.1, 1.5),
    "gdist_scale": (0.1, 2.0),
    "inflation_radius": (0.1, 0.6),
}


def _declared(server, name):
    """The declaration of a parameter known to `server` under `name` or an alias."""
    return next(p for p in SERVERS[server] if name == p.name or name in p.aliases)


def _server(name):
    return ROLES["local_inflation"] if name == "inflation_radius" else ROLES["planner"]


def _targets(name):
    if name == "inflation_radius":
        return (Target("local_inflation", (name,)), Target("global_inflation", (name,)))
    declared = _declared(_server(name), name)
    targets: Tuple[Target, ...] = (Target("planner", (declared.name,) + declared.aliases),)
    if name == "max_vel_theta":  # the planner takes the other direction apart: the same speed, mirrored
        targets += (Target("planner", ("min_vel_theta",), -1.0),)
    return targets


def _space():
    declared = [_declared(_server(name), name) for name in _RANGES]
    low, high = np.array(list(_RANGES.values()), dtype=np.float64).T
    integer = np.array([p.type == "int" for p in declared])
    theta0 = np.array([p.value for p in declared], dtype=np.float64)
    low, high = low.copy(), high.copy()
    for array in (low, high, integer, theta0):
        array.setflags(write=False)
    return Space(tuple(_RANGES), low, high, integer, theta0, {name: _targets(name) for name in _RANGES})


SPACE = _space()
THETA_0 = SPACE.theta0
