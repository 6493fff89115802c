"""Choice of the velocity of a cycle (TrajectoryPlanner::createTrajectories): window, samples, winner, flags.

Called by planner.py once per control cycle. The choice equals that of the C++ planner to the last bit. The cycle
begins with the two distance grids, which count steps to the path and to the local goal
(base_local_planner/map_grid.cpp). At the end, a turn in place may replace the best forward sample
(docs/explanation/planner.md, section 6.5). The conditions of a turn have no side effects, so the cheap conditions come
first, and most turns are never rolled out.
"""

from __future__ import annotations

import math
from typing import Any, Tuple

import numpy as np

from applr_ros1.common.arrays import Data
from applr_ros1.common.kernels import kernel
from applr_ros1.planner.costmap.footprint import fill_footprint
from applr_ros1.planner.costmap.footprint_cost import outline_cost, outline_of
from applr_ros1.planner.costmap.grid import LETHAL, world_to_map
from applr_ros1.planner.distance_grid import (
    final_distance,
    place,
    reset,
    settle,
    start_at,
    start_at_plan,
)
from applr_ros1.planner.sampling_planner import (
    Record,
    Triple,
    angle_difference,
    take_start,
    through_quaternion,
)
from applr_ros1.planner.trajectory import scoring
from applr_ros1.planner.trajectory.forward import best_forward
from applr_ros1.planner.trajectory.records import Grids, Scene, Scratch
from applr_ros1.planner.trajectory.scoring import (
    COLLISION,
    HUGE,
    NO_CEILING,
    NO_PATH,
    new_velocity,
    score_below,
)


@kernel
def prepare(grids: Grids, scene: Scene, x: float, y: float, yaw: float) -> Tuple[int, int]:
    """Reset both grids, start their floods for a robot at a pose, and return the local goal's cell (x, y).

    Walls under the robot's footprint are passable in the path grid but not in the goal grid. The local goal is (-1, -1)
    if the plan is off the map.
    """
    reset(grids.path, scene.cells)
    reset(grids.goal, scene.cells)
    _open_under_robot(grids, scene, x, y, yaw)
    goal_x, goal_y = start_at_plan(grids.path, scene, scene.plan, True)
    if goal_x >= 0:
        start_at(grids.goal, place(grids.goal, goal_x, goal_y))
    return goal_x, goal_y


@kernel
def _open_under_robot(grids: Grids, scene: Scene, x: float, y: float, yaw: float) -> None:
    """Mark the cells under the robot's footprint (`within`) and make them passable in the path grid."""
    _, ox, oy, resolution, footprint, _, _ = scene
    ny, nx = grids.within.shape
    grids.within[:] = 0
    fill_footprint(grids.within, 1, ox, oy, resolution, footprint, (x, y, yaw), False)
    side = int(min(_farthest(footprint) / resolution, float(nx + ny))) + 2
    cx = int(min(max((x - ox) / resolution, 0.0), nx - 1.0))
    cy = int(min(max((y - oy) / resolution, 0.0), ny - 1.0))
    for row in range(max(0, cy - side), min(ny, cy + side + 1)):
        for column in range(max(0, cx - side), min(nx, cx + side + 1)):
            if grids.within[row, column]:
                grids.path.distance[place(grids.path, column, row)] = nx * ny + 1


@kernel
def _farthest(footprint: Data) -> float:
    """Return the largest distance [m] of the vertices (n, 2) from the robot's centre."""
    farthest = 0.0
    for i in range(footprint.shape[0]):
        farthest = max(farthest, math.hypot(footprint[i, 0], footprint[i, 1]))
    return farthest


WIDEST = 40  # largest radius around the robot that is searched for costs [cells]


@kernel(error_model="numpy")
def best_in_place(
    p: Record,
    state: Record,
    scene: Scene,
    grids: Grids,
    start: Data,
    ws: Data,
    dw: float,
    occupied: int,
    best: float,
) -> Tuple[float, float, int]:
    """Return (cost, w, number of points) of the turn that replaces the best forward sample, no points if none does.

    A turn must not cost more than the best sample or turn so far (at first `best`), must be faster than the step `dw`
    of `ws`, and must not be barred by `state`. The cell heading_lookahead ahead of the turned robot must be on the map
    and nearer to the goal than for all turns accepted before. occupied: cost at the first pose, which all turns share.
    """
    ny, nx = scene.cells.shape
    n = nx * ny
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
            k = place(grids.path, cx, cy)
            path_distance = settle(grids.path, k, n + 1)
            goal_distance = settle(grids.goal, k, n + 1)
            if path_distance >= n or goal_distance >= n:
                continue
            base = scoring.terms(p, float(path_distance), float(goal_distance))
        if base + p.occdist_scale * occupied > best:
            continue
        ahead = _distance_ahead(p, scene, grids, x, y, theta, heading_distance)
        if not 0 <= ahead < heading_distance:
            continue
        if ceiling < 0:
            ceiling = _surroundings(p, scene, start)
        cost, count, _, _, _ = score_below(
            p, scene, grids, start, (0.0, 0.0, w), ceiling, base, best
        )
        if 0 <= cost <= best:
            best, chosen, points, heading_distance = cost, w, count, float(ahead)
    return best, chosen, points


