"""The seven critics of DWAPlannerROS in the order of the C++ planner, and their weighted sum.

See docs/explanation/planner_dwa.md, sections 6 and 7. Section 7 describes the first critic
(OscillationCostFunction): after a reversal, it bars the previous direction until the robot has
moved on. A negative value of a critic rejects the trajectory. The search (search.py) evaluates only
the few samples that may win. score_all_samples evaluates all samples, for display and tests, and to
report why no sample is legal.
"""

import math
from typing import NamedTuple, Tuple

import numpy as np

from applr_ros1.common.arrays import Data
from applr_ros1.common.kernels import kernel
from applr_ros1.planner.costmap.footprint_cost import NO_MARGIN, outline_cost, outline_of
from applr_ros1.planner.costmap.grid import world_to_map
from applr_ros1.planner.distance_grid import final_distance, place
from applr_ros1.planner.dwa.records import (
    ALIGNMENT,
    FRONT,
    GOAL,
    PATH,
    Grids,
    Scene,
    Scratch,
    grid_of,
)
from applr_ros1.planner.dwa.samples import (
    commanded,
    ground_speed,
    roll_out,
    sample_axes,
    sample_of,
    step_count,
)
from applr_ros1.planner.sampling_planner import Record, Velocity


@kernel
def is_barred(state: Record, velocity: Velocity) -> bool:
    """Return whether the oscillation flags bar this velocity. Zero is never barred."""
    return bool(
        (state.forward_pos_only and velocity.vx < 0)
        or (state.forward_neg_only and velocity.vx > 0)
        or (state.strafe_pos_only and velocity.vy < 0)
        or (state.strafe_neg_only and velocity.vy > 0)
        or (state.rot_pos_only and velocity.w < 0)
        or (state.rot_neg_only and velocity.w > 0)
    )


@kernel
def remember(p: Record, state: Record, start: Record, velocity: Velocity) -> None:
    """Update the oscillation flags with the velocity that a search chose.

    start: pose and velocity of this cycle, rounded to float32.
    """
    # 1. The signs of the chosen velocity. Sideways motion and turns count only while the robot
    # hardly drives (oscillation_cost_function.cpp, setOscillationFlags).
    has_reversed = _reverses(velocity.vx, state.forward_pos, state.forward_neg)
    (state.forward_pos_only, state.forward_neg_only, state.forward_pos, state.forward_neg) = _flags(
        velocity.vx,
        state.forward_pos_only,
        state.forward_neg_only,
        state.forward_pos,
        state.forward_neg,
    )
    if abs(velocity.vx) <= p.min_vel_trans:
        has_reversed |= _reverses(velocity.vy, state.strafing_pos, state.strafing_neg)
        (state.strafe_pos_only, state.strafe_neg_only, state.strafing_pos, state.strafing_neg) = (
            _flags(
                velocity.vy,
                state.strafe_pos_only,
                state.strafe_neg_only,
                state.strafing_pos,
                state.strafing_neg,
            )
        )
        has_reversed |= _reverses(velocity.w, state.rotating_pos, state.rotating_neg)
        (state.rot_pos_only, state.rot_neg_only, state.rotating_pos, state.rotating_neg) = _flags(
            velocity.w,
            state.rot_pos_only,
            state.rot_neg_only,
            state.rotating_pos,
            state.rotating_neg,
        )

    # 2. A reversal starts the distance anew after which all flags are cleared.
    if has_reversed:
        state.prev_x = start.x
        state.prev_y = start.y
        state.prev_theta = start.theta
    if (
        state.forward_pos_only
        or state.forward_neg_only
        or state.strafe_pos_only
        or state.strafe_neg_only
        or state.rot_pos_only
        or state.rot_neg_only
    ):
        # As in C++, differences are float32, their squares double, and the angle is not wrapped.
        dx = np.float64(np.float32(start.x) - np.float32(state.prev_x))
        dy = np.float64(np.float32(start.y) - np.float32(state.prev_y))
        turn = np.float64(np.float32(start.theta) - np.float32(state.prev_theta))
        has_moved = dx * dx + dy * dy > p.oscillation_reset_dist * p.oscillation_reset_dist
        if has_moved or abs(turn) > p.oscillation_reset_angle:
            clear(state)


