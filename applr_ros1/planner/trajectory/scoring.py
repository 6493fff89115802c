"""Roll-out and scoring of one velocity sample (TrajectoryPlanner::generateTrajectory), without ROS or state.

Called for the samples of a cycle, and by TrajectoryPlanner.score for single samples. All arithmetic is double, in the
order of the C++ code, so that results are equal to the last bit.
"""

import math
from typing import Tuple

import numpy as np

from applr_ros1.common.arrays import Data
from applr_ros1.common.kernels import kernel
from applr_ros1.planner.costmap.footprint import line_cost
from applr_ros1.planner.costmap.footprint_cost import outline_cost, outline_of
from applr_ros1.planner.costmap.grid import INSCRIBED, map_to_world, world_to_map
from applr_ros1.planner.distance_grid import place, settle
from applr_ros1.planner.sampling_planner import Record, Triple, angle_difference
from applr_ros1.planner.trajectory.records import Grids, Scene, Scratch

COLLISION = -1.0  # cost of a sample off the map, or with the footprint on a lethal or unknown cell
NO_PATH = -2.0  # cost of a sample from which neither path nor goal can be reached
PRUNED = -3.0  # cost of a sample whose scoring stopped because the sample cannot beat the best one
NO_CEILING = 256  # upper bound of cell costs that excludes nothing, because all costs are below it
HUGE = float(np.finfo(np.float64).max)
Score = Tuple[
    float, int, float, float, float
]  # cost, number of points, and x, y, theta of the last point


@kernel
def new_velocity(target: float, velocity: float, acceleration: float, dt: float) -> float:
    """Return the velocity after dt of acceleration towards `target`."""
    if target - velocity >= 0:
        return min(target, velocity + acceleration * dt)
    return max(target, velocity - acceleration * dt)


@kernel
def advance(
    x: float, y: float, theta: float, vx: float, vy: float, c: float, s: float, dt: float
) -> Tuple[float, float]:
    """Return the position (x, y) after dt. c and s are cosine and sine of theta."""
    if vy == 0.0:
        return x + vx * c * dt, y + vx * s * dt
    return (
        x + (vx * c + vy * math.cos(math.pi / 2 + theta)) * dt,
        y + (vx * s + vy * math.sin(math.pi / 2 + theta)) * dt,
    )


@kernel(error_model="numpy")
def step_count(p: Record, vx: float, vy: float, w: float) -> int:
    """Return the number of steps, at least 1, of the sample (vx, vy, w). As in C++, sim_time does not affect turns."""
    if p.heading_scoring:
        return max(int(p.sim_time / p.sim_granularity + 0.5), 1)
    speed = abs(vx) if vy == 0.0 else math.hypot(vx, vy)
    return max(
        int(max(speed * p.sim_time / p.sim_granularity, abs(w) / p.angular_sim_granularity) + 0.5),
        1,
    )


@kernel
def terms(p: Record, path_distance: float, goal_distance: float) -> float:
    """Return the sum of the path and goal terms of a cost."""
    return p.path_distance_bias * path_distance + goal_distance * p.goal_distance_bias


@kernel
def score(params: Data, scene: Scene, grids: Grids, start: Data, sample: Triple) -> Score:
    """Return (cost, number of points, end x, y, theta) of one sample, see score_below. params: array of one record."""
    return score_below(params[0], scene, grids, start, sample, NO_CEILING, 0.0, np.inf)


