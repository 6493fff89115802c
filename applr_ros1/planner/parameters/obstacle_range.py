"""How far from a laser its points mark obstacles in the costmaps, and its rays clear them.

move_base reads both ranges once, at its start. A robot's files have those of its maker; a parameter
set or a policy may be made for others (policy.decision.Method.obstacle_range). Uses only the
standard library.
"""

from __future__ import annotations

import math
from typing import Dict, List, NamedTuple

from applr_ros1.planner.parameters.costmap_parameters import STATIC_SOURCE
from applr_ros1.planner.parameters.layers import (
    COSTMAPS,
    OBSTACLE_LAYER,
    arranged,
    layers,
    marking_lasers,
    section_in_files,
)
from applr_ros1.planner.parameters.parameter import by_name
from applr_ros1.planner.parameters.trees import Tree, branch

NAME = "obstacle_range"
DECLARED = by_name(STATIC_SOURCE)[NAME]
# How much farther rays clear than points mark [m], as in the files of the included robots.
CLEARED_BEYOND_M = 0.5


class LaserSource(NamedTuple):
    """Observation source of a costmap in which a laser marks and clears.

    Attributes:
        path: Its section, such as "local_costmap/obstacles_layer/scan".
        obstacle_range: Range below which its points mark obstacles [m].
    """

    path: str
    obstacle_range: float


def laser_sources(tree: Tree) -> List[LaserSource]:
    """Return the sources of both costmaps in which a laser marks and clears.

    Args:
        tree: Nested parameters of move_base, complete or not.

    Raises:
        ParameterError: The layers of a costmap cannot be read (layers.layers).
    """
    found_sources = []
    full = arranged(tree)
    for costmap in COSTMAPS:
        for layer in layers(costmap, branch(full, costmap), OBSTACLE_LAYER):
            for source_name in marking_lasers(layer.values):
                obstacle_range = layer.values[source_name].get(NAME, DECLARED.default)
                if not DECLARED.reads(obstacle_range):
                    obstacle_range = DECLARED.default  # as roscpp; parameters.check warns
                path = f"{layer.path}/{source_name}"
                found_sources.append(LaserSource(path, float(obstacle_range)))
    return found_sources


def ranges(obstacle_range: float) -> Dict[str, float]:
    """Return the two values of a source that marks obstacles up to a range [m]."""
    return {NAME: obstacle_range, "raytrace_range": obstacle_range + CLEARED_BEYOND_M}


def seeing(tree: Tree, obstacle_range: float) -> Tree:
    """Return the nested parameters with which the lasers of a tree mark up to a range [m].

    They are to be loaded after the tree. Errors are those of laser_sources.
    """
    parameters: Tree = {}
    for source in laser_sources(tree):
        section = branch(parameters, section_in_files(tree, source.path), create=True)
        section.update(ranges(obstacle_range))
    return parameters


def mismatch(tree: Tree, needed: float, reason: str) -> str:
    """Return in one line which lasers mark up to another range than needed [m]; "" if none does.

    Args:
        tree: As for laser_sources, whose errors are raised.
        needed: Range that is needed [m].
        reason: Who needs it, in words.
    """
    others = []
    for source in laser_sources(tree):
        if not math.isclose(source.obstacle_range, needed, rel_tol=1e-3):
            others.append(source)
    if not others:
        return ""
    places = " and ".join(f"{source.path}/{NAME}" for source in others)
    present = " and ".join(dict.fromkeys(f"{source.obstacle_range:g}" for source in others))
    lines = ", ".join(f"{name}: {value:g}" for name, value in ranges(needed).items())
    return f"{places}: obstacles are marked up to {present} m, but {reason}; give {lines}"