@kernel
def _reverses(v: float, pos: float, neg: float) -> bool:
    """Return whether the velocity v of an axis is opposite to the axis's last motion."""
    return (v < 0 and pos != 0) or (v > 0 and neg != 0)


@kernel
def _flags(
    v: float, pos_only: float, neg_only: float, pos: float, neg: float
) -> Tuple[float, float, float, float]:
    """Return the four flags of one axis after a search chose the velocity v, zero for none."""
    # After a reversal only the new direction is allowed.
    if v < 0:
        if pos:
            neg_only = 1.0
        return pos_only, neg_only, 0.0, 1.0
    if v > 0:
        if neg:
            pos_only = 1.0
        return pos_only, neg_only, 1.0, 0.0
    return pos_only, neg_only, pos, neg


@kernel
def clear(state: Record) -> None:
    """Clear the flags of all directions. The pose of their last change is kept."""
    state.forward_pos_only = state.forward_neg_only = 0
    state.strafe_pos_only = state.strafe_neg_only = 0
    state.rot_pos_only = state.rot_neg_only = 0
    state.forward_pos = state.forward_neg = 0
    state.strafing_pos = state.strafing_neg = 0
    state.rotating_pos = state.rotating_neg = 0


# Values of rejecting critics
OSCILLATES = -5.0
COLLIDES = -6.0
OFF_MAP = -4.0
IN_OBSTACLE = -3.0
UNREACHED = -2.0

NOTHING_LEGAL = -7.0  # cost of a cycle without a legal sample
REFUSED = -1.0  # cost of a sample rejected by the generator (samples.step_count)
HUGE = float(np.finfo(np.float64).max)


class Weights(NamedTuple):
    """Weights of the critics in the order in which C++ asks them, under their names in C++."""

    oscillation: float
    obstacle: float
    goal_front: float  # distance of the nose from the goal ("nose to goal")
    alignment: float  # distance of the nose from the path ("nose on path")
    path: float
    goal: float
    twirling: float


CRITICS = Weights._fields
ALL = len(CRITICS)
NUMBERS = Weights(*range(ALL))  # number of each critic


@kernel
def weights(p: Record) -> Weights:
    """Return the critics' weights. A critic of weight 0 is not evaluated: it rejects nothing."""
    return Weights(
        oscillation=1.0,
        obstacle=p.occdist_scale,
        goal_front=p.goal_scale,
        alignment=p.alignment_scale,
        path=p.path_scale,
        goal=p.goal_scale,
        twirling=p.twirling_scale,
    )


@kernel(error_model="numpy")
def footprint_scale(p: Record, speed: float) -> float:
    """Return the factor by which the footprint is enlarged at this speed [m/s]."""
    # ObstacleCostFunction::getScalingFactor: a fast robot needs more room for errors.
    if speed <= p.scaling_speed:
        return 1.0
    speed_share = (speed - p.scaling_speed) / (p.max_vel_trans - p.scaling_speed)
    return p.max_scaling_factor * speed_share + 1.0


@kernel
def scale_footprint(footprint: Data, scale: float, scaled_footprint: Data) -> None:
    """Write the vertices (n, 2), multiplied by `scale`, to `scaled_footprint`."""
    for i in range(footprint.shape[0]):
        scaled_footprint[i, 0] = footprint[i, 0] * scale
        scaled_footprint[i, 1] = footprint[i, 1] * scale


@kernel
def critique(
    p: Record,
    state: Record,
    scene: Scene,
    grids: Grids,
    points: Data,
    velocity: Velocity,
    critic: int,
) -> float:
    """Return the value of one critic, numbered as in NUMBERS, for a trajectory.

    points: poses (k, 3) of the trajectory; without any, the map's critics return 0. velocity: the
    velocity that the trajectory stores (samples.commanded).
    """
    if critic == NUMBERS.oscillation:
        return OSCILLATES if is_barred(state, velocity) else 0.0
    if critic == NUMBERS.obstacle:
        return _obstacle(p, scene, points, ground_speed(velocity.vx, velocity.vy))
    if critic == NUMBERS.goal_front:
        return _on_grid(scene, grids, FRONT, points, p.forward_point_distance, False)
    if critic == NUMBERS.alignment:
        grid_facts = grids.facts[0]
        grid_row = grid_facts.alignment_row if grid_facts.flooded else ALIGNMENT
        return _on_grid(scene, grids, grid_row, points, p.forward_point_distance, False)
    if critic == NUMBERS.path:
        return _on_grid(scene, grids, PATH, points, 0.0, True)
    if critic == NUMBERS.goal:
        return _on_grid(scene, grids, GOAL, points, 0.0, True)
    return abs(velocity.w)


