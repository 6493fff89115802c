"""Parameter space of APPLR: the planner parameters theta that a policy sets, their ranges and theta_0.

`space_of` makes it from a robot's description. Names, ranges and servers are in its robot.yaml, theta_0 in its
parameter files, types and bounds in the planner's declarations. SPACE is the Jackal's space, and `SPACE.chosen` its
subspace of the paper's eight parameters.
"""

from dataclasses import dataclass, field, replace
from functools import cached_property, lru_cache
from typing import Any, Dict, List, Mapping, Tuple

import numpy as np

from applr_ros1 import robots
from applr_ros1.common import files
from applr_ros1.common.arguments import number_within
from applr_ros1.common.arrays import Array
from applr_ros1.common.errors import ApplrError
from applr_ros1.common.trees import branch
from applr_ros1.robots import Robot
from applr_ros1.robots.check import space_errors
from applr_ros1.robots.robot import Setting


@dataclass(frozen=True)
class Space:
    """Box-shaped space of n planner parameters.

    Attributes:
        names: Names of the parameters; the paper's names for the Jackal.
        low: (n,) smallest values, in each parameter's own unit.
        high: (n,) largest values.
        integer: (n,) bool, True for sample counts.
        theta0: (n,) default parameters of the robot, with which its move_base starts.
        targets: {parameter: settings of move_base that it sets}. A parameter is read back from its first setting.
        robot: Name of the robot.
        fixed: Names of the parameters that policies in the paper's encoding do not choose.
    """

    names: Tuple[str, ...]
    low: np.ndarray
    high: np.ndarray
    integer: np.ndarray
    theta0: np.ndarray
    targets: Dict[str, Tuple[Setting, ...]] = field(default_factory=dict)
    robot: str = "jackal"
    fixed: Tuple[str, ...] = ()

    def __len__(self) -> int:
        return len(self.names)

    @cached_property
    def chosen(self) -> "Space":
        """Subspace of the parameters that policies in the paper's encoding choose: eight for the Jackal."""
        at, names = self._chosen_at, tuple(name for name in self.names if name not in self.fixed)
        targets = {name: self.targets.get(name, ()) for name in names}
        rows = (self.low[at], self.high[at], self.integer[at], self.theta0[at])
        return Space(names, *rows, targets, self.robot)

    @cached_property
    def _chosen_at(self) -> List[int]:
        return [i for i, name in enumerate(self.names) if name not in self.fixed]

    def pick(self, theta: Any) -> Array:
        """Return the parameters (..., k) of the subspace `chosen` out of parameters (..., n)."""
        chosen: Array = np.asarray(theta, dtype=np.float64)[..., self._chosen_at]
        return chosen

    def fill(self, values: Any) -> Array:
        """Return parameters (n,): those of the subspace `chosen` from `values` (k,), the others from theta_0."""
        theta = self.theta0.copy()
        theta[self._chosen_at] = values
        return theta

    def below(self, name: str, highest: float) -> "Space":
        """Return the space with one parameter limited to `highest`. Unknown names change nothing."""
        mine = np.array(self.names) == name
        return replace(self, high=np.where(mine, np.minimum(self.high, highest), self.high))

    def clip(self, theta: Any) -> Array:
        """Return the nearest parameters (n,) float64 inside the ranges, with counts rounded.

        Raises ApplrError if the length is wrong or a value is not finite.
        """
        inside: Array = np.clip(self._checked(theta, "parameter"), self.low, self.high)
        return np.where(self.integer, np.rint(inside), inside)

    def to_theta(self, action: Any) -> Array:
        """Return the parameters (n,) float64 for an action (n,) in [-1, 1], scaled to the ranges, with counts rounded.

        Raises ApplrError if the length is wrong or a value is not finite.
        """
        action = np.clip(self._checked(action, "action"), -1.0, 1.0)
        return self.clip(self.low + 0.5 * (action + 1.0) * (self.high - self.low))

    def to_action(self, theta: Any) -> Array:
        """Return the action (n,) float64 in [-1, 1] for parameters. Values beyond the ranges are clipped."""
        shares = (self._checked(theta, "parameter") - self.low) / (self.high - self.low)
        action: Array = np.clip(2.0 * shares - 1.0, -1.0, 1.0)
        return action

    def as_dict(self, theta: Any) -> Dict[str, float]:
        """Return the parameters (n,) as {name: value}, with counts as int."""
        return {
            name: int(value) if whole else float(value) for name, value, whole in zip(self.names, theta, self.integer)
        }

    def from_dict(self, values: Mapping[str, Any]) -> Array:
        """Return the parameters (n,) for {name: value} after a range check. Missing names are taken from theta_0."""
        theta = self.theta0.copy()
        for name, value in values.items():
            if name not in self.names:
                raise ApplrError(f"unknown parameter {name!r}: use {', '.join(self.names)}")
            i = self.names.index(name)
            theta[i] = number_within(f"parameter {name}", value, self.low[i], self.high[i])
        return self.clip(theta)

    @property
    def servers(self) -> Tuple[str, ...]:
        """Unique names of the move_base servers that hold the parameters, in the order of the parameters."""
        return tuple(dict.fromkeys(t.server for name in self.names for t in self.targets[name]))

    def targets_of(self, server: str) -> List[Tuple[int, Setting]]:
        """Return [(index into theta, Setting), ...] for the values of a server."""
        return [(i, t) for i, name in enumerate(self.names) for t in self.targets[name] if t.server == server]

    def requests(self, theta: Any) -> Dict[str, Dict[str, Any]]:
        """Return one request for each move_base server, {server: {name: value}}, for parameters (n,), clipped."""
        values = list(self.as_dict(self.clip(theta)).values())
        return {
            server: {t.name: -values[i] if t.negated else values[i] for i, t in self.targets_of(server)}
            for server in self.servers
        }

    def places(self) -> List[Tuple[str, str]]:
        """Return [(server, name), ...] of the settings from which each parameter of theta is read back."""
        return [(self.targets[name][0].server, self.targets[name][0].name) for name in self.names]

    def read(self, path: Any) -> Tuple[np.ndarray, bool]:
        """Read a JSON file with a parameter set: {name: value}, or {"parameters": {name: value}, ...}.

        Returns:
            The parameters (n,), with theta_0 for missing names; and whether the distance biases are per costmap cell,
            which a file states by `"meter_scoring": false`.
        """
        content = files.read_json(path)
        values = content.get("parameters", content)
        try:
            return self.from_dict(values), content.get("meter_scoring") is False
        except ApplrError as e:
            raise ApplrError(f"{path}: {e}") from None

    def to_dict(self) -> Dict[str, Any]:
        """Return the space as JSON values for a policy's file and an evaluation's settings."""
        columns = {name: getattr(self, name).tolist() for name in ("low", "high", "integer", "theta0")}
        return {"names": list(self.names), **columns}

    @classmethod
    def from_metadata(cls, values: Mapping[str, Any], robot: str) -> "Space":
        """Make a space from the values of to_dict. It has no targets and cannot make requests."""
        low, high, theta0 = (np.array(values[name], dtype=np.float64) for name in ("low", "high", "theta0"))
        integer, names = np.array(values["integer"], dtype=bool), tuple(map(str, values["names"]))
        return cls(names, low, high, integer, theta0, robot=str(robot))

    def _checked(self, numbers: Any, kind: str) -> Array:
        """Return numbers (..., n) as float64. Raise ApplrError if n is wrong or a number is not finite."""
        vector: Array = np.asarray(numbers, dtype=np.float64)
        if vector.shape[-1:] != (len(self.names),):
            raise ApplrError(f"{kind} vector has shape {vector.shape}: {len(self.names)} values are needed")
        if not np.all(np.isfinite(vector)):
            bad = np.argwhere(~np.isfinite(vector))[0]
            raise ApplrError(f"{kind} {self.names[bad[-1]]} is {vector[tuple(bad)]}, not finite")
        return vector


