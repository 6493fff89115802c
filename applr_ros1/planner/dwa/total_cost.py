"""Cost of a trajectory: the weighted sum of the critics' values.

The search (search.py) scores only the few samples that may win. score_all_samples scores all
samples, for display and tests, and to report why no sample is legal.
"""

from typing import NamedTuple, Tuple

import numpy as np

from applr_ros1.common.arrays import Data
from applr_ros1.common.kernels import kernel
from applr_ros1.planner.dwa.critics import registry
from applr_ros1.planner.dwa.critics.registry import ALL
from applr_ros1.planner.dwa.records import DWAGrids, DWAScene, DWAScratch
from applr_ros1.planner.dwa.samples import commanded, roll_out, sample_axes, sample_of, step_count
from applr_ros1.planner.sampling_planner import Record, Velocity

NOTHING_LEGAL = -7.0  # cost of a cycle without a legal sample
REFUSED = -1.0  # cost of a sample rejected by the generator (samples.step_count)


@kernel
def total_cost(
    p: Record,
    state: Record,
    scene: DWAScene,
    grids: DWAGrids,
    points: Data,
    velocity: Velocity,
    best_cost: float,
) -> Tuple[float, int]:
    """Return (cost, critic): the critics' weighted sum, and the critic that ended the summation.

    A critic that rejects the trajectory ends the summation, and its value is the cost. A sum above
    a positive `best_cost` also ends the summation, and the cost is this partial sum. The second
    result is ALL if no critic ended the summation. points, velocity: see registry.value.
    """
    cost_sum = 0.0
    critic_weights = registry.weights(p)
    for critic in range(ALL):
        if critic_weights[critic] == 0:
            continue
        critic_value = registry.value(p, state, scene, grids, points, velocity, critic)
        if critic_value < 0:
            return critic_value, critic
        # An infinite weight times zero would be NaN.
        if critic_value != 0:
            critic_value *= critic_weights[critic]
        cost_sum += critic_value
        if best_cost > 0 and cost_sum > best_cost:
            return cost_sum, critic
    return cost_sum, ALL


class Samples(NamedTuple):
    """All samples of a cycle, one row per sample."""

    velocities: Data  # sampled vx, vy, w (m, 3)
    stored: Data  # velocity of the trajectory (m, 3)
    counts: Data  # number of points (m,), 0 if the generator rejects the sample
    ends: Data  # last point of the trajectory (m, 3)
    critics: Data  # unweighted values of the critics (m, ALL)
    costs: Data  # weighted sums (m,)
    shown: Data  # weighted sums (m,) in the search, which stops adding above the best cost so far
    ended: Data  # critic that ended this summation (m,), ALL if none did
    points: Data  # x, y, theta, shown cost (k, 4) of all trajectories of non-negative shown cost


@kernel
def score_all_samples(
    params: Data, flags: Data, grids: DWAGrids, scratch: DWAScratch, scene: DWAScene
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
            critic_values[i, critic] = registry.value(
                p, state, scene, grids, points, velocity, critic
            )
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
