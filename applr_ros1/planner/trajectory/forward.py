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
    # n sides has the direction of the middle side, and by the law of sines the length length *
    # sin(n * half) / sin(half).
    half = 0.5 * turn
    half_cos, half_sin = small_turn(half)
    middle_cos = math.cos((n - 1) * half)
    middle_sin = math.sin((n - 1) * half)
    sides = float(n)
    if half != 0.0:
        sides = (middle_sin * half_cos + middle_cos * half_sin) / half_sin
    chord = length * sides
    heading = from_.heading
    x = from_.x + chord * (heading.cos * middle_cos - heading.sin * middle_sin)
    y = from_.y + chord * (heading.sin * middle_cos + heading.cos * middle_sin)
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
    ox, oy, resolution, columns, rows = ground
    steps = step_count(p, sample)
    dt = p.sim_time / steps
    turn = sample.w * dt
    x = y = 0.0
    # Near the border of a cell, a closed form may fall into the neighbouring one.
    is_sure = abs(turn) <= LARGEST_TURN
    if is_sure:
        ramped = ramp(p, start, heading, sample, dt, steps - 1)
        x, y = along_arc(ramped, sample.vx * dt, turn, steps - 1 - ramped.moves)
        at_border = on_border((x - ox) / resolution, MARGIN)
        is_sure = not (at_border or on_border((y - oy) / resolution, MARGIN))
    if not is_sure:
        x, y = exact_end(p, start, sample, steps)
    return world_to_map(x, y, ox, oy, resolution, columns, rows)


@kernel(error_model="numpy")
def probe(
    p: Record,
    scene: Scene,
    start: Record,
    heading: Heading,
    sample: Velocity,
    obstacle_cost: int,
    allowed: float,
) -> int:
    """Return a lower bound of the obstacle cost from a few poses, or -1 if one is illegal.

    The poses are the last one, then those at halves, quarters and eighths of the way: a sample that
    fails does so most often at its end. The bound starts from `obstacle_cost`, and the probe ends
    once it exceeds `allowed`. heading: direction at the start.
    """
    steps = step_count(p, sample)
    dt = p.sim_time / steps
    turn = sample.w * dt
    # Round robots have no outline, and their centre costs little to test in the roll-out.
    if abs(turn) > LARGEST_TURN or scene.footprint.shape[0] < 3:
        return obstacle_cost
    ramped = ramp(p, start, heading, sample, dt, steps - 1)
    outline = outline_of(scene, scene.footprint)
    moves = steps - 1 - ramped.moves  # moves at the sample's velocity
    parts = 1
    while parts <= 8 and moves // parts >= 8:
        for i in range(1, parts + 1, 2):  # The even parts belong to the coarser division before.
            n = moves * i // parts
            x, y = along_arc(ramped, sample.vx * dt, turn, n)
            end = turned(ramped.heading, heading_of(n * turn))
            cost = outline_cost(outline, x, y, end.cos, end.sin, 0, 0, MARGIN)
            if cost == UNSURE:
                continue
            if cost < 0:
                return -1
            obstacle_cost = max(obstacle_cost, cost)
            if obstacle_cost > allowed:
                return obstacle_cost
        parts *= 2
    return obstacle_cost


@kernel(error_model="numpy")
def best_forward(
    p: Record,
    scene: Scene,
    grids: Grids,
    scratch: Scratch,
    start: Record,
    vs: Data,
    ws: Data,
    obstacle_cost: int,
) -> Best:
    """Return the best forward sample. Among equal costs, the first sample wins.

    Each speed in `vs` is combined first with w = 0, then with all values of `ws` but the last, as
    in C++. obstacle_cost: cost at the first pose, which all samples share.
    """
    bases = scratch.bases
    keys = scratch.keys
    heap = scratch.heap
    probed = scratch.probed
    nw = ws.shape[0]
    heading = heading_of(start.theta)
    waiting = _bound(p, scene, grids, scratch, start, vs, ws, obstacle_cost)
    best = Best(HUGE, 0.0, 0.0, 0)
    best_number = 0
    while waiting > 0:
        number = heap[0]
        # All other samples have higher bounds, or equal ones and higher numbers.
        if keys[number] > best.cost or (keys[number] == best.cost and number > best_number):
            break
        sample = scoring.forward_sample(vs, ws, number // nw, number % nw)

        # Raise the bound with a few poses before the whole trajectory is rolled out.
        is_legal = True
        if not probed[number]:
            probed[number] = 1
            allowed = float(NO_CEILING)
            if best.cost < HUGE:
                allowed = (best.cost - bases[number]) / p.occdist_scale + 1.0
            raised = probe(p, scene, start, heading, sample, obstacle_cost, allowed)
            if raised > obstacle_cost:
                keys[number] = bases[number] + p.occdist_scale * raised
                sift_down(heap, keys, waiting, 0)
                continue
            is_legal = raised >= 0

        if is_legal:
            result = scoring.score_below(
                p, scene, grids, start, sample, NO_CEILING, bases[number], best.cost
            )
            cost = result.cost
            if 0 <= cost < best.cost or (cost == best.cost and number < best_number):
                best = Best(cost, sample.vx, sample.w, result.point_count)
                best_number = number
        waiting = drop_first(heap, keys, waiting)
    return best


@kernel(error_model="numpy")
def _bound(
    p: Record,
    scene: Scene,
    grids: Grids,
    scratch: Scratch,
    start: Record,
    vs: Data,
    ws: Data,
    obstacle_cost: int,
) -> int:
    """Fill bases, keys and heap of `scratch`, and return the number of samples that may win.

    The floods continue until they reach the samples' last cells, but only little beyond the robot's
    range, because cells behind walls might require a flood of the whole map.
    """
    # Members of tuples are taken out of the loops, because numba counts references at each access.
    bases = scratch.bases
    keys = scratch.keys
    heap = scratch.heap
    probed = scratch.probed
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
    fastest_sample = max(abs(vs[0]), abs(vs[-1]))  # The speeds are in ascending order.
    speed = max(abs(start.vx), fastest_sample) + abs(start.vy)
    travel = speed * p.sim_time / scene.resolution
    reach = int(min(3.0 * travel, float(cell_count))) + 8
    cell_x = int((start.x - scene.ox) / scene.resolution)
    cell_y = int((start.y - scene.oy) / scene.resolution)
    index = place(path_grid, cell_x, cell_y)
    path_limit = min(int(path_distances[index]), cell_count) + reach
    goal_limit = min(int(goal_distances[index]), cell_count) + reach

    count = 0
    for i in range(vs.shape[0]):
        for j in range(ws.shape[0]):
            base = 0.0
            if by_distances:
                sample = scoring.forward_sample(vs, ws, i, j)
                cell_x, cell_y = end_cell(p, ground, start, heading, sample)
                if cell_x < 0:
                    continue
                index = place(path_grid, cell_x, cell_y)
                path_distance = int(path_distances[index])
                goal_distance = int(goal_distances[index])
                # A value above the number of cells means that the flood has not come that far.
                if path_distance > cell_count:
                    path_distance = at_least(path_grid, index, path_limit)
                if goal_distance > cell_count:
                    goal_distance = at_least(goal_grid, index, goal_limit)
                if path_distance >= cell_count or goal_distance >= cell_count:
                    continue
                base = scoring.terms(p, float(path_distance), float(goal_distance))
            number = i * ws.shape[0] + j
            bases[number] = base
            keys[number] = base + p.occdist_scale * obstacle_cost
            probed[number] = 0
            heap[count] = number
            count += 1
    order_heap(heap, keys, count)
    return count
