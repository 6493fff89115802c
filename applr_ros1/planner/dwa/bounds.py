"""What a sample costs at least, without rolling it out step by step.

Called by search.py to leave out samples that cannot win. Poses come from closed forms; a cell is used only where the
pose is farther from a cell border than the float32 steps of the real trajectory can have led it astray. So a bound is
never above the exact cost, and no result depends on the closed forms.
"""

import math

from applr_ros1.common.kernels import kernel
from applr_ros1.planner.costmap.grid import world_to_map
from applr_ros1.planner.costmap.outline import UNSURE, outline_cost
from applr_ros1.planner.distance_grid import settle
from applr_ros1.planner.dwa.generator import commanded, move, ramped
from applr_ros1.planner.dwa.records import FRONT, GOAL, PATH
from applr_ros1.planner.trajectory.bounds import LARGEST_TURN, small_turn

ROUNDING = 1.01 * 2.0**-24  # of one float32 value, with something for the closed forms
AT_BORDER = -(1 << 40)  # instead of a cell: too close to a border between two to be told
FORMULA = 1e-9  # [m]; the closed forms by themselves are good to about 1e-12


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


@kernel(error_model="numpy")
def probe(p, scene, scaled, start, c, s, vx, vy, w, speed, steps, occupied, allowed):
    """An obstacle cost that the sample meets, from a few of its poses; -1 if one of them is illegal.

    Starts from `occupied`; a cost above `allowed` ends it. The last pose first, then halves, quarters, eighths.
    scaled: the footprint (n, 2) at the sample's speed.
    """
    cells, ox, oy, resolution, _, lines, _, _ = scene
    ny, nx = cells.shape
    flat = cells.reshape(nx * ny)
    dt = p.sim_time / steps
    turn = w * dt
    if not p.use_dwa or abs(turn) > LARGEST_TURN or scaled.shape[0] < 3:
        return occupied
    error, heading = arc_errors(start[0], start[1], start[2], speed, w, p.sim_time, steps)
    margin = (error + heading * _reach(scaled)) / resolution + 1e-9
    dx = vx * c - vy * s
    dy = vx * s + vy * c
    left = steps - 1
    parts = 1
    while parts <= 8 and left // parts >= 3:
        for i in range(1, parts + 1, 2):
            x, y, hc, hs = arc(dx, dy, turn, dt, left * i // parts)
            x += start[0]
            y += start[1]
            ec = c * hc - s * hs
            es = s * hc + c * hs
            cost = outline_cost(cells, flat, ox, oy, resolution, scaled, lines, x, y, ec, es, 0, 0, margin)
            if cost == UNSURE:
                continue
            if cost < 0:
                return -1
            occupied = max(occupied, cost)
            if occupied > allowed:
                return occupied
        parts *= 2
    return occupied


@kernel
def _reach(footprint):
    """The largest coordinate [m] of the vertices (n, 2), doubled: more than any vertex is away from the centre."""
    reach = 0.0
    for i in range(footprint.shape[0]):
        reach = max(reach, abs(footprint[i, 0]), abs(footprint[i, 1]))
    return 2.0 * reach


@kernel
def at_least(grids, row, k, nx, ny, limit):
    """The value of the cell k in one grid, walls as N; limit + 1 where the flood would have to go beyond the limit."""
    n = nx * ny
    value = int(grids.distances[row, k])
    if value <= n:
        return value
    value = settle(grids.distances[row], grids.queues[row], grids.ends[row], nx + 2, n + 1, k, limit)
    if value > n and grids.ends[row, 0] < grids.ends[row, 1]:
        return limit + 1
    return value


@kernel
def flood_limits(p, grids, scene, start, cx, cy):
    """How far the floods of path, goal and front may go for bounds: not much farther than the robot gets.

    Behind walls there may be cells that only a flood of the whole map would reach.
    """
    ny, nx = scene.cells.shape
    n = nx * ny
    speed = max(abs(p.max_vel_x), abs(p.min_vel_x)) + max(abs(p.max_vel_y), abs(p.min_vel_y))
    if p.max_vel_trans >= 0:
        speed = min(speed, p.max_vel_trans)
    travel = (speed * p.sim_time + 2 * abs(p.forward_point_distance)) / scene.resolution
    reach = int(min(3.0 * travel, float(n))) + 8
    k = (cy + 1) * (nx + 2) + cx + 1
    path = min(int(grids.distances[PATH, k]), n) + reach
    goal = min(int(grids.distances[GOAL, k]), n) + reach
    front = min(at_least(grids, FRONT, k, nx, ny, goal + reach), n) + reach
    return path, goal, front
