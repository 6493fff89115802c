"""Sources of a robot's local costmap: the laser that is replayed, and what is not."""

from __future__ import annotations

from typing import List, NamedTuple

from applr_ros1.common.trees import branch
from applr_ros1.planner.parameters.layers import (
    OBSTACLE_LAYER,
    PREDICTED,
    TYPES,
    layers,
    marking_lasers,
    sources,
)
from applr_ros1.robots import Robot


class CostmapSources(NamedTuple):
    """Topics of the lasers of a local costmap, and other sources and layers, with their layers."""

    lasers: List[str]
    others: List[str]


def sources_in(robot: Robot) -> CostmapSources:
    """Return what the local costmap of a robot sees."""
    costmap = branch(robot.all_parameters(), "local_costmap")
    lasers = []
    others = []
    layer_names = []
    for layer in layers("local_costmap", costmap, OBSTACLE_LAYER):
        layer_names.append(layer.name)
        section = branch(costmap, layer.name)
        laser_names = marking_lasers(section)
        for source_name in sources(section):
            topic = str(branch(section, source_name).get("topic", source_name))
            if source_name in laser_names and topic not in lasers[1:]:
                lasers.append(topic)
            elif topic not in (PREDICTED, *lasers):
                others.append(f"{topic} ({layer.name})")
    for entry in costmap.get("plugins", ()):
        if entry["type"] not in TYPES and entry["name"] not in layer_names:
            others.append(f"{entry['name']} ({entry['type']})")
    return CostmapSources(lasers, others)
