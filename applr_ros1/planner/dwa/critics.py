"""The seven critics of DWAPlannerROS in the order of the C++ planner, and their weighted sum.

See docs/explanation/planner_dwa.md, sections 6 and 7. Section 7 describes the first critic, which bars a direction just
left until the robot has moved on (OscillationCostFunction). A negative value rejects the trajectory. The search
(search.py) evaluates only the few samples that may win. score_all_samples evaluates all of them for display, for tests,
and to report why none is legal.
"""

import math
from collections import namedtuple

import numpy as np

from applr_ros1.common.kernels import kernel
from applr_ros1.planner import distance_grid
from applr_ros1.planner.costmap.footprint_cost import outline_cost
from applr_ros1.planner.costmap.grid import world_to_map
from applr_ros1.planner.dwa.records import ALIGNMENT, FRONT, GOAL, PATH
from applr_ros1.planner.dwa.samples import commanded, ground_speed, roll_out, sample_axes, step_count


@kernel
def is_barred(state, vx, vy, w):
    """Return True if the flags bar this velocity. Zero is never barred."""
    return (
        (state.forward_pos_only and vx < 0)
        or (state.forward_neg_only and vx > 0)
        or (state.strafe_pos_only and vy < 0)
        or (state.strafe_neg_only and vy > 0)
        or (state.rot_pos_only and w < 0)
        or (state.rot_neg_only and w > 0)
    )


@kernel
def remember(p, state, x, y, theta, vx, vy, w):
    """Update the flags with the chosen velocity, and clear them once the robot has moved on from the last change.

    x, y, theta: pose of this cycle, float32 values.
    """
    state.forward_pos_only, state.forward_neg_only, state.forward_pos, state.forward_neg, changed = _turned(
        vx, state.forward_pos_only, state.forward_neg_only, state.forward_pos, state.forward_neg
    )
    if abs(vx) <= p.min_vel_trans:
        state.strafe_pos_only, state.strafe_neg_only, state.strafing_pos, state.strafing_neg, strafes = _turned(
            vy, state.strafe_pos_only, state.strafe_neg_only, state.strafing_pos, state.strafing_neg
        )
        state.rot_pos_only, state.rot_neg_only, state.rotating_pos, state.rotating_neg, rotates = _turned(
            w, state.rot_pos_only, state.rot_neg_only, state.rotating_pos, state.rotating_neg
        )
        changed = changed or strafes or rotates
    if changed:
        state.prev_x = x
        state.prev_y = y
        state.prev_theta = theta
    if (
        state.forward_pos_only
        or state.forward_neg_only
        or state.strafe_pos_only
        or state.strafe_neg_only
        or state.rot_pos_only
        or state.rot_neg_only
    ):
        dx = np.float64(np.float32(x) - np.float32(state.prev_x))
        dy = np.float64(np.float32(y) - np.float32(state.prev_y))
        turn = np.float64(np.float32(theta) - np.float32(state.prev_theta))
        far = dx * dx + dy * dy > p.oscillation_reset_dist * p.oscillation_reset_dist
        if far or abs(turn) > p.oscillation_reset_angle:
            clear(state)


@kernel
def _turned(v, pos_only, neg_only, pos, neg):
    """Return the four flags of one axis after its chosen velocity v, and whether v reverses the last direction."""
    if v < 0:
        return pos_only, 1 if pos else neg_only, 0, 1, pos != 0
    if v > 0:
        return 1 if neg else pos_only, neg_only, 1, 0, neg != 0
    return pos_only, neg_only, pos, neg, False


@kernel
def clear(state):
    """Clear the flags of all directions. The pose of the last change stays."""
    state.forward_pos_only = state.forward_neg_only = 0
    state.strafe_pos_only = state.strafe_neg_only = 0
    state.rot_pos_only = state.rot_neg_only = 0
    state.forward_pos = state.forward_neg = 0
    state.strafing_pos = state.strafing_neg = 0
    state.rotating_pos = state.rotating_neg = 0


OSCILLATES, COLLIDES, OFF_MAP, IN_OBSTACLE, UNREACHED = -5.0, -6.0, -4.0, -3.0, -2.0  # values of rejecting critics
NOTHING_LEGAL = -7.0  # cost of a cycle without a legal sample
REFUSED = -1.0  # cost of a sample rejected by the generator
# names of the critics in C++
CRITICS = ("oscillation", "obstacle", "goal_front", "alignment", "path", "goal", "twirling")
ALL = len(CRITICS)
HUGE = float(np.finfo(np.float64).max)


@kernel
def weights(p):
    """Return the critics' weights in the order of CRITICS. A critic of weight 0 is not evaluated."""
    return 1.0, p.occdist_scale, p.goal_scale, p.alignment_scale, p.path_scale, p.goal_scale, p.twirling_scale


@kernel(error_model="numpy")
def footprint_scale(p, speed):
    """Return the factor by which the footprint is enlarged at this speed [m/s]."""
    if speed <= p.scaling_speed:
        return 1.0
    return p.max_scaling_factor * ((speed - p.scaling_speed) / (p.max_vel_trans - p.scaling_speed)) + 1.0


@kernel
def scale_footprint(footprint, scale, scaled):
    """Write the vertices (n, 2), multiplied by `scale`, to `scaled`."""
    for i in range(footprint.shape[0]):
        scaled[i, 0] = footprint[i, 0] * scale
        scaled[i, 1] = footprint[i, 1] * scale