@kernel
def total_cost(
    p: Record,
    state: Record,
    scene: Scene,
    grids: Grids,
    points: Data,
    velocity: Velocity,
    best_cost: float,
) -> Tuple[float, int]:
    """Return (cost, critic): the critics' weighted sum, and the critic that ended the summation.

    A critic that rejects the trajectory ends the summation, and its value is the cost. A sum above
    a positive `best_cost` also ends the summation, and the cost is this partial sum. The second
    result is ALL if no critic ended the summation. points, velocity: see critique.
    """
    cost_sum = 0.0
    critic_weights = weights(p)
    for critic in range(ALL):
        if critic_weights[critic] == 0:
            continue
        critic_value = critique(p, state, scene, grids, points, velocity, critic)
        if critic_value < 0:
            return critic_value, critic
        # An infinite weight times zero would be NaN.
        if critic_value != 0:
            critic_value *= critic_weights[critic]
        cost_sum += critic_value
        if best_cost > 0 and cost_sum > best_cost:
            return cost_sum, critic
    return cost_sum, ALL


@kernel
def weighted_sum(p: Record, obstacle: float, bound: Record, w: float) -> float:
    """Return the cost of a trajectory that no critic rejects, summed in the order of CRITICS.

    obstacle: value of the obstacle critic. bound: BOUNDS record with the values of the grids'
    critics.
    """
    critic_weights = weights(p)
    cost = obstacle * critic_weights.obstacle
    cost += bound.front * critic_weights.goal_front
    cost += bound.alignment * critic_weights.alignment
    cost += bound.path * critic_weights.path
    cost += bound.goal * critic_weights.goal
    return cost + abs(w) * critic_weights.twirling


@kernel
def _obstacle(p: Record, scene: Scene, points: Data, speed: float) -> float:
    """Return the largest cost at any of the points (k, 3), or COLLIDES if one of them is illegal.

    With sum_scores, return the sum of all costs. speed: speed over ground [m/s], which enlarges the
    footprint.
    """
    cells = scene.cells
    rows, columns = cells.shape
    scaled_footprint = np.empty_like(scene.footprint)
    scale_footprint(scene.footprint, footprint_scale(p, speed), scaled_footprint)
    outline = outline_of(scene, scaled_footprint)
    largest_cost = cost_sum = 0
    for i in range(points.shape[0]):
        x = points[i, 0]
        y = points[i, 1]
        theta = points[i, 2]
        cell_x, cell_y = world_to_map(x, y, scene.ox, scene.oy, scene.resolution, columns, rows)
        if cell_x < 0:
            return COLLIDES
        cost = outline_cost(
            outline, x, y, math.cos(theta), math.sin(theta), cell_x, cell_y, NO_MARGIN
        )
        if cost < 0:
            return COLLIDES
        # The centre may lie on a lethal cell as long as the outline does not touch one, as in C++.
        cost = max(cost, int(cells[cell_y, cell_x]))
        largest_cost = max(largest_cost, cost)
        cost_sum += cost
    return float(cost_sum if p.sum_scores else largest_cost)


