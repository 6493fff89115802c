"""Lower bounds of a sample's cost, without rolling it out step by step.

search.py uses the bounds to skip samples that cannot win. A bound never exceeds the exact cost. The end of a trajectory
comes from a closed form, whereas the exact poses are rounded to float32 in every step. A cell is therefore taken from
the closed form only if the pose is farther from a cell border than the rounding errors can reach.
"""

import math

from applr_ros1.common.kernels import kernel
from applr_ros1.planner import distance_grid
from applr_ros1.planner.costmap.footprint_cost import UNSURE, outline_cost
from applr_ros1.planner.costmap.grid import world_to_map
from applr_ros1.planner.dwa.critics import final_distance, footprint_scale, is_barred, scale_footprint, weighted_sum
from applr_ros1.planner.dwa.records import FRONT, GOAL, PATH
from applr_ros1.planner.dwa.samples import (
    SLACK,
    angular_steps,
    commanded,
    ground_speed,
    is_too_fast,
    least_turn,
    linear_steps,
    move,
    ramped,
)
from applr_ros1.planner.sampling_planner import LARGEST_TURN, sift_down, small_turn

ROUNDING = 1.01 * 2.0**-24  # relative rounding error of one float32 value, plus a margin for the closed forms
FORMULA = 1e-9  # error bound of the closed forms, whose actual error is about 1e-12 [m]
AT_BORDER = -(1 << 40)  # marker for a pose too close to a cell border to decide on one of the cells


@kernel
def arc(dx, dy, turn, dt, moves):
    """Return (x, y, cos, sin): displacement and heading change after equal moves of dt [s] and `turn` [rad] each.

    dx, dy: velocity at the start, in the axes of the map. |turn| must not exceed LARGEST_TURN.
    """
    half = 0.5 * turn
    dc, ds = small_turn(half)
    mc = math.cos((moves - 1) * half)
    ms = math.sin((moves - 1) * half)
    ts = ms * dc + mc * ds  # sine of moves * half
    tc = mc * dc - ms * ds
    length = dt * (ts / ds if half != 0.0 else float(moves))
    return length * (dx * mc - dy * ms), length * (dy * mc + dx * ms), 1 - 2 * ts * ts, 2 * ts * tc


@kernel
def arc_errors(x, y, theta, speed, w, sim_time, steps):
    """Return bounds of the float32 trajectory's deviation from the closed form: position [m] and heading [rad].

    x, y, theta: start of the trajectory.
    """
    length = speed * sim_time
    heading = steps * ROUNDING * (abs(theta) + abs(w) * sim_time)
    return steps * ROUNDING * (max(abs(x), abs(y)) + length) + length * heading + FORMULA, heading


@kernel
def sure_cell(f, margin):
    """Return the cell of a coordinate in cells, negative if below the map, AT_BORDER within `margin` of a border."""
    nearest = math.floor(f + 0.5)
    if abs(f - nearest) < margin:
        return AT_BORDER
    return int(math.floor(f))