@kernel
def final_distance(grids, row, k, stride, n):
    """Return the C++ value of cell k in one grid: a distance, n for a wall, n + 1 if no flood reaches it."""
    return distance_grid.final_distance(grids.distances[row], grids.queues[row], grids.ends[row], stride, n, k)


@kernel
def critique(p, state, scene, grids, points, vx, vy, w, critic):
    """Return the value of one critic for a trajectory with points (k, 3) and a velocity, or 0 if it has no points."""
    if critic == 0:
        return OSCILLATES if is_barred(state, vx, vy, w) else 0.0
    if critic == 1:
        return _obstacle(p, scene, points, ground_speed(vx, vy))
    if critic == 2:
        return _on_grid(scene, grids, FRONT, points, p.forward_point_distance, False)
    if critic == 3:
        row = grids.facts[1] if grids.facts[0] else ALIGNMENT
        return _on_grid(scene, grids, row, points, p.forward_point_distance, False)
    if critic == 4:
        return _on_grid(scene, grids, PATH, points, 0.0, True)
    if critic == 5:
        return _on_grid(scene, grids, GOAL, points, 0.0, True)
    return abs(w)


@kernel
def total_cost(p, state, scene, grids, points, vx, vy, w, best):
    """Return (cost, critic): the weighted sum of the critics and the one that ended the summation, ALL if none did.

    If a critic rejects the trajectory, its value is the cost. A sum above a positive `best` also ends the summation,
    and the cost is then this partial sum.
    """
    total = 0.0
    factors = weights(p)
    for critic in range(ALL):
        factor = factors[critic]
        if factor == 0:
            continue
        cost = critique(p, state, scene, grids, points, vx, vy, w, critic)
        if cost < 0:
            return cost, critic
        if cost != 0:
            cost *= factor
        total += cost
        if best > 0 and total > best:
            return total, critic
    return total, ALL


@kernel
def weighted_sum(p, occupied, front, alignment, path, goal, w):
    """Return the cost of a trajectory that no critic rejects, summed from the critics' values in their order."""
    _, by_obstacle, by_front, by_alignment, by_path, by_goal, by_turn = weights(p)
    cost = occupied * by_obstacle + front * by_front + alignment * by_alignment + path * by_path + goal * by_goal
    return cost + abs(w) * by_turn


@kernel
def _obstacle(p, scene, points, speed):
    """Return the largest cost under the scaled outline and the centre, or the sum over the points."""
    cells, ox, oy, resolution, footprint, lines, _, _ = scene
    ny, nx = cells.shape
    scaled = np.empty_like(footprint)
    scale_footprint(footprint, footprint_scale(p, speed), scaled)
    worst = total = 0
    for i in range(points.shape[0]):
        x, y, theta = points[i, 0], points[i, 1], points[i, 2]
        cx, cy = world_to_map(x, y, ox, oy, resolution, nx, ny)
        if cx < 0:
            return COLLIDES
        cost = outline_cost(
            cells,
            cells.reshape(-1),
            ox,
            oy,
            resolution,
            scaled,
            lines,
            x,
            y,
            math.cos(theta),
            math.sin(theta),
            cx,
            cy,
            0.0,
        )
        if cost < 0:
            return COLLIDES
        cost = max(cost, int(cells[cy, cx]))
        worst = max(worst, cost)
        total += cost
    return float(total if p.sum_scores else worst)


@kernel
def _on_grid(scene, grids, row, points, ahead, stops):
    """Return the grid's value `ahead` [m] of the last point. All points must be on the map, with `stops` reachable."""
    cells, ox, oy, resolution, _, _, _, _ = scene
    ny, nx = cells.shape
    value = 0.0
    for i in range(points.shape[0]):
        x, y = points[i, 0], points[i, 1]
        if ahead != 0.0:
            x = x + ahead * math.cos(points[i, 2])
            y = y + ahead * math.sin(points[i, 2])
        cx, cy = world_to_map(x, y, ox, oy, resolution, nx, ny)
        if cx < 0:
            return OFF_MAP
        if not grids.facts[0]:
            value = HUGE  # The grid was never flooded.
        elif stops or i == points.shape[0] - 1:
            distance = final_distance(grids, row, (cy + 1) * (nx + 2) + cx + 1, nx + 2, nx * ny)
            if stops and distance >= nx * ny:
                return IN_OBSTACLE if distance == nx * ny else UNREACHED
            value = float(distance)
    return value


# All samples of a cycle, one row per sample. velocities (m, 3): sampled vx, vy, w. stored (m, 3): velocity of the
# trajectory. counts (m,): number of its points, 0 if the generator rejects it. ends (m, 3): its last point. critics
# (m, 7): raw values of the critics. costs (m,): cost of the sample alone. shown (m,): cost in the search's order, whose
# summation stops above the best so far. ended (m,): critic that stopped it, ALL if none did. points: x, y, theta and
# shown cost of all trajectories whose shown cost is not negative, one after the other.
Samples = namedtuple("Samples", "velocities stored counts ends critics costs shown ended points")


@kernel
def score_all_samples(params, flags, grids, scratch, scene):
    """Score all samples of the last cycle. flags: record of the flags before that search."""
    p, state, start = params[0], flags[0], scratch.start
    nx, ny, nw = sample_axes(p, scratch, scene.plan)
    m = nx * ny * nw
    velocities, stored, ends = np.zeros((m, 3)), np.zeros((m, 3)), np.zeros((m, 3))
    counts, ended = np.zeros(m, np.int64), np.full(m, ALL, np.int64)
    critics, costs, shown = np.zeros((m, ALL)), np.full(m, REFUSED), np.full(m, REFUSED)
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
        for critic in range(ALL):
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
