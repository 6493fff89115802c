"""What else could be set in a robot: one list for everything that looks for a better value.

`./applr check` drives it on open floor, `./applr why` in the world that the laser saw, and
`./applr tune` searches in search_space(). None of them leaves the ranges of the robot's space.
applr_ros1/why/factors.py has what is never tried, and the values of each parameter;
applr_ros1/why/alternatives.py guesses from a replay alone.

A value that is unlike every usual one is the likeliest cause of a failure, whichever parameter has
it. Therefore usual values of such parameters come first, the most unusual parameter ahead, then
changes that free most robots, and at last those of all other parameters. Of one parameter, the
nearest value comes first.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any, Callable, Dict, Iterable, Iterator, List, NamedTuple, Sequence, Tuple

import numpy as np
from typing_extensions import override

from applr_ros1.common.files import yaml_value
from applr_ros1.planner.parameters import obstacle_range
from applr_ros1.planner.parameters.costmap_parameters import COSTMAP, STATIC_SOURCE
from applr_ros1.planner.parameters.layers import section_in_files
from applr_ros1.planner.parameters.obstacle_range import laser_sources, ranges
from applr_ros1.planner.parameters.parameter import by_name
from applr_ros1.planner.parameters.settings import Change, in_words
from applr_ros1.planner.parameters.trees import branch
from applr_ros1.policy import methods
from applr_ros1.policy.parameter_space import Space
from applr_ros1.robots import Robot
from applr_ros1.robots.check import SIGHT_S, crossed_limits
from applr_ros1.robots.geometry import box_outline
from applr_ros1.robots.robot import SpaceParameter, Target
from applr_ros1.why.factors import values_to_try
from training.attempts.loaded import loadable_space
from training.attempts.usual_values import (
    COSTMAPS,
    UNUSUAL,
    ParameterPlace,
    UsualValues,
    departure,
    places_of,
)

# Defaults of C++: of costmap, and of sources of an obstacle layer
CPP_PADDING_M: float = by_name(COSTMAP)["footprint_padding"].default
CPP_OBSTACLE_RANGE_M: float = by_name(STATIC_SOURCE)["obstacle_range"].default
CPP_RAYTRACE_RANGE_M: float = by_name(STATIC_SOURCE)["raytrace_range"].default
RANGE_BOUNDS_M = 1.0, 8.0  # bounds of a search for the obstacle range, for the Jackal's size [m]
LARGER_M = 0.05  # excess of a footprint over the body from which on the body's outline is tried [m]
WINDOW = ("width", "height")  # sides of a costmap
# Weights of DWAPlannerROS and TrajectoryPlannerROS that only count in proportion to each other
BIASES = ("path_distance_bias", "goal_distance_bias")
# Distances of an escape, of which either alone ends it late
ESCAPE = ("escape_reset_dist", "escape_reset_theta")
# Parameters whose other values free most robots, in the order of the attempts
FREQUENT = ("occdist_scale", "sim_time", "goal_distance_bias", "path_distance_bias", "vx_samples")


class Candidate(NamedTuple):
    """Changes that are tried together.

    Attributes:
        changes: The changes; the first one names the candidate.
        words: Words for people with an arrow, if they are not those of the changes.
        replaces_unusual: Whether they put a usual value in place of an unusual one, which may be
            the cause of a failure.
    """

    changes: Tuple[Change, ...]
    words: str = ""
    replaces_unusual: bool = False

    @override
    def __str__(self) -> str:
        if self.words:
            return self.words
        # The same change of both costmaps is said once.
        distinct = dict.fromkeys(map(str, self.changes))
        words = ", ".join(distinct)
        if len(distinct) < len(self.changes) and "costmap" in self.changes[-1].server:
            words += " in both costmaps"
        return words

    @property
    def before(self) -> str:
        """What is replaced, for people."""
        if self.words:
            return self.words.partition(" -> ")[0]
        named = [f"{change.name} {in_words(change.before)}" for change in self.changes]
        return ", ".join(dict.fromkeys(named))

    @property
    def departure(self) -> float:
        """Largest ratio of values before and after."""
        return max(change.departure for change in self.changes)

    @property
    def names(self) -> List[str]:
        """Names of the changed parameters."""
        return list(dict.fromkeys(change.name for change in self.changes))

    @property
    def new_values(self) -> Tuple[Tuple[Any, ...], ...]:
        """Server, name and new value of each change, whatever the values before."""
        return tuple((change.server, change.name, change.after) for change in self.changes)


def with_changes(robot: Robot, changes: Sequence[Change], name: str) -> Robot:
    """Return the robot under another name, with changed values in its files."""
    tree: Dict[str, Any] = {}
    # Not all_parameters(): it gives every costmap a list of layers, whatever the files have.
    in_files = robot.parameters()
    for change in changes:
        section = branch(tree, section_in_files(in_files, change.server), create=True)
        section[change.name] = change.after
    return robot.with_parameters(tree, name)


class Rated(NamedTuple):
    """Candidate with its departure from the usual value, as the natural logarithm of a ratio."""

    departure: float
    candidate: Candidate


def _sorted(rated_candidates: Iterable[Rated]) -> List[Rated]:
    """Return candidates, those that depart most from usual values first."""
    return sorted(rated_candidates, key=lambda rated: -rated.departure)


def _rated(ratio: float, changes: Sequence[Change], words: str = "") -> Rated:
    """Return changes as a candidate whose values depart by a ratio from the usual ones."""
    return Rated(float(np.log(ratio)), Candidate(tuple(changes), words))


def advice_of(robot: Robot, candidate: Candidate) -> str:
    """Return all changes of a candidate as an instruction for the robot's files."""
    in_files = robot.parameters()
    instructions = []
    for change in candidate.changes:
        section = section_in_files(in_files, change.server)
        instructions.append(change._replace(server=section).advice)
    return " and ".join(instructions)


