"""Sources of a robot's local costmap: the laser that is replayed, and what is not."""

from __future__ import annotations

from typing import List, NamedTuple

from applr_ros1.planner.parameters.layers import (
    PREDICTED,
    layers,
    marking_lasers,
)
from applr_ros1.robots import Robot


class CostmapSources(NamedTuple):
    """Topic of the first laser of a local costmap, if any, and other topics with their layers."""

    lasers: List[str]
    others: List[str]


def sources_in(robot: Robot) -> CostmapSources:
    """Return what the local costmap of a robot sees."""
    costmap = robot.all_parameters()["local_costmap"]
    known_layers = layers("local_costmap", costmap)
    lasers: List[str] = []
    others: List[str] = []
    for layer in known_layers:
        laser_names = marking_lasers(layer.values)
        for source_name in layer.sources:
            topic = str(layer.values[source_name]["topic"])
            if source_name in laser_names and not lasers:
                lasers.append(topic)
            elif topic not in (PREDICTED, *lasers):
                others.append(f"{topic} ({layer.name})")
    known_names = [layer.name for layer in known_layers]
    others += [entry["name"] for entry in costmap["plugins"] if entry["name"] not in known_names]
    return CostmapSources(lasers, others)
