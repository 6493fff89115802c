"""Where a sample's trajectory ends, from a closed form, and how far from that the real one can be.

Called by bounds.py. The real trajectory is rounded to float32 in every step; a cell is told from the closed form only
where the pose is farther from a cell border than these roundings can have led it astray.
"""

import math

from applr_ros1.common.kernels import kernel
from applr_ros1.planner.angles import LARGEST_TURN, small_turn
from applr_ros1.planner.costmap.grid import world_to_map
from applr_ros1.planner.dwa.generator import commanded, move, ramped

ROUNDING = 1.01 * 2.0**-24  # of one float32 value, with something for the closed forms
FORMULA = 1e-9  # [m]; the closed forms by themselves are good to about 1e-12
AT_BORDER = -(1 << 40)  # instead of a cell: too close to a border between two to be told


@kernel
def arc(dx, dy, turn, dt, moves):
    """(x, y, cos, sin): the way from the start and the heading's change after equal moves of dt [s] and `turn` [rad].

    dx, dy: velocity at the start, in the axes of the map; |turn| <= LARGEST_TURN.
    """
    half = 0.5 * turn
    dc, ds = small_turn(half)
    mc = math.cos((moves - 1) * half)
    ms = math.sin((moves - 1) * half)
    ts = ms * dc + mc * ds  # of moves * half
    tc = mc * dc - ms * ds
    length = dt * (ts / ds if half != 0.0 else float(moves))
    return length * (dx * mc - dy * ms), length * (dy * mc + dx * ms), 1 - 2 * ts * ts, 2 * ts * tc


@kernel
def arc_errors(x, y, theta, speed, w, sim_time, steps):
    """How far the float32 trajectory may be from the closed form, at most: position [m] and heading [rad].

    x, y, theta: where it begins.
    """
    length = speed * sim_time
    heading = steps * ROUNDING * (abs(theta) + abs(w) * sim_time)
    return steps * ROUNDING * (max(abs(x), abs(y)) + length) + length * heading + FORMULA, heading


@kernel
def sure_cell(f, margin):
    """The cell of a coordinate counted in cells, below 0 if below the map; AT_BORDER within `margin` of a border."""
    nearest = math.floor(f + 0.5)
    if abs(f - nearest) < margin:
        return AT_BORDER
    return int(math.floor(f))


@kernel(error_model="numpy")
def sure_end_cells(x0, y0, theta0, c, s, ox, oy, per_cell, dx, dy, speed, w, sim_time, steps, ahead):
    """Cells (x, y) of the last point and of its nose, in and beyond the map; AT_BORDER what cannot be told.

    x0, y0, theta0, c, s: where it begins, with cosine and sine. ox, oy: the map's origin; per_cell: 1 / resolution.
    dx, dy: velocity at the start in the axes of the map; ahead: of the nose. Only for a constant velocity.
    """
    dt = sim_time / steps
    turn = w * dt
    if abs(turn) > LARGEST_TURN:
        return AT_BORDER, AT_BORDER, AT_BORDER, AT_BORDER
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
    return end_x, end_y, nose_x, nose_y


@kernel
def exact_end(p, start, vx, vy, w, steps):
    """(x, y, theta) of the last point, step by step as generator.roll_out."""
    dt = p.sim_time / steps
    x, y, theta = start[0], start[1], start[2]
    vx_now, vy_now, w_now = commanded(p, start, vx, vy, w, steps)
    for _ in range(steps - 1):
        if not p.use_dwa:
            vx_now, vy_now, w_now = ramped(p, vx, vy, w, vx_now, vy_now, w_now, dt)
        x, y, theta = move(x, y, theta, math.cos(theta), math.sin(theta), vx_now, vy_now, w_now, dt)
    return x, y, theta


@kernel
def exact_end_cells(p, scene, start, vx, vy, w, steps):
    """Cells (x, y) of the last point and of its nose, each (-1, -1) off the map."""
    ny, nx = scene.cells.shape
    ahead = p.forward_point_distance
    x, y, theta = exact_end(p, start, vx, vy, w, steps)
    fx, fy = x, y
    if ahead != 0.0:
        fx = x + ahead * math.cos(theta)
        fy = y + ahead * math.sin(theta)
    cx, cy = world_to_map(x, y, scene.ox, scene.oy, scene.resolution, nx, ny)
    nose_x, nose_y = world_to_map(fx, fy, scene.ox, scene.oy, scene.resolution, nx, ny)
    return cx, cy, nose_x, nose_y
