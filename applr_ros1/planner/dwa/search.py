"""Chooses the velocity of a cycle without rolling out those samples that cannot win.

Called by planner.py. Samples wait in a heap by a lower bound of their cost; the lowest is scored, and scoring ends
where no bound is left that beats the best cost. The choice is the C++ planner's to the last bit.
"""

import math

import numpy as np

from applr_ros1.common.kernels import kernel
from applr_ros1.planner.angles import normalize_angle
from applr_ros1.planner.costmap.footprint_cost import outline_cost
from applr_ros1.planner.costmap.grid import world_to_map
from applr_ros1.planner.dwa.bounds import fill_bounds, probe
from applr_ros1.planner.dwa.critics import (
    HUGE,
    NOTHING_LEGAL,
    final_distance,
    footprint_scale,
    scale_footprint,
    weighted_sum,
)
from applr_ros1.planner.dwa.generator import commanded, ground_speed, move, ramped, step_count
from applr_ros1.planner.dwa.oscillation import remember
from applr_ros1.planner.dwa.preparation import begin_floods, prepare
from applr_ros1.planner.dwa.records import FRONT, GOAL, PATH
from applr_ros1.planner.dwa.velocities import sample_axes
from applr_ros1.planner.sample_heap import sift_down

NO_LIMIT = 1 << 60


