"""Compilation, or loading from disk, of every numba kernel of the planner before it drives.

The move_base node calls it before it reports that it is ready, and benchmarks call it before they
measure. The first start on a machine takes about a minute, later ones a few seconds.
common/kernel_cache.py documents the cache's location.
"""

from __future__ import annotations

from typing import Dict

import numpy as np

from applr_ros1.common.scan import LaserScan, Observation, SensorCloud
from applr_ros1.planner.move_base import MoveBase
from applr_ros1.planner.parameters.declarations import LOCAL_PLANNERS
from applr_ros1.planner.parameters.layers import PREDICTED

# vertices of the throw-away robot's footprint [m]
FOOTPRINT = "[[0.2, 0.2], [-0.2, 0.2], [-0.2, -0.2], [0.2, -0.2]]"


def warm_up(base_local_planner: str = LOCAL_PLANNERS[0]) -> None:
    """Exercise all functions of a throw-away MoveBase with this local planner.

    It drives with a laser and predicted obstacle points. Its parameters change on the way, as under
    a policy.
    """
    dwa_parameters = {"min_vel_y": 0.0, "max_vel_y": 0.0, "prune_plan": True}
    costmap_parameters = {
        "observation_sources": "scan",
        "scan": {"data_type": "LaserScan"},
        "footprint": FOOTPRINT,
    }
    move_base = MoveBase(
        {
            "base_local_planner": base_local_planner,
            "applr": {"movers": True},
            "DWAPlannerROS": dwa_parameters,
            "local_costmap": dict(costmap_parameters, rolling_window=True, static_map=False),
            "global_costmap": dict(
                costmap_parameters,
                width=40,
                height=40,
                origin_x=-20.0,
                origin_y=-20.0,
                static_map=False,
            ),
        }
    )
    ranges = np.full(101, np.inf, np.float32)  # Any scan compiles the same kernels.
    ranges[40:60:2] = 1.5
    points = np.ones((3, 3), np.float32)
    # ahead, here but turned, off the map
    goals = ((3.0, 0.2, 0.0), (0.0, 0.0, 2.0), (30.0, 0.0, 0.0))
    now = 0.0
    for goal in goals:
        move_base.set_goal(goal, now)
        for step in range(4):
            pose = 0.01 * step, 0.0, 0.3 * step
            scan = LaserScan(now, -2.0, 0.04, 0.1, 30.0, ranges, pose)
            predicted = SensorCloud(now, points, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0))
            observations: Dict[str, Observation] = {"scan": scan, PREDICTED: predicted}
            cycle = move_base.step(now, pose, (0.1, 0.0), observations)
            if cycle.controlled:  # Outputs for display have kernels, too.
                len(move_base.local_planner.local_plan)
                move_base.local_planner.cost_cloud(move_base.local_costmap)
                move_base.local_planner.trajectory_cloud(move_base.local_costmap)
            now += 0.05
        _change_inflation(move_base)
    for behaviour in move_base.recoveries:
        behaviour.start(now, pose)
        behaviour.step(now, pose, move_base.local_costmap, move_base.global_costmap)
    move_base.cancel()
    move_base.step(now, pose, (0.0, 0.0))
    move_base.make_plan(pose, (30.0, 0.0, 0.0), 0.2)
    move_base.clear_costmaps()


def _change_inflation(move_base: MoveBase) -> None:
    """Change the inflation radii, so that the costs of the last cycle are removed."""
    for server in move_base.servers:
        values = move_base.configuration(server)
        if "inflation_radius" in values:
            move_base.reconfigure(server, {"inflation_radius": 0.9 * values["inflation_radius"]})