@kernel(error_model="numpy")
def sure_end_cells(x0, y0, theta0, c, s, ox, oy, per_cell, dx, dy, speed, w, sim_time, steps, ahead):
    """Return the cells (x, y) of the last point and of its nose, on or off the map, AT_BORDER if undecided.

    x0, y0, theta0, c, s: start, with cosine and sine. ox, oy: origin of the map. per_cell: 1 / resolution. dx, dy:
    velocity at the start in the axes of the map. ahead: distance of the nose. Valid only for a constant velocity.
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
    """Return (x, y, theta) of the last point, computed step by step like samples.roll_out."""
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
    """Return the cells (x, y) of the last point and of its nose, each (-1, -1) if off the map."""
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
def fill_bounds(p, state, grids, scratch, scene, nx, ny, nw, c, s, scaled):
    """Fill bounds, occupied, keys and heap of `scratch`, and return how many samples may win.

    c, s: cosine and sine of the heading at the start. scaled: buffer for the footprint (n, 2). The inner loop avoids
    passing arrays to other functions, because counting their references costs more than the rest.
    """
    xs, ys, ws, keys, bounds, occupied, heap, probed, start = scratch
    cells, ox, oy, resolution, footprint, lines, _, _ = scene
    rows, columns = cells.shape
    flat = cells.reshape(rows * columns)
    n = rows * columns
    stride = columns + 2
    by_path = p.path_scale != 0.0
    by_goal = p.goal_scale != 0.0
    by_alignment = p.alignment_scale != 0.0
    by_nose = by_goal or by_alignment
    by_outline = p.occdist_scale != 0.0
    x0, y0, theta0 = start[0], start[1], start[2]
    path_limit, goal_limit, front_limit = _limits_from_here(p, grids, scene, start, c, s)
    if path_limit < 0:
        return 0
    cx, cy = world_to_map(x0, y0, ox, oy, resolution, columns, rows)
    alignment_row = grids.facts[1]
    path_grid, goal_grid = grids.distances[PATH], grids.distances[GOAL]
    front_grid, alignment_grid = grids.distances[FRONT], grids.distances[alignment_row]
    centre = int(cells[cy, cx]) if by_outline else 0
    here = met = centre
    scale_here = -1.0
    use_dwa, sim_time, ahead = p.use_dwa, p.sim_time, p.forward_point_distance
    per_cell = 1.0 / resolution
    count = 0
    for ix in range(nx):
        for iy in range(ny):
            vx, vy = xs[ix], ys[iy]
            speed = ground_speed(vx, vy)
            if is_too_fast(p, speed):
                continue
            least = least_turn(p, speed)
            linear = linear_steps(p, speed)
            dx = vx * c - vy * s
            dy = vx * s + vy * c
            for iw in range(nw):
                w = ws[iw]
                if abs(w) + SLACK < least:
                    continue
                steps = int(math.ceil(max(linear, angular_steps(p, w))))
                if steps == 0:
                    continue
                stored_vx, stored_vy, stored_w, stored_speed = vx, vy, w, speed
                if not use_dwa:
                    stored_vx, stored_vy, stored_w = commanded(p, start, vx, vy, w, steps)
                    stored_speed = ground_speed(stored_vx, stored_vy)
                if is_barred(state, stored_vx, stored_vy, stored_w):
                    continue
                if by_outline:
                    scale = footprint_scale(p, stored_speed)
                    if scale != scale_here:
                        scale_here = scale
                        scale_footprint(footprint, scale, scaled)
                        here = outline_cost(cells, flat, ox, oy, resolution, scaled, lines, x0, y0, c, s, cx, cy, 0.0)
                        met = max(here, centre)
                    if here < 0:
                        continue
                front = alignment = path = goal = 0
                if by_path or by_nose:
                    end_x = end_y = nose_x = nose_y = AT_BORDER
                    if use_dwa:
                        end_x, end_y, nose_x, nose_y = sure_end_cells(
                            x0, y0, theta0, c, s, ox, oy, per_cell, dx, dy, speed, w, sim_time, steps, ahead
                        )
                    if min(end_x, end_y, nose_x, nose_y) == AT_BORDER:
                        end_x, end_y, nose_x, nose_y = exact_end_cells(p, scene, start, vx, vy, w, steps)
                    if by_path or by_goal:
                        if not (0 <= end_x < columns and 0 <= end_y < rows):
                            continue
                        k = (end_y + 1) * stride + end_x + 1
                        if by_path:
                            path = path_grid[k]
                            if path > n:
                                path = at_least(grids, PATH, k, columns, rows, path_limit)
                            if path >= n:
                                continue
                        if by_goal:
                            goal = goal_grid[k]
                            if goal > n:
                                goal = at_least(grids, GOAL, k, columns, rows, goal_limit)
                            if goal >= n:
                                continue
                    if by_nose:
                        if not (0 <= nose_x < columns and 0 <= nose_y < rows):
                            continue
                        k = (nose_y + 1) * stride + nose_x + 1
                        if by_goal:
                            front = front_grid[k]
                            if front > n:
                                front = at_least(grids, FRONT, k, columns, rows, front_limit)
                        if by_alignment:
                            alignment = alignment_grid[k]
                            if alignment > n:
                                alignment = at_least(grids, alignment_row, k, columns, rows, path_limit)
                i = (ix * ny + iy) * nw + iw
                bounds[i, 0], bounds[i, 1], bounds[i, 2], bounds[i, 3] = front, alignment, path, goal
                occupied[i] = met
                keys[i] = weighted_sum(p, met, front, alignment, path, goal, stored_w)
                probed[i] = 0
                heap[count] = i
                count += 1
    for i in range(count // 2 - 1, -1, -1):
        sift_down(heap, keys, count, i)
    return count


@kernel
def _limits_from_here(p, grids, scene, start, c, s):
    """Return the flood limits of path, goal and front grids for the bounds: not much beyond the robot's range.

    Cells behind walls might otherwise require a flood of the whole map. The limits are -1 if a critic other than the
    obstacle critic rejects the robot's current pose, which is the first point of every sample.
    """
    ny, nx = scene.cells.shape
    n = nx * ny
    by_path = p.path_scale != 0.0
    by_goal = p.goal_scale != 0.0
    ahead = p.forward_point_distance
    cx, cy = world_to_map(start[0], start[1], scene.ox, scene.oy, scene.resolution, nx, ny)
    if cx < 0 and (by_path or by_goal or p.occdist_scale != 0.0):
        return -1, -1, -1
    k = (cy + 1) * (nx + 2) + cx + 1
    path = final_distance(grids, PATH, k, nx + 2, n) if by_path else 0
    goal = final_distance(grids, GOAL, k, nx + 2, n) if by_goal else 0
    if path >= n or goal >= n:
        return -1, -1, -1
    if ahead != 0.0 and (by_goal or p.alignment_scale != 0.0):
        nose_x, nose_y = start[0] + ahead * c, start[1] + ahead * s
        if world_to_map(nose_x, nose_y, scene.ox, scene.oy, scene.resolution, nx, ny)[0] < 0:
            return -1, -1, -1
    speed = max(abs(p.max_vel_x), abs(p.min_vel_x)) + max(abs(p.max_vel_y), abs(p.min_vel_y))
    if p.max_vel_trans >= 0:
        speed = min(speed, p.max_vel_trans)
    travel = (speed * p.sim_time + 2 * abs(ahead)) / scene.resolution
    reach = int(min(3.0 * travel, float(n))) + 8
    front = min(at_least(grids, FRONT, k, nx, ny, goal + reach), n) if by_goal else 0
    return path + reach, goal + reach, front + reach


@kernel
def at_least(grids, row, k, nx, ny, limit):
    """Return the value of cell k in one grid (N for a wall), or limit + 1 if the flood would exceed the limit."""
    return distance_grid.at_least(grids.distances[row], grids.queues[row], grids.ends[row], nx, ny, k, limit)


@kernel(error_model="numpy")
def probe(p, scene, scaled, start, c, s, vx, vy, w, speed, steps, occupied, allowed):
    """Return a lower bound of the sample's obstacle cost from a few of its poses, or -1 if one of them is illegal.

    The bound starts from `occupied`, and a cost above `allowed` ends the probe. The last pose is tested first, followed
    by halves, quarters and eighths. scaled: footprint (n, 2) at the sample's speed.
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
    """Return twice the largest coordinate [m] of the vertices (n, 2), which exceeds every vertex's distance."""
    reach = 0.0
    for i in range(footprint.shape[0]):
        reach = max(reach, abs(footprint[i, 0]), abs(footprint[i, 1]))
    return 2.0 * reach
