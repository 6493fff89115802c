"""Chooses the velocity of a cycle without rolling out those samples that cannot win.

Called by planner.py. Samples wait in a heap by a lower bound of their cost; the lowest is scored, and scoring ends
where no bound is left that beats the best cost. The choice is the C++ planner's to the last bit.
"""

import math

import numpy as np

from applr_ros1.common.kernels import kernel
from applr_ros1.planner.angles import wrapped
from applr_ros1.planner.costmap.grid import world_to_map
from applr_ros1.planner.costmap.outline import outline_cost
from applr_ros1.planner.dwa.bounds import (
    AT_BORDER,
    arc,
    arc_errors,
    at_least,
    exact_end_cells,
    flood_limits,
    probe,
    sure_cell,
)
from applr_ros1.planner.dwa.critics import HUGE, NOTHING_LEGAL, final_distance, footprint_scale, scale_footprint
from applr_ros1.planner.dwa.generator import (
    SLACK,
    angular_steps,
    commanded,
    ground_speed,
    is_too_fast,
    least_turn,
    linear_steps,
    move,
    ramped,
    step_count,
)
from applr_ros1.planner.dwa.oscillation import is_barred, remember
from applr_ros1.planner.dwa.preparation import begin_floods, prepare
from applr_ros1.planner.dwa.records import FRONT, GOAL, PATH
from applr_ros1.planner.dwa.velocities import sample_axes
from applr_ros1.planner.sample_heap import sift_down
from applr_ros1.planner.trajectory.bounds import LARGEST_TURN

NO_LIMIT = 1 << 60


@kernel(error_model="numpy")
def find_best(params, state, grids, scratch, scene, x, y, yaw, vx, vy, w):
    """One cycle: preparation, floods, samples, winner, flags. params, state: one record each.

    Returns (cost, number of the sample, number of points, the sample, the trajectory's velocity, commanded w,
    nose-on-path is on); a cost below 0 means no valid command. Pose and velocity go through float32 first, angles
    through a quaternion before that.
    """
    p = params[0]
    aligned = prepare(params, scratch, scene.plan, x, y, wrapped(yaw), vx, vy, wrapped(w))
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
    return cost, sample, steps, (vx, vy, w), stored, wrapped(stored[2]), aligned


@kernel
def total(p, occupied, front, alignment, path, goal, w):
    """The weighted sum of the critics, in their order."""
    cost = occupied * p.occdist_scale
    cost += front * p.goal_scale
    cost += alignment * p.alignment_scale
    cost += path * p.path_scale
    cost += goal * p.goal_scale
    return cost + abs(w) * p.twirling_scale


