"""The seven critics of DWAPlannerROS in the order of the C++ planner, and their weighted sum.

See docs/explanation/planner_dwa.md, sections 6 and 7. Section 7 describes the first critic (OscillationCostFunction):
after a reversal, it bars the previous direction until the robot has moved on. A negative value of a critic rejects the
trajectory. The search (search.py) evaluates only the few samples that may win. score_all_samples evaluates all samples,
for display and tests, and to report why no sample is legal.
"""

import math
from collections import namedtuple
from typing import Sequence, Tuple

import numpy as np

from applr_ros1.common.arrays import Data
from applr_ros1.common.kernels import kernel
from applr_ros1.planner.costmap.footprint_cost import outline_cost, outline_of
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
from applr_ros1.planner.sampling_planner import Record, Triple


@kernel
def is_barred(state: Record, velocity: Triple) -> bool:
    """Return whether the oscillation flags bar this velocity. Zero is never barred."""
    vx, vy, w = velocity
    return bool(
        (state.forward_pos_only and vx < 0)
        or (state.forward_neg_only and vx > 0)
        or (state.strafe_pos_only and vy < 0)
        or (state.strafe_neg_only and vy > 0)
        or (state.rot_pos_only and w < 0)
        or (state.rot_neg_only and w > 0)
    )


@kernel
def remember(p: Record, state: Record, start: Data, velocity: Triple) -> None:
    """Update the oscillation flags with a search's result. Clear them if the robot has moved on since a flag changed.

    start (6,): pose and velocity of this cycle, rounded to float32.
    """
    x, y, theta = start[0], start[1], start[2]
    vx, vy, w = velocity
    (
        state.forward_pos_only,
        state.forward_neg_only,
        state.forward_pos,
        state.forward_neg,
        changed,
    ) = _turned(
        vx, state.forward_pos_only, state.forward_neg_only, state.forward_pos, state.forward_neg
    )
    if abs(vx) <= p.min_vel_trans:
        (
            state.strafe_pos_only,
            state.strafe_neg_only,
            state.strafing_pos,
            state.strafing_neg,
            strafes,
        ) = _turned(
            vy, state.strafe_pos_only, state.strafe_neg_only, state.strafing_pos, state.strafing_neg
        )
        state.rot_pos_only, state.rot_neg_only, state.rotating_pos, state.rotating_neg, rotates = (
            _turned(
                w, state.rot_pos_only, state.rot_neg_only, state.rotating_pos, state.rotating_neg
            )
        )
        changed = changed or strafes or rotates
    if changed:
        state.prev_x = x
        state.prev_y = y
        state.prev_theta = theta
    if (
        state.forward_pos_only
        or state.forward_neg_only
        or state.strafe_pos_only
        or state.strafe_neg_only
        or state.rot_pos_only
        or state.rot_neg_only
    ):
        dx = np.float64(np.float32(x) - np.float32(state.prev_x))
        dy = np.float64(np.float32(y) - np.float32(state.prev_y))
        turn = np.float64(np.float32(theta) - np.float32(state.prev_theta))
        far = dx * dx + dy * dy > p.oscillation_reset_dist * p.oscillation_reset_dist
        if far or abs(turn) > p.oscillation_reset_angle:
            clear(state)


@kernel
def _turned(
    v: float, pos_only: float, neg_only: float, pos: float, neg: float
) -> Tuple[float, float, float, float, bool]:
    """Return the four flags of one axis after a search chose velocity v, and whether v reverses the last direction."""
    if v < 0:
        return pos_only, 1 if pos else neg_only, 0, 1, pos != 0
    if v > 0:
        return 1 if neg else pos_only, neg_only, 1, 0, neg != 0
    return pos_only, neg_only, pos, neg, False


@kernel
def clear(state: Record) -> None:
    """Clear the flags of all directions. The pose of their last change is kept."""
    state.forward_pos_only = state.forward_neg_only = 0
    state.strafe_pos_only = state.strafe_neg_only = 0
    state.rot_pos_only = state.rot_neg_only = 0
    state.forward_pos = state.forward_neg = 0
    state.strafing_pos = state.strafing_neg = 0
    state.rotating_pos = state.rotating_neg = 0


