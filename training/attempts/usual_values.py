"""Usual values of move_base's parameters, and how far a robot's own values are from them.

Usual values are the declared default, those of the included robots and the limits of the base.
Numbers and flags of move_base itself, of the local planner and of the inflation layers are
compared; the other values of a costmap depend on sensors and surroundings.
"""

from __future__ import annotations

import math
from typing import Any, Dict, List, NamedTuple, Sequence, Tuple

from applr_ros1.planner.parameters.declarations import tables
from applr_ros1.planner.parameters.layers import INFLATION_LAYER, layers
from applr_ros1.planner.parameters.parameter import Parameter
from applr_ros1.planner.parameters.settings import Change, ratio_of
from applr_ros1.planner.parameters.trees import branch
from applr_ros1.robots import NAMES, Robot, load
from applr_ros1.robots.robot import Base
from applr_ros1.why.factors import FUTILE

# A change of both is named by the local one, which the replay of a local planner knows.
COSTMAPS = ("local_costmap", "global_costmap")
UNUSUAL = 0.4  # logarithm of the ratio to the usual value from which on a value is unusual (1.5)
GOAL_TOLERANCE = 0.2  # tolerance of the goal that is tried [m, rad]


class ParameterPlace(NamedTuple):
    """Place of a number or flag among the parameters of move_base.

    Attributes:
        server: Section below move_base; "" is move_base itself.
        declared: Declaration of the parameter.
        value: Value in force, in the declared unit.
    """

    server: str
    declared: Parameter
    value: Any

    @property
    def name(self) -> str:
        """Latest name of the parameter."""
        return self.declared.name

    @property
    def address(self) -> Tuple[str, str]:
        """Server and name."""
        return self.server, self.name


def places_of(robot: Robot) -> List[ParameterPlace]:
    """Return the numbers and flags of move_base itself, local planner and inflation layers."""
    tree = robot.all_parameters()
    servers = ["", robot.local_planner]
    for costmap in COSTMAPS:
        for layer in layers(costmap, tree[costmap], INFLATION_LAYER):
            servers.append(layer.path)
    declarations = tables(tree)
    places = []
    for server in servers:
        section = branch(tree, server)
        for declared in declarations[server]:
            value = section.get(declared.name)
            # Flags are numbers in Python.
            if isinstance(value, (int, float)) and declared.name not in FUTILE:
                places.append(ParameterPlace(server, declared, value))
    return places


def departure(value: Any, usual_value: Any) -> float:
    """Return the absolute logarithm of the ratio of two values; inf if they have no ratio.

    Flags, zeros and values of opposite signs have none.
    """
    if value == usual_value:
        return 0.0
    if isinstance(value, bool):
        return math.inf
    return math.log(ratio_of(value, usual_value))


def _limits(base: Base) -> Dict[str, float]:
    """Return the limits of a base for parameters of the kinds "speed" and "turn"."""
    return {"speed": base.max_speed, "turn": base.max_yaw_rate}


class UsualValues:
    """Usual values of the parameters of one robot.

    Args:
        robot: Robot whose base limits the speeds, and whose local planner is compared.

    Attributes:
        of_robots: Values of the included robots by name, in the same order for every parameter of
            the local planner. Speeds are for a base with this robot's limits.
    """

    def __init__(self, robot: Robot):
        base = robot.base
        self._robot = robot
        self._largest = _limits(base)
        # Limits that the planner may know from the base, by name [m/s^2, rad/s^2]
        self._of_base = {
            "acc_lim_x": base.max_acceleration,
            "acc_lim_theta": base.max_yaw_acceleration,
        }
        # Parameters of which one value is tried: the base has no speed sideways, and a goal must be
        # reachable.
        self._only = {
            "max_vel_y": 0.0,
            "min_vel_y": 0.0,
            "yaw_goal_tolerance": GOAL_TOLERANCE,
            "xy_goal_tolerance": GOAL_TOLERANCE,
        }
        self.of_robots: Dict[str, List[Any]] = {}
        for robot_name in NAMES:
            included = load(robot_name)
            limits = _limits(included.base)
            for place in places_of(included):
                value = place.value
                kind = place.declared.kind
                if kind in limits:
                    value *= self._largest[kind] / limits[kind]
                # Parameters of another local planner have the same names and other meanings.
                is_of_planner = place.server == included.local_planner
                if not is_of_planner or included.local_planner == robot.local_planner:
                    self.of_robots.setdefault(place.name, []).append(value)

    def support(self, changes: Sequence[Change]) -> float:
        """Return how many usual values are near the new values: the fewest of any parameter.

        Of other values of a costmap, none but usual ones are tried: the result is inf.
        """
        new_values = {(change.server, change.name): change.after for change in changes}
        counts = []
        for place in places_of(self._robot):
            new_value = new_values.get(place.address)
            if new_value is not None:
                departures = [departure(new_value, known) for known in self._known(place)]
                counts.append(sum(ratio < UNUSUAL for ratio in departures))
        return min(counts, default=math.inf)

    def departure(self, place: ParameterPlace) -> float:
        """Return the departure of a value from the nearest usual one."""
        return min(departure(place.value, known) for known in self._known(place))

    def to_try(self, place: ParameterPlace) -> List[Any]:
        """Return the values to try instead of one, the nearest first.

        Those that are nearly equal are tried once. Speeds stay within the limits of the base.
        """
        if place.name in self._only:
            return [self._only[place.name]]
        largest = self._largest.get(place.declared.kind, math.inf)
        distinct: List[Any] = []
        for value in self._known(place):
            if abs(value) > largest:
                value = math.copysign(largest, value)
            if all(departure(value, other) >= UNUSUAL for other in distinct):
                distinct.append(value)
        return sorted(distinct, key=lambda value: departure(place.value, value))

    def _known(self, place: ParameterPlace) -> List[Any]:
        """Return the usual values: those of the base, the default, and the included robots'."""
        known = [place.declared.default, *self.of_robots.get(place.name, [])]
        if place.name in self._of_base:
            known.insert(0, self._of_base[place.name])
        # A planner may use all the speed of its base.
        if place.declared.kind in self._largest and place.name.startswith("max_"):
            known.append(self._largest[place.declared.kind])
        if place.name in self._only:
            known.append(self._only[place.name])
        return known