def search_space(robot: Robot) -> Space:
    """Return the space of a search.

    `chosen` are the parameters that can be loaded (loadable_space) and, as the last one, the
    obstacle range, which move_base reads only at its start. The range is left out if the robot's
    files have none for a laser, or several, or if its laser is too short for another.
    """
    space = loadable_space(robot)
    sources = laser_sources(robot.parameters())
    ranges_in_files = {source.obstacle_range for source in sources}
    if len(ranges_in_files) != 1:
        return space
    (range_in_files,) = ranges_in_files
    nearest, farthest = (robot.world_scale * bound for bound in RANGE_BOUNDS_M)
    farthest = min(farthest, robot.laser.range_max)
    shortest_range = min(nearest, range_in_files)
    longest_range = max(farthest, range_in_files)
    if shortest_range >= longest_range:
        return space
    return replace(
        space,
        names=(*space.names, obstacle_range.NAME),
        low=np.append(space.low, shortest_range),
        high=np.append(space.high, longest_range),
        integer=np.append(space.integer, False),
        theta0=np.append(space.theta0, range_in_files),
        targets={**space.targets, obstacle_range.NAME: ()},
    )


PlaceGroup = List[ParameterPlace]  # places that change together


class GroupedPlaces:
    """Places of a robot's parameters, in groups that change together.

    A group belongs to one parameter, such as a radius in both costmaps, and has one value.

    Attributes:
        groups: All groups.
        by_name: The first group with each name.
    """

    def __init__(self, robot: Robot):
        # The robot's space by server and name of each value that it sets
        self._space: Dict[Tuple[str, str], Tuple[SpaceParameter, Target]] = {}
        for parameter in robot.space:
            for target in parameter.sets:
                self._space[target.server, target.name] = parameter, target
        groups: Dict[Tuple[str, Any], PlaceGroup] = {}
        self.by_name: Dict[str, PlaceGroup] = {}
        for place in places_of(robot):
            key = place.name, place.value
            if place.address in self._space:
                parameter, target = self._space[place.address]
                key = parameter.name, target.signed(place.value)
            group = groups.setdefault(key, [])
            group.append(place)
            self.by_name.setdefault(place.name, group)
        self.groups = list(groups.values())

    def changed(self, group: PlaceGroup, value: Any) -> Tuple[Change, ...]:
        """Return the changes that give a value of the first place to a group of places."""
        if group[0].address in self._space:
            _, target = self._space[group[0].address]
            value = target.signed(value)
        changes = []
        for place in group:
            new_value = value
            if place.address in self._space:
                parameter, target = self._space[place.address]
                new_value = target.signed(min(max(value, parameter.low), parameter.high))
            # A number of samples stays whole.
            new_value = type(place.value)(new_value)
            if new_value != place.value:
                changes.append(Change(*place.address, place.value, new_value))
        return tuple(changes)


