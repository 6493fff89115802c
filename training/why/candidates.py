"""Candidates for a remedy: changes of move_base's values, live and in files, worth a drive."""

from __future__ import annotations

from typing import Any, Dict, Iterator, List, Mapping, NamedTuple, Sequence, Tuple

import numpy as np
from typing_extensions import override

from applr_ros1.common.files import yaml_value
from applr_ros1.common.trees import branch
from applr_ros1.planner.parameters.costmap_parameters import COSTMAP, INFLATION, STATIC_SOURCE
from applr_ros1.planner.parameters.layers import section_in_files
from applr_ros1.planner.parameters.move_base_parameters import MOVE_BASE
from applr_ros1.planner.parameters.obstacle_range import laser_sources, ranges
from applr_ros1.planner.parameters.parameter import by_name
from applr_ros1.planner.parameters.settings import Change, Settings
from applr_ros1.policy import methods
from applr_ros1.robots import Robot
from applr_ros1.robots.check import SIGHT_S, crossed_limits
from applr_ros1.robots.geometry import Box, bounding_box
from applr_ros1.why.alternatives import LEAST_CHANGE

COSTMAPS = ("local_costmap", "global_costmap")
# Defaults of C++: of costmap, control rate, sources of an obstacle layer, and inflation layer
CPP_PADDING_M: float = by_name(COSTMAP)["footprint_padding"].default
CPP_RATE_HZ: float = by_name(MOVE_BASE)["controller_frequency"].default
CPP_OBSTACLE_RANGE_M: float = by_name(STATIC_SOURCE)["obstacle_range"].default
CPP_RAYTRACE_RANGE_M: float = by_name(STATIC_SOURCE)["raytrace_range"].default
CPP_INFLATION_M: float = by_name(INFLATION)["inflation_radius"].default
CPP_SCALING: float = by_name(INFLATION)["cost_scaling_factor"].default
UNUSUAL = 0.4  # logarithm of the ratio to the usual value from which on a value is unusual (1.5)
LARGER_M = 0.05  # excess of a footprint over the body from which on the body's outline is tried [m]


class Candidate(NamedTuple):
    """Changes that are tried together.

    Attributes:
        changes: The changes; the first one names the candidate.
        words: Words for people, if they are not those of the changes.
    """

    changes: Tuple[Change, ...]
    words: str = ""

    @override
    def __str__(self) -> str:
        if self.words:
            return self.words
        # The same change of both costmaps is said once.
        distinct = dict.fromkeys(map(str, self.changes))
        words = ", ".join(distinct)
        if len(distinct) < len(self.changes):
            words += " in both costmaps"
        return words

    @property
    def departure(self) -> float:
        """Largest ratio of values before and after."""
        return max(change.departure for change in self.changes)

    @property
    def names(self) -> List[str]:
        """Names of the changed parameters."""
        return list(dict.fromkeys(change.name for change in self.changes))


def with_changes(robot: Robot, changes: Sequence[Change], name: str) -> Robot:
    """Return the robot under another name, with changed values in its files."""
    tree: Dict[str, Any] = {}
    # Not all_parameters(): it gives every costmap a list of layers, whatever the files have.
    in_files = robot.parameters()
    for change in changes:
        section = branch(tree, section_in_files(in_files, change.server), create=True)
        section[change.name] = change.after
    return robot.with_parameters(tree, name)


def recorded_changes(robot: Robot, settings: Settings) -> List[Change]:
    """Return what makes the robot's files equal to the settings of a drive."""
    in_files = Settings.from_tree(robot.all_parameters())
    changes = []
    for change in in_files.differences(settings):
        # A server that the drive does not tell about keeps the files' values, and so do texts,
        # such as frames: they are not set while a robot drives.
        if change.after is not None and not isinstance(change.after, str):
            changes.append(change)
    return changes


class Rated(NamedTuple):
    """Candidate with its departure from the usual value, as the natural logarithm of a ratio."""

    departure: float
    candidate: Candidate


