"""Lower bounds of the samples' costs, computed without rolling out each sample step by step.

search.py uses the bounds to skip samples that cannot win. A bound never exceeds the exact cost. The
end of a trajectory comes from a closed form, whereas the exact poses are rounded to float32 in
every step. A cell is therefore taken from the closed form only if the pose is farther from a cell
border than the rounding errors can reach.
"""

import math
from typing import NamedTuple, Tuple

from applr_ros1.common.arrays import Data
from applr_ros1.common.kernels import kernel
from applr_ros1.planner.costmap.footprint_cost import NO_MARGIN, UNSURE, outline_cost, outline_of
from applr_ros1.planner.costmap.grid import world_to_map
from applr_ros1.planner.distance_grid import at_least, final_distance, place
from applr_ros1.planner.dwa import samples
from applr_ros1.planner.dwa.critics import (
    footprint_scale,
    is_barred,
    scale_footprint,
    weighted_sum,
)
from applr_ros1.planner.dwa.records import FRONT, GOAL, PATH, Grids, Scene, Scratch, grid_of
from applr_ros1.planner.dwa.samples import SampleCounts, commanded, ground_speed
from applr_ros1.planner.parameters.dwa_planner_parameters import SLACK
from applr_ros1.planner.sampling_planner import (
    LARGEST_TURN,
    Heading,
    Record,
    Velocity,
    order_heap,
    small_turn,
    turned,
)

# Relative error of one float32 value, plus a margin for the closed forms
ROUNDING = 1.01 * 2.0**-24
FORMULA = 1e-9  # error bound of the closed forms, whose actual error is about 1e-12 [m]
CELL_FORMULA = 1e-9  # error bound of a division by the resolution [cells]
# Index of a cell that is uncertain because the pose is too close to a border
AT_BORDER = -(1 << 40)


class MapVelocity(NamedTuple):
    """Velocity of the base in the axes of the map, at the heading of the start."""

    dx: float  # [m/s]
    dy: float  # [m/s]
    speed: float  # norm of (dx, dy) [m/s]
    w: float  # [rad/s]


class Arc(NamedTuple):
    """Displacement in the axes of the map, and change of heading, after several equal moves."""

    x: float  # [m]
    y: float  # [m]
    turn: Heading


class Cells(NamedTuple):
    """Cells of a trajectory's last point and of its nose, forward_point_distance ahead."""

    end_x: int
    end_y: int
    nose_x: int
    nose_y: int


class Limits(NamedTuple):
    """Distances [cells] up to which grids are flooded for the bounds, -1 if no sample is legal."""

    path: int
    goal: int
    front: int


UNCERTAIN = Cells(AT_BORDER, AT_BORDER, AT_BORDER, AT_BORDER)
NO_SAMPLE = Limits(-1, -1, -1)


@kernel
def in_map(vx: float, vy: float, w: float, speed: float, heading: Heading) -> MapVelocity:
    """Return a velocity of the base in the axes of the map. speed: its speed over ground [m/s]."""
    dx = vx * heading.cos - vy * heading.sin
    dy = vx * heading.sin + vy * heading.cos
    return MapVelocity(dx, dy, speed, w)


@kernel
def arc(velocity: MapVelocity, turn: float, dt: float, moves: int) -> Arc:
    """Return the motion after `moves` moves of dt [s] and `turn` [rad] each, at constant velocity.

    |turn| must not exceed LARGEST_TURN.
    """
    # The positions are corners of a regular polygon with the exterior angle `turn`. The chord over
    # several sides has the direction of the middle side, and by the law of sines the length
    # side * sin(moves * half) / sin(half).
    half = 0.5 * turn
    half_cos, half_sin = small_turn(half)
    middle_cos = math.cos((moves - 1) * half)
    middle_sin = math.sin((moves - 1) * half)
    # sine and cosine of moves * half, half the change of heading
    sin = middle_sin * half_cos + middle_cos * half_sin
    cos = middle_cos * half_cos - middle_sin * half_sin
    sides = float(moves)
    if half != 0.0:
        sides = sin / half_sin
    time = dt * sides
    x = time * (velocity.dx * middle_cos - velocity.dy * middle_sin)
    y = time * (velocity.dy * middle_cos + velocity.dx * middle_sin)
    return Arc(x, y, Heading(1 - 2 * sin * sin, 2 * sin * cos))


