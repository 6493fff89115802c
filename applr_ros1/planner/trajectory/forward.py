"""Search for the best forward sample of a cycle without rolling out the samples that cannot win.

Called by sampling.py. The search is search/best_first.py; here are the samples and the two bounds
of their cost, from the last point and from a few poses. See docs/explanation/planner.md, section
6.4.
"""

import math
from typing import NamedTuple, Tuple

from applr_ros1.common.arrays import Data
from applr_ros1.common.kernels import kernel
from applr_ros1.planner.costmap.footprint_cost import on_border, outline_of
from applr_ros1.planner.costmap.grid import world_to_map
from applr_ros1.planner.distance_grid import at_least, place
from applr_ros1.planner.sampling_planner import Heading, Record, Velocity, heading_of, turned
from applr_ros1.planner.search.arcs import (
    LARGEST_TURN,
    arc_from,
    flood_reach,
    pose_after,
    probe,
    small_turn,
)
from applr_ros1.planner.search.best_first import HUGE, add, first_step, next_step
from applr_ros1.planner.trajectory import scoring
from applr_ros1.planner.trajectory.records import (
    TrajectoryGrids,
    TrajectoryScene,
    TrajectoryScratch,
)
from applr_ros1.planner.trajectory.scoring import accelerated, step_count

MARGIN = 1e-6  # distance to a border [cells] at which a cell is certain; closed forms err by 1e-10
SHORTEST_PART = 8  # least number of moves between two probed poses


class MapGeometry(NamedTuple):
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


class FloodLimits(NamedTuple):
    """Distances [cells] up to which the grids are flooded for the bounds."""

    path: int
    goal: int


class BestSample(NamedTuple):
    """Best forward sample or turn so far."""

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


@kernel(error_model="numpy")
def end_cell(
    p: Record, geometry: MapGeometry, start: Record, heading: Heading, sample: Velocity
) -> Tuple[int, int]:
    """Return the cell (x, y) of the sample's last point, (-1, -1) if off the map.

    heading: direction at the start.
    """
    origin_x, origin_y, resolution, columns, rows = geometry
    steps = step_count(p, sample)
    dt = p.sim_time / steps
    x = y = 0.0
    # Near the border of a cell, a closed form may fall into the neighbouring one.
    is_sure = abs(sample.w * dt) <= LARGEST_TURN
    if is_sure:
        ramp_end = ramp(p, start, heading, sample, dt, steps - 1)
        arc = arc_from(ramp_end.x, ramp_end.y, ramp_end.heading, sample, dt)
        end = pose_after(arc, steps - 1 - ramp_end.moves)
        x = end.x
        y = end.y
        x_at_border = on_border((x - origin_x) / resolution, MARGIN)
        is_sure = not (x_at_border or on_border((y - origin_y) / resolution, MARGIN))
    if not is_sure:
        x, y, _ = scoring.last_point(p, start, sample)
    return world_to_map(x, y, origin_x, origin_y, resolution, columns, rows)


@kernel(error_model="numpy")
def best_forward(
    p: Record,
    scene: TrajectoryScene,
    grids: TrajectoryGrids,
    scratch: TrajectoryScratch,
    start: Record,
    speeds: Data,
    turn_rates: Data,
    obstacle_cost: int,
) -> BestSample:
    """Return the best forward sample. Among equal costs, the first sample wins.

    Each speed is combined first with w = 0, then with all turn rates but the last, as in C++.
    obstacle_cost: cost at the first pose, which all samples share.
    """
    base_costs = scratch.base_costs
    bounds = scratch.bounds
    heap = scratch.heap
    is_probed = scratch.is_probed
    turn_count = turn_rates.shape[0]
    heading = heading_of(start.theta)
    sample_count = _bound(p, scene, grids, scratch, start, speeds, turn_rates, obstacle_cost)
    best_sample = BestSample(HUGE, 0.0, 0.0, 0)
    step = first_step(bounds, heap, is_probed, sample_count)
    while step.number >= 0:
        sample = scoring.forward_sample(
            speeds, turn_rates, step.number // turn_count, step.number % turn_count
        )
        base_cost = base_costs[step.number]
        if step.is_exact:
            sample_score = scoring.score_below(
                p, scene, grids, start, sample, base_cost, step.best_cost
            )
            answer = sample_score.cost
        else:
            # A closer bound from a few poses, before the whole trajectory is rolled out
            cost_limit = HUGE
            if step.best_cost < HUGE:
                cost_limit = (step.best_cost - base_cost) / p.occdist_scale + 1.0
            raised_cost = probe_sample(p, scene, start, heading, sample, obstacle_cost, cost_limit)
            answer = -1.0
            if raised_cost >= 0:
                answer = base_cost + p.occdist_scale * raised_cost
        step = next_step(bounds, heap, is_probed, step, answer)
    if step.best_number >= 0:
        sample = scoring.forward_sample(
            speeds, turn_rates, step.best_number // turn_count, step.best_number % turn_count
        )
        best_sample = BestSample(step.best_cost, sample.vx, sample.w, step_count(p, sample))
    return best_sample


