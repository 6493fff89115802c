"""The action space of APPLR: the planner parameters theta that a policy sets, their ranges and theta_0.

`space_of` makes it from a robot's description: names, ranges and servers stand in its robot.yaml, theta_0 in its
parameter files, types and bounds in the planner's declarations. SPACE is the Jackal's; `SPACE.chosen` are the paper's
eight parameters of it.
"""

from dataclasses import dataclass, field, replace
from functools import cached_property, lru_cache
from typing import Dict, Tuple

import numpy as np

from applr_ros1 import robots
from applr_ros1.common import files
from applr_ros1.common.arguments import number_within
from applr_ros1.common.errors import ApplrError
from applr_ros1.common.trees import branch
from applr_ros1.robots.check import space_errors
from applr_ros1.robots.robot import Setting


@dataclass(frozen=True)
class Space:
    """A box of n planner parameters.

    Attributes:
        names: What the parameters are called; for the Jackal the paper's names.
        low: (n,) smallest values, in each parameter's own unit.
        high: (n,) largest values.
        integer: (n,) bool, True for sample counts.
        theta0: (n,) the robot's own values, with which its move_base starts.
        targets: Which servers' values each parameter sets; the first one is where it is read back.
        robot: Name of the robot that it belongs to.
        fixed: Those that policies in the paper's encoding do not choose.
    """

    names: Tuple[str, ...]
    low: np.ndarray
    high: np.ndarray
    integer: np.ndarray
    theta0: np.ndarray
    targets: Dict[str, Tuple[Setting, ...]] = field(default_factory=dict)
    robot: str = "jackal"
    fixed: Tuple[str, ...] = ()

    def __len__(self):
        return len(self.names)

    @cached_property
    def chosen(self):
        """The Space of the parameters that policies in the paper's encoding choose: eight for the Jackal."""
        at, names = self._chosen_at, tuple(name for name in self.names if name not in self.fixed)
        targets = {name: self.targets.get(name, ()) for name in names}
        rows = (self.low[at], self.high[at], self.integer[at], self.theta0[at])
        return Space(names, *rows, targets, self.robot)

    @cached_property
    def _chosen_at(self):
        return [i for i, name in enumerate(self.names) if name not in self.fixed]

    def pick(self, theta):
        """The chosen (..., k) of parameters (..., n)."""
        return np.asarray(theta, dtype=np.float64)[..., self._chosen_at]

    def fill(self, values):
        """Parameters (n,) of the chosen ones (k,); the others have their values of theta_0."""
        theta = self.theta0.copy()
        theta[self._chosen_at] = values
        return theta

    def below(self, name, highest):
        """The Space in which one parameter, where there is such a one, is at most `highest`."""
        mine = np.array(self.names) == name
        return replace(self, high=np.where(mine, np.minimum(self.high, highest), self.high))

    def clip(self, theta):
        """The nearest parameters (n,) float64 inside the ranges, counts rounded to whole numbers.

        Raises ApplrError when the length is wrong or a value is not finite (1e9 is clipped, NaN is refused).
        """
        theta = np.asarray(theta, dtype=np.float64)
        self._check(theta, "parameter")
        theta = np.clip(theta, self.low, self.high)
        return np.where(self.integer, np.rint(theta), theta)

    def to_theta(self, action):
        """The parameters (n,) float64 for an action (n,) in [-1, 1]: scaled to the ranges, clipped, counts rounded.

        Raises ApplrError for NaN, inf and wrong lengths.
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

    def from_dict(self, values):
        """The parameters (n,) of {name: value}, which are checked; missing names are taken from theta_0."""
        theta = self.theta0.copy()
        for name, value in values.items():
            if name not in self.names:
                raise ApplrError(f"unknown parameter {name!r}: use {', '.join(self.names)}")
            i = self.names.index(name)
            theta[i] = number_within(f"parameter {name}", value, self.low[i], self.high[i])
        return self.clip(theta)

    @property
    def servers(self):
        """The servers of move_base that hold the parameters, each once, in the order of the parameters."""
        return tuple(dict.fromkeys(t.server for name in self.names for t in self.targets[name]))

    def targets_of(self, server):
        """[(index into theta, Setting), ...] of the values that a server holds."""
        return [(i, t) for i, name in enumerate(self.names) for t in self.targets[name] if t.server == server]

    def requests(self, theta):
        """One request for each of move_base's servers, {server: {name: value}}, for parameters (n,), clipped."""
        return self.requests_for(self.clip(theta))

    def requests_for(self, values):
        """The requests for values (n,) that may lie outside of the space's ranges (nodes/applr/meter_scoring.py)."""
        values = list(self.as_dict(values).values())
        return {
            server: {t.name: -values[i] if t.negated else values[i] for i, t in self.targets_of(server)}
            for server in self.servers
        }

    def places(self):
        """[(server, name), ...]: where the value of each parameter of theta is read back from move_base."""
        return [(self.targets[name][0].server, self.targets[name][0].name) for name in self.names]

    def read(self, path):
        """Read a JSON file with a set: {name: value}, or {"parameters": {name: value}, ...}.

        Returns:
            The parameters (n,), of which names left out keep theta_0; and whether the file states
            `"meter_scoring": false`, as tune's do: its distance biases are meant per cell.
        """
        stated = files.read_json(path)
        values = stated.get("parameters", stated)
        try:
            return self.from_dict(values), stated.get("meter_scoring") is False
        except ApplrError as e:
            raise ApplrError(f"{path}: {e}") from None

    def to_dict(self):
        """The space as JSON values: what a policy's file and an evaluation's settings hold of it."""
        columns = {name: getattr(self, name).tolist() for name in ("low", "high", "integer", "theta0")}
        return {"names": list(self.names), **columns}

    @classmethod
    def from_metadata(cls, values, robot):
        """The space that a dict from to_dict describes; without targets, for it belongs to no move_base."""
        low, high, theta0 = (np.array(values[name], dtype=np.float64) for name in ("low", "high", "theta0"))
        integer, names = np.array(values["integer"], dtype=bool), tuple(map(str, values["names"]))
        return cls(names, low, high, integer, theta0, robot=str(robot))

    def _check(self, vector, what):
        if vector.shape[-1:] != (len(self.names),):
            raise ApplrError(f"{what} vector has shape {vector.shape}: {len(self.names)} values are needed")
        if not np.all(np.isfinite(vector)):
            bad = np.argwhere(~np.isfinite(vector))[0]
            raise ApplrError(f"{what} {self.names[bad[-1]]} is {vector[tuple(bad)]}: refused, not finite")


def are_in_force(values, configuration):
    """Return whether a server with this configuration {name: value} has {name: value}; then it is not to be called.

    C++ empties a costmap at every call of its server, whatever is asked for (Costmap2DROS::reconfigureCB).
    """
    return all(configuration.get(name) == value for name, value in values.items())


def send(requests, move_base):
    """Make requests {server: {name: value}} to a MoveBase, as the applr node does over ROS; {server: what is in force}.

    Servers whose values are in force are not called.
    """
    return {
        server: has if are_in_force(values, has) else move_base.reconfigure(server, values)
        for server, values, has in ((name, asked, move_base.configuration(name)) for name, asked in requests.items())
    }


@lru_cache(maxsize=32)
def space_of(robot):
    """The parameter space that a robots.Robot describes. Raises ApplrError for one that its move_base does not take."""
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
