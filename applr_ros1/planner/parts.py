"""Makes MoveBase's costmaps from its parameters. Called by move_base.py."""

from __future__ import annotations

from typing import Any, Dict

import numpy as np

from applr_ros1.planner.costmap import footprint
from applr_ros1.planner.costmap.costmap import Costmap
from applr_ros1.planner.costmap.inflation_layer import InflationParameters
from applr_ros1.planner.costmap.obstacle_layer import ObstacleParameters


def make_costmap(name: str, static: Dict[str, Any], config) -> Costmap:
    """An empty map with its two layers.

    Args:
        name: "local_costmap" or "global_costmap".
        static: its branch of the complete parameter tree.
        config: the Configuration in force.
    """
    now, source = config[name], static["obstacles_layer"]["scan"]
    obstacles = ObstacleParameters(
        obstacle_range=source["obstacle_range"],
        raytrace_range=source["raytrace_range"],
        source_min_height=source["min_obstacle_height"],
        source_max_height=source["max_obstacle_height"],
        marking=source["marking"],
        clearing=source["clearing"],
        **config[name + "/obstacles_layer"],
    )
    return Costmap(
        now["width"],
        now["height"],
        now["resolution"],
        (now["origin_x"], now["origin_y"]),
        rolling=static["rolling_window"],
        footprint=padded_footprint(now),
        track_unknown=static["track_unknown_space"],
        obstacles=obstacles,
        inflation=InflationParameters(**config[name + "/inflater_layer"]),
    )


def padded_footprint(values: Dict[str, Any]) -> np.ndarray:
    """The padded outline (n, 2) [m] of one costmap's server values; a circle where no footprint is given."""
    outline = footprint.parse(values["footprint"])
    if len(outline) < 3:
        outline = footprint.circle(values["robot_radius"])
    return footprint.pad(outline, values["footprint_padding"])
