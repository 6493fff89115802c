"""Lower bounds of the samples' costs, computed without rolling out each sample step by step.

search.py uses the bounds to skip samples that cannot win. A bound never exceeds the exact cost. The
end of a trajectory comes from a closed form, whereas the exact poses are rounded to float32 in
every step. A cell is therefore taken from the closed form only if the pose is farther from a cell
border than the rounding errors can reach.
"""

import math
from typing import NamedTuple, Tuple

import numpy as np

from applr_ros1.common.arrays import Data
from applr_ros1.common.kernels import kernel
from applr_ros1.planner.costmap.footprint import farthest
from applr_ros1.planner.costmap.footprint_cost import NO_MARGIN, outline_cost, outline_of
from applr_ros1.planner.costmap.grid import world_to_map
from applr_ros1.planner.distance_grid import at_least, final_distance, place
from applr_ros1.planner.dwa import samples
from applr_ros1.planner.dwa.critics.obstacle import footprint_scale, scale_footprint
from applr_ros1.planner.dwa.critics.oscillation import is_barred
from applr_ros1.planner.dwa.critics.registry import OBSTACLE, READERS, lower_bound, weights
from applr_ros1.planner.dwa.records import (
    FRONT,
    GOAL,
    PATH,
    DWAGrids,
    DWAScene,
    DWAScratch,
    grid_of,
    row_of,
)
from applr_ros1.planner.dwa.samples import SampleCounts, commanded, ground_speed
from applr_ros1.planner.parameters.dwa_planner_parameters import SLACK
from applr_ros1.planner.sampling_planner import (
    Heading,
    Record,
    Velocity,
)
from applr_ros1.planner.search.arcs import (
    LARGEST_TURN,
    arc_from,
    flood_reach,
    pose_after,
    probe,
)
from applr_ros1.planner.search.best_first import add

# Relative error of one float32 value, plus a margin for the closed forms
ROUNDING = 1.01 * 2.0**-24
FORMULA = 1e-9  # error bound of the closed forms, whose actual error is about 1e-12 [m]
CELL_FORMULA = 1e-9  # error bound of a division by the resolution [cells]
SHORTEST_PART = 3  # least number of moves between two probed poses
# Index of a cell that is uncertain because the pose is too close to a border
AT_BORDER = -(1 << 40)


class EndCells(NamedTuple):
    """Cells of a trajectory's last point and of its nose, forward_point_distance ahead."""

    end_x: int
    end_y: int
    nose_x: int
    nose_y: int


class DWAFloodLimits(NamedTuple):
    """Distances [cells] up to which grids are flooded for the bounds, -1 if no sample is legal.

    In the order of the rows of DWAGrids.
    """

    path: int
    goal: int
    front: int
    alignment: int


UNCERTAIN = EndCells(AT_BORDER, AT_BORDER, AT_BORDER, AT_BORDER)
NO_SAMPLE = DWAFloodLimits(-1, -1, -1, -1)


@kernel
def arc_errors(
    start: Record, speed: float, w: float, sim_time: float, steps: int
) -> Tuple[float, float]:
    """Return bounds of the closed form's error: position [m] and heading [rad].

    The reference is the float32 trajectory of C++, which rounds in each of its `steps` moves.
    speed, w: speed over ground [m/s] and turn rate [rad/s].
    """
    path_length = speed * sim_time
    turn_error = steps * ROUNDING * (abs(start.theta) + abs(w) * sim_time)
    farthest_coordinate = max(abs(start.x), abs(start.y)) + path_length
    return steps * ROUNDING * farthest_coordinate + path_length * turn_error + FORMULA, turn_error


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
    origin_x: float,
    origin_y: float,
    cells_per_metre: float,
    sample: Velocity,
    speed: float,
    steps: int,
) -> EndCells:
    """Return the last point's cell and its nose's, on or off the map.

    Uncertain indices are AT_BORDER.

    heading: direction at the start. origin_x, origin_y: origin of the map [m]. cells_per_metre:
    1 / resolution [1/m]. sample: velocity, which must be constant (use_dwa). speed: its speed over
    ground [m/s].
    """
    dt = p.sim_time / steps
    if abs(sample.w * dt) > LARGEST_TURN:
        return UNCERTAIN
    end = pose_after(arc_from(start.x, start.y, heading, sample, dt), steps - 1)
    position_error, turn_error = arc_errors(start, speed, sample.w, p.sim_time, steps)
    margin = position_error * cells_per_metre + CELL_FORMULA
    x_in_cells = (end.x - origin_x) * cells_per_metre
    y_in_cells = (end.y - origin_y) * cells_per_metre
    end_x = sure_cell(x_in_cells, margin)
    end_y = sure_cell(y_in_cells, margin)

    # An error of the heading moves the nose, too.
    nose_offset = p.forward_point_distance
    margin += abs(nose_offset) * turn_error * cells_per_metre
    nose_x = sure_cell(x_in_cells + nose_offset * end.heading.cos * cells_per_metre, margin)
    nose_y = sure_cell(y_in_cells + nose_offset * end.heading.sin * cells_per_metre, margin)
    return EndCells(end_x, end_y, nose_x, nose_y)


