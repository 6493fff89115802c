"""Changes of single parameters, and of two weights, for a robot that fails on open floor.

A value that is unlike every usual one is the likeliest cause of a failure, whichever parameter has
it. Therefore usual values of such parameters are tried first, the most unusual parameter ahead,
then changes that free most robots, and at last usual values of all other parameters.
"""

from __future__ import annotations

from itertools import chain, islice
from typing import Any, Dict, Iterable, Iterator, List, Mapping, NamedTuple, Tuple

from applr_ros1.planner.parameters.declarations import tables
from applr_ros1.planner.parameters.layers import section_in_files
from applr_ros1.planner.parameters.settings import Change
from applr_ros1.robots import Robot
from applr_ros1.robots.robot import SpaceParameter, Target
from training.robot.usual_values import ParameterPlace, UsualValues, places_of
from training.why.candidates import UNUSUAL, Candidate, Rated

# Weights of DWAPlannerROS and TrajectoryPlannerROS that only count in proportion to each other
BIASES = ("path_distance_bias", "goal_distance_bias")
# Changes that are tried if no unusual value tells more: (parameter of the robot's
# space, factor on its value), in the order of the attempts. The first ones free most robots.
FACTORS = (
    ("occdist_scale", 0.1),
    ("occdist_scale", 0.01),
    ("sim_time", 1.5),
    ("sim_time", 0.6),
    ("max_vel_x", 0.5),
    ("goal_distance_bias", 3.0),
    ("path_distance_bias", 0.3),
    ("vx_samples", 3.0),
)
MOST_CHANGES = 40  # largest number of changes; a drive of some seconds takes place for each


class InSpace(NamedTuple):
    """Parameter of the robot's space, and one of the addresses that it sets.

    Attributes:
        parameter: Parameter of the space, with its range.
        target: Address of a value that follows it, perhaps with the opposite sign.
    """

    parameter: SpaceParameter
    target: Target

    def read(self, value: Any) -> Any:
        """Return the parameter's number for a value at the address."""
        return self.target.signed(value)

    def written(self, number: Any) -> Any:
        """Return the value at the address for a number, which is kept within the range."""
        within = min(max(number, self.parameter.low), self.parameter.high)
        return self.target.signed(within)


RangeByPlace = Dict[Tuple[str, str], InSpace]  # by server and name
PlaceGroup = List[ParameterPlace]  # places that change together


def single_candidates(robot: Robot) -> Iterator[Candidate]:
    """Yield at most MOST_CHANGES changes of a single parameter, the likeliest remedy first.

    A parameter may stand in several places, which change together. So do both BIASES.
    """
    space: RangeByPlace = {}
    for parameter in robot.space:
        for target in parameter.sets:
            space[target.server, target.name] = InSpace(parameter, target)
    groups: Dict[Tuple[str, Any], PlaceGroup] = {}
    for place in places_of(robot):
        groups.setdefault(_key(space, place), []).append(place)
    group_by_name = {}
    for group in groups.values():
        group_by_name.update(dict.fromkeys([place.name for place in group], group))

    usual_values = UsualValues(robot)
    unusual = []
    others = []
    for rated in _usual_instead(space, groups.values(), usual_values):
        if rated.departure >= UNUSUAL:
            unusual.append(rated.candidate)
        else:
            others.append(rated.candidate)
    weights = _weights_of_robots(space, group_by_name, usual_values)
    frequent = _frequent_remedies(space, group_by_name)
    in_order = chain(unusual, weights, frequent, others)
    # Several rules may ask for the same change.
    yield from islice(dict.fromkeys(in_order), MOST_CHANGES)


def advice_of(robot: Robot, candidate: Candidate) -> str:
    """Return all changes of a candidate as an instruction for the robot's files.

    Each parameter is called by its latest name.
    """
    in_files = robot.parameters()
    declarations = tables(robot.all_parameters())
    instructions = []
    for change in candidate.changes:
        latest_names = {declared.name for declared in declarations[change.server]}
        if change.name in latest_names:
            section = section_in_files(in_files, change.server)
            instructions.append(change._replace(server=section).advice)
    return " and ".join(instructions)


def _weights_of_robots(
    space: RangeByPlace, groups: Mapping[str, PlaceGroup], usual_values: UsualValues
) -> Iterator[Candidate]:
    """Yield the BIASES of each included robot with the same local planner."""
    for weights in zip(*(usual_values.of_robots[name] for name in BIASES)):
        changes: List[Change] = []
        for name, weight in zip(BIASES, weights):
            changes += _changes(space, groups[name], weight)
        if changes:
            yield Candidate(tuple(changes))


def _frequent_remedies(
    space: RangeByPlace, groups: Mapping[str, PlaceGroup]
) -> Iterator[Candidate]:
    """Yield changes that free most robots, whether their values are usual or not."""
    for name, factor in FACTORS:
        value = float(f"{factor * groups[name][0].value:.2g}")
        changes = tuple(_changes(space, groups[name], value))
        if changes:
            yield Candidate(changes)


def _usual_instead(
    space: RangeByPlace, groups: Iterable[PlaceGroup], usual_values: UsualValues
) -> List[Rated]:
    """Return changes to usual values, those of the most unusual parameter first."""
    rated_candidates = []
    for group in groups:
        first = group[0]
        departure = usual_values.departure(first)
        for usual_value in usual_values.to_try(first):
            changes = tuple(_changes(space, group, usual_value))
            if changes:
                rated_candidates.append(Rated(departure, Candidate(changes)))
    rated_candidates.sort(key=lambda rated: -rated.departure)
    return rated_candidates


def _key(space: RangeByPlace, place: ParameterPlace) -> Tuple[str, Any]:
    """Return what places have in common that change together.

    They belong to the same parameter, such as a radius in both costmaps, and have the same value.
    """
    in_space = space.get((place.server, place.name))
    if in_space is None:
        return place.name, place.value
    return in_space.parameter.name, in_space.read(place.value)


def _changes(space: RangeByPlace, group: PlaceGroup, usual_value: Any) -> Iterator[Change]:
    """Yield the changes that give a usual value of the first place to a group of places."""
    first = group[0]
    first_in_space = space.get((first.server, first.name))
    number = first_in_space.read(usual_value) if first_in_space else usual_value
    for place in group:
        in_space = space.get((place.server, place.name))
        value = in_space.written(number) if in_space else number
        # A number of samples stays whole.
        value = type(place.value)(value)
        if value != place.value:
            # Older names have the same value.
            for name in place.declared.names:
                yield Change(place.server, name, place.value, value)
