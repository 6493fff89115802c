"""Parameter space of APPLR: planner parameters theta that a policy sets, ranges and theta_0.

`space_of` makes it from a robot's description. Names, ranges and servers are in its robot.yaml,
theta_0 in its parameter files, types and bounds in the planner's declarations. SPACE is the
Jackal's space, and `SPACE.chosen` its subspace of the paper's eight parameters.

A parameter may set several values, to which the robot's files may give different numbers. At its
value in theta_0, the parameter leaves each of them as the files have it. At any other value, it
sets all of them to the same number, but for the inflation of the global costmap: no number that is
set lets plans lead through a gap that is narrower than the robot.
"""

from dataclasses import dataclass, field, replace
from functools import cached_property, lru_cache
from typing import Any, Dict, List, Mapping, NamedTuple, Optional, Tuple

import numpy as np

from applr_ros1 import robots
from applr_ros1.common import files
from applr_ros1.common.arguments import number_within
from applr_ros1.common.arrays import Array
from applr_ros1.common.errors import ApplrError, shown
from applr_ros1.planner.costmap.footprint import passing_radius
from applr_ros1.planner.parameters import obstacle_range
from applr_ros1.planner.parameters.layers import COSTMAPS
from applr_ros1.planner.parameters.parameter import Parameter, by_name
from applr_ros1.planner.parameters.settings import Change, Settings
from applr_ros1.planner.parameters.trees import Tree, Values
from applr_ros1.robots import Robot
from applr_ros1.robots.check import space_errors
from applr_ros1.robots.robot import Target

# Values of a local planner that limit its speed, and that max_speed of the nodes limits in turn.
# TrajectoryPlannerROS drives at min_vel_x even if max_vel_x is lower.
SPEED_LIMITS = ("max_vel_x", "max_vel_trans", "min_vel_x")

GLOBAL_COSTMAP, _ = COSTMAPS
INFLATION_RADIUS = "inflation_radius"


class ParameterSet(NamedTuple):
    """Parameter set from a file.

    Attributes:
        theta: Parameters (n,), with distance biases per costmap cell.
        obstacle_range: Range [m] up to which lasers mark obstacles, None for the range in the
            robot's files (decision.Method).
    """

    theta: Array
    obstacle_range: Optional[float] = None


def obstacle_range_of(metadata: Mapping[str, Any]) -> Optional[float]:
    """Return the obstacle range [m] that a parameter set or a policy file asks for, or None.

    Raise ApplrError if it is no range.
    """
    if metadata.get(obstacle_range.NAME) is None:
        return None
    return float(number_within(obstacle_range.NAME, metadata[obstacle_range.NAME], 0.1, 200.0))