@kernel(error_model="numpy")
def _lowest(p, state, grids, scratch, scene, nx, ny, nw):
    """(cost, number) of the first sample of lowest cost, (HUGE, -1) if none is legal."""
    xs, ys, ws, keys, bounds, occupied, heap, probed, start = scratch
    c = math.cos(start[2])
    s = math.sin(start[2])
    scaled = np.empty_like(scene.footprint)
    count = _bound(p, state, grids, scratch, scene, nx, ny, nw, c, s, scaled)
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
                    rest = total(p, 0.0, front, alignment, path, goal, stored[2])
                    allowed = int(min((best - rest) / p.occdist_scale, 1e9)) + 1
                met = probe(p, scene, scaled, start, c, s, vx, vy, w, speed, steps, occupied[i], allowed)
                hopeless = met < 0
                if met > occupied[i]:
                    occupied[i] = met
                    keys[i] = total(p, met, front, alignment, path, goal, stored[2])
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
def _bound(p, state, grids, scratch, scene, nx, ny, nw, c, s, scaled):
    """Fill bounds, occupied, keys and heap; returns how many samples may win.

    The inner loop calls nothing that takes an array, except where it must: counting references costs more than the
    rest.
    """
    xs, ys, ws, keys, bounds, occupied, heap, probed, start = scratch
    cells, ox, oy, resolution, footprint, lines, _, _ = scene
    rows, columns = cells.shape
    flat = cells.reshape(rows * columns)
    n = rows * columns
    stride = columns + 2
    by_path = p.path_scale != 0.0
    by_goal = p.goal_scale != 0.0
    by_alignment = p.alignment_scale != 0.0
    by_nose = by_goal or by_alignment
    by_outline = p.occdist_scale != 0.0
    x0, y0, theta0 = start[0], start[1], start[2]
    cx, cy = world_to_map(x0, y0, ox, oy, resolution, columns, rows)
    if cx < 0 and (by_path or by_goal or by_outline):
        return 0
    k = (cy + 1) * stride + cx + 1
    if by_path and final_distance(grids, PATH, k, stride, n) >= n:
        return 0
    if by_goal and final_distance(grids, GOAL, k, stride, n) >= n:
        return 0
    ahead = p.forward_point_distance
    if by_nose and ahead != 0.0:
        nose_x, _ = world_to_map(x0 + ahead * c, y0 + ahead * s, ox, oy, resolution, columns, rows)
        if nose_x < 0:
            return 0
    path_limit = goal_limit = front_limit = 0
    if by_path or by_goal:
        path_limit, goal_limit, front_limit = flood_limits(p, grids, scene, start, cx, cy)
    alignment_row = grids.facts[1]
    path_grid, goal_grid = grids.distances[PATH], grids.distances[GOAL]
    front_grid, alignment_grid = grids.distances[FRONT], grids.distances[alignment_row]
    centre = int(cells[cy, cx]) if by_outline else 0
    here = met = centre
    scale_here = -1.0
    use_dwa, sim_time = p.use_dwa, p.sim_time
    per_cell = 1.0 / resolution
    count = 0
    for ix in range(nx):
        for iy in range(ny):
            vx, vy = xs[ix], ys[iy]
            speed = ground_speed(vx, vy)
            if is_too_fast(p, speed):
                continue
            least = least_turn(p, speed)
            linear = linear_steps(p, speed)
            dx = vx * c - vy * s
            dy = vx * s + vy * c
            for iw in range(nw):
                w = ws[iw]
                if abs(w) + SLACK < least:
                    continue
                steps = int(math.ceil(max(linear, angular_steps(p, w))))
                if steps == 0:
                    continue
                stored_vx, stored_vy, stored_w, stored_speed = vx, vy, w, speed
                if not use_dwa:
                    stored_vx, stored_vy, stored_w = commanded(p, start, vx, vy, w, steps)
                    stored_speed = ground_speed(stored_vx, stored_vy)
                if is_barred(state, stored_vx, stored_vy, stored_w):
                    continue
                if by_outline:
                    scale = footprint_scale(p, stored_speed)
                    if scale != scale_here:
                        scale_here = scale
                        scale_footprint(footprint, scale, scaled)
                        here = outline_cost(cells, flat, ox, oy, resolution, scaled, lines, x0, y0, c, s, cx, cy, 0.0)
                        met = max(here, centre)
                    if here < 0:
                        continue
                front = alignment = path = goal = 0
                if by_path or by_nose:
                    dt = sim_time / steps
                    turn = w * dt
                    end_x = end_y = nose_x = nose_y = AT_BORDER
                    if use_dwa and abs(turn) <= LARGEST_TURN:
                        x, y, hc, hs = arc(dx, dy, turn, dt, steps - 1)
                        error, heading = arc_errors(x0, y0, theta0, speed, w, sim_time, steps)
                        margin = error * per_cell + 1e-9
                        fx = (x0 + x - ox) * per_cell
                        fy = (y0 + y - oy) * per_cell
                        end_x = sure_cell(fx, margin)
                        end_y = sure_cell(fy, margin)
                        margin += abs(ahead) * heading * per_cell
                        nose_x = sure_cell(fx + ahead * (c * hc - s * hs) * per_cell, margin)
                        nose_y = sure_cell(fy + ahead * (s * hc + c * hs) * per_cell, margin)
                    if min(end_x, end_y, nose_x, nose_y) == AT_BORDER:
                        end_x, end_y, nose_x, nose_y = exact_end_cells(p, scene, start, vx, vy, w, steps)
                    if by_path or by_goal:
                        if not (0 <= end_x < columns and 0 <= end_y < rows):
                            continue
                        k = (end_y + 1) * stride + end_x + 1
                        if by_path:
                            path = path_grid[k]
                            if path > n:
                                path = at_least(grids, PATH, k, columns, rows, path_limit)
                            if path >= n:
                                continue
                        if by_goal:
                            goal = goal_grid[k]
                            if goal > n:
                                goal = at_least(grids, GOAL, k, columns, rows, goal_limit)
                            if goal >= n:
                                continue
                    if by_nose:
                        if not (0 <= nose_x < columns and 0 <= nose_y < rows):
                            continue
                        k = (nose_y + 1) * stride + nose_x + 1
                        if by_goal:
                            front = front_grid[k]
                            if front > n:
                                front = at_least(grids, FRONT, k, columns, rows, front_limit)
                        if by_alignment:
                            alignment = alignment_grid[k]
                            if alignment > n:
                                alignment = at_least(grids, alignment_row, k, columns, rows, path_limit)
                i = (ix * ny + iy) * nw + iw
                bounds[i, 0], bounds[i, 1], bounds[i, 2], bounds[i, 3] = front, alignment, path, goal
                occupied[i] = met
                keys[i] = total(p, met, front, alignment, path, goal, stored_w)
                probed[i] = 0
                heap[count] = i
                count += 1
    for i in range(count // 2 - 1, -1, -1):
        sift_down(heap, keys, count, i)
    return count


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
            if total(p, worst, bounds[i, 0], bounds[i, 1], bounds[i, 2], bounds[i, 3], stored_w) > best:
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
    return total(p, worst, front, alignment, path, goal, stored_w)
