"""Search for the best forward sample of a cycle without rolling out the samples that cannot win.

Called by sampling.py. Samples wait in a heap, ordered by a lower bound of their cost. The sample
with the lowest bound is scored next, and the search ends when no bound beats the best cost. See
docs/explanation/planner.md, section 6.4.

Poses for bounds come from closed forms, which differ from the exact poses by rounding errors. A
cell is therefore used only if the pose is far enough from a cell border. A bound never exceeds the
exact cost, and no result depends on the closed forms.
"""

import math
from typing import NamedTuple, Tuple

from applr_ros1.common.arrays import Data
from applr_ros1.common.kernels import kernel
from applr_ros1.planner.costmap.footprint_cost import (
    UNSURE,
    on_border,
    outline_cost,
    outline_of,
)
from applr_ros1.planner.costmap.grid import world_to_map
from applr_ros1.planner.distance_grid import at_least, place
from applr_ros1.planner.sampling_planner import (
    LARGEST_TURN,
    Heading,
    Record,
    Velocity,
    drop_first,
    heading_of,
    order_heap,
    sift_down,
    small_turn,
    turned,
)
from applr_ros1.planner.trajectory import scoring
from applr_ros1.planner.trajectory.records import Grids, Scene, Scratch
from applr_ros1.planner.trajectory.scoring import HUGE, NO_CEILING, accelerated, step_count

MARGIN = 1e-6  # distance to a border [cells] at which a cell is certain; closed forms err by 1e-10


class Ground(NamedTuple):
    """Geometry of the map, without its cells: numba counts references to arrays."""

    ox: float  # origin [m]
    oy: float
    resolution: float  # [m]
    columns: int  # size [cells]
    rows: int


class Ramp(NamedTuple):
    """Pose after the moves in which the base reaches a sample's velocity."""

    moves: int
    x: float  # [m]
    y: float  # [m]
    heading: Heading


class Best(NamedTuple):
    """Best sample so far."""

    cost: float  # HUGE if no sample is legal
    vx: float  # [m/s], 0 for a turn in place
    w: float  # [rad/s]
    point_count: int  # 0 if no sample is legal


@kernel
def ramp(
    p: Record, start: Record, heading: Heading, sample: Velocity, dt: float, moves: int
) -> Ramp:
    """Return the pose at which the base reaches the sample's velocity, or after `moves` moves.

    heading: direction at the start. dt: duration of a move [s].
    """
    x = start.x
    y = start.y
    velocity = Velocity(start.vx, start.vy, start.w)
    for i in range(moves):
        # From here on, the base drives along an arc.
        if velocity.vx == sample.vx and velocity.w == sample.w and velocity.vy == 0.0:
            return Ramp(i, x, y, heading)
        velocity = accelerated(p, velocity, sample, dt)
        x += (velocity.vx * heading.cos - velocity.vy * heading.sin) * dt
        y += (velocity.vx * heading.sin + velocity.vy * heading.cos) * dt
        turn = velocity.w * dt
        if abs(turn) < 0.25:
            cos, sin = small_turn(turn)
        else:
            cos = math.cos(turn)
            sin = math.sin(turn)
        heading = turned(heading, Heading(cos, sin))
    return Ramp(moves, x, y, heading)


@kernel
def along_arc(from_: Ramp, length: float, turn: float, n: int) -> Tuple[float, float]:
    """Return the position (x, y) after n moves of `length` [m] and `turn` [rad] each.

    |turn| must not exceed LARGEST_TURN.
    """
    # The positions are corners of a regular polygon with the exterior angle `turn`. The chord over
    # n sides has the direction of the middle side, and by the law of sines it is as long as
    # sin(n * half_turn) / sin(half_turn) sides.
    half_turn = 0.5 * turn
    half_cos, half_sin = small_turn(half_turn)
    middle_cos = math.cos((n - 1) * half_turn)
    middle_sin = math.sin((n - 1) * half_turn)
    chord_sides = float(n)
    if half_turn != 0.0:
        chord_sides = (middle_sin * half_cos + middle_cos * half_sin) / half_sin
    chord_length = length * chord_sides
    heading = from_.heading
    x = from_.x + chord_length * (heading.cos * middle_cos - heading.sin * middle_sin)
    y = from_.y + chord_length * (heading.sin * middle_cos + heading.cos * middle_sin)
    return x, y