OSCILLATES, COLLIDES, OFF_MAP, IN_OBSTACLE, UNREACHED = (
    -5.0,
    -6.0,
    -4.0,
    -3.0,
    -2.0,
)  # values of rejecting critics
NOTHING_LEGAL = -7.0  # cost of a cycle without a legal sample
REFUSED = -1.0  # cost of a sample rejected by the generator (samples.step_count)
CRITICS = (
    "oscillation",
    "obstacle",
    "goal_front",
    "alignment",
    "path",
    "goal",
    "twirling",
)  # names in C++
ALL = len(CRITICS)
HUGE = float(np.finfo(np.float64).max)


@kernel
def weights(p: Record) -> Tuple[float, ...]:
    """Return the critics' weights in the order of CRITICS. A critic of weight 0 is not evaluated."""
    return (
        1.0,
        p.occdist_scale,
        p.goal_scale,
        p.alignment_scale,
        p.path_scale,
        p.goal_scale,
        p.twirling_scale,
    )


@kernel(error_model="numpy")
def footprint_scale(p: Record, speed: float) -> float:
    """Return the factor by which the footprint is enlarged at this speed [m/s]."""
    if speed <= p.scaling_speed:
        return 1.0
    return (
        p.max_scaling_factor * ((speed - p.scaling_speed) / (p.max_vel_trans - p.scaling_speed))
        + 1.0
    )


@kernel
def scale_footprint(footprint: Data, scale: float, scaled: Data) -> None:
    """Write the vertices (n, 2), multiplied by `scale`, to `scaled`."""
    for i in range(footprint.shape[0]):
        scaled[i, 0] = footprint[i, 0] * scale
        scaled[i, 1] = footprint[i, 1] * scale


@kernel
def critique(
    p: Record,
    state: Record,
    scene: Scene,
    grids: Grids,
    points: Data,
    velocity: Triple,
    critic: int,
) -> float:
    """Return the value of one critic for a trajectory with points (k, 3) and a velocity, or 0 if it has no points."""
    if critic == 0:
        return OSCILLATES if is_barred(state, velocity) else 0.0
    if critic == 1:
        return _obstacle(p, scene, points, ground_speed(velocity[0], velocity[1]))
    if critic == 2:
        return _on_grid(scene, grids, FRONT, points, p.forward_point_distance, False)
    if critic == 3:
        row = grids.facts[1] if grids.facts[0] else ALIGNMENT
        return _on_grid(scene, grids, row, points, p.forward_point_distance, False)
    if critic == 4:
        return _on_grid(scene, grids, PATH, points, 0.0, True)
    if critic == 5:
        return _on_grid(scene, grids, GOAL, points, 0.0, True)
    return abs(velocity[2])


@kernel
def total_cost(
    p: Record,
    state: Record,
    scene: Scene,
    grids: Grids,
    points: Data,
    velocity: Triple,
    best: float,
) -> Tuple[float, int]:
    """Return (cost, critic): the weighted sum of the critics, and the critic that ended the summation, ALL if none did.

    A critic that rejects the trajectory ends the summation, and its value is the cost. A sum above a positive `best`
    also ends the summation, and the cost is this partial sum.
    """
    total = 0.0
    factors = weights(p)
    for critic in range(ALL):
        factor = factors[critic]
        if factor == 0:
            continue
        cost = critique(p, state, scene, grids, points, velocity, critic)
        if cost < 0:
            return cost, critic
        if cost != 0:
            cost *= factor
        total += cost
        if best > 0 and total > best:
            return total, critic
    return total, ALL


@kernel
def weighted_sum(p: Record, occupied: float, distances: Sequence[int], w: float) -> float:
    """Return the cost of a trajectory that no critic rejects, summed in the order of CRITICS.

    occupied: value of the obstacle critic. distances (4,): values of the critics front, alignment, path and goal.
    """
    front, alignment, path, goal = distances[0], distances[1], distances[2], distances[3]
    _, by_obstacle, by_front, by_alignment, by_path, by_goal, by_turn = weights(p)
    cost = (
        occupied * by_obstacle
        + front * by_front
        + alignment * by_alignment
        + path * by_path
        + goal * by_goal
    )
    return cost + abs(w) * by_turn