class CandidateList(NamedTuple):
    """What else could be set in a robot, in the order of the attempts.

    Attributes:
        unusual: Usual values in place of unusual ones.
        others: Other values in place of usual ones, which may make up for the cause.
    """

    unusual: List[Candidate]
    others: List[Candidate]


def candidates_of(robot: Robot) -> CandidateList:
    """Return what else could be set in a robot.

    Never less padding than C++'s default, nor a footprint smaller than the body.
    """
    tree = robot.all_parameters()
    places = GroupedPlaces(robot)
    usual_values = UsualValues(robot)
    usual_instead = _usual_instead(places, usual_values)
    weights = _weights_of_robots(places, usual_values)
    rated_candidates = [
        *usual_instead,
        *weights,
        *_footprints(robot, tree),
        *_paddings(tree),
        *_ranges(robot, tree),
        *_windows(robot, tree),
        *_limits(robot.local_planner, tree),
    ]
    unusual = [rated.candidate for rated in _sorted(rated_candidates) if rated.departure >= UNUSUAL]
    others = [
        *(rated.candidate for rated in weights),
        *_factored(places, usual_values, [places.by_name[name] for name in FREQUENT]),
        *_escape(places),
        *(rated.candidate for rated in usual_instead),
        *_factored(places, usual_values, places.groups),
    ]
    # Several rules may ask for the same change, and for the value in force.
    tried = {Candidate(())}
    for listed in (unusual, others):
        listed[:] = [candidate for candidate in dict.fromkeys(listed) if candidate not in tried]
        tried.update(listed)
    unusual = [candidate._replace(replaces_unusual=True) for candidate in unusual]
    return CandidateList(unusual, others)


def mildest_first(robot: Robot) -> Callable[[Candidate], Tuple[float, float]]:
    """Return a key that sorts candidates of a robot that help equally.

    Values of most robots come first, then those nearest to the robot's own.
    """
    usual_values = UsualValues(robot)
    return lambda candidate: (-usual_values.support(candidate.changes), candidate.departure)


def _usual_instead(places: GroupedPlaces, usual_values: UsualValues) -> List[Rated]:
    """Return changes to usual values, those of the most unusual parameter first."""
    rated_candidates = []
    for group in places.groups:
        departure = usual_values.departure(group[0])
        for usual_value in usual_values.to_try(group[0]):
            candidate = Candidate(places.changed(group, usual_value))
            rated_candidates.append(Rated(departure, candidate))
    return _sorted(rated_candidates)


def _weights_of_robots(places: GroupedPlaces, usual_values: UsualValues) -> List[Rated]:
    """Return the BIASES of each included robot with the same local planner.

    They are as unusual as their ratio, although each of them may be usual.
    """
    groups = [places.by_name[name] for name in BIASES]
    path_bias, goal_bias = (group[0].value for group in groups)
    departures = []
    candidates = []
    for weights in zip(*(usual_values.of_robots[name] for name in BIASES)):
        changes: Tuple[Change, ...] = ()
        for group, weight in zip(groups, weights):
            changes += places.changed(group, weight)
        candidates.append(Candidate(changes))
        path_weight, goal_weight = weights
        departures.append(departure(path_bias * goal_weight, path_weight * goal_bias))
    return [Rated(min(departures), candidate) for candidate in candidates]


def _factored(
    places: GroupedPlaces, usual_values: UsualValues, groups: Iterable[PlaceGroup]
) -> Iterator[Candidate]:
    """Yield other values in place of usual ones. Unusual ones get usual values alone."""
    for group in groups:
        first = group[0]
        if usual_values.departure(first) >= UNUSUAL:
            continue
        for value in values_to_try(first.declared, first.value):
            yield Candidate(places.changed(group, value))