@kernel(error_model="numpy")
def _bound(
    p: Record,
    scene: TrajectoryScene,
    grids: TrajectoryGrids,
    scratch: TrajectoryScratch,
    start: Record,
    speeds: Data,
    turn_rates: Data,
    obstacle_cost: int,
) -> int:
    """Fill the queue and base_costs of `scratch`, and return the number of samples that may win.

    The bound is the cost at the last point, with the first pose's obstacle cost.
    """
    # Members of tuples are taken out of the loops, because numba counts references at each access.
    base_costs = scratch.base_costs
    bounds = scratch.bounds
    heap = scratch.heap
    is_probed = scratch.is_probed
    path_grid = grids.path
    goal_grid = grids.goal
    path_distances = path_grid.distance
    goal_distances = goal_grid.distance
    rows, columns = scene.cells.shape
    cell_count = columns * rows  # grid value of a wall; a distance is smaller
    geometry = MapGeometry(scene.ox, scene.oy, scene.resolution, columns, rows)
    # With these options only the obstacle term is known before the roll-out.
    by_distances = not p.simple_attractor and not p.heading_scoring

    heading = heading_of(start.theta)
    limits = _flood_limits(p, scene, grids, start, speeds)
    turn_count = turn_rates.shape[0]
    waiting_count = 0
    for speed_number in range(speeds.shape[0]):
        for turn_number in range(turn_count):
            base_cost = 0.0
            if by_distances:
                sample = scoring.forward_sample(speeds, turn_rates, speed_number, turn_number)
                cell_x, cell_y = end_cell(p, geometry, start, heading, sample)
                if cell_x < 0:
                    continue
                end_index = place(path_grid, cell_x, cell_y)
                path_distance = int(path_distances[end_index])
                goal_distance = int(goal_distances[end_index])
                # A value above the number of cells means that the flood has not come that far.
                if path_distance > cell_count:
                    path_distance = at_least(path_grid, end_index, limits.path)
                if goal_distance > cell_count:
                    goal_distance = at_least(goal_grid, end_index, limits.goal)
                if path_distance >= cell_count or goal_distance >= cell_count:
                    continue
                base_cost = scoring.terms(p, float(path_distance), float(goal_distance))
            number = speed_number * turn_count + turn_number
            base_costs[number] = base_cost
            bound = base_cost + p.occdist_scale * obstacle_cost
            waiting_count = add(bounds, heap, is_probed, waiting_count, number, bound)
    return waiting_count


@kernel(error_model="numpy")
def _flood_limits(
    p: Record, scene: TrajectoryScene, grids: TrajectoryGrids, start: Record, speeds: Data
) -> FloodLimits:
    """Return the distances for what the robot can reach within sim_time."""
    rows, columns = scene.cells.shape
    cell_count = columns * rows
    fastest_sample = max(abs(speeds[0]), abs(speeds[-1]))  # The speeds are in ascending order.
    speed = max(abs(start.vx), fastest_sample) + abs(start.vy)
    reach = flood_reach(speed * p.sim_time, scene.resolution, cell_count)
    cell_x = int((start.x - scene.ox) / scene.resolution)
    cell_y = int((start.y - scene.oy) / scene.resolution)
    start_index = place(grids.path, cell_x, cell_y)
    path_distance = min(int(grids.path.distance[start_index]), cell_count)
    goal_distance = min(int(grids.goal.distance[start_index]), cell_count)
    return FloodLimits(path_distance + reach, goal_distance + reach)


@kernel(error_model="numpy")
def probe_sample(
    p: Record,
    scene: TrajectoryScene,
    start: Record,
    heading: Heading,
    sample: Velocity,
    obstacle_cost: int,
    cost_limit: float,
) -> int:
    """Return a lower bound of a sample's obstacle cost from a few poses, see search.arcs.probe.

    heading: direction at the start.
    """
    steps = step_count(p, sample)
    dt = p.sim_time / steps
    # Round robots have no outline, and their centre costs little to test in the roll-out.
    if abs(sample.w * dt) > LARGEST_TURN or scene.footprint.shape[0] < 3:
        return obstacle_cost
    ramp_end = ramp(p, start, heading, sample, dt, steps - 1)
    arc_moves = steps - 1 - ramp_end.moves
    arc = arc_from(ramp_end.x, ramp_end.y, ramp_end.heading, sample, dt)
    outline = outline_of(scene, scene.footprint)
    return probe(outline, arc, arc_moves, SHORTEST_PART, MARGIN, obstacle_cost, cost_limit)