@kernel(error_model="numpy")
def _end(p: Record, start: Data, w: float) -> Triple:
    """Return the exact (x, y, theta) of the last scored point of a turn in place, which begins with braking."""
    steps = scoring.step_count(p, 0.0, 0.0, w)
    dt = p.sim_time / steps
    x, y, theta, vx_i, vy_i, w_i = start[0], start[1], start[2], start[3], start[4], start[5]
    for _ in range(steps - 1):
        w_i = new_velocity(w, w_i, p.acc_lim_theta, dt)
        if vx_i != 0.0 or vy_i != 0.0:
            vx_i = new_velocity(0.0, vx_i, p.acc_lim_x, dt)
            vy_i = new_velocity(0.0, vy_i, p.acc_lim_y, dt)
            x, y = scoring.advance(x, y, theta, vx_i, vy_i, math.cos(theta), math.sin(theta), dt)
        theta = theta + w_i * dt
    return x, y, theta


@kernel
def _distance_ahead(
    p: Record, scene: Scene, grids: Grids, x: float, y: float, theta: float, limit: float
) -> int:
    """Return the goal distance heading_lookahead ahead of a pose; -1 if off the map or not below `limit`."""
    ny, nx = scene.cells.shape
    n = nx * ny
    ahead_x = x + p.heading_lookahead * math.cos(theta)
    ahead_y = y + p.heading_lookahead * math.sin(theta)
    cx, cy = world_to_map(ahead_x, ahead_y, scene.ox, scene.oy, scene.resolution, nx, ny)
    if cx < 0:
        return -1
    goal = grids.goal
    k = place(goal, cx, cy)
    value = settle(goal, k, int(min(limit, n + 1.0)))
    if value > n and goal.ends[0] < goal.ends[1]:
        return -1
    return final_distance(goal, k) if value == n and limit > n else value


@kernel(error_model="numpy")
def _surroundings(p: Record, scene: Scene, start: Data) -> int:
    """Return an upper bound of costs under a turn in place from `start`, NO_CEILING if unknown or lethal."""
    ny, nx = scene.cells.shape
    reach = start[3] * start[3] / (2 * p.acc_lim_x) + start[4] * start[4] / (
        2 * p.acc_lim_y
    )  # braking distance
    reach = (reach + _farthest(scene.footprint)) / scene.resolution
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


@kernel(error_model="numpy")
def find_best_path(
    params: Data,
    state: Data,
    grids: Grids,
    scratch: Scratch,
    scene: Scene,
    pose: Triple,
    velocity: Triple,
) -> Tuple[Any, ...]:
    """Run one cycle: floods, samples, winner, flags. params, state: arrays of one record.

    Returns (cost, vx, w, number of points, commanded vx, commanded w). A negative cost means no valid command.
    Pose and velocity are first rounded to float32, as in C++.
    """
    p = params[0]
    start = scratch.start
    take_start(start, pose, velocity)
    prepare(grids, scene, start[0], start[1], start[2])
    least_vx, most_vx, least_w, most_w = velocity_window(p, scene.plan, start)
    vs = scratch.vs[: p.vx_samples]
    ws = scratch.ws[: p.vtheta_samples]
    fill_evenly(least_vx, most_vx, vs)
    dw = fill_evenly(least_w, most_w, ws)
    if (
        ws.shape[0] == 1
    ):  # C++ divides by zero here. A single turn passes its test only if the window is inverted.
        dw = -np.inf if most_w < least_w else np.inf

    cost, best_vx, best_w, points = HUGE, 0.0, 0.0, 0
    occupied = first_pose(p, scene, grids, start)
    if occupied >= 0:
        if not state[0].escaping:
            cost, best_vx, best_w, points = best_forward(
                p, scene, grids, scratch, start, vs, ws, occupied
            )
        turn_cost, turn_w, turn_points = best_in_place(
            p, state[0], scene, grids, start, ws, dw, occupied, cost
        )
        if turn_points > 0:
            cost, best_vx, best_w, points = turn_cost, 0.0, turn_w, turn_points
    legal = points > 0
    if not legal:
        best_vx = p.escape_vel
        cost, points, _, _, _ = score_below(
            p, scene, grids, start, (best_vx, 0.0, 0.0), NO_CEILING, 0.0, np.inf
        )
    remember(p, state[0], start, cost, best_vx, best_w, legal)
    if cost == COLLISION:
        cost = 1.0  # The robot backs out even into an obstacle.
    if cost < 0:
        return cost, best_vx, best_w, points, 0.0, 0.0
    return cost, best_vx, best_w, points, best_vx, through_quaternion(best_w)