def _escape(places: GroupedPlaces) -> Iterator[Candidate]:
    """Yield both distances of an escape halved together."""
    changes: Tuple[Change, ...] = ()
    for group in filter(None, map(places.by_name.get, ESCAPE)):
        changes += places.changed(group, group[0].value / 2)
    yield Candidate(changes)


def _footprints(robot: Robot, tree: Dict[str, Any]) -> Iterator[Rated]:
    """Yield the outline of the body in place of a larger footprint."""
    outline = box_outline(robot)
    body = np.ptp(outline, axis=0)
    recorded = body
    changes = []
    for costmap in COSTMAPS:
        footprint = yaml_value(tree[costmap].get("footprint", "[]"), "footprint")
        # Without a polygon, the footprint is a circle (robot_radius).
        if len(footprint) >= 3:
            size = np.ptp(np.array(footprint, float), axis=0)
            if (size - body).max() > LARGER_M:
                recorded = np.maximum(recorded, size)
                changes.append(Change(costmap, "footprint", str(footprint), str(outline)))
    in_metres = "{:.2f} x {:.2f} m".format
    change_in_words = (
        f"footprint {in_metres(*recorded)} -> the outline of the body, {in_metres(*body)}"
    )
    yield _rated(float((recorded / body).max()), changes, change_in_words)


def _paddings(tree: Dict[str, Any]) -> Iterator[Rated]:
    """Yield C++'s padding in place of a larger one."""
    changes = []
    for costmap in COSTMAPS:
        padding = tree[costmap]["footprint_padding"]
        if padding > CPP_PADDING_M:
            changes.append(Change(costmap, "footprint_padding", padding, CPP_PADDING_M))
    # A ratio of paddings says little, because the usual one is so small: 10 cm count as twice.
    largest = max((change.before for change in changes), default=0.0)
    yield _rated(1.0 + largest / 0.1, changes)


def _ranges(robot: Robot, tree: Dict[str, Any]) -> Iterator[Rated]:
    """Yield the usual ranges of obstacles and of clearing in place of shorter ones.

    They are C++'s. Obstacles are marked for at least SIGHT_S at the base's top speed, because a
    dead end that is marked late is entered, and as far as the robot's set or policy asks. Rays
    clear what is marked.
    """
    sight = min(SIGHT_S * robot.base.max_speed, robot.laser.range_max)
    usual_range = max(CPP_OBSTACLE_RANGE_M, sight, *methods.obstacle_ranges(robot))
    for usual_values in (ranges(usual_range), {"raytrace_range": CPP_RAYTRACE_RANGE_M}):
        first_name = next(iter(usual_values))
        changes = []
        for source in laser_sources(tree):
            section = branch(tree, source.path)
            if section[first_name] < usual_values[first_name]:
                for name, usual_value in usual_values.items():
                    if section[name] < usual_value:
                        changes.append(Change(source.path, name, section[name], usual_value))
        # A range of 0 has no ratio.
        ratios = [change.after / max(change.before, 0.01) for change in changes]
        yield _rated(max(ratios, default=1.0), changes)


def _windows(robot: Robot, tree: Dict[str, Any]) -> Iterator[Rated]:
    """Yield a local costmap of twice the size."""
    local_costmap = tree["local_costmap"]
    sizes = [local_costmap[side] for side in WINDOW]
    changes = []
    for side, size in zip(WINDOW, sizes):
        changes.append(Change("local_costmap", side, size, 2 * size))
    # A smaller window than this lacks obstacles that the laser layers would take up.
    usual_size = 2.0 * CPP_OBSTACLE_RANGE_M * robot.world_scale
    width, height = sizes
    change_in_words = f"local costmap {width:g} x {height:g} -> {2 * width:g} x {2 * height:g} m"
    yield _rated(usual_size / max(min(sizes), 0.1), changes, change_in_words)


def _limits(planner: str, tree: Dict[str, Any]) -> Iterator[Rated]:
    """Yield half of the largest value in place of a smallest value that exceeds it."""
    values = tree[planner]
    for limits in crossed_limits(planner, values):
        if limits.consequence:
            smallest = values[limits.low]
            half = values[limits.high] / 2
            # The owner's largest value stays.
            change = Change(planner, limits.low, smallest, half)
            yield _rated(smallest / max(half, 0.01), [change])
