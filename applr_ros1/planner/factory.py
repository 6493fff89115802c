"""Factory of the costmaps and the local planner of MoveBase, from move_base's parameters. Called by move_base.py."""

from __future__ import annotations

from typing import Any, Callable, Dict

import numpy as np

from applr_ros1.common.scan import Source
from applr_ros1.planner.costmap import footprint
from applr_ros1.planner.costmap.costmap import Costmap, LayerDescription
from applr_ros1.planner.costmap.grid import FREE, UNKNOWN
from applr_ros1.planner.costmap.inflation_layer import InflationParameters
from applr_ros1.planner.costmap.obstacle_layer import ObstacleParameters
from applr_ros1.planner.costmap.static_layer import StaticParameters
from applr_ros1.planner.dwa.local_planner import DWALocalPlanner
from applr_ros1.planner.local_planner import LocalPlanner
from applr_ros1.planner.parameters.configuration import Configuration
from applr_ros1.planner.parameters.declarations import namespace
from applr_ros1.planner.parameters.layers import (
    INFLATION_LAYER,
    STATIC_LAYER,
    Layer,
    layers,
    sources,
)
from applr_ros1.planner.trajectory.local_planner import TrajectoryLocalPlanner

LOCAL_PLANNERS: Dict[str, Callable[[Dict[str, Any], np.ndarray], LocalPlanner]] = {
    "base_local_planner/TrajectoryPlannerROS": TrajectoryLocalPlanner,
    "dwa_local_planner/DWAPlannerROS": lambda params, footprint: DWALocalPlanner(params),
}


def make_local_planner(full: Dict[str, Any], config: Configuration) -> LocalPlanner:
    """Return the local planner named by base_local_planner, with the current values.

    Parameters that a planner reads only once, like TrajectoryPlannerROS's footprint, have their start-up values.

    Args:
        full: complete parameter tree.
        config: current configuration.
    """
    plugin = full["base_local_planner"]
    place = namespace(plugin)
    latches = (
        full["latch_xy_goal_tolerance"]
        if place == "DWAPlannerROS"
        else full[place]["latch_xy_goal_tolerance"]
    )
    begun = config.start_up(place)
    outline = footprint.padded(config.start_up("local_costmap"))
    planner = LOCAL_PLANNERS[plugin](
        dict(full[place], **begun, latch_xy_goal_tolerance=latches), outline
    )
    if config[place] != begun:
        planner.reconfigure(config[place])
    return planner


def make_costmap(name: str, static: Dict[str, Any], config: Configuration) -> Costmap:
    """Return an empty costmap with the layers listed in its parameters.

    Args:
        name: "local_costmap" or "global_costmap".
        static: branch of this costmap in the complete parameter tree.
        config: current configuration.
    """
    now = config[name]
    return Costmap(
        now["width"],
        now["height"],
        now["resolution"],
        (now["origin_x"], now["origin_y"]),
        rolling=static["rolling_window"],
        footprint=footprint.padded(now),
        track_unknown=static.get("track_unknown_space", False),
        layers=[
            _describe(layer, static[layer.name], config[layer.path])
            for layer in layers(name, static)
        ],
    )


def _describe(layer: Layer, static: Dict[str, Any], now: Dict[str, Any]) -> LayerDescription:
    """Return the description of a layer, from its branch of the complete tree and its current values."""
    if layer.kind == INFLATION_LAYER:
        return LayerDescription(layer.name, InflationParameters(**now))
    if layer.kind == STATIC_LAYER:
        return LayerDescription(layer.name, StaticParameters(**dict(static, **now)))
    made = [Source(**static[name]) for name in sources(static)]
    default = UNKNOWN if static["track_unknown_space"] else FREE
    return LayerDescription(layer.name, ObstacleParameters(**now), made, default)
