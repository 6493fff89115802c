"""Search for the velocity of a cycle without rolling out samples that cannot win.

Called by planner.py. A cycle begins by rounding the pose and starting the four distance grids (section 3 of
docs/explanation/planner_dwa.md). Samples wait in a heap, ordered by a lower bound of their cost (bounds.py). The
critics (critics.py) evaluate the sample with the lowest bound, until no bound beats the best cost. The choice equals
that of the C++ planner to the last bit.
"""

import math

import numpy as np

from applr_ros1.common.kernels import kernel
from applr_ros1.planner.distance_grid import reset, start_at, start_at_plan
from applr_ros1.planner.dwa.bounds import fill_bounds, probe
from applr_ros1.planner.dwa.critics import (
    HUGE,
    NOTHING_LEGAL,
    footprint_scale,
    remember,
    scale_footprint,
    total_cost,
    weighted_sum,
)
from applr_ros1.planner.dwa.records import ALIGNMENT, FRONT, GOAL, PATH
from applr_ros1.planner.dwa.samples import commanded, ground_speed, roll_out, sample_axes, step_count, take_start
from applr_ros1.planner.sampling_planner import sift_down, through_quaternion


@kernel
def prepare(params, scratch, plan, x, y, yaw, vx, vy, w):
    """Store pose and velocity, and return whether the nose-on-path critic is on. It is off near the plan's end.

    plan: points (k, 2 or 3) [m], not empty. yaw and w have already passed through a quaternion.
    """
    p = params[0]
    start = scratch.start
    take_start(start, x, y, yaw, vx, vy, w)
    last = plan.shape[0] - 1
    dx = start[0] - plan[last, 0]
    dy = start[1] - plan[last, 1]
    ahead = p.forward_point_distance
    aligned = dx * dx + dy * dy > ahead * ahead * p.cheat_factor
    p.alignment_scale = p.path_scale if aligned else 0.0
    return aligned


@kernel
def begin_floods(p, grids, start, scene, aligned):
    """Reset the grids for the scene's costmap and start each flood. aligned: whether the nose-on-path critic is on."""
    cells, ox, oy, resolution, _, _, plan, aligned_plan = scene
    distances, queues, ends, facts = grids
    stride = cells.shape[1] + 2
    reset(distances[PATH], ends[PATH], cells)
    ends[:] = 0
    distances[GOAL] = distances[PATH]
    distances[FRONT] = distances[PATH]
    facts[0] = 1
    facts[1] = PATH
    if not aligned:
        facts[1] = ALIGNMENT
        distances[ALIGNMENT] = distances[PATH]
        start_at_plan(
            distances[ALIGNMENT], queues[ALIGNMENT], ends[ALIGNMENT], cells, ox, oy, resolution, aligned_plan, True
        )
    goal_x, goal_y = start_at_plan(distances[PATH], queues[PATH], ends[PATH], cells, ox, oy, resolution, plan, True)
    if goal_x >= 0:
        start_at(distances[GOAL], queues[GOAL], ends[GOAL], (goal_y + 1) * stride + goal_x + 1)
    front = plan.copy()
    last = front.shape[0] - 1
    angle = math.atan2(plan[last, 1] - start[1], plan[last, 0] - start[0])
    front[last, 0] += p.forward_point_distance * math.cos(angle)
    front[last, 1] += p.forward_point_distance * math.sin(angle)
    start_at_plan(distances[FRONT], queues[FRONT], ends[FRONT], cells, ox, oy, resolution, front, False)


NO_LIMIT = 1 << 60


@kernel(error_model="numpy")
def find_best(params, state, grids, scratch, scene, x, y, yaw, vx, vy, w):
    """Run one cycle: preparation, floods, samples, winner, flags. params, state: one record each.

    Returns (cost, number of the sample, number of points, the sample, the trajectory's velocity, commanded w, whether
    nose-on-path is on). A negative cost means no valid command. Angles pass through a quaternion, then pose and
    velocity are rounded to float32.
    """
    p = params[0]
    aligned = prepare(params, scratch, scene.plan, x, y, through_quaternion(yaw), vx, vy, through_quaternion(w))
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
    return cost, sample, steps, (vx, vy, w), stored, through_quaternion(stored[2]), aligned


@kernel(error_model="numpy")
def _lowest(p, state, grids, scratch, scene, nx, ny, nw):
    """Return (cost, number) of the first sample of lowest cost, or (HUGE, -1) if none is legal."""
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
            points = np.empty((steps, 3))
            roll_out(p, start, vx, vy, w, points)
            cost, _ = total_cost(p, state, scene, grids, points, stored[0], stored[1], stored[2], best)
            if cost >= 0 and (cost < best or (cost == best and i < winner)):
                best, winner = cost, i
        count -= 1
        heap[0] = heap[count]
        sift_down(heap, keys, count, 0)
    return best, winner
