"""Finds the turn in place, if any, that replaces the best forward sample of a cycle.

Called by sampling.py. docs/explanation/planner.md, section 6.5. The conditions of a turn have no side effects, so the
cheap ones come first and most turns are never rolled out.
"""

import math

import numpy as np

from applr_ros1.common.kernels import kernel
from applr_ros1.planner.costmap.grid import LETHAL, world_to_map
from applr_ros1.planner.distance_grid import final_distance, settle
from applr_ros1.planner.trajectory.scoring import (
    HUGE,
    NO_CEILING,
    advance,
    new_velocity,
    score_below,
    step_count,
    terms,
)

WIDEST = 40  # [cells] about the robot that are looked through at most


@kernel(error_model="numpy")
def best_in_place(p, state, scene, grids, start, ws, dw, occupied, best):
    """(cost, w, number of points) of the turn that replaces a sample of cost `best`; no points if none does.

    A turn must not cost more than the best so far, must be faster than the step `dw` of `ws`, must not be barred by
    `state`, and must end facing a cell that is on the map and nearer the goal than any turn taken before it did.
    occupied: the cost at the first pose, which all turns share.
    """
    ny, nx = scene.cells.shape
    unseen = nx * ny + 1
    heading_distance = HUGE
    chosen = 0.0
    points = 0
    ceiling = -1
    for i in range(ws.shape[0]):
        w = ws[i]
        if not (w > dw or w < -dw) or w == 0.0:
            continue
        if (state.stuck_left and w < 0) or (state.stuck_right and w > 0):
            continue
        w = max(w, p.min_in_place_vel_theta) if w > 0 else min(w, -p.min_in_place_vel_theta)
        x, y, theta = _end(p, start, w)
        base = 0.0
        if not p.simple_attractor and not p.heading_scoring:
            cx, cy = world_to_map(x, y, scene.ox, scene.oy, scene.resolution, nx, ny)
            if cx < 0:
                continue
            k = (cy + 1) * (nx + 2) + cx + 1
            path_distance = settle(grids.path, grids.path_queue, grids.path_ends, nx + 2, unseen, k, unseen)
            goal_distance = settle(grids.goal, grids.goal_queue, grids.goal_ends, nx + 2, unseen, k, unseen)
            if path_distance >= nx * ny or goal_distance >= nx * ny:
                continue
            base = terms(p, float(path_distance), float(goal_distance))
        if base + p.occdist_scale * occupied > best:
            continue
        ahead = _distance_ahead(p, scene, grids, x, y, theta, heading_distance)
        if not 0 <= ahead < heading_distance:
            continue
        if ceiling < 0:
            ceiling = _surroundings(p, scene, start)
        cost, n, _, _, _ = score_below(p, scene, grids, start, 0.0, 0.0, w, ceiling, base, best)
        if 0 <= cost <= best:
            best, chosen, points, heading_distance = cost, w, n, float(ahead)
    return best, chosen, points


@kernel(error_model="numpy")
def _end(p, start, w):
    """(x, y, theta) of the last scored point of a turn in place: exact, for the position soon rests."""
    steps = step_count(p, 0.0, 0.0, w)
    dt = p.sim_time / steps
    x, y, theta, vx_i, vy_i, w_i = start[0], start[1], start[2], start[3], start[4], start[5]
    for _ in range(steps - 1):
        w_i = new_velocity(w, w_i, p.acc_lim_theta, dt)
        if vx_i != 0.0 or vy_i != 0.0:
            vx_i = new_velocity(0.0, vx_i, p.acc_lim_x, dt)
            vy_i = new_velocity(0.0, vy_i, p.acc_lim_y, dt)
            x, y = advance(x, y, theta, vx_i, vy_i, math.cos(theta), math.sin(theta), dt)
        theta = theta + w_i * dt
    return x, y, theta


@kernel
def _distance_ahead(p, scene, grids, x, y, theta, limit):
    """Goal distance of the cell `heading_lookahead` ahead of a pose; -1 if off the map or not below `limit`."""
    ny, nx = scene.cells.shape
    n = nx * ny
    cx, cy = world_to_map(
        x + p.heading_lookahead * math.cos(theta),
        y + p.heading_lookahead * math.sin(theta),
        scene.ox,
        scene.oy,
        scene.resolution,
        nx,
        ny,
    )
    if cx < 0:
        return -1
    goal, queue, ends = grids.goal, grids.goal_queue, grids.goal_ends
    k = (cy + 1) * (nx + 2) + cx + 1
    value = settle(goal, queue, ends, nx + 2, n + 1, k, int(min(limit, n + 1.0)))
    if value > n and ends[0] < ends[1]:
        return -1
    if value == n and limit > n:
        return final_distance(goal, queue, ends, nx + 2, n, k)
    return value


@kernel(error_model="numpy")
def _surroundings(p, scene, start):
    """Largest cost that any turn in place from `start` can meet; NO_CEILING if not known or illegal."""
    ny, nx = scene.cells.shape
    reach = start[3] * start[3] / (2 * p.acc_lim_x) + start[4] * start[4] / (2 * p.acc_lim_y)  # until it stands
    farthest = 0.0
    for i in range(scene.footprint.shape[0]):
        farthest = max(farthest, math.hypot(scene.footprint[i, 0], scene.footprint[i, 1]))
    reach = (reach + farthest) / scene.resolution
    if not reach < WIDEST:
        return NO_CEILING
    side = int(reach) + 2
    cx, cy = world_to_map(start[0], start[1], scene.ox, scene.oy, scene.resolution, nx, ny)
    if not (side <= cx < nx - side and side <= cy < ny - side):
        return NO_CEILING
    worst = np.uint8(0)
    for row in range(cy - side, cy + side + 1):
        for column in range(cx - side, cx + side + 1):
            worst = max(worst, scene.cells[row, column])
    return int(worst) if worst < LETHAL else NO_CEILING
