"""The trajectories of all forward samples of a cycle, for display; the search (sampling.py) rolls out far fewer.

Called by planner.py when somebody looks at trajectory_cloud.
"""

import numpy as np

from applr_ros1.common.kernels import kernel
from applr_ros1.planner.trajectory.scoring import NO_CEILING, roll_out, score_below

POINTS = 12  # of each trajectory that are shown; all of them would make messages of megabytes


@kernel
def score_all_samples(params, scene, grids, scratch):
    """(n, 4) x, y, theta, cost: points of the legal forward samples of the cycle last searched, one after the other.

    Of each trajectory at most POINTS points in even steps, its last one among them.
    """
    p = params[0]
    turns = scratch.ws.shape[0] + 1  # straight ahead is tried with each speed, too
    m = scratch.vs.shape[0] * turns
    cloud = np.empty((m * POINTS, 4))
    n = 0
    for i in range(m):
        v = scratch.vs[i // turns]
        w = scratch.ws[i % turns - 1] if i % turns > 0 else 0.0
        cost, count, _, _, _ = score_below(p, scene, grids, scratch.start, v, 0.0, w, NO_CEILING, 0.0, np.inf)
        if cost < 0:
            continue
        points = np.empty((count, 3))
        roll_out(params, scratch.start, v, w, points)
        step = (count + POINTS - 1) // POINTS
        for k in range((count - 1) % step, count, step):
            cloud[n, :3] = points[k]
            cloud[n, 3] = cost
            n += 1
    return cloud[:n]