@kernel(error_model="numpy")
def velocity_window(p: Record, plan: Data, start: Data) -> Tuple[float, float, float, float]:
    """Return (least vx, most vx, least w, most w) of this cycle's samples. docs/explanation/planner.md, section 6.3."""
    most_vx = p.max_vel_x
    if plan.shape[0] > 0:
        last = plan.shape[0] - 1
        away = math.hypot(plan[last, 0] - start[0], plan[last, 1] - start[1])
        most_vx = min(most_vx, away / p.sim_time)
    period = p.sim_period if p.dwa else p.sim_time
    most_vx = max(min(most_vx, start[3] + p.acc_lim_x * period), p.min_vel_x)
    least_vx = max(p.min_vel_x, start[3] - p.acc_lim_x * period)
    most_w = min(p.max_vel_theta, start[5] + p.acc_lim_theta * period)
    least_w = max(p.min_vel_theta, start[5] - p.acc_lim_theta * period)
    return least_vx, most_vx, least_w, most_w


@kernel
def fill_evenly(least: float, most: float, values: Data) -> float:
    """Fill `values` (n,) from `least` to `most` by repeated addition of a step; return the step (0 for one value)."""
    n = values.shape[0]
    step = (most - least) / (n - 1) if n > 1 else 0.0
    value = least
    for i in range(n):
        values[i] = value
        value += step
    return step


@kernel
def first_pose(p: Record, scene: Scene, grids: Grids, start: Data) -> int:
    """Return the cost under the robot at its current pose, the first point of every sample, or COLLISION or NO_PATH."""
    ny, nx = scene.cells.shape
    cx, cy = world_to_map(start[0], start[1], scene.ox, scene.oy, scene.resolution, nx, ny)
    if cx < 0:
        return int(COLLISION)
    outline = outline_of(scene, scene.footprint)
    cost = outline_cost(
        outline, start[0], start[1], math.cos(start[2]), math.sin(start[2]), cx, cy, 0.0
    )
    if cost < 0:
        return int(COLLISION)
    if not p.simple_attractor and not p.heading_scoring:
        n = nx * ny
        k = place(grids.goal, cx, cy)
        if settle(grids.goal, k, n + 1) >= n or settle(grids.path, k, n + 1) >= n:
            return int(NO_PATH)
    return max(cost, int(scene.cells[cy, cx]))


@kernel
def remember(
    p: Record, state: Record, start: Data, cost: float, vx: float, w: float, legal: bool
) -> None:
    """Update the flags with the choice of the cycle. docs/explanation/planner.md, section 6.6.

    legal: whether the choice is a forward sample or a turn. Otherwise the robot backs out, at `cost`.
    """
    x, y, theta = start[0], start[1], start[2]
    if legal and not vx > 0:
        if w < 0:
            state.stuck_right = state.stuck_right or state.rotating_right
            state.rotating_right = 1
        elif w > 0:
            state.stuck_left = state.stuck_left or state.rotating_left
            state.rotating_left = 1
        state.prev_x = x
        state.prev_y = y
    if math.hypot(x - state.prev_x, y - state.prev_y) > p.oscillation_reset_dist:
        state.stuck_left = state.stuck_right = state.rotating_left = state.rotating_right = 0
    if not legal and not state.escaping and cost > NO_PATH:
        state.escape_x = x
        state.escape_y = y
        state.escape_theta = theta
        state.escaping = 1
    if (
        math.hypot(x - state.escape_x, y - state.escape_y) > p.escape_reset_dist
        or abs(angle_difference(state.escape_theta, theta)) > p.escape_reset_theta
    ):
        state.escaping = 0