@kernel
def arc_errors(
    start: Record, speed: float, w: float, sim_time: float, steps: int
) -> Tuple[float, float]:
    """Return bounds of the closed form's error: position [m] and heading [rad].

    The reference is the float32 trajectory of C++, which rounds in each of its `steps` moves.
    speed, w: speed over ground [m/s] and turn rate [rad/s].
    """
    length = speed * sim_time
    turn_error = steps * ROUNDING * (abs(start.theta) + abs(w) * sim_time)
    farthest = max(abs(start.x), abs(start.y)) + length
    return steps * ROUNDING * farthest + length * turn_error + FORMULA, turn_error


@kernel
def sure_cell(coordinate: float, margin: float) -> int:
    """Return the cell at a coordinate [cells], or AT_BORDER within `margin` [cells] of one."""
    nearest_border = math.floor(coordinate + 0.5)
    if abs(coordinate - nearest_border) < margin:
        return AT_BORDER
    return int(math.floor(coordinate))


@kernel(error_model="numpy")
def sure_end_cells(
    p: Record,
    start: Record,
    heading: Heading,
    ox: float,
    oy: float,
    per_cell: float,
    velocity: MapVelocity,
    steps: int,
) -> Cells:
    """Return the last point's cell and its nose's, on or off the map.

    Uncertain indices are AT_BORDER.

    heading: direction at the start. ox, oy: origin of the map [m]. per_cell: 1 / resolution [1/m].
    velocity: velocity at the start, which must be constant (use_dwa).
    """
    dt = p.sim_time / steps
    turn = velocity.w * dt
    if abs(turn) > LARGEST_TURN:
        return UNCERTAIN
    way = arc(velocity, turn, dt, steps - 1)
    error, turn_error = arc_errors(start, velocity.speed, velocity.w, p.sim_time, steps)
    margin = error * per_cell + CELL_FORMULA
    x = (start.x + way.x - ox) * per_cell
    y = (start.y + way.y - oy) * per_cell
    end_x = sure_cell(x, margin)
    end_y = sure_cell(y, margin)

    # An error of the heading moves the nose, too.
    ahead = p.forward_point_distance
    margin += abs(ahead) * turn_error * per_cell
    end = turned(heading, way.turn)
    nose_x = sure_cell(x + ahead * end.cos * per_cell, margin)
    nose_y = sure_cell(y + ahead * end.sin * per_cell, margin)
    return Cells(end_x, end_y, nose_x, nose_y)


@kernel
def exact_end_cells(p: Record, scene: Scene, start: Record, sample: Velocity, steps: int) -> Cells:
    """Return the last point's cell and its nose's, each (-1, -1) if off the map.

    The trajectory is computed step by step as in samples.roll_out.
    """
    dt = p.sim_time / steps
    x = start.x
    y = start.y
    theta = start.theta
    velocity = commanded(p, start, sample, steps)
    for _ in range(steps - 1):
        if not p.use_dwa:
            velocity = samples.ramped(p, sample, velocity, dt)
        x, y, theta = samples.move(x, y, theta, velocity, dt)
    ahead = p.forward_point_distance
    front_x = x
    front_y = y
    if ahead != 0.0:
        front_x = x + ahead * math.cos(theta)
        front_y = y + ahead * math.sin(theta)
    end_x, end_y = _cell(scene, x, y)
    nose_x, nose_y = _cell(scene, front_x, front_y)
    return Cells(end_x, end_y, nose_x, nose_y)


@kernel(inline="always")
def _cell(scene: Scene, x: float, y: float) -> Tuple[int, int]:
    """Return the cell of the point x, y [m], (-1, -1) if off the map."""
    rows, columns = scene.cells.shape
    return world_to_map(x, y, scene.ox, scene.oy, scene.resolution, columns, rows)