@kernel
def exact_end(p: Record, start: Record, sample: Velocity, steps: int) -> Tuple[float, float]:
    """Return (x, y) of the last scored point, computed step by step as in scoring.score_below."""
    dt = p.sim_time / steps
    x = start.x
    y = start.y
    theta = start.theta
    velocity = Velocity(start.vx, start.vy, start.w)
    for _ in range(steps - 1):
        velocity = accelerated(p, velocity, sample, dt)
        x, y = scoring.advance(x, y, theta, heading_of(theta), velocity, dt)
        theta = theta + velocity.w * dt
    return x, y


@kernel(error_model="numpy")
def end_cell(
    p: Record, ground: Ground, start: Record, heading: Heading, sample: Velocity
) -> Tuple[int, int]:
    """Return the cell (x, y) of the sample's last point, (-1, -1) if off the map.

    heading: direction at the start.
    """
    origin_x, origin_y, resolution, columns, rows = ground
    steps = step_count(p, sample)
    dt = p.sim_time / steps
    turn = sample.w * dt
    x = y = 0.0
    # Near the border of a cell, a closed form may fall into the neighbouring one.
    is_sure = abs(turn) <= LARGEST_TURN
    if is_sure:
        ramp_end = ramp(p, start, heading, sample, dt, steps - 1)
        x, y = along_arc(ramp_end, sample.vx * dt, turn, steps - 1 - ramp_end.moves)
        x_at_border = on_border((x - origin_x) / resolution, MARGIN)
        is_sure = not (x_at_border or on_border((y - origin_y) / resolution, MARGIN))
    if not is_sure:
        x, y = exact_end(p, start, sample, steps)
    return world_to_map(x, y, origin_x, origin_y, resolution, columns, rows)


@kernel(error_model="numpy")
def probe(
    p: Record,
    scene: Scene,
    start: Record,
    heading: Heading,
    sample: Velocity,
    obstacle_cost: int,
    cost_limit: float,
) -> int:
    """Return a lower bound of the obstacle cost from a few poses, or -1 if one is illegal.

    The poses are the last one, then those at halves, quarters and eighths of the way: a sample that
    fails does so most often at its end. The bound starts from `obstacle_cost`, and the probe ends
    once it exceeds `cost_limit`. heading: direction at the start.
    """
    steps = step_count(p, sample)
    dt = p.sim_time / steps
    turn = sample.w * dt
    # Round robots have no outline, and their centre costs little to test in the roll-out.
    if abs(turn) > LARGEST_TURN or scene.footprint.shape[0] < 3:
        return obstacle_cost
    ramp_end = ramp(p, start, heading, sample, dt, steps - 1)
    outline = outline_of(scene, scene.footprint)
    moves = steps - 1 - ramp_end.moves  # moves at the sample's velocity
    part_count = 1
    while part_count <= 8 and moves // part_count >= 8:
        # The even parts belong to the coarser division before.
        for i in range(1, part_count + 1, 2):
            probed_moves = moves * i // part_count
            x, y = along_arc(ramp_end, sample.vx * dt, turn, probed_moves)
            probed_heading = turned(ramp_end.heading, heading_of(probed_moves * turn))
            cost = outline_cost(outline, x, y, probed_heading.cos, probed_heading.sin, 0, 0, MARGIN)
            if cost == UNSURE:
                continue
            if cost < 0:
                return -1
            obstacle_cost = max(obstacle_cost, cost)
            if obstacle_cost > cost_limit:
                return obstacle_cost
        part_count *= 2
    return obstacle_cost


