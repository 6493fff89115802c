"""Finds the best forward sample of a cycle without rolling out those that cannot be it.

Called by sampling.py. Samples wait in a heap by a lower bound of their cost; the lowest is scored, and
scoring ends where no bound is left that beats the best cost. docs/explanation/planner.md, section 6.4.
"""

import math

from applr_ros1.common.kernels import kernel
from applr_ros1.planner.distance_grid import at_least
from applr_ros1.planner.sample_heap import sift_down
from applr_ros1.planner.trajectory.bounds import end_cell, probe
from applr_ros1.planner.trajectory.scoring import HUGE, NO_CEILING, score_below, terms


@kernel(error_model="numpy")
def best_forward(p, scene, grids, scratch, start, vs, ws, occupied):
    """(cost, vx, w, number of points) of the best forward sample; HUGE and no points if none is legal.

    Samples: for each of `vs` first w = 0, then all but the last of `ws`; of equal costs the first one wins.
    occupied: the cost at the first pose, which all samples share.
    """
    _, _, bases, keys, heap, probed, _ = scratch
    nw = ws.shape[0]
    c = math.cos(start[2])
    s = math.sin(start[2])
    count = _bound(p, scene, grids, scratch, start, vs, ws, occupied)
    best = HUGE
    best_sample = best_points = 0
    best_vx = best_w = 0.0
    while count > 0:
        sample = heap[0]
        if keys[sample] > best or (keys[sample] == best and sample > best_sample):
            break
        vx = vs[sample // nw]
        w = ws[sample % nw - 1] if sample % nw > 0 else 0.0
        hopeless = False
        if not probed[sample]:
            probed[sample] = 1
            allowed = NO_CEILING if best == HUGE else (best - bases[sample]) / p.occdist_scale + 1.0
            met = probe(p, scene, start, c, s, vx, w, occupied, allowed)
            hopeless = met < 0
            if met > occupied:
                keys[sample] = bases[sample] + p.occdist_scale * met
                sift_down(heap, keys, count, 0)
                continue
        if not hopeless:
            cost, n, _, _, _ = score_below(p, scene, grids, start, vx, 0.0, w, NO_CEILING, bases[sample], best)
            if cost >= 0 and (cost < best or (cost == best and sample < best_sample)):
                best, best_sample, best_points, best_vx, best_w = cost, sample, n, vx, w
        count -= 1
        heap[0] = heap[count]
        sift_down(heap, keys, count, 0)
    return best, best_vx, best_w, best_points


@kernel(error_model="numpy")
def _bound(p, scene, grids, scratch, start, vs, ws, occupied):
    """Fill bases (lower bounds of path and goal terms), keys (of costs) and heap; returns how many may win.

    The floods go on until the samples' last cells are reached, but not much farther than the robot gets: behind
    walls there may be cells that only a flood of the whole map would reach.
    """
    _, _, bases, keys, heap, probed, _ = scratch
    cells, ox, oy, resolution, _, _, _ = scene
    path, goal, path_queue, goal_queue, path_ends, goal_ends, _ = grids
    ny, nx = cells.shape
    exact = not p.simple_attractor and not p.heading_scoring  # else only the obstacle term is known beforehand
    c = math.cos(start[2])
    s = math.sin(start[2])
    travel = (max(abs(start[3]), abs(vs[0]), abs(vs[-1])) + abs(start[4])) * p.sim_time / resolution
    reach = int(min(3.0 * travel, float(nx * ny))) + 8
    k = (int((start[1] - oy) / resolution) + 1) * (nx + 2) + int((start[0] - ox) / resolution) + 1
    path_limit = min(int(path[k]), nx * ny) + reach
    goal_limit = min(int(goal[k]), nx * ny) + reach
    count = 0
    for i in range(vs.shape[0]):
        for j in range(ws.shape[0]):
            base = 0.0
            if exact:
                cx, cy = end_cell(p, nx, ny, ox, oy, resolution, start, c, s, vs[i], ws[j - 1] if j > 0 else 0.0)
                if cx < 0:
                    continue
                k = (cy + 1) * (nx + 2) + cx + 1
                path_distance = int(path[k])
                goal_distance = int(goal[k])
                if path_distance > nx * ny:
                    path_distance = at_least(path, path_queue, path_ends, nx, ny, k, path_limit)
                if goal_distance > nx * ny:
                    goal_distance = at_least(goal, goal_queue, goal_ends, nx, ny, k, goal_limit)
                if path_distance >= nx * ny or goal_distance >= nx * ny:
                    continue
                base = terms(p, float(path_distance), float(goal_distance))
            sample = i * ws.shape[0] + j
            bases[sample] = base
            keys[sample] = base + p.occdist_scale * occupied
            probed[sample] = 0
            heap[count] = sample
            count += 1
    for i in range(count // 2 - 1, -1, -1):
        sift_down(heap, keys, count, i)
    return count
