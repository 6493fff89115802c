"""Compiles (or loads) every numba kernel of the planner before it has to drive.

Called by the move_base node before it says that it is ready, and by whoever measures times. The first start on a
machine takes about a minute, later ones a few seconds: numba keeps the machine code beside the sources.
"""

from __future__ import annotations

import numpy as np

from applr_ros1.planner.costmap.scan import LaserScan
from applr_ros1.planner.move_base import MoveBase
from applr_ros1.planner.parameters.declarations import JACKAL, LOCAL_PLANNERS


def warm_up(base_local_planner: str = LOCAL_PLANNERS[0]) -> None:
    """Drive a throw-away MoveBase with the Jackal's parameters through planning, control, recoveries and requests.

    Args:
        base_local_planner: the local planner that is going to drive.
    """
    dwa = {"min_vel_y": 0.0, "max_vel_y": 0.0, "prune_plan": True}
    move_base = MoveBase(dict(JACKAL, base_local_planner=base_local_planner, DWAPlannerROS=dwa))
    ranges = np.full(101, np.inf, np.float32)  # any scan compiles the same kernels
    ranges[40:60:2] = 1.5
    goals = ((3.0, 0.2, 0.0), (0.0, 0.0, 2.0), (30.0, 0.0, 0.0))  # ahead, here but turned, off the map
    now = 0.0
    for goal in goals:
        move_base.set_goal(goal, now)
        for step in range(4):
            pose = 0.01 * step, 0.0, 0.3 * step
            scan = LaserScan(now, -2.0, 0.04, 0.1, 30.0, ranges, pose)
            cycle = move_base.step(now, pose, (0.1, 0.0), scan)
            if cycle.controlled:  # what is only shown has kernels too
                len(move_base.local_planner.local_plan)
                move_base.local_planner.cost_cloud(move_base.local_costmap)
                move_base.local_planner.trajectory_cloud(move_base.local_costmap)
            now += 0.05
    for behaviour in move_base.recoveries:
        behaviour.start(now, pose)
        behaviour.step(now, pose, move_base.local_costmap, move_base.global_costmap)
    move_base.cancel(now)
    move_base.step(now, pose, (0.0, 0.0))
    move_base.make_plan(pose, (30.0, 0.0, 0.0), 0.2)
    move_base.clear_costmaps()