@dataclass(frozen=True)
class Space:
    """Box-shaped space of n planner parameters.

    Attributes:
        names: Names of the parameters; the paper's names for the Jackal.
        low: (n,) smallest values, in each parameter's own unit.
        high: (n,) largest values.
        integer: (n,) bool, True for sample counts.
        theta0: (n,) default parameters of the robot, with which its move_base starts.
        targets: {parameter: addresses of the values of move_base that it sets}. A parameter is read
            back from its first address.
        defaults: Values at all addresses in the robot's files, which may lie outside the ranges.
        global_costmap: Parameters of the global costmap in the robot's files.
        robot: Name of the robot.
        fixed: Names of the parameters that policies in the paper's encoding do not choose.
    """

    names: Tuple[str, ...]
    low: Array
    high: Array
    integer: Array
    theta0: Array
    targets: Dict[str, Tuple[Target, ...]] = field(default_factory=dict)
    defaults: Settings = field(default_factory=lambda: Settings({}))
    global_costmap: Values = field(default_factory=dict)
    robot: str = "jackal"
    fixed: Tuple[str, ...] = ()

    def __len__(self) -> int:
        return len(self.names)

    @cached_property
    def chosen(self) -> "Space":
        """Subspace that policies in the paper's encoding choose: eight for the Jackal."""
        chosen_indices = self._chosen_at
        chosen_names = tuple(self.names[index] for index in chosen_indices)
        return replace(
            self,
            names=chosen_names,
            low=self.low[chosen_indices],
            high=self.high[chosen_indices],
            integer=self.integer[chosen_indices],
            theta0=self.theta0[chosen_indices],
            targets={name: self.targets.get(name, ()) for name in chosen_names},
            fixed=(),
        )

    @cached_property
    def _chosen_at(self) -> List[int]:
        return [index for index, name in enumerate(self.names) if name not in self.fixed]

    def chosen_of(self, theta: Any) -> Array:
        """Return the parameters (..., k) that a method may choose out of parameters (..., n).

        They are those of the subspace `chosen`; fill() is the way back.
        """
        return np.asarray(theta, dtype=np.float64)[..., self._chosen_at]

    def fill(self, values: Any) -> Array:
        """Return parameters (n,): the subspace `chosen` from `values` (k,), others from theta_0."""
        theta = self.theta0.copy()
        theta[self._chosen_at] = values
        return theta

    @cached_property
    def sets_speed(self) -> Array:
        """(n,) bool, True for parameters that set one of SPEED_LIMITS."""
        sets_speed = np.zeros(len(self.names), dtype=bool)
        for parameter_index, target in self.addresses:
            if target.name in SPEED_LIMITS:
                sets_speed[parameter_index] = True
        return sets_speed

    def below(self, max_speed: float) -> "Space":
        """Return the space whose speeds, the robot's defaults included, are at most `max_speed`."""
        highest = np.where(self.sets_speed, max_speed, np.inf)
        changes = []
        for parameter_index, target in self.addresses:
            default = self.defaults[target.server][target.name]
            limited = target.signed(min(target.signed(default), float(highest[parameter_index])))
            changes.append(Change(target.server, target.name, default, limited))
        return replace(
            self,
            high=np.minimum(self.high, highest),
            theta0=np.minimum(self.theta0, highest),
            defaults=self.defaults.with_(*changes),
        )

    def clip(self, theta: Any) -> Array:
        """Return the nearest parameters (n,) float64 inside the ranges, with counts rounded.

        Raises ApplrError if the length is wrong or a value is not finite.
        """
        clipped_values = np.clip(self._checked(theta, "parameter"), self.low, self.high)
        # After clipping: the bounds of a count are whole numbers.
        return np.where(self.integer, np.rint(clipped_values), clipped_values)

    def to_theta(self, action: Any) -> Array:
        """Return the parameters (n,) float64 for an action (n,) in [-1, 1].

        They are scaled to the ranges, with counts rounded.

        Raises ApplrError if the length is wrong or a value is not finite.
        """
        action = np.clip(self._checked(action, "action"), -1.0, 1.0)
        return self.clip(self.low + 0.5 * (action + 1.0) * (self.high - self.low))

    def to_action(self, theta: Any) -> Array:
        """Return the action (n,) float64 in [-1, 1] for parameters.

        Values beyond the ranges are clipped.
        """
        range_shares = (self._checked(theta, "parameter") - self.low) / (self.high - self.low)
        return np.clip(2.0 * range_shares - 1.0, -1.0, 1.0)

    def as_dict(self, theta: Any) -> Dict[str, float]:
        """Return the parameters (n,) as {name: value}, with counts as int."""
        parameters = {}
        for name, value, is_count in zip(self.names, theta, self.integer):
            # dynamic_reconfigure refuses a float for an int_t, and numpy's types.
            parameters[name] = int(value) if is_count else float(value)
        return parameters

    def from_dict(self, values: Values) -> Array:
        """Return the parameters (n,) for {name: value} after a range check.

        Missing names are taken from theta_0.
        """
        theta = self.theta0.copy()
        for name, value in values.items():
            if name not in self.names:
                raise ApplrError(f"unknown parameter {shown(name)}: use {', '.join(self.names)}")
            index = self.names.index(name)
            theta[index] = number_within(
                f"parameter {name}",
                value,
                self.low[index],
                self.high[index],
            )
        return self.clip(theta)

    @cached_property
    def addresses(self) -> List[Tuple[int, Target]]:
        """All values that the space sets: (index of the parameter in theta, address)."""
        addresses = []
        for parameter_index, parameter_name in enumerate(self.names):
            for target in self.targets[parameter_name]:
                addresses.append((parameter_index, target))
        return addresses

    @property
    def servers(self) -> Tuple[str, ...]:
        """Unique names of the servers that hold the parameters, in their order."""
        return tuple(dict.fromkeys(target.server for _, target in self.addresses))

    def settings(self, theta: Any) -> Settings:
        """Return the values that parameters (n,) set: a request per server.

        Those of theta_0 are the robot's defaults.

        Args:
            theta: Parameters (n,) within the ranges, as the Pilot limits them.
        """
        return self.settings_of(self.as_dict(theta))

    def settings_of(self, values: Values) -> Settings:
        """Return the values that some parameters {name: value} set."""
        settings: Dict[str, Tree] = {}
        for parameter_index, target in self.addresses:
            name = self.names[parameter_index]
            if name not in values:
                continue
            value = target.signed(values[name])
            if values[name] == self.theta0[parameter_index]:
                value = self.defaults[target.server][target.name]
            settings.setdefault(target.server, {})[target.name] = value
        self._keep_plans_passable(settings)
        return Settings(settings)

    def _keep_plans_passable(self, settings: Dict[str, Tree]) -> None:
        """Raise the inflation of the global costmap to the smallest one that plans need.

        The radius of the robot's files stays. That of the local costmap may be smaller, since the
        local planner checks the whole footprint.
        """
        global_costmap = {**self.global_costmap, **settings.get(GLOBAL_COSTMAP, {})}
        for server, values in settings.items():
            if not server.startswith(f"{GLOBAL_COSTMAP}/") or INFLATION_RADIUS not in values:
                continue
            radius = values[INFLATION_RADIUS]
            if radius != self.defaults[server][INFLATION_RADIUS]:
                values[INFLATION_RADIUS] = max(radius, passing_radius(global_costmap))

    def read_back(self, settings: Settings) -> Array:
        """Return the parameters (n,) float64 that are in force in the settings of the servers."""
        server_values = []
        for parameter_name in self.names:
            # The other targets of a parameter follow the first one.
            target = self.targets[parameter_name][0]
            server_values.append(settings[target.server][target.name])
        return np.array(server_values, dtype=np.float64)

    def read(self, path: Any) -> ParameterSet:
        """Read a JSON file with a parameter set.

        It holds {name: value}, or {"parameters": {name: value}, ...}.

        Missing names have their values in theta_0. `"obstacle_range"` beside the parameters is the
        range with which it drives.
        """
        with files.reading(path):
            content = files.read_json(path)
            theta = self.from_dict(content.get("parameters", content))
            needed_range = obstacle_range_of(content)
            return ParameterSet(theta, needed_range)

    def to_dict(self) -> Dict[str, Any]:
        """Return the space as JSON values for a policy's file and an evaluation's settings."""
        return {
            "names": list(self.names),
            "low": self.low.tolist(),
            "high": self.high.tolist(),
            "integer": self.integer.tolist(),
            "theta0": self.theta0.tolist(),
        }

    @classmethod
    def from_metadata(cls, values: Mapping[str, Any], robot: str) -> "Space":
        """Make a space from the values of to_dict. It has no targets and cannot make requests."""
        return cls(
            names=tuple(map(str, values["names"])),
            low=np.array(values["low"], dtype=np.float64),
            high=np.array(values["high"], dtype=np.float64),
            integer=np.array(values["integer"], dtype=bool),
            theta0=np.array(values["theta0"], dtype=np.float64),
            robot=str(robot),
        )

    def _checked(self, numbers: Any, kind: str) -> Array:
        """Return numbers (..., n) as float64.

        Raise ApplrError if n is wrong or a number is not finite.
        """
        vector = np.asarray(numbers, dtype=np.float64)
        if vector.shape[-1:] != (len(self.names),):
            raise ApplrError(
                f"{kind} vector has shape {vector.shape}: {len(self.names)} values are needed"
            )
        if not np.all(np.isfinite(vector)):
            array_index = np.argwhere(~np.isfinite(vector))[0]
            raise ApplrError(
                f"{kind} {self.names[array_index[-1]]} is {vector[tuple(array_index)]}, not finite"
            )
        return vector