@kernel(error_model="numpy")
def best_forward(
    p: Record,
    scene: Scene,
    grids: Grids,
    scratch: Scratch,
    start: Record,
    speeds: Data,
    turn_rates: Data,
    obstacle_cost: int,
) -> Best:
    """Return the best forward sample. Among equal costs, the first sample wins.

    Each speed is combined first with w = 0, then with all turn rates but the last, as in C++.
    obstacle_cost: cost at the first pose, which all samples share.
    """
    base_costs = scratch.base_costs
    keys = scratch.keys
    heap = scratch.heap
    is_probed = scratch.is_probed
    turn_count = turn_rates.shape[0]
    heading = heading_of(start.theta)
    waiting_count = _bound(p, scene, grids, scratch, start, speeds, turn_rates, obstacle_cost)
    best_sample = Best(HUGE, 0.0, 0.0, 0)
    best_number = 0
    while waiting_count > 0:
        sample_number = heap[0]
        # All other samples have higher bounds, or equal ones and higher numbers.
        if keys[sample_number] > best_sample.cost or (
            keys[sample_number] == best_sample.cost and sample_number > best_number
        ):
            break
        sample = scoring.forward_sample(
            speeds, turn_rates, sample_number // turn_count, sample_number % turn_count
        )

        # Raise the bound with a few poses before the whole trajectory is rolled out.
        is_legal = True
        if not is_probed[sample_number]:
            is_probed[sample_number] = 1
            cost_limit = float(NO_CEILING)
            if best_sample.cost < HUGE:
                cost_limit = (best_sample.cost - base_costs[sample_number]) / p.occdist_scale + 1.0
            raised_cost = probe(p, scene, start, heading, sample, obstacle_cost, cost_limit)
            if raised_cost > obstacle_cost:
                keys[sample_number] = base_costs[sample_number] + p.occdist_scale * raised_cost
                sift_down(heap, keys, waiting_count, 0)
                continue
            is_legal = raised_cost >= 0

        if is_legal:
            sample_score = scoring.score_below(
                p,
                scene,
                grids,
                start,
                sample,
                NO_CEILING,
                base_costs[sample_number],
                best_sample.cost,
            )
            cost = sample_score.cost
            if 0 <= cost < best_sample.cost or (
                cost == best_sample.cost and sample_number < best_number
            ):
                best_sample = Best(cost, sample.vx, sample.w, sample_score.point_count)
                best_number = sample_number
        waiting_count = drop_first(heap, keys, waiting_count)
    return best_sample


@kernel(error_model="numpy")
def _bound(
    p: Record,
    scene: Scene,
    grids: Grids,
    scratch: Scratch,
    start: Record,
    speeds: Data,
    turn_rates: Data,
    obstacle_cost: int,
) -> int:
    """Fill base_costs, keys and heap of `scratch`, and return the number of samples that may win.

    The floods continue until they reach the samples' last cells, but only little beyond the robot's
    range, because cells behind walls might require a flood of the whole map.
    """
    # Members of tuples are taken out of the loops, because numba counts references at each access.
    base_costs = scratch.base_costs
    keys = scratch.keys
    heap = scratch.heap
    is_probed = scratch.is_probed
    path_grid = grids.path
    goal_grid = grids.goal
    path_distances = path_grid.distance
    goal_distances = goal_grid.distance
    rows, columns = scene.cells.shape
    cell_count = columns * rows  # grid value of a wall; a distance is smaller
    ground = Ground(scene.ox, scene.oy, scene.resolution, columns, rows)
    # With these options only the obstacle term is known before the roll-out.
    by_distances = not p.simple_attractor and not p.heading_scoring

    # Flood to what the robot can reach in sim_time: a diagonal metre is up to 1.42 m of 4-connected
    # steps, and detours around obstacles are longer.
    heading = heading_of(start.theta)
    fastest_sample = max(abs(speeds[0]), abs(speeds[-1]))  # The speeds are in ascending order.
    speed = max(abs(start.vx), fastest_sample) + abs(start.vy)
    travel_cells = speed * p.sim_time / scene.resolution
    reach = int(min(3.0 * travel_cells, float(cell_count))) + 8
    cell_x = int((start.x - scene.ox) / scene.resolution)
    cell_y = int((start.y - scene.oy) / scene.resolution)
    start_index = place(path_grid, cell_x, cell_y)
    path_limit = min(int(path_distances[start_index]), cell_count) + reach
    goal_limit = min(int(goal_distances[start_index]), cell_count) + reach

    sample_count = 0
    for speed_number in range(speeds.shape[0]):
        for turn_number in range(turn_rates.shape[0]):
            base_cost = 0.0
            if by_distances:
                sample = scoring.forward_sample(speeds, turn_rates, speed_number, turn_number)
                cell_x, cell_y = end_cell(p, ground, start, heading, sample)
                if cell_x < 0:
                    continue
                end_index = place(path_grid, cell_x, cell_y)
                path_distance = int(path_distances[end_index])
                goal_distance = int(goal_distances[end_index])
                # A value above the number of cells means that the flood has not come that far.
                if path_distance > cell_count:
                    path_distance = at_least(path_grid, end_index, path_limit)
                if goal_distance > cell_count:
                    goal_distance = at_least(goal_grid, end_index, goal_limit)
                if path_distance >= cell_count or goal_distance >= cell_count:
                    continue
                base_cost = scoring.terms(p, float(path_distance), float(goal_distance))
            sample_number = speed_number * turn_rates.shape[0] + turn_number
            base_costs[sample_number] = base_cost
            keys[sample_number] = base_cost + p.occdist_scale * obstacle_cost
            is_probed[sample_number] = 0
            heap[sample_count] = sample_number
            sample_count += 1
    order_heap(heap, keys, sample_count)
    return sample_count
