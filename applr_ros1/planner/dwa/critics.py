"""The critics of one trajectory, each over all its points, in the order of the C++ planner.

Called for single trajectories and for what is shown of a cycle (score_all_samples.py); the search finds the same costs
with less work. A negative value refuses the trajectory. docs/explanation/planner_dwa.md section 6.
"""

import math

import numpy as np

from applr_ros1.common.kernels import kernel
from applr_ros1.planner import distance_grid
from applr_ros1.planner.costmap.footprint_cost import outline_cost
from applr_ros1.planner.costmap.grid import world_to_map
from applr_ros1.planner.dwa.generator import ground_speed
from applr_ros1.planner.dwa.oscillation import is_barred
from applr_ros1.planner.dwa.records import ALIGNMENT, FRONT, GOAL, PATH

OSCILLATES, COLLIDES, OFF_MAP, IN_OBSTACLE, UNREACHED = -5.0, -6.0, -4.0, -3.0, -2.0
NOTHING_LEGAL = -7.0
REFUSED = -1.0  # by the generator
CRITICS = 7
HUGE = float(np.finfo(np.float64).max)


@kernel
def weight(p, critic):
    """The weight of a critic by its place in the order; one of weight 0 is not asked."""
    if critic == 0:
        return 1.0
    if critic == 1:
        return p.occdist_scale
    if critic == 3:
        return p.alignment_scale
    if critic == 4:
        return p.path_scale
    if critic == 6:
        return p.twirling_scale
    return p.goal_scale


@kernel(error_model="numpy")
def footprint_scale(p, speed):
    """How much larger the footprint counts at this speed [m/s]."""
    if speed <= p.scaling_speed:
        return 1.0
    return p.max_scaling_factor * ((speed - p.scaling_speed) / (p.max_vel_trans - p.scaling_speed)) + 1.0


@kernel
def scale_footprint(footprint, scale, scaled):
    """Write the vertices (n, 2), each coordinate times `scale`, into `scaled`."""
    for i in range(footprint.shape[0]):
        scaled[i, 0] = footprint[i, 0] * scale
        scaled[i, 1] = footprint[i, 1] * scale


@kernel
def final_distance(grids, row, k, stride, n):
    """The value that C++ holds at the cell k of one grid: a distance, n for a wall, n + 1 where no flood comes."""
    return distance_grid.final_distance(grids.distances[row], grids.queues[row], grids.ends[row], stride, n, k)


@kernel
def critique(p, state, scene, grids, points, vx, vy, w, critic):
    """The value of one critic for a trajectory: its points (k, 3) and its velocity. No points: 0."""
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
    """(cost, critic): the weighted sum of the critics, and the one that ended it, CRITICS if none did.

    A refusing critic's value is the cost. A sum above `best`, if that is above 0, ends it too: with that partial sum.
    """
    total = 0.0
    for critic in range(CRITICS):
        factor = weight(p, critic)
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
    return total, CRITICS


@kernel
def weighted_sum(p, occupied, front, alignment, path, goal, w):
    """The cost of a trajectory that no critic refuses, from their values: summed in their order."""
    cost = occupied * p.occdist_scale
    cost += front * p.goal_scale
    cost += alignment * p.alignment_scale
    cost += path * p.path_scale
    cost += goal * p.goal_scale
    return cost + abs(w) * p.twirling_scale


@kernel
def _obstacle(p, scene, points, speed):
    """The largest cost under the scaled outline and the centre, or the sum over the points."""
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
    """The grid's value `ahead` [m] of the last point. Every point must be on the map and, if it stops, reachable."""
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
            value = HUGE  # never flooded
        elif stops or i == points.shape[0] - 1:
            distance = final_distance(grids, row, (cy + 1) * (nx + 2) + cx + 1, nx + 2, nx * ny)
            if stops and distance >= nx * ny:
                return IN_OBSTACLE if distance == nx * ny else UNREACHED
            value = float(distance)
    return value