@kernel
def exact_end_cells(
    p: Record, scene: DWAScene, start: Record, sample: Velocity, steps: int
) -> EndCells:
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
    nose_offset = p.forward_point_distance
    front_x = x
    front_y = y
    if nose_offset != 0.0:
        front_x = x + nose_offset * math.cos(theta)
        front_y = y + nose_offset * math.sin(theta)
    end_x, end_y = _cell(scene, x, y)
    nose_x, nose_y = _cell(scene, front_x, front_y)
    return EndCells(end_x, end_y, nose_x, nose_y)


@kernel(inline="always")
def _cell(scene: DWAScene, x: float, y: float) -> Tuple[int, int]:
    """Return the cell of the point x, y [m], (-1, -1) if off the map."""
    rows, columns = scene.cells.shape
    return world_to_map(x, y, scene.ox, scene.oy, scene.resolution, columns, rows)


@kernel(error_model="numpy")
def fill_bounds(
    p: Record,
    state: Record,
    grids: DWAGrids,
    scratch: DWAScratch,
    scene: DWAScene,
    axis_counts: SampleCounts,
    heading: Heading,
    scaled_footprint: Data,
) -> int:
    """Fill the bounds and the heap of `scratch`, and return how many samples may win.

    heading: direction at the start. scaled_footprint: buffer for the footprint (n, 2).
    """
    # Members of tuples are taken out of the loops, because numba counts references at each access.
    sampled_vx = scratch.sampled_vx
    sampled_vy = scratch.sampled_vy
    sampled_w = scratch.sampled_w
    bounds = scratch.bounds
    known_of = scratch.known
    heap = scratch.heap
    is_probed = scratch.is_probed
    start = scratch.start[0]
    distances = grids.distances
    footprint = scene.footprint
    origin_x = scene.ox
    origin_y = scene.oy
    cells_per_metre = 1.0 / scene.resolution
    rows, columns = scene.cells.shape
    cell_count = rows * columns  # grid value of a wall; a distance is smaller
    row_step = columns + 2  # The grids have a border of walls.

    # Critics of weight 0 reject nothing.
    by_obstacle = p.occdist_scale != 0.0

    # The first point of every sample is the robot's current pose, whose cost depends on the sample
    # only through the scale of the footprint.
    limits = _limits_from_here(p, grids, scene, start, heading)
    if limits.path < 0:
        return 0
    cell_x, cell_y = _cell(scene, start.x, start.y)
    centre_cost = int(scene.cells[cell_y, cell_x]) if by_obstacle else 0
    outline_cost_here = obstacle_cost = centre_cost
    scale_here = -1.0
    outline = outline_of(scene, scaled_footprint)

    # Critics that read a grid, except for those of weight 0, which reject nothing
    critic_weights = weights(p)
    readers = READERS.copy()
    reader_count = 0
    by_end = by_nose = False
    for i in range(len(READERS)):
        reader = READERS[i]
        if critic_weights[reader.critic] != 0.0:
            by_end |= not reader.at_nose
            by_nose |= reader.at_nose
            readers[reader_count] = reader
            readers[reader_count].row = row_of(grids, reader.row)
            readers[reader_count].limit = limits[reader.row]
            reader_count += 1

    sample_count = 0
    for ix in range(axis_counts.vx):
        for iy in range(axis_counts.vy):
            vx = sampled_vx[ix]
            vy = sampled_vy[iy]
            speed = ground_speed(vx, vy)
            if samples.is_too_fast(p, speed):
                continue
            slowest_turn = samples.slowest_turn(p, speed)
            linear_steps = samples.linear_steps(p, speed)
            for iw in range(axis_counts.w):
                # Critics that look at the sample alone
                w = sampled_w[iw]
                if abs(w) + SLACK < slowest_turn:
                    continue
                steps = int(math.ceil(max(linear_steps, samples.angular_steps(p, w))))
                if steps == 0:
                    continue
                stored_velocity = Velocity(vx, vy, w)
                stored_speed = speed
                if not p.use_dwa:
                    stored_velocity = commanded(p, start, stored_velocity, steps)
                    stored_speed = ground_speed(stored_velocity.vx, stored_velocity.vy)
                if is_barred(state, stored_velocity):
                    continue

                # The obstacle critic at the current pose
                if by_obstacle:
                    scale = footprint_scale(p, stored_speed)
                    if scale != scale_here:
                        scale_here = scale
                        scale_footprint(footprint, scale, scaled_footprint)
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
                        obstacle_cost = max(outline_cost_here, centre_cost)
                    if outline_cost_here < 0:
                        continue

                # Cells of the last point and of its nose
                end_index = nose_index = 0
                if by_end or by_nose:
                    cells = UNCERTAIN
                    if p.use_dwa:
                        cells = sure_end_cells(
                            p,
                            start,
                            heading,
                            origin_x,
                            origin_y,
                            cells_per_metre,
                            Velocity(vx, vy, w),
                            speed,
                            steps,
                        )
                    if min(cells.end_x, cells.end_y, cells.nose_x, cells.nose_y) == AT_BORDER:
                        cells = exact_end_cells(p, scene, start, Velocity(vx, vy, w), steps)
                    if by_end:
                        if not (0 <= cells.end_x < columns and 0 <= cells.end_y < rows):
                            continue
                        end_index = (cells.end_y + 1) * row_step + cells.end_x + 1
                    if by_nose:
                        if not (0 <= cells.nose_x < columns and 0 <= cells.nose_y < rows):
                            continue
                        nose_index = (cells.nose_y + 1) * row_step + cells.nose_x + 1

                # The critics that read a grid there. A value above the number of cells means that
                # the flood has not come that far. Unsigned indices spare numba the wrap-around of
                # negative ones.
                sample_number = (ix * axis_counts.vy + iy) * axis_counts.w + iw
                known_row = np.uintp(sample_number)
                is_refused = False
                for i in range(reader_count):
                    reader = readers[i]
                    grid_index = nose_index if reader.at_nose else end_index
                    distance = distances[np.uintp(reader.row), np.uintp(grid_index)]
                    if distance > cell_count:
                        grid = grid_of(grids, reader.row)
                        distance = at_least(grid, grid_index, reader.limit)
                    if reader.refuses and distance >= cell_count:
                        is_refused = True
                        break
                    known_of[known_row, np.uintp(reader.critic)] = distance
                if is_refused:
                    continue

                known_of[known_row, OBSTACLE] = obstacle_cost
                cost_bound = lower_bound(p, known_of, known_row, stored_velocity)
                sample_count = add(bounds, heap, is_probed, sample_count, sample_number, cost_bound)
    return sample_count