def are_in_force(values: Mapping[str, Any], configuration: Mapping[str, Any]) -> bool:
    """Return whether a server's configuration {name: value} already has these values, so that no call is needed.

    Needless calls are harmful: C++ clears a costmap at every call of its server (Costmap2DROS::reconfigureCB).
    """
    return all(configuration.get(name) == value for name, value in values.items())


def send(requests: Mapping[str, Mapping[str, Any]], move_base: Any) -> Dict[str, Any]:
    """Send requests {server: {name: value}} to a MoveBase, and return the current configuration of each server.

    Like the applr node over ROS, it does not call servers that already have the values.
    """
    return {
        server: has if are_in_force(values, has) else move_base.reconfigure(server, values)
        for server, values, has in ((name, asked, move_base.configuration(name)) for name, asked in requests.items())
    }


@lru_cache(maxsize=32)
def space_of(robot: Robot) -> Space:
    """Return the parameter space of a robot. Raises ApplrError if its move_base does not accept the space."""
    tree = robot.all_parameters()
    for line in space_errors(robot, tree):
        raise ApplrError(f"robot {robot.name}: {line}")
    theta0 = [branch(tree, p.sets[0].server)[p.sets[0].name] for p in robot.space]
    low, high = ([getattr(parameter, bound) for parameter in robot.space] for bound in ("low", "high"))
    arrays = [np.array(column, dtype=np.float64) for column in (low, high, theta0)]
    integer = np.array([parameter.integer for parameter in robot.space])
    for array in (*arrays, integer):
        array.setflags(write=False)
    targets = {parameter.name: parameter.sets for parameter in robot.space}
    fixed = tuple(parameter.name for parameter in robot.space if not parameter.paper)
    return Space(tuple(targets), arrays[0], arrays[1], integer, arrays[2], targets, robot.name, fixed)


SPACE = space_of(robots.JACKAL)
THETA_0 = SPACE.theta0
