"""What a forward sample costs at least, without rolling it out step by step.

Called by forward.py to leave out samples that cannot win. Poses come from closed forms and differ from
the exact ones by rounding errors, so a cell is used only where the pose is far enough from a cell border to be
sure of it: a bound is never above the exact cost, and no result depends on the closed forms.
"""

import math

from applr_ros1.common.kernels import kernel
from applr_ros1.planner.angles import LARGEST_TURN, small_turn
from applr_ros1.planner.costmap.footprint_cost import UNSURE, on_border, outline_cost
from applr_ros1.planner.costmap.grid import world_to_map
from applr_ros1.planner.trajectory.scoring import advance, new_velocity, step_count

MARGIN = 1e-6  # [cells]; the closed forms are good to about 1e-10


@kernel
def ramp(p, start, c, s, vx, w, dt, moves):
    """(moves made, x, y, c, s) where the sample (vx, w) first has its velocities, or after `moves`.

    c, s: cosine and sine of the heading, at the start and at the end.
    """
    x, y, vx_i, vy_i, w_i = start[0], start[1], start[3], start[4], start[5]
    for i in range(moves):
        if vx_i == vx and w_i == w and vy_i == 0.0:
            return i, x, y, c, s
        vx_i = new_velocity(vx, vx_i, p.acc_lim_x, dt)
        vy_i = new_velocity(0.0, vy_i, p.acc_lim_y, dt)
        w_i = new_velocity(w, w_i, p.acc_lim_theta, dt)
        x += (vx_i * c - vy_i * s) * dt
        y += (vx_i * s + vy_i * c) * dt
        turn = w_i * dt
        if abs(turn) < 0.25:
            dc, ds = small_turn(turn)
        else:
            dc, ds = math.cos(turn), math.sin(turn)
        c, s = c * dc - s * ds, s * dc + c * ds
    return moves, x, y, c, s


@kernel
def along_arc(x, y, c, s, length, turn, n):
    """(x, y) after n moves of `length` [m] and `turn` [rad] each: the chord of the polygon that they make.

    c, s: cosine and sine of the heading at the start; |turn| <= LARGEST_TURN.
    """
    half = 0.5 * turn
    dc, ds = small_turn(half)
    mc = math.cos((n - 1) * half)
    ms = math.sin((n - 1) * half)
    ratio = (ms * dc + mc * ds) / ds if half != 0.0 else float(n)
    return x + length * ratio * (c * mc - s * ms), y + length * ratio * (s * mc + c * ms)


@kernel
def exact_end(p, start, vx, w, steps):
    """(x, y) of the last scored point, step by step as scoring.score_below."""
    dt = p.sim_time / steps
    x, y, theta, vx_i, vy_i, w_i = start[0], start[1], start[2], start[3], start[4], start[5]
    for _ in range(steps - 1):
        vx_i = new_velocity(vx, vx_i, p.acc_lim_x, dt)
        vy_i = new_velocity(0.0, vy_i, p.acc_lim_y, dt)
        w_i = new_velocity(w, w_i, p.acc_lim_theta, dt)
        x, y = advance(x, y, theta, vx_i, vy_i, math.cos(theta), math.sin(theta), dt)
        theta = theta + w_i * dt
    return x, y


@kernel(error_model="numpy")
def end_cell(p, nx, ny, ox, oy, resolution, start, c, s, vx, w):
    """Cell (x, y) of the sample's last point, (-1, -1) off the map; c, s: of the heading at the start."""
    steps = step_count(p, vx, 0.0, w)
    dt = p.sim_time / steps
    turn = w * dt
    x = y = 0.0
    sure = abs(turn) <= LARGEST_TURN
    if sure:
        moves, x, y, c, s = ramp(p, start, c, s, vx, w, dt, steps - 1)
        x, y = along_arc(x, y, c, s, vx * dt, turn, steps - 1 - moves)
    if not sure or on_border((x - ox) / resolution, MARGIN) or on_border((y - oy) / resolution, MARGIN):
        x, y = exact_end(p, start, vx, w, steps)
    return world_to_map(x, y, ox, oy, resolution, nx, ny)


@kernel(error_model="numpy")
def probe(p, scene, start, c, s, vx, w, occupied, allowed):
    """A cost that the sample (vx, w) meets, from a few of its poses; -1 if one of them is illegal.

    Starts from `occupied`; a cost above `allowed` ends it. The last pose first, then halves, quarters, eighths.
    """
    cells, ox, oy, resolution, footprint, lines, _ = scene
    ny, nx = cells.shape
    flat = cells.reshape(nx * ny)
    steps = step_count(p, vx, 0.0, w)
    dt = p.sim_time / steps
    turn = w * dt
    if abs(turn) > LARGEST_TURN or footprint.shape[0] < 3:
        return occupied
    moves, x0, y0, c, s = ramp(p, start, c, s, vx, w, dt, steps - 1)
    left = steps - 1 - moves
    parts = 1
    while parts <= 8 and left // parts >= 8:
        for i in range(1, parts + 1, 2):
            n = left * i // parts
            x, y = along_arc(x0, y0, c, s, vx * dt, turn, n)
            dc = math.cos(n * turn)
            ds = math.sin(n * turn)
            cost = outline_cost(
                cells, flat, ox, oy, resolution, footprint, lines, x, y, c * dc - s * ds, s * dc + c * ds, 0, 0, MARGIN
            )
            if cost == UNSURE:
                continue
            if cost < 0:
                return -1
            occupied = max(occupied, cost)
            if occupied > allowed:
                return occupied
        parts *= 2
    return occupied