def _rated(ratio: float, changes: Sequence[Change], words: str = "") -> Rated:
    """Return changes as a candidate whose values depart by a ratio from the usual ones."""
    return Rated(float(np.log(ratio)), Candidate(tuple(changes), words))


def _values_before(changes: Sequence[Change]) -> List[float]:
    """Return the values that the changes replace."""
    return [change.before for change in changes]


def file_candidates(robot: Robot) -> List[Candidate]:
    """Return changes of unusual values in the robot's files, the most unusual ones first.

    Never less padding than C++'s default, nor a footprint smaller than the body.
    """
    tree = robot.all_parameters()
    rated_candidates = [
        *_footprints(robot, tree),
        *_paddings(tree),
        *_ranges(robot, tree),
        *_windows(tree),
        *_inflations(tree),
        *_scalings(tree),
        *_rates(tree),
        *_limits(robot.local_planner, tree),
    ]
    rated_candidates.sort(key=lambda rated: -rated.departure)
    unusual = []
    for rated in rated_candidates:
        # Another value in place of a usual one may help by chance, and explains nothing.
        if rated.departure >= UNUSUAL:
            unusual.append(rated.candidate)
    return unusual


def _footprints(robot: Robot, tree: Dict[str, Any]) -> Iterator[Rated]:
    """Yield the outline of the body in place of a larger footprint."""
    box = bounding_box(robot)
    body = np.array([box.front - box.back, box.left - box.right])
    changes = []
    largest_ratio = 0.0
    for costmap in COSTMAPS:
        footprint = yaml_value(tree[costmap].get("footprint", "[]"), "footprint")
        # Without a polygon, the footprint is a circle (robot_radius).
        if len(footprint) < 3:
            continue
        size = np.ptp(np.array(footprint, float), axis=0)
        excess = float((size - body).max())
        if excess > LARGER_M:
            ratio = float((size / body).max())
            largest_ratio = max(largest_ratio, ratio)
            changes.append(Change(costmap, "footprint", str(footprint), str(_outline(box))))
    if changes:
        length, width = body.tolist()
        change_in_words = f"footprint -> the outline of the body, {length:.2f} x {width:.2f} m"
        yield _rated(largest_ratio, changes, change_in_words)


def _outline(box: Box) -> List[List[float]]:
    """Return the corners of a box as a footprint has them [m]."""
    return [
        [box.back, box.right],
        [box.back, box.left],
        [box.front, box.left],
        [box.front, box.right],
    ]


def _paddings(tree: Dict[str, Any]) -> Iterator[Rated]:
    """Yield C++'s padding in place of a larger one."""
    changes = []
    for costmap in COSTMAPS:
        padding = tree[costmap].get("footprint_padding", CPP_PADDING_M)
        if padding > CPP_PADDING_M:
            changes.append(Change(costmap, "footprint_padding", padding, CPP_PADDING_M))
    if changes:
        # A ratio of paddings says little, because the usual one is so small: 10 cm count as twice.
        ratio = 1.0 + max(_values_before(changes)) / 0.1
        yield _rated(ratio, changes)


def _ranges(robot: Robot, tree: Dict[str, Any]) -> Iterator[Rated]:
    """Yield the usual ranges of obstacles and of clearing in place of shorter ones.

    They are C++'s. Obstacles are marked for at least SIGHT_S at the base's top speed, because a
    dead end that is marked late is entered, and as far as the robot's set or policy asks. Rays
    clear what is marked.
    """
    sight = min(SIGHT_S * robot.base.max_speed, robot.laser.range_max)
    usual_range = max(CPP_OBSTACLE_RANGE_M, sight, *methods.obstacle_ranges(robot))
    usual_ranges = {
        "obstacle_range": ranges(usual_range),
        "raytrace_range": {"raytrace_range": CPP_RAYTRACE_RANGE_M},
    }
    for parameter_name, usual_values in usual_ranges.items():
        changes = []
        for source in laser_sources(tree):
            section = branch(tree, source.path)
            if section[parameter_name] >= usual_values[parameter_name]:
                continue
            for name, usual_value in usual_values.items():
                if section[name] < usual_value:
                    changes.append(Change(source.path, name, section[name], usual_value))
        if changes:
            # A range of 0 has no ratio.
            departures = [change.after / max(change.before, 0.01) for change in changes]
            yield _rated(max(departures), changes)