@kernel(error_model="numpy")
def score_below(
    p: Record,
    scene: Scene,
    grids: Grids,
    start: Data,
    sample: Triple,
    ceiling: int,
    base: float,
    bound: float,
) -> Score:
    """Score the sample (vx, vy, w) from `start` (6,): x, y, theta and the velocities vx, vy, w there.

    Returns (cost, number of points, x, y, theta of the last point). The cost is >= 0, COLLISION, NO_PATH, or PRUNED as
    soon as `base` (a lower bound of the path and goal terms) plus the obstacle term exceeds `bound`.
    ceiling: upper bound of the costs under the footprint on its way, which saves tests; NO_CEILING if unknown.
    """
    vx, vy, w = sample
    cells, ox, oy, resolution, footprint, _, plan = scene
    outline = outline_of(scene, footprint)
    path, goal, _ = grids
    path_distances, goal_distances = (
        path.distance,
        goal.distance,
    )  # Access within the loop would count references.
    ny, nx = cells.shape
    impossible = nx * ny
    unseen = impossible + 1
    steps = step_count(p, vx, vy, w)
    dt = p.sim_time / steps
    x, y, theta, vx_i, vy_i, w_i = start[0], start[1], start[2], start[3], start[4], start[5]
    end_x = end_y = end_theta = time = 0.0
    occupied = 0
    path_distance = goal_distance = heading_difference = 0.0
    for i in range(steps):
        cx, cy = world_to_map(x, y, ox, oy, resolution, nx, ny)
        if cx < 0:
            return COLLISION, i, end_x, end_y, end_theta
        c = math.cos(theta)
        s = math.sin(theta)
        if occupied < ceiling:
            met = outline_cost(outline, x, y, c, s, cx, cy, 0.0)
            if met < 0:
                return COLLISION, i, end_x, end_y, end_theta
            occupied = max(occupied, met, int(cells[cy, cx]))
            if base + p.occdist_scale * occupied > bound:
                return PRUNED, i, end_x, end_y, end_theta
        if p.simple_attractor:
            if plan.shape[0] > 0:
                dx = x - plan[plan.shape[0] - 1, 0]
                dy = y - plan[plan.shape[0] - 1, 1]
                goal_distance = dx * dx + dy * dy
        elif (
            not p.heading_scoring
            or p.heading_scoring_timestep <= time < p.heading_scoring_timestep + dt
        ):
            k = place(path, cx, cy)
            goal_steps = int(goal_distances[k])
            path_steps = int(path_distances[k])
            if goal_steps == unseen:
                goal_steps = settle(goal, k, unseen)
            if path_steps == unseen:
                path_steps = settle(path, k, unseen)
            if goal_steps >= impossible or path_steps >= impossible:
                return NO_PATH, i, end_x, end_y, end_theta
            path_distance = float(path_steps)
            goal_distance = float(goal_steps)
            if p.heading_scoring:
                heading_difference = _heading_difference(scene, cx, cy, x, y, theta)
        end_x, end_y, end_theta = x, y, theta
        vx_i = new_velocity(vx, vx_i, p.acc_lim_x, dt)
        vy_i = new_velocity(vy, vy_i, p.acc_lim_y, dt)
        w_i = new_velocity(w, w_i, p.acc_lim_theta, dt)
        x, y = advance(x, y, theta, vx_i, vy_i, c, s, dt)
        theta = theta + w_i * dt
        time += dt
    cost = terms(p, path_distance, goal_distance) + p.occdist_scale * occupied
    if p.heading_scoring:  # C++ adds the terms in another order here.
        cost = p.occdist_scale * occupied + p.path_distance_bias * path_distance
        cost = cost + 0.3 * heading_difference + goal_distance * p.goal_distance_bias
    return cost, steps, end_x, end_y, end_theta


@kernel
def roll_out(params: Data, start: Data, vx: float, w: float, points: Data) -> None:
    """Write the first poses x, y, theta of the sample (vx, w) to `points` (n, 3), as score_below visits them."""
    p = params[0]
    dt = p.sim_time / step_count(p, vx, 0.0, w)
    x, y, theta, vx_i, vy_i, w_i = start[0], start[1], start[2], start[3], start[4], start[5]
    for i in range(points.shape[0]):
        points[i, 0] = x
        points[i, 1] = y
        points[i, 2] = theta
        vx_i = new_velocity(vx, vx_i, p.acc_lim_x, dt)
        vy_i = new_velocity(0.0, vy_i, p.acc_lim_y, dt)
        w_i = new_velocity(w, w_i, p.acc_lim_theta, dt)
        x, y = advance(x, y, theta, vx_i, vy_i, math.cos(theta), math.sin(theta), dt)
        theta = theta + w_i * dt


@kernel
def _heading_difference(scene: Scene, cx: int, cy: int, x: float, y: float, theta: float) -> float:
    """Return the angle [rad] from the heading to the farthest plan point in free sight, HUGE if there is none."""
    cells, ox, oy, resolution, _, _, plan = scene
    ny, nx = cells.shape
    for i in range(plan.shape[0] - 1, -1, -1):
        mx, my = world_to_map(plan[i, 0], plan[i, 1], ox, oy, resolution, nx, ny)
        if mx < 0 or not 0 <= line_cost(cells, cx, cy, mx, my) < INSCRIBED:
            continue
        gx, gy = map_to_world(mx, my, ox, oy, resolution)
        return abs(angle_difference(theta, math.atan2(gy - y, gx - x)))
    return HUGE


POINTS = (
    12  # largest number of points shown per trajectory; all points would take megabytes per message
)


@kernel
def score_all_samples(
    params: Data, scene: Scene, grids: Grids, scratch: Scratch
) -> Tuple[Data, Data]:
    """Return (cloud, refused) of all forward samples of the last cycle. The search itself rolls out far fewer.

    cloud (n, 4): x, y, theta, cost of up to POINTS points per legal sample, evenly spaced and including its last point.
    refused (2,): numbers of samples of cost COLLISION and NO_PATH.
    """
    p = params[0]
    turns = scratch.ws.shape[0] + 1  # Each speed is also tried straight ahead.
    m = scratch.vs.shape[0] * turns
    cloud, refused = np.empty((m * POINTS, 4)), np.zeros(2, np.int64)
    n = 0
    for i in range(m):
        v = scratch.vs[i // turns]
        w = scratch.ws[i % turns - 1] if i % turns > 0 else 0.0
        cost, count, _, _, _ = score_below(
            p, scene, grids, scratch.start, (v, 0.0, w), NO_CEILING, 0.0, np.inf
        )
        if cost < 0:
            refused[0 if cost == COLLISION else 1] += 1
            continue
        points = np.empty((count, 3))
        roll_out(params, scratch.start, v, w, points)
        step = (count + POINTS - 1) // POINTS
        for k in range((count - 1) % step, count, step):
            cloud[n, :3] = points[k]
            cloud[n, 3] = cost
            n += 1
    return cloud[:n], refused