@lru_cache(maxsize=32)
def space_of(robot: Robot) -> Space:
    """Return the parameter space of a robot.

    Raises ApplrError if its move_base does not accept the space.
    """
    for error_message in space_errors(robot, robot.all_parameters()):
        # Only the first error is reported.
        raise ApplrError(f"robot {robot.name}: {error_message}")
    return unchecked_space(robot)


@lru_cache(maxsize=32)
def unchecked_space(robot: Robot) -> Space:
    """Return the parameter space of a robot whose parameters may lie outside it.

    A robot with recorded values has them as they were, whatever its space allows.
    """
    tree = robot.all_parameters()
    bounds = []
    integer = []
    theta0 = []
    targets = {}
    defaults: Dict[str, Tree] = {}
    fixed_names = []
    for parameter in robot.space:
        bounds.append((parameter.low, parameter.high))
        integer.append(parameter.integer)
        theta0.append(parameter.sets[0].value_in(tree))
        targets[parameter.name] = parameter.sets
        for target in parameter.sets:
            defaults.setdefault(target.server, {})[target.name] = target.value_in(tree)
        if not parameter.paper:
            fixed_names.append(parameter.name)
    # A robot without parameters for policies has an empty space.
    lowest, highest = np.array(bounds, dtype=np.float64).reshape(-1, 2).T
    space = Space(
        names=tuple(targets),
        low=lowest,
        high=highest,
        integer=np.array(integer),
        theta0=np.array(theta0, dtype=np.float64),
        targets=targets,
        defaults=Settings(defaults),
        global_costmap=tree[GLOBAL_COSTMAP],
        robot=robot.name,
        fixed=tuple(fixed_names),
    )
    # All users of the robot share this space.
    for array in (space.low, space.high, space.integer, space.theta0):
        array.setflags(write=False)
    return space


def declaration(robot: Robot, name: str) -> Parameter:
    """Return the planner's declaration of a parameter of a robot's space: unit, bounds, meaning."""
    # The first target declares the parameter; the others follow it.
    target = space_of(robot).targets[name][0]
    return by_name(robot.servers[target.server].parameters)[target.name]


SPACE = space_of(robots.JACKAL)
THETA_0 = SPACE.theta0
