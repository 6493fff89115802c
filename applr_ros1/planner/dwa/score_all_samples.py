"""Scores every sample of a cycle as the C++ planner does, none left out: for trajectory_cloud, and for tests.

The search (search.py) finds the same winner with less work.
"""

from collections import namedtuple

import numpy as np

from applr_ros1.common.kernels import kernel
from applr_ros1.planner.dwa.critics import CRITICS, REFUSED, critique, total_cost
from applr_ros1.planner.dwa.generator import commanded, roll_out, step_count
from applr_ros1.planner.dwa.velocities import sample_axes

# One row per sample (m,). velocities (m, 3): sampled vx, vy, w; stored (m, 3): of the trajectory; counts (m,): its
# points, 0 if the generator refuses it; ends (m, 3): the last one; critics (m, 7): their raw values; costs (m,): by
# itself; shown (m,): in the search's order, where it ends once it is above the best so far; ended (m,): the critic
# that ended that, CRITICS if none did. points: of all trajectories whose shown cost is not negative, one after the
# other: x, y, theta and that cost.
Samples = namedtuple("Samples", "velocities stored counts ends critics costs shown ended points")


@kernel
def score_all_samples(params, flags, grids, scratch, scene):
    """Samples of the cycle last searched. flags: those before that search; one record."""
    p, state, start = params[0], flags[0], scratch.start
    nx, ny, nw = sample_axes(p, scratch, scene.plan)
    m = nx * ny * nw
    velocities, stored, ends = np.zeros((m, 3)), np.zeros((m, 3)), np.zeros((m, 3))
    counts, ended = np.zeros(m, np.int64), np.full(m, CRITICS, np.int64)
    critics, costs, shown = np.zeros((m, CRITICS)), np.full(m, REFUSED), np.full(m, REFUSED)
    best = -1.0
    for i in range(m):
        vx, vy, w = scratch.xs[i // (nw * ny)], scratch.ys[i // nw % ny], scratch.ws[i % nw]
        velocities[i] = vx, vy, w
        steps = counts[i] = step_count(p, vx, vy, w)
        if steps == 0:
            continue
        stored[i] = commanded(p, start, vx, vy, w, steps)
        points = np.empty((steps, 3))
        roll_out(p, start, vx, vy, w, points)
        ends[i] = points[steps - 1]
        vx, vy, w = stored[i]
        for critic in range(CRITICS):
            critics[i, critic] = critique(p, state, scene, grids, points, vx, vy, w, critic)
        costs[i], _ = total_cost(p, state, scene, grids, points, vx, vy, w, -1.0)
        shown[i], ended[i] = total_cost(p, state, scene, grids, points, vx, vy, w, best)
        if shown[i] >= 0 and (best < 0 or shown[i] < best):
            best = shown[i]
    cloud = np.empty((counts[shown >= 0].sum(), 4))
    n = 0
    for i in range(m):
        if shown[i] >= 0:
            points = np.empty((counts[i], 3))
            roll_out(p, start, velocities[i, 0], velocities[i, 1], velocities[i, 2], points)
            cloud[n : n + counts[i], :3] = points
            cloud[n : n + counts[i], 3] = shown[i]
            n += counts[i]
    return Samples(velocities, stored, counts, ends, critics, costs, shown, ended, cloud)
