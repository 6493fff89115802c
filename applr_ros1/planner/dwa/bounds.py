"""Lower bounds of the samples' costs, computed without rolling out each sample step by step.

search.py uses the bounds to skip samples that cannot win. A bound never exceeds the exact cost. The end of a trajectory
comes from a closed form, whereas the exact poses are rounded to float32 in every step. A cell is therefore taken from
the closed form only if the pose is farther from a cell border than the rounding errors can reach.
"""

import math
from typing import Sequence, Tuple

from applr_ros1.common.arrays import Data
from applr_ros1.common.kernels import kernel
from applr_ros1.planner.costmap.footprint_cost import UNSURE, outline_cost, outline_of
from applr_ros1.planner.costmap.grid import world_to_map
from applr_ros1.planner.distance_grid import at_least, final_distance, place
from applr_ros1.planner.dwa import samples
from applr_ros1.planner.dwa.critics import footprint_scale, is_barred, scale_footprint, weighted_sum
from applr_ros1.planner.dwa.records import FRONT, GOAL, PATH, Grids, Scene, Scratch, grid_of
from applr_ros1.planner.dwa.samples import commanded, ground_speed
from applr_ros1.planner.parameters.dwa_planner_parameters import SLACK
from applr_ros1.planner.sampling_planner import LARGEST_TURN, Record, Triple, sift_down, small_turn

ROUNDING = (
    1.01 * 2.0**-24
)  # relative rounding error of one float32 value, plus a margin for the closed forms
FORMULA = 1e-9  # error bound of the closed forms, whose actual error is about 1e-12 [m]
AT_BORDER = -(
    1 << 40
)  # index of a cell that is uncertain because the pose is too close to a cell border
Pair = Tuple[float, float]
Counts = Tuple[int, int, int]
Cells = Tuple[
    int, int, int, int
]  # cells (x, y) of the last point and of its nose, forward_point_distance ahead