@kernel
def _obstacle(p: Record, scene: Scene, points: Data, speed: float) -> float:
    """Return the largest cost at any point, or with sum_scores the sum of all costs; COLLIDES if a point is illegal."""
    cells = scene.cells
    ny, nx = cells.shape
    scaled = np.empty_like(scene.footprint)
    scale_footprint(scene.footprint, footprint_scale(p, speed), scaled)
    outline = outline_of(scene, scaled)
    worst = total = 0
    for i in range(points.shape[0]):
        x, y, theta = points[i, 0], points[i, 1], points[i, 2]
        cx, cy = world_to_map(x, y, scene.ox, scene.oy, scene.resolution, nx, ny)
        if cx < 0:
            return COLLIDES
        cost = outline_cost(outline, x, y, math.cos(theta), math.sin(theta), cx, cy, 0.0)
        if cost < 0:
            return COLLIDES
        cost = max(cost, int(cells[cy, cx]))
        worst = max(worst, cost)
        total += cost
    return float(total if p.sum_scores else worst)


@kernel
def _on_grid(
    scene: Scene, grids: Grids, row: int, points: Data, ahead: float, stops: bool
) -> float:
    """Return the grid's value `ahead` [m] in front of the last point, or a negative value if a point is rejected."""
    ny, nx = scene.cells.shape
    grid = grid_of(grids, row)
    value = 0.0
    for i in range(points.shape[0]):
        x, y = points[i, 0], points[i, 1]
        if ahead != 0.0:
            x = x + ahead * math.cos(points[i, 2])
            y = y + ahead * math.sin(points[i, 2])
        cx, cy = world_to_map(x, y, scene.ox, scene.oy, scene.resolution, nx, ny)
        if cx < 0:
            return OFF_MAP
        if not grids.facts[0]:
            value = HUGE  # The grid was never flooded.
        elif stops or i == points.shape[0] - 1:  # If `stops`, every point has to be reachable.
            distance = final_distance(grid, place(grid, cx, cy))
            if stops and distance >= nx * ny:
                return IN_OBSTACLE if distance == nx * ny else UNREACHED
            value = float(distance)
    return value


# All samples of a cycle, one row per sample:
#   velocities (m, 3)   sampled vx, vy, w
#   stored, ends        velocity and last point (m, 3) of the trajectory
#   counts (m,)         number of points, 0 if the generator rejects the sample
#   critics, costs      unweighted values of the critics (m, 7), and their weighted sum (m,)
#   shown (m,)          weighted sum in the search, which stops adding above the cost of the best sample so far
#   ended (m,)          critic that ended this summation, ALL if none did
#   points (k, 4)       x, y, theta and shown cost of all trajectories of non-negative shown cost, one after the other
Samples = namedtuple("Samples", "velocities stored counts ends critics costs shown ended points")


@kernel
def score_all_samples(
    params: Data, flags: Data, grids: Grids, scratch: Scratch, scene: Scene
) -> Samples:
    """Score all samples of the last cycle. flags: oscillation flags as they were before that cycle's search."""
    p, state, start = params[0], flags[0], scratch.start
    axes = sample_axes(p, scratch, scene.plan)
    m = axes[0] * axes[1] * axes[2]
    velocities, stored, ends = np.zeros((m, 3)), np.zeros((m, 3)), np.zeros((m, 3))
    counts, ended = np.zeros(m, np.int64), np.full(m, ALL, np.int64)
    critics, costs, shown = np.zeros((m, ALL)), np.full(m, REFUSED), np.full(m, REFUSED)
    best = -1.0
    for i in range(m):
        sample = sample_of(scratch, axes, i)
        velocities[i] = sample
        steps = counts[i] = step_count(p, sample)
        if steps == 0:
            continue
        velocity = commanded(p, start, sample, steps)
        stored[i] = velocity
        points = np.empty((steps, 3))
        roll_out(p, start, sample, points)
        ends[i] = points[steps - 1]
        for critic in range(ALL):
            critics[i, critic] = critique(p, state, scene, grids, points, velocity, critic)
        costs[i], _ = total_cost(p, state, scene, grids, points, velocity, -1.0)
        shown[i], ended[i] = total_cost(p, state, scene, grids, points, velocity, best)
        if shown[i] >= 0 and (best < 0 or shown[i] < best):
            best = shown[i]
    cloud = np.empty((counts[shown >= 0].sum(), 4))
    n = 0
    for i in range(m):
        if shown[i] >= 0:
            points = np.empty((counts[i], 3))
            roll_out(p, start, (velocities[i, 0], velocities[i, 1], velocities[i, 2]), points)
            cloud[n : n + counts[i], :3] = points
            cloud[n : n + counts[i], 3] = shown[i]
            n += counts[i]
    return Samples(velocities, stored, counts, ends, critics, costs, shown, ended, cloud)
