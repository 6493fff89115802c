"""Candidates for a remedy: changes of values that can be set while move_base runs, and of values in its files."""

from __future__ import annotations

from typing import Any, Dict, Iterator, List, Mapping, NamedTuple, Sequence, Tuple

import numpy as np
from typing_extensions import override

from applr_ros1.common.files import yaml_value
from applr_ros1.common.trees import branch
from applr_ros1.planner.parameters.settings import Change, Settings
from applr_ros1.robots import Robot
from applr_ros1.robots.geometry import bounding_box

COSTMAPS = ("local_costmap", "global_costmap")
LEAST_CHANGE = 0.1  # smallest relative change that is tried
CPP_PADDING_M = 0.01  # default of the C++ costmap
CPP_RATE_HZ = 20.0  # default of the C++ move_base
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
        distinct = dict.fromkeys(map(str, self.changes))
        both = len(distinct) < len(self.changes)
        return ", ".join(distinct) + " in both costmaps" * both

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
    for change in changes:
        branch(tree, _section(robot, change.server), create=True)[change.name] = change.after
    return robot.with_parameters(tree, name)


def _section(robot: Robot, server: str) -> str:
    """Return where the files have the values of a server.

    Without a list of layers, a costmap makes its layers itself, from values beside its own.
    """
    costmap, _, layer = server.partition("/")
    if layer and "plugins" not in branch(robot.parameters(), costmap):
        return costmap
    return server


def recorded_changes(robot: Robot, settings: Settings) -> List[Change]:
    """Return what makes the robot's files equal to the settings of a drive."""
    in_files = Settings.from_tree(robot.all_parameters())
    changes = []
    for change in in_files.differences(settings):
        if change.after is not None and not isinstance(change.after, str):
            changes.append(change)
    return changes


def file_candidates(robot: Robot) -> List[Candidate]:
    """Return changes of values in the robot's files, those that depart most from the usual value first.

    Never less padding than C++'s default, nor a footprint smaller than the body.
    """
    tree = robot.all_parameters()
    found = [*_footprints(robot, tree), *_paddings(tree), *_ranges(tree)]
    found += [*_windows(tree), *_inflations(tree), *_rates(tree)]
    found.sort(key=lambda pair: -pair[0])
    return [candidate for _, candidate in found]


Rated = Tuple[float, Candidate]  # departure from the usual value as a logarithm, and the candidate


def _footprints(robot: Robot, tree: Dict[str, Any]) -> Iterator[Rated]:
    """Yield the outline of the body in place of a larger footprint."""
    back, front, right, left = bounding_box(robot)
    outline = [[back, right], [back, left], [front, left], [front, right]]
    changes = []
    excess = 0.0
    for costmap in COSTMAPS:
        footprint = yaml_value(tree[costmap].get("footprint", "[]"), "footprint")
        if len(footprint) < 3:
            continue
        size = np.ptp(np.array(footprint, float), axis=0)
        body = (front - back, left - right)
        beyond = float((size - body).max())
        if beyond > LARGER_M:
            excess = max(excess, float((size / body).max()))
            changes.append(Change(costmap, "footprint", str(footprint), str(outline)))
    if changes:
        length, width = front - back, left - right
        words = f"footprint -> the outline of the body, {length:.2f} x {width:.2f} m"
        yield float(np.log(excess)), Candidate(tuple(changes), words)


def _paddings(tree: Dict[str, Any]) -> Iterator[Rated]:
    """Yield C++'s padding in place of a larger one."""
    changes = []
    for costmap in COSTMAPS:
        padding = tree[costmap].get("footprint_padding", CPP_PADDING_M)
        if padding > CPP_PADDING_M:
            changes.append(Change(costmap, "footprint_padding", padding, CPP_PADDING_M))
    if changes:
        largest = max(change.before for change in changes)
        # A centimetre of padding weighs little in itself.
        yield float(np.log(1.0 + largest / 0.1)), Candidate(tuple(changes))


def _ranges(tree: Dict[str, Any]) -> Iterator[Rated]:
    """Yield C++'s ranges of obstacles and of clearing in place of shorter ones."""
    for name, usual in (("obstacle_range", 2.5), ("raytrace_range", 3.0)):
        changes = []
        for path, section in _sections_with(tree, name):
            if section[name] < usual:
                changes.append(Change(path, name, section[name], usual))
        if changes:
            smallest = min(change.before for change in changes)
            departure = float(np.log(usual / max(smallest, 0.01)))
            yield departure, Candidate(tuple(changes))


def _windows(tree: Dict[str, Any]) -> Iterator[Rated]:
    """Yield a larger local costmap."""
    local = tree["local_costmap"]
    changes = []
    for side in ("width", "height"):
        size = local[side]
        changes.append(Change("local_costmap", side, size, type(size)(2 * size)))
    yield 0.0, Candidate(tuple(changes))


def _inflations(tree: Dict[str, Any]) -> Iterator[Rated]:
    """Yield half of the inflation in both costmaps, for plans that keep too far from obstacles."""
    changes = []
    for path, section in _sections_with(tree, "inflation_radius"):
        radius = section["inflation_radius"]
        changes.append(Change(path, "inflation_radius", radius, radius / 2))
    if len(changes) > 1:
        largest = max(change.before for change in changes)
        yield abs(float(np.log(max(largest, 0.01) / 0.55))), Candidate(tuple(changes))


def _sections_with(
    tree: Dict[str, Any], name: str, path: str = ""
) -> Iterator[Tuple[str, Dict[str, Any]]]:
    """Yield the sections of a tree that have a number of a name."""
    if isinstance(tree.get(name), (int, float)):
        yield path, tree
    for key, value in tree.items():
        if isinstance(value, dict):
            yield from _sections_with(value, name, f"{path}/{key}".lstrip("/"))


def escape_candidates(server: str, values: Mapping[str, Any]) -> List[Candidate]:
    """Return both distances of an escape halved together: either of them alone ends it late.

    Args:
        server: Server of the local planner.
        values: Its values in force.
    """
    changes = []
    for name in ("escape_reset_dist", "escape_reset_theta"):
        if name in values:
            changes.append(Change(server, name, values[name], values[name] / 2))
    return [Candidate(tuple(changes))] if changes else []


def _rates(tree: Dict[str, Any]) -> Iterator[Rated]:
    """Yield C++'s control rate in place of a lower one."""
    rate = tree["controller_frequency"]
    if rate < CPP_RATE_HZ * (1.0 - LEAST_CHANGE):
        change = Change("", "controller_frequency", rate, CPP_RATE_HZ)
        yield float(np.log(CPP_RATE_HZ / max(rate, 0.1))), Candidate((change,))