@kernel
def _on_grid(
    scene: Scene, grids: Grids, grid_row: int, points: Data, nose_offset: float, tests_all: bool
) -> float:
    """Return the distance on a grid `nose_offset` [m] in front of the last of the points (k, 3).

    A negative result rejects the trajectory: OFF_MAP if any point is off the map and, with
    `tests_all`, IN_OBSTACLE or UNREACHED if any point cannot be reached. Before the first search
    the result is HUGE.
    """
    rows, columns = scene.cells.shape
    grid = grid_of(grids, grid_row)
    last_distance = 0.0
    for i in range(points.shape[0]):
        x = points[i, 0]
        y = points[i, 1]
        if nose_offset != 0.0:
            x = x + nose_offset * math.cos(points[i, 2])
            y = y + nose_offset * math.sin(points[i, 2])
        cell_x, cell_y = world_to_map(x, y, scene.ox, scene.oy, scene.resolution, columns, rows)
        if cell_x < 0:
            return OFF_MAP
        if not grids.facts[0].flooded:
            last_distance = HUGE
        elif tests_all or i == points.shape[0] - 1:
            distance = final_distance(grid, place(grid, cell_x, cell_y))
            if tests_all and distance >= columns * rows:
                return IN_OBSTACLE if distance == columns * rows else UNREACHED
            last_distance = float(distance)
    return last_distance


class Samples(NamedTuple):
    """All samples of a cycle, one row per sample."""

    velocities: Data  # sampled vx, vy, w (m, 3)
    stored: Data  # velocity of the trajectory (m, 3)
    counts: Data  # number of points (m,), 0 if the generator rejects the sample
    ends: Data  # last point of the trajectory (m, 3)
    critics: Data  # unweighted values of the critics (m, 7)
    costs: Data  # weighted sums (m,)
    shown: Data  # weighted sums (m,) in the search, which stops adding above the best cost so far
    ended: Data  # critic that ended this summation (m,), ALL if none did
    points: Data  # x, y, theta, shown cost (k, 4) of all trajectories of non-negative shown cost


@kernel
def score_all_samples(
    params: Data, flags: Data, grids: Grids, scratch: Scratch, scene: Scene
) -> Samples:
    """Score all samples of the last cycle.

    params: array of one record. flags: array of one STATE record, the oscillation flags as they
    were before that cycle's search.
    """
    p = params[0]
    state = flags[0]
    start = scratch.start[0]
    axis_counts = sample_axes(p, scratch, scene.plan)
    sample_count = axis_counts.vx * axis_counts.vy * axis_counts.w
    velocities = np.zeros((sample_count, 3))
    stored_velocities = np.zeros((sample_count, 3))
    point_counts = np.zeros(sample_count, np.int64)
    last_points = np.zeros((sample_count, 3))
    critic_values = np.zeros((sample_count, ALL))
    costs = np.full(sample_count, REFUSED)
    shown_costs = np.full(sample_count, REFUSED)
    ending_critics = np.full(sample_count, ALL, np.int64)

    # Score the samples in the order of C++, where the best cost so far ends a summation.
    best_cost = -1.0
    for i in range(sample_count):
        sample = sample_of(scratch, axis_counts, i)
        velocities[i] = sample
        steps = step_count(p, sample)
        point_counts[i] = steps
        if steps == 0:
            continue
        velocity = commanded(p, start, sample, steps)
        stored_velocities[i] = velocity
        points = np.empty((steps, 3))
        roll_out(p, start, sample, points)
        last_points[i] = points[steps - 1]
        for critic in range(ALL):
            critic_values[i, critic] = critique(p, state, scene, grids, points, velocity, critic)
        costs[i], _ = total_cost(p, state, scene, grids, points, velocity, -1.0)
        shown_costs[i], ending_critics[i] = total_cost(
            p, state, scene, grids, points, velocity, best_cost
        )
        if shown_costs[i] >= 0 and (best_cost < 0 or shown_costs[i] < best_cost):
            best_cost = shown_costs[i]

    # Roll out the legal samples again, now that the number of their points is known.
    trajectory_points = np.empty((point_counts[shown_costs >= 0].sum(), 4))
    first_point = 0
    for i in range(sample_count):
        if shown_costs[i] >= 0:
            end_point = first_point + point_counts[i]
            points = np.empty((point_counts[i], 3))
            roll_out(p, start, sample_of(scratch, axis_counts, i), points)
            trajectory_points[first_point:end_point, :3] = points
            trajectory_points[first_point:end_point, 3] = shown_costs[i]
            first_point = end_point
    return Samples(
        velocities,
        stored_velocities,
        point_counts,
        last_points,
        critic_values,
        costs,
        shown_costs,
        ending_critics,
        trajectory_points,
    )
