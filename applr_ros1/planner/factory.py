"""Factory of MoveBase's costmaps and local planner, from the parameters of move_base."""

from __future__ import annotations

from typing import Callable, Dict

import numpy as np

from applr_ros1.common.scan import Source
from applr_ros1.planner.costmap import footprint
from applr_ros1.planner.costmap.costmap import Costmap, Layer
from applr_ros1.planner.costmap.grid import FREE, UNKNOWN
from applr_ros1.planner.costmap.inflation_layer import InflationLayer, InflationParameters
from applr_ros1.planner.costmap.obstacle_layer import ObstacleLayer, ObstacleParameters
from applr_ros1.planner.costmap.static_layer import StaticLayer, StaticParameters
from applr_ros1.planner.dwa.local_planner import DWALocalPlanner
from applr_ros1.planner.local_planner import LocalPlanner
from applr_ros1.planner.parameters.configuration import Configuration
from applr_ros1.planner.parameters.declarations import namespace
from applr_ros1.planner.parameters.layers import (
    INFLATION_LAYER,
    STATIC_LAYER,
    LayerSection,
    layers,
)
from applr_ros1.planner.parameters.trees import Tree, Values
from applr_ros1.planner.trajectory.local_planner import TrajectoryLocalPlanner

LOCAL_PLANNERS: Dict[str, Callable[[Tree, np.ndarray], LocalPlanner]] = {
    "base_local_planner/TrajectoryPlannerROS": TrajectoryLocalPlanner,
    # DWAPlannerROS takes the footprint from the costmap in each cycle.
    "dwa_local_planner/DWAPlannerROS": lambda params, footprint: DWALocalPlanner(params),
}


def make_local_planner(full: Tree, config: Configuration) -> LocalPlanner:
    """Return the local planner named by base_local_planner, with the current values.

    Parameters that a planner reads only once, like TrajectoryPlannerROS's footprint, have their
    start-up values.

    Args:
        full: complete parameter tree.
        config: current configuration.
    """
    plugin = full["base_local_planner"]
    server = namespace(plugin)
    parameters = dict(full[server])
    # In C++, DWAPlannerROS reads this parameter from move_base's own namespace.
    if server == "DWAPlannerROS":
        parameters["latch_xy_goal_tolerance"] = full["latch_xy_goal_tolerance"]
    outline = footprint.padded(full["local_costmap"])
    planner = LOCAL_PLANNERS[plugin](parameters, outline)
    # After a reset that keeps the parameters, values changed at run time differ from these.
    if config[server] != config.start_up[server]:
        planner.reconfigure(config[server])
    return planner


def make_costmap(name: str, static: Tree, config: Configuration) -> Costmap:
    """Return an empty costmap with the layers listed in its parameters.

    Args:
        name: "local_costmap" or "global_costmap".
        static: branch of this costmap in the complete parameter tree.
        config: current configuration.
    """
    current = config[name]
    costmap_layers = [_make_layer(layer, config[layer.path]) for layer in layers(name, static)]
    # A costmap has its own track_unknown_space only if the files give one (check.complete).
    track_unknown = static.get("track_unknown_space", False)
    return Costmap(
        current["width"],
        current["height"],
        current["resolution"],
        (current["origin_x"], current["origin_y"]),
        rolling=static["rolling_window"],
        footprint=footprint.padded(current),
        track_unknown=track_unknown,
        layers=costmap_layers,
    )


def _make_layer(layer: LayerSection, current: Values) -> Layer:
    """Return a layer of a costmap.

    Args:
        layer: section of the layer in the complete parameter tree.
        current: current values of its server.
    """
    static = layer.values
    if layer.kind == INFLATION_LAYER:
        return InflationLayer(layer.name, InflationParameters(**current))
    if layer.kind == STATIC_LAYER:
        return StaticLayer(layer.name, StaticParameters(**dict(static, **current)))
    return ObstacleLayer(
        layer.name,
        ObstacleParameters(**current),
        [Source(**static[name]) for name in layer.sources],
        UNKNOWN if static["track_unknown_space"] else FREE,
    )