@kernel
def _limits_from_here(
    p: Record, grids: DWAGrids, scene: DWAScene, start: Record, heading: Heading
) -> DWAFloodLimits:
    """Return the distances [cells] up to which the grids are flooded for the bounds.

    They lie little beyond the robot's range, because cells behind walls might require a flood of
    the whole map. The result is NO_SAMPLE if the robot's current pose, the first point of every
    sample, is off the map or rejected by a grid's critic. heading: direction at the start.
    """
    rows, columns = scene.cells.shape
    cell_count = columns * rows
    by_path = p.path_scale != 0.0
    by_goal = p.goal_scale != 0.0
    nose_offset = p.forward_point_distance
    path_grid = grid_of(grids, PATH)
    goal_grid = grid_of(grids, GOAL)

    # Critics of the first point and its nose
    cell_x, cell_y = _cell(scene, start.x, start.y)
    if cell_x < 0 and (by_path or by_goal or p.occdist_scale != 0.0):
        return NO_SAMPLE
    start_index = place(path_grid, cell_x, cell_y)
    path_distance = final_distance(path_grid, start_index) if by_path else 0
    goal_distance = final_distance(goal_grid, start_index) if by_goal else 0
    if path_distance >= cell_count or goal_distance >= cell_count:
        return NO_SAMPLE
    if nose_offset != 0.0 and (by_goal or p.alignment_scale != 0.0):
        nose_x, _ = _cell(
            scene, start.x + nose_offset * heading.cos, start.y + nose_offset * heading.sin
        )
        if nose_x < 0:
            return NO_SAMPLE

    speed_x = max(abs(p.max_vel_x), abs(p.min_vel_x))
    speed_y = max(abs(p.max_vel_y), abs(p.min_vel_y))
    speed = speed_x + speed_y
    if p.max_vel_trans >= 0:
        speed = min(speed, p.max_vel_trans)
    travel = speed * p.sim_time + 2 * abs(nose_offset)
    reach = flood_reach(travel, scene.resolution, cell_count)
    front_distance = 0
    if by_goal:
        front_distance = min(
            at_least(grid_of(grids, FRONT), start_index, goal_distance + reach), cell_count
        )
    return DWAFloodLimits(
        path=path_distance + reach,
        goal=goal_distance + reach,
        front=front_distance + reach,
        alignment=path_distance + reach,
    )


@kernel(error_model="numpy")
def probe_sample(
    p: Record,
    scene: DWAScene,
    scaled_footprint: Data,
    start: Record,
    heading: Heading,
    sample: Velocity,
    obstacle_cost: int,
    cost_limit: float,
) -> int:
    """Return a lower bound of a sample's obstacle cost from a few poses, see search.arcs.probe.

    scaled_footprint: footprint (n, 2) at the sample's speed. heading: direction at the start.
    """
    steps = samples.step_count(p, sample)
    dt = p.sim_time / steps
    if not p.use_dwa or abs(sample.w * dt) > LARGEST_TURN or scaled_footprint.shape[0] < 3:
        return obstacle_cost
    speed = ground_speed(sample.vx, sample.vy)
    position_error, turn_error = arc_errors(start, speed, sample.w, p.sim_time, steps)
    vertex_error = turn_error * farthest(scaled_footprint)
    margin = (position_error + vertex_error) / scene.resolution + CELL_FORMULA
    arc = arc_from(start.x, start.y, heading, sample, dt)
    outline = outline_of(scene, scaled_footprint)
    return probe(outline, arc, steps - 1, SHORTEST_PART, margin, obstacle_cost, cost_limit)