def _windows(tree: Dict[str, Any]) -> Iterator[Rated]:
    """Yield a local costmap of twice the size."""
    local_costmap = tree["local_costmap"]
    changes = []
    for side in ("width", "height"):
        size = local_costmap[side]
        changes.append(Change("local_costmap", side, size, type(size)(2 * size)))
    # A smaller window than this lacks obstacles that the laser layers would take up.
    usual_size = 2.0 * CPP_OBSTACLE_RANGE_M
    smallest = max(min(_values_before(changes)), 0.1)
    yield _rated(max(1.0, usual_size / smallest), changes)


def _inflations(tree: Dict[str, Any]) -> Iterator[Rated]:
    """Yield half of the inflation in both costmaps, for plans that keep too far from obstacles."""
    changes = []
    for section_path, section in _sections_with(tree, "inflation_radius"):
        radius = section["inflation_radius"]
        changes.append(Change(section_path, "inflation_radius", radius, radius / 2))
    # The inflation of one costmap alone is among the changes that the replay ranks.
    if len(changes) > 1:
        ratio = max(*_values_before(changes), 0.01) / CPP_INFLATION_M
        # A smaller inflation than the usual one departs from it as well.
        yield _rated(max(ratio, 1.0 / ratio), changes)


def _scalings(tree: Dict[str, Any]) -> Iterator[Rated]:
    """Yield C++'s decline of the inflation in both costmaps in place of a slower one.

    With a slow decline, costs are high all over narrow places, and plans prefer any other way.
    """
    changes = []
    for section_path, section in _sections_with(tree, "cost_scaling_factor"):
        factor = section["cost_scaling_factor"]
        if factor < CPP_SCALING:
            changes.append(Change(section_path, "cost_scaling_factor", factor, CPP_SCALING))
    if len(changes) > 1:
        smallest = max(min(_values_before(changes)), 0.1)
        yield _rated(CPP_SCALING / smallest, changes)


def _sections_with(
    tree: Dict[str, Any], name: str, path: str = ""
) -> Iterator[Tuple[str, Dict[str, Any]]]:
    """Yield the sections of a tree that have a number of a name."""
    if isinstance(tree.get(name), (int, float)):
        yield path, tree
    for section_name, section in tree.items():
        if isinstance(section, dict):
            yield from _sections_with(section, name, f"{path}/{section_name}".lstrip("/"))


def escape_candidates(server: str, values: Mapping[str, Any]) -> List[Candidate]:
    """Return both distances of an escape halved together: either of them alone ends it late.

    Args:
        server: Server of the local planner.
        values: Its values in force.
    """
    changes = []
    for parameter_name in ("escape_reset_dist", "escape_reset_theta"):
        if parameter_name in values:
            in_force = values[parameter_name]
            changes.append(Change(server, parameter_name, in_force, in_force / 2))
    if not changes:
        return []
    return [Candidate(tuple(changes))]


def _rates(tree: Dict[str, Any]) -> Iterator[Rated]:
    """Yield C++'s control rate in place of a lower one."""
    rate = tree["controller_frequency"]
    if rate < CPP_RATE_HZ * (1.0 - LEAST_CHANGE):
        change = Change("", "controller_frequency", rate, CPP_RATE_HZ)
        yield _rated(CPP_RATE_HZ / max(rate, 0.1), [change])


def _limits(planner: str, tree: Dict[str, Any]) -> Iterator[Rated]:
    """Yield half of the largest value in place of a smallest value that exceeds it."""
    for limits in crossed_limits(planner, tree[planner]):
        if limits.consequence:
            smallest = tree[planner][limits.low]
            half = tree[planner][limits.high] / 2
            # The owner's largest value stays.
            change = Change(planner, limits.low, smallest, half)
            yield _rated(smallest / max(half, 0.01), [change])