@kernel(error_model="numpy")
def fill_bounds(
    p: Record,
    state: Record,
    grids: Grids,
    scratch: Scratch,
    scene: Scene,
    counts: SampleCounts,
    heading: Heading,
    scaled: Data,
) -> int:
    """Fill bounds, keys and heap of `scratch`, and return how many samples may win.

    heading: direction at the start. scaled: buffer for the footprint (n, 2).
    """
    # Members of tuples are taken out of the loops, because numba counts references at each access.
    xs = scratch.xs
    ys = scratch.ys
    ws = scratch.ws
    keys = scratch.keys
    bounds = scratch.bounds
    heap = scratch.heap
    probed = scratch.probed
    start = scratch.start[0]
    path_grid = grid_of(grids, PATH)
    goal_grid = grid_of(grids, GOAL)
    front_grid = grid_of(grids, FRONT)
    alignment_grid = grid_of(grids, grids.facts[0].alignment_row)
    footprint = scene.footprint
    ox = scene.ox
    oy = scene.oy
    per_cell = 1.0 / scene.resolution
    rows, columns = scene.cells.shape
    cell_count = rows * columns  # grid value of a wall; a distance is smaller
    stride = columns + 2  # The grids have a border of walls.

    # Critics of weight 0 reject nothing.
    by_obstacle = p.occdist_scale != 0.0
    by_path = p.path_scale != 0.0
    by_goal = p.goal_scale != 0.0
    by_alignment = p.alignment_scale != 0.0
    by_end = by_path or by_goal
    by_nose = by_goal or by_alignment

    # The first point of every sample is the robot's current pose, whose cost depends on the sample
    # only through the scale of the footprint.
    limits = _limits_from_here(p, grids, scene, start, heading)
    if limits.path < 0:
        return 0
    cell_x, cell_y = _cell(scene, start.x, start.y)
    centre_cost = int(scene.cells[cell_y, cell_x]) if by_obstacle else 0
    outline_cost_here = obstacle = centre_cost
    scale_here = -1.0
    outline = outline_of(scene, scaled)

    count = 0
    for ix in range(counts.vx):
        for iy in range(counts.vy):
            vx = xs[ix]
            vy = ys[iy]
            speed = ground_speed(vx, vy)
            if samples.is_too_fast(p, speed):
                continue
            slowest_turn = samples.slowest_turn(p, speed)
            linear = samples.linear_steps(p, speed)
            for iw in range(counts.w):
                # Critics that look at the sample alone
                w = ws[iw]
                if abs(w) + SLACK < slowest_turn:
                    continue
                steps = int(math.ceil(max(linear, samples.angular_steps(p, w))))
                if steps == 0:
                    continue
                stored = Velocity(vx, vy, w)
                stored_speed = speed
                if not p.use_dwa:
                    stored = commanded(p, start, stored, steps)
                    stored_speed = ground_speed(stored.vx, stored.vy)
                if is_barred(state, stored):
                    continue

                # The obstacle critic at the current pose
                if by_obstacle:
                    scale = footprint_scale(p, stored_speed)
                    if scale != scale_here:
                        scale_here = scale
                        scale_footprint(footprint, scale, scaled)
                        outline_cost_here = outline_cost(
                            outline,
                            start.x,
                            start.y,
                            heading.cos,
                            heading.sin,
                            cell_x,
                            cell_y,
                            NO_MARGIN,
                        )
                        obstacle = max(outline_cost_here, centre_cost)
                    if outline_cost_here < 0:
                        continue

                # The grids' critics at the last point and its nose. A value above the number of
                # cells means that the flood has not come that far.
                front = alignment = path = goal = 0
                if by_end or by_nose:
                    cells = UNCERTAIN
                    if p.use_dwa:
                        velocity = in_map(vx, vy, w, speed, heading)
                        cells = sure_end_cells(p, start, heading, ox, oy, per_cell, velocity, steps)
                    if min(cells.end_x, cells.end_y, cells.nose_x, cells.nose_y) == AT_BORDER:
                        cells = exact_end_cells(p, scene, start, Velocity(vx, vy, w), steps)
                    if by_end:
                        if not (0 <= cells.end_x < columns and 0 <= cells.end_y < rows):
                            continue
                        index = (cells.end_y + 1) * stride + cells.end_x + 1
                        if by_path:
                            path = path_grid.distance[index]
                            if path > cell_count:
                                path = at_least(path_grid, index, limits.path)
                            if path >= cell_count:
                                continue
                        if by_goal:
                            goal = goal_grid.distance[index]
                            if goal > cell_count:
                                goal = at_least(goal_grid, index, limits.goal)
                            if goal >= cell_count:
                                continue
                    if by_nose:
                        if not (0 <= cells.nose_x < columns and 0 <= cells.nose_y < rows):
                            continue
                        index = (cells.nose_y + 1) * stride + cells.nose_x + 1
                        if by_goal:
                            front = front_grid.distance[index]
                            if front > cell_count:
                                front = at_least(front_grid, index, limits.front)
                        if by_alignment:
                            alignment = alignment_grid.distance[index]
                            if alignment > cell_count:
                                alignment = at_least(alignment_grid, index, limits.path)

                number = (ix * counts.vy + iy) * counts.w + iw
                bound = bounds[number]
                bound.front = front
                bound.alignment = alignment
                bound.path = path
                bound.goal = goal
                bound.obstacle = obstacle
                keys[number] = weighted_sum(p, obstacle, bound, stored.w)
                probed[number] = 0
                heap[count] = number
                count += 1
    order_heap(heap, keys, count)
    return count


