"""Chooses the velocity of a cycle (TrajectoryPlanner::createTrajectories): window, samples, winner, flags.

Called by planner.py once per control cycle. The choice is the C++ planner's to the last bit.
"""

from __future__ import annotations

import math
from collections import namedtuple

import numpy as np

from applr_ros1.common.kernels import kernel
from applr_ros1.planner.angles import angle_difference, normalize_angle
from applr_ros1.planner.costmap.footprint_cost import outline_cost
from applr_ros1.planner.costmap.grid import world_to_map
from applr_ros1.planner.distance_grid import settle
from applr_ros1.planner.trajectory.forward import best_forward
from applr_ros1.planner.trajectory.in_place import best_in_place
from applr_ros1.planner.trajectory.map_grid import prepare
from applr_ros1.planner.trajectory.scoring import COLLISION, HUGE, NO_CEILING, NO_PATH, score_below

# What the planner remembers between cycles; the order is that of TrajectoryPlanner.state.
STATE = np.dtype(
    [
        (name, np.int64)
        for name in (
            "stuck_left",
            "stuck_right",
            "rotating_left",
            "rotating_right",
            "escaping",
        )
    ]
    + [(name, np.float64) for name in ("prev_x", "prev_y", "escape_x", "escape_y", "escape_theta")]
)

# Room for one cycle: vs (vx_samples,), ws (vtheta_samples,); of every forward sample its lower bounds (bases of the
# path and goal terms, keys of the cost), the heap and whether it was probed; start (6,), where samples begin.
Scratch = namedtuple("Scratch", "vs ws bases keys heap probed start")


def allocate(vx_samples: int, vtheta_samples: int) -> Scratch:
    """Scratch for so many samples."""
    n = vx_samples * vtheta_samples
    return Scratch(
        np.zeros(vx_samples),
        np.zeros(vtheta_samples),
        np.zeros(n),
        np.zeros(n),
        np.zeros(n, np.int64),
        np.zeros(n, np.uint8),
        np.zeros(6),
    )


@kernel(error_model="numpy")
def find_best_path(params, state, grids, scratch, scene, x, y, yaw, vx, vy, w):
    """One cycle: floods, samples, winner, flags. params, state: one record each.

    Returns (cost, vx, w, number of points, commanded vx, commanded w); a cost below 0 means no valid command.
    Pose and velocity go through float32 first, as in C++.
    """
    p = params[0]
    start = scratch.start
    start[0] = np.float32(x)
    start[1] = np.float32(y)
    start[2] = np.float32(normalize_angle(yaw))
    start[3] = np.float32(vx)
    start[4] = np.float32(vy)
    start[5] = np.float32(normalize_angle(w))
    prepare(
        grids,
        scene.cells,
        scene.ox,
        scene.oy,
        scene.resolution,
        scene.footprint,
        start[0],
        start[1],
        start[2],
        scene.plan,
    )

    least_vx, most_vx, least_w, most_w = velocity_window(p, scene.plan, start)
    vs = scratch.vs[: p.vx_samples]
    ws = scratch.ws[: p.vtheta_samples]
    fill_evenly(least_vx, most_vx, vs)
    dw = fill_evenly(least_w, most_w, ws)
    if ws.shape[0] == 1:  # C++ divides by zero: a single turn passes its test only for a negative width
        dw = -np.inf if most_w < least_w else np.inf

    cost, best_vx, best_w, points = HUGE, 0.0, 0.0, 0
    occupied = first_pose(p, scene, grids, start)
    if occupied >= 0:
        if not state[0].escaping:
            cost, best_vx, best_w, points = best_forward(p, scene, grids, scratch, start, vs, ws, occupied)
        turn_cost, turn_w, turn_points = best_in_place(p, state[0], scene, grids, start, ws, dw, occupied, cost)
        if turn_points > 0:
            cost, best_vx, best_w, points = turn_cost, 0.0, turn_w, turn_points
    legal = points > 0
    if not legal:
        best_vx = p.escape_vel
        cost, points, _, _, _ = score_below(p, scene, grids, start, best_vx, 0.0, 0.0, NO_CEILING, 0.0, np.inf)
    remember(p, state[0], start, cost, best_vx, best_w, legal)
    if cost == COLLISION:
        cost = 1.0  # backs up even into an obstacle
    if cost < 0:
        return cost, best_vx, best_w, points, 0.0, 0.0
    return cost, best_vx, best_w, points, best_vx, normalize_angle(best_w)


@kernel(error_model="numpy")
def velocity_window(p, plan, start):
    """(least vx, most vx, least w, most w) of this cycle's samples. docs/explanation/planner.md, section 6.3."""
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
def fill_evenly(least, most, values):
    """Fill `values` (n,) from `least` on in equal steps by repeated addition; returns the step, 0 for one value."""
    n = values.shape[0]
    step = (most - least) / (n - 1) if n > 1 else 0.0
    value = least
    for i in range(n):
        values[i] = value
        value += step
    return step


@kernel
def first_pose(p, scene, grids, start):
    """Cost under the robot as it stands, COLLISION or NO_PATH: the first point of every sample."""
    cells, ox, oy, resolution, footprint, lines, _ = scene
    ny, nx = cells.shape
    cx, cy = world_to_map(start[0], start[1], ox, oy, resolution, nx, ny)
    if cx < 0:
        return int(COLLISION)
    cost = outline_cost(
        cells,
        cells.reshape(nx * ny),
        ox,
        oy,
        resolution,
        footprint,
        lines,
        start[0],
        start[1],
        math.cos(start[2]),
        math.sin(start[2]),
        cx,
        cy,
        0.0,
    )
    if cost < 0:
        return int(COLLISION)
    if not p.simple_attractor and not p.heading_scoring:
        k = (cy + 1) * (nx + 2) + cx + 1
        unseen = nx * ny + 1
        if (
            settle(grids.goal, grids.goal_queue, grids.goal_ends, nx + 2, unseen, k, unseen) >= nx * ny
            or settle(grids.path, grids.path_queue, grids.path_ends, nx + 2, unseen, k, unseen) >= nx * ny
        ):
            return int(NO_PATH)
    return max(cost, int(cells[cy, cx]))


@kernel
def remember(p, state, start, cost, vx, w, legal):
    """Take the cycle's choice into the flags. docs/explanation/planner.md, section 6.6.

    legal: the choice is a forward sample or a turn; otherwise it is backing up, at `cost`.
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