@kernel
def arc(
    dx: float, dy: float, turn: float, dt: float, moves: int
) -> Tuple[float, float, float, float]:
    """Return (x, y, cos, sin): displacement and heading change after `moves` moves of dt [s] and `turn` [rad] each.

    dx, dy: velocity at the start in the axes of the map [m/s]. |turn| must not exceed LARGEST_TURN.
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
def arc_errors(pose: Triple, speed: float, w: float, sim_time: float, steps: int) -> Pair:
    """Return how far the float32 trajectory may deviate from the closed form: position [m] and heading [rad].

    pose: start of the trajectory. speed, w: speed over ground [m/s] and turn rate [rad/s].
    """
    x, y, theta = pose
    length = speed * sim_time
    heading = steps * ROUNDING * (abs(theta) + abs(w) * sim_time)
    return steps * ROUNDING * (max(abs(x), abs(y)) + length) + length * heading + FORMULA, heading


@kernel
def sure_cell(f: float, margin: float) -> int:
    """Return the index of the cell at coordinate f [cells], AT_BORDER if a border is within `margin` [cells]."""
    nearest = math.floor(f + 0.5)
    if abs(f - nearest) < margin:
        return AT_BORDER
    return int(math.floor(f))


@kernel(error_model="numpy")
def sure_end_cells(
    pose: Triple,
    heading: Pair,
    place: Triple,
    velocity: Sequence[float],
    sim_time: float,
    steps: int,
    ahead: float,
) -> Cells:
    """Return the cells (x, y) of the last point and of its nose, on or off the map. Uncertain indices are AT_BORDER.

    pose: start. heading: cosine and sine of the yaw at the start. place: origin of the map and 1 / resolution.
    velocity: dx, dy at the start in the axes of the map, their norm, and w; it must be constant. ahead: distance of the
    nose from the last point [m].
    """
    (x0, y0, _), (c, s), (ox, oy, per_cell), (dx, dy, speed, w) = pose, heading, place, velocity
    dt = sim_time / steps
    turn = w * dt
    if abs(turn) > LARGEST_TURN:
        return AT_BORDER, AT_BORDER, AT_BORDER, AT_BORDER
    x, y, hc, hs = arc(dx, dy, turn, dt, steps - 1)
    error, turn_error = arc_errors(pose, speed, w, sim_time, steps)
    margin = error * per_cell + 1e-9
    fx = (x0 + x - ox) * per_cell
    fy = (y0 + y - oy) * per_cell
    end_x = sure_cell(fx, margin)
    end_y = sure_cell(fy, margin)
    margin += abs(ahead) * turn_error * per_cell
    nose_x = sure_cell(fx + ahead * (c * hc - s * hs) * per_cell, margin)
    nose_y = sure_cell(fy + ahead * (s * hc + c * hs) * per_cell, margin)
    return end_x, end_y, nose_x, nose_y


@kernel
def exact_end_cells(p: Record, scene: Scene, start: Data, sample: Triple, steps: int) -> Cells:
    """Return the cells (x, y) of the last point and of its nose, each (-1, -1) if off the map.

    The trajectory is computed step by step as in samples.roll_out.
    """
    ny, nx = scene.cells.shape
    ahead = p.forward_point_distance
    dt = p.sim_time / steps
    x, y, theta = start[0], start[1], start[2]
    now = commanded(p, start, sample, steps)
    for _ in range(steps - 1):
        if not p.use_dwa:
            now = samples.ramped(p, sample, now, dt)
        x, y, theta = samples.move(x, y, theta, now, dt)
    fx, fy = x, y
    if ahead != 0.0:
        fx = x + ahead * math.cos(theta)
        fy = y + ahead * math.sin(theta)
    cx, cy = world_to_map(x, y, scene.ox, scene.oy, scene.resolution, nx, ny)
    nose_x, nose_y = world_to_map(fx, fy, scene.ox, scene.oy, scene.resolution, nx, ny)
    return cx, cy, nose_x, nose_y


@kernel(error_model="numpy")
def fill_bounds(
    p: Record,
    state: Record,
    grids: Grids,
    scratch: Scratch,
    scene: Scene,
    axes: Counts,
    heading: Pair,
    scaled: Data,
) -> int:
    """Fill bounds, occupied, keys and heap of `scratch`, and return how many samples may win.

    axes: numbers of vx, vy and w. heading: cosine and sine of the yaw at the start. scaled: buffer for the footprint.
    The inner loop passes few arrays to functions, because numba's counting of references would take most of the time.
    """
    (nx, ny, nw), (c, s) = axes, heading
    xs, ys, ws, keys, bounds, occupied, heap, probed, start = scratch
    cells, ox, oy, resolution, footprint, _, _, _ = scene
    rows, columns = cells.shape
    n = rows * columns
    stride = columns + 2
    by_path = p.path_scale != 0.0
    by_goal = p.goal_scale != 0.0
    by_alignment = p.alignment_scale != 0.0
    by_nose = by_goal or by_alignment
    by_outline = p.occdist_scale != 0.0
    x0, y0 = start[0], start[1]
    pose, place_of_map = (x0, y0, start[2]), (ox, oy, 1.0 / resolution)
    path_limit, goal_limit, front_limit = _limits_from_here(p, grids, scene, start, heading)
    if path_limit < 0:
        return 0
    cx, cy = world_to_map(x0, y0, ox, oy, resolution, columns, rows)
    path_grid, goal_grid = grid_of(grids, PATH), grid_of(grids, GOAL)
    front_grid, alignment_grid = grid_of(grids, FRONT), grid_of(grids, grids.facts[1])
    centre = int(cells[cy, cx]) if by_outline else 0
    here = met = centre
    scale_here = -1.0
    use_dwa, sim_time, ahead = p.use_dwa, p.sim_time, p.forward_point_distance
    outline = outline_of(scene, scaled)
    count = 0
    for ix in range(nx):
        for iy in range(ny):
            vx, vy = xs[ix], ys[iy]
            speed = ground_speed(vx, vy)
            if samples.is_too_fast(p, speed):
                continue
            least = samples.least_turn(p, speed)
            linear = samples.linear_steps(p, speed)
            dx = vx * c - vy * s
            dy = vx * s + vy * c
            for iw in range(nw):
                w = ws[iw]
                if abs(w) + SLACK < least:
                    continue
                steps = int(math.ceil(max(linear, samples.angular_steps(p, w))))
                if steps == 0:
                    continue
                stored, stored_speed = (vx, vy, w), speed
                if not use_dwa:
                    stored = commanded(p, start, (vx, vy, w), steps)
                    stored_speed = ground_speed(stored[0], stored[1])
                if is_barred(state, stored):
                    continue
                if by_outline:
                    scale = footprint_scale(p, stored_speed)
                    if scale != scale_here:
                        scale_here = scale
                        scale_footprint(footprint, scale, scaled)
                        here = outline_cost(outline, x0, y0, c, s, cx, cy, 0.0)
                        met = max(here, centre)
                    if here < 0:
                        continue
                front = alignment = path = goal = 0
                if by_path or by_nose:
                    end_x = end_y = nose_x = nose_y = AT_BORDER
                    if use_dwa:
                        end_x, end_y, nose_x, nose_y = sure_end_cells(
                            pose, heading, place_of_map, (dx, dy, speed, w), sim_time, steps, ahead
                        )
                    if min(end_x, end_y, nose_x, nose_y) == AT_BORDER:
                        end_x, end_y, nose_x, nose_y = exact_end_cells(
                            p, scene, start, (vx, vy, w), steps
                        )
                    if by_path or by_goal:
                        if not (0 <= end_x < columns and 0 <= end_y < rows):
                            continue
                        k = (end_y + 1) * stride + end_x + 1
                        if by_path:
                            path = path_grid.distance[k]
                            if path > n:
                                path = at_least(path_grid, k, path_limit)
                            if path >= n:
                                continue
                        if by_goal:
                            goal = goal_grid.distance[k]
                            if goal > n:
                                goal = at_least(goal_grid, k, goal_limit)
                            if goal >= n:
                                continue
                    if by_nose:
                        if not (0 <= nose_x < columns and 0 <= nose_y < rows):
                            continue
                        k = (nose_y + 1) * stride + nose_x + 1
                        if by_goal:
                            front = front_grid.distance[k]
                            if front > n:
                                front = at_least(front_grid, k, front_limit)
                        if by_alignment:
                            alignment = alignment_grid.distance[k]
                            if alignment > n:
                                alignment = at_least(alignment_grid, k, path_limit)
                i = (ix * ny + iy) * nw + iw
                bounds[i, 0], bounds[i, 1], bounds[i, 2], bounds[i, 3] = (
                    front,
                    alignment,
                    path,
                    goal,
                )
                occupied[i] = met
                keys[i] = weighted_sum(p, met, (front, alignment, path, goal), stored[2])
                probed[i] = 0
                heap[count] = i
                count += 1
    for i in range(count // 2 - 1, -1, -1):
        sift_down(heap, keys, count, i)
    return count


@kernel
def _limits_from_here(p: Record, grids: Grids, scene: Scene, start: Data, heading: Pair) -> Counts:
    """Return the distances [cells] up to which the path, goal and front grids are flooded for the bounds.

    They lie little beyond the robot's range, because cells behind walls might require a flood of the whole map. All are
    -1 if the robot's current pose, the first point of every sample, is off the map or rejected by a grid's critic.
    """
    ny, nx = scene.cells.shape
    n = nx * ny
    by_path = p.path_scale != 0.0
    by_goal = p.goal_scale != 0.0
    ahead = p.forward_point_distance
    cx, cy = world_to_map(start[0], start[1], scene.ox, scene.oy, scene.resolution, nx, ny)
    if cx < 0 and (by_path or by_goal or p.occdist_scale != 0.0):
        return -1, -1, -1
    k = place(grid_of(grids, PATH), cx, cy)
    path = final_distance(grid_of(grids, PATH), k) if by_path else 0
    goal = final_distance(grid_of(grids, GOAL), k) if by_goal else 0
    if path >= n or goal >= n:
        return -1, -1, -1
    if ahead != 0.0 and (by_goal or p.alignment_scale != 0.0):
        nose_x, nose_y = start[0] + ahead * heading[0], start[1] + ahead * heading[1]
        if world_to_map(nose_x, nose_y, scene.ox, scene.oy, scene.resolution, nx, ny)[0] < 0:
            return -1, -1, -1
    speed = max(abs(p.max_vel_x), abs(p.min_vel_x)) + max(abs(p.max_vel_y), abs(p.min_vel_y))
    if p.max_vel_trans >= 0:
        speed = min(speed, p.max_vel_trans)
    travel = (speed * p.sim_time + 2 * abs(ahead)) / scene.resolution
    reach = int(min(3.0 * travel, float(n))) + 8
    front = min(at_least(grid_of(grids, FRONT), k, goal + reach), n) if by_goal else 0
    return path + reach, goal + reach, front + reach


@kernel(error_model="numpy")
def probe(
    p: Record,
    scene: Scene,
    scaled: Data,
    start: Data,
    heading: Pair,
    sample: Triple,
    occupied: int,
    allowed: int,
) -> int:
    """Return a lower bound of the sample's obstacle cost from a few of its poses, or -1 if one of them is illegal.

    The bound starts from `occupied`. The probe ends once the bound exceeds `allowed`. It tests the last pose, then the
    poses at halves, quarters and eighths of the way. scaled: footprint (n, 2) at the sample's speed.
    """
    (c, s), (vx, vy, w) = heading, sample
    steps = samples.step_count(p, sample)
    dt = p.sim_time / steps
    turn = w * dt
    if not p.use_dwa or abs(turn) > LARGEST_TURN or scaled.shape[0] < 3:
        return occupied
    error, turn_error = arc_errors(
        (start[0], start[1], start[2]), ground_speed(vx, vy), w, p.sim_time, steps
    )
    margin = (error + turn_error * _reach(scaled)) / scene.resolution + 1e-9
    dx = vx * c - vy * s
    dy = vx * s + vy * c
    outline = outline_of(scene, scaled)
    left = steps - 1
    parts = 1
    while parts <= 8 and left // parts >= 3:
        for i in range(1, parts + 1, 2):
            x, y, hc, hs = arc(dx, dy, turn, dt, left * i // parts)
            x += start[0]
            y += start[1]
            ec = c * hc - s * hs
            es = s * hc + c * hs
            cost = outline_cost(outline, x, y, ec, es, 0, 0, margin)
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
def _reach(footprint: Data) -> float:
    """Return an upper bound of the vertices' distances from the centre: twice the largest coordinate [m]."""
    reach = 0.0
    for i in range(footprint.shape[0]):
        reach = max(reach, abs(footprint[i, 0]), abs(footprint[i, 1]))
    return 2.0 * reach