@kernel
def _limits_from_here(
    p: Record, grids: Grids, scene: Scene, start: Record, heading: Heading
) -> Limits:
    """Return the distances [cells] up to which the grids are flooded for the bounds.

    They lie little beyond the robot's range, because cells behind walls might require a flood of
    the whole map. The result is NO_SAMPLE if the robot's current pose, the first point of every
    sample, is off the map or rejected by a grid's critic. heading: direction at the start.
    """
    rows, columns = scene.cells.shape
    cell_count = columns * rows
    by_path = p.path_scale != 0.0
    by_goal = p.goal_scale != 0.0
    ahead = p.forward_point_distance
    path_grid = grid_of(grids, PATH)
    goal_grid = grid_of(grids, GOAL)

    # Critics of the first point and its nose
    cell_x, cell_y = _cell(scene, start.x, start.y)
    if cell_x < 0 and (by_path or by_goal or p.occdist_scale != 0.0):
        return NO_SAMPLE
    index = place(path_grid, cell_x, cell_y)
    path = final_distance(path_grid, index) if by_path else 0
    goal = final_distance(goal_grid, index) if by_goal else 0
    if path >= cell_count or goal >= cell_count:
        return NO_SAMPLE
    if ahead != 0.0 and (by_goal or p.alignment_scale != 0.0):
        nose_x, _ = _cell(scene, start.x + ahead * heading.cos, start.y + ahead * heading.sin)
        if nose_x < 0:
            return NO_SAMPLE

    # A diagonal metre is up to 1.42 m of 4-connected steps, and detours around obstacles are
    # longer.
    speed_x = max(abs(p.max_vel_x), abs(p.min_vel_x))
    speed_y = max(abs(p.max_vel_y), abs(p.min_vel_y))
    speed = speed_x + speed_y
    if p.max_vel_trans >= 0:
        speed = min(speed, p.max_vel_trans)
    travel = (speed * p.sim_time + 2 * abs(ahead)) / scene.resolution
    reach = int(min(3.0 * travel, float(cell_count))) + 8
    front = 0
    if by_goal:
        front = min(at_least(grid_of(grids, FRONT), index, goal + reach), cell_count)
    return Limits(path + reach, goal + reach, front + reach)


@kernel(error_model="numpy")
def probe(
    p: Record,
    scene: Scene,
    scaled: Data,
    start: Record,
    heading: Heading,
    sample: Velocity,
    obstacle: int,
    allowed: int,
) -> int:
    """Return a lower bound of the obstacle cost from a few poses, or -1 if one is illegal.

    The poses are the last one, then those at halves, quarters and eighths of the way: a sample that
    fails does so most often at its end. The bound starts from `obstacle`, and the probe ends once
    it exceeds `allowed`. scaled: footprint (n, 2) at the sample's speed. heading: direction at the
    start.
    """
    steps = samples.step_count(p, sample)
    dt = p.sim_time / steps
    turn = sample.w * dt
    if not p.use_dwa or abs(turn) > LARGEST_TURN or scaled.shape[0] < 3:
        return obstacle
    speed = ground_speed(sample.vx, sample.vy)
    error, turn_error = arc_errors(start, speed, sample.w, p.sim_time, steps)
    margin = (error + turn_error * _reach(scaled)) / scene.resolution + CELL_FORMULA
    velocity = in_map(sample.vx, sample.vy, sample.w, speed, heading)
    outline = outline_of(scene, scaled)
    moves = steps - 1
    parts = 1
    while parts <= 8 and moves // parts >= 3:
        for i in range(1, parts + 1, 2):  # The even parts belong to the coarser division before.
            way = arc(velocity, turn, dt, moves * i // parts)
            x = start.x + way.x
            y = start.y + way.y
            end = turned(heading, way.turn)
            cost = outline_cost(outline, x, y, end.cos, end.sin, 0, 0, margin)
            if cost == UNSURE:
                continue
            if cost < 0:
                return -1
            obstacle = max(obstacle, cost)
            if obstacle > allowed:
                return obstacle
        parts *= 2
    return obstacle


@kernel
def _reach(footprint: Data) -> float:
    """Return an upper bound of the vertices' distances from the centre [m]."""
    reach = 0.0
    for i in range(footprint.shape[0]):
        reach = max(reach, abs(footprint[i, 0]), abs(footprint[i, 1]))
    # A vertex is at most sqrt(2) times as far as its larger coordinate.
    return 2.0 * reach