@kernel(error_model="numpy")
def find_best(params, state, grids, scratch, scene, x, y, yaw, vx, vy, w):
    """One cycle: preparation, floods, samples, winner, flags. params, state: one record each.

    Returns (cost, number of the sample, number of points, the sample, the trajectory's velocity, commanded w,
    nose-on-path is on); a cost below 0 means no valid command. Pose and velocity go through float32 first, angles
    through a quaternion before that.
    """
    p = params[0]
    aligned = prepare(params, scratch, scene.plan, x, y, normalize_angle(yaw), vx, vy, normalize_angle(w))
    start = scratch.start
    begin_floods(p, grids, start, scene, aligned)
    nx, ny, nw = sample_axes(p, scratch, scene.plan)
    cost, sample = _lowest(p, state[0], grids, scratch, scene, nx, ny, nw)
    if cost == HUGE:
        return NOTHING_LEGAL, -1, 0, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0), 0.0, aligned
    vx, vy, w = scratch.xs[sample // (nw * ny)], scratch.ys[sample // nw % ny], scratch.ws[sample % nw]
    steps = step_count(p, vx, vy, w)
    stored = commanded(p, start, vx, vy, w, steps)
    remember(p, state[0], start[0], start[1], start[2], stored[0], stored[1], stored[2])
    return cost, sample, steps, (vx, vy, w), stored, normalize_angle(stored[2]), aligned


@kernel(error_model="numpy")
def _lowest(p, state, grids, scratch, scene, nx, ny, nw):
    """(cost, number) of the first sample of lowest cost, (HUGE, -1) if none is legal."""
    xs, ys, ws, keys, bounds, occupied, heap, probed, start = scratch
    c = math.cos(start[2])
    s = math.sin(start[2])
    scaled = np.empty_like(scene.footprint)
    count = fill_bounds(p, state, grids, scratch, scene, nx, ny, nw, c, s, scaled)
    best = HUGE
    winner = -1
    while count > 0:
        i = heap[0]
        if keys[i] > best or (keys[i] == best and i > winner):
            break
        vx, vy, w = xs[i // (nw * ny)], ys[i // nw % ny], ws[i % nw]
        steps = step_count(p, vx, vy, w)
        stored = commanded(p, start, vx, vy, w, steps)
        speed = ground_speed(stored[0], stored[1])
        front, alignment, path, goal = bounds[i, 0], bounds[i, 1], bounds[i, 2], bounds[i, 3]
        hopeless = False
        if p.occdist_scale != 0.0:
            scale_footprint(scene.footprint, footprint_scale(p, speed), scaled)
            if not probed[i]:
                probed[i] = 1
                allowed = NO_LIMIT
                if best < HUGE:
                    rest = weighted_sum(p, 0.0, front, alignment, path, goal, stored[2])
                    allowed = int(min((best - rest) / p.occdist_scale, 1e9)) + 1
                met = probe(p, scene, scaled, start, c, s, vx, vy, w, speed, steps, occupied[i], allowed)
                hopeless = met < 0
                if met > occupied[i]:
                    occupied[i] = met
                    keys[i] = weighted_sum(p, met, front, alignment, path, goal, stored[2])
                    sift_down(heap, keys, count, 0)
                    continue
        if not hopeless:
            cost = _score(p, grids, scene, start, scaled, vx, vy, w, stored[2], steps, bounds, i, best)
            if cost < best or (cost == best and cost < HUGE and i < winner):
                best, winner = cost, i
        count -= 1
        heap[0] = heap[count]
        sift_down(heap, keys, count, 0)
    return best, winner


@kernel(error_model="numpy")
def _score(p, grids, scene, start, scaled, vx, vy, w, stored_w, steps, bounds, i, best):
    """The cost of one sample, rolled out; HUGE if it is illegal, or above `best` already on the way."""
    cells, ox, oy, resolution, _, lines, _, _ = scene
    rows, columns = cells.shape
    flat = cells.reshape(rows * columns)
    n = rows * columns
    stride = columns + 2
    by_path = p.path_scale != 0.0
    by_goal = p.goal_scale != 0.0
    by_nose = by_goal or p.alignment_scale != 0.0
    by_outline = p.occdist_scale != 0.0
    ahead = p.forward_point_distance
    path_grid = grids.distances[PATH]
    goal_grid = grids.distances[GOAL]
    dt = p.sim_time / steps
    x, y, theta = start[0], start[1], start[2]
    vx_now, vy_now, w_now = commanded(p, start, vx, vy, w, steps)
    worst = summed = 0
    path = goal = nose = 0
    for step in range(steps):
        c = math.cos(theta)
        s = math.sin(theta)
        cx, cy = world_to_map(x, y, ox, oy, resolution, columns, rows)
        k = (cy + 1) * stride + cx + 1
        if cx < 0 and (by_path or by_goal or by_outline):
            return HUGE
        if by_nose:
            nose_x, nose_y = cx, cy
            if ahead != 0.0:
                nose_x, nose_y = world_to_map(x + ahead * c, y + ahead * s, ox, oy, resolution, columns, rows)
            if nose_x < 0:
                return HUGE
            nose = (nose_y + 1) * stride + nose_x + 1
        if by_path:
            path = path_grid[k]
            if path >= n:
                path = final_distance(grids, PATH, k, stride, n)
                if path >= n:
                    return HUGE
        if by_goal:
            goal = goal_grid[k]
            if goal >= n:
                goal = final_distance(grids, GOAL, k, stride, n)
                if goal >= n:
                    return HUGE
        if by_outline:
            cost = outline_cost(cells, flat, ox, oy, resolution, scaled, lines, x, y, c, s, cx, cy, 0.0)
            if cost < 0:
                return HUGE
            cost = max(cost, int(cells[cy, cx]))
            worst = max(worst, cost)
            summed += cost
            if p.sum_scores:
                worst = summed
            if weighted_sum(p, worst, bounds[i, 0], bounds[i, 1], bounds[i, 2], bounds[i, 3], stored_w) > best:
                return HUGE
        if step < steps - 1:
            if not p.use_dwa:
                vx_now, vy_now, w_now = ramped(p, vx, vy, w, vx_now, vy_now, w_now, dt)
            x, y, theta = move(x, y, theta, c, s, vx_now, vy_now, w_now, dt)
    front = alignment = 0
    if by_goal:
        front = final_distance(grids, FRONT, nose, stride, n)
    if p.alignment_scale != 0.0:
        alignment = final_distance(grids, grids.facts[1], nose, stride, n)
    return weighted_sum(p, worst, front, alignment, path, goal, stored_w)
