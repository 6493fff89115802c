"""Search for the velocity of a cycle without rolling out samples that cannot win.

Called by planner.py. A cycle begins by rounding the pose and starting the four distance grids
(section 3 of docs/explanation/planner_dwa.md). Samples wait in a heap, ordered by a lower bound of
their cost (bounds.py). The critics (critics.py) evaluate the sample with the lowest bound, until no
bound beats the best cost. The choice equals that of the C++ planner to the last bit.
"""

import math
from typing import NamedTuple

import numpy as np

from applr_ros1.common.arrays import Data
from applr_ros1.common.kernels import kernel
from applr_ros1.planner.distance_grid import place, reset, start_at, start_at_plan
from applr_ros1.planner.dwa import critics
from applr_ros1.planner.dwa.bounds import fill_bounds, probe
from applr_ros1.planner.dwa.critics import HUGE, NOTHING_LEGAL, weighted_sum
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
    SampleCounts,
    commanded,
    ground_speed,
    roll_out,
    sample_axes,
    sample_of,
    step_count,
)
from applr_ros1.planner.sampling_planner import (
    Record,
    Triple,
    Velocity,
    drop_first,
    heading_of,
    sift_down,
    take_start,
    through_quaternion,
)


@kernel
def prepare(params: Data, scratch: Scratch, plan: Data, pose: Triple, velocity: Triple) -> bool:
    """Store pose and velocity, and return whether the nose-on-path critic is on.

    The critic is off near the plan's end, where the plan ahead is too short for the nose. params:
    array of one record. plan: points (k, 2 or 3) [m], not empty.
    """
    p = params[0]
    start = scratch.start[0]
    take_start(start, pose, velocity)
    # DWAPlanner::updatePlanAndLocalCosts compares squares.
    last_point = plan.shape[0] - 1
    dx = start.x - plan[last_point, 0]
    dy = start.y - plan[last_point, 1]
    nose_offset = p.forward_point_distance
    is_aligned = dx * dx + dy * dy > nose_offset * nose_offset * p.cheat_factor
    p.alignment_scale = p.path_scale if is_aligned else 0.0
    return bool(is_aligned)


@kernel
def begin_floods(p: Record, grids: Grids, start: Record, scene: Scene, is_aligned: bool) -> None:
    """Reset the grids for the scene's costmap and start each flood.

    is_aligned: whether the nose-on-path critic is on.
    """
    # All grids have the same walls, so that three of them are copies of the first.
    plan = scene.plan
    distances = grids.distances
    path_grid = grid_of(grids, PATH)
    reset(path_grid, scene.cells)
    grids.ends[:] = 0
    distances[GOAL] = distances[PATH]
    distances[FRONT] = distances[PATH]

    # The nose-on-path critic reads the path's grid. While it is off, its grid has the plan of the
    # last cycle in which it was on; that is what C++ publishes.
    grid_facts = grids.facts[0]
    grid_facts.flooded = 1
    grid_facts.alignment_row = PATH
    if not is_aligned:
        grid_facts.alignment_row = ALIGNMENT
        distances[ALIGNMENT] = distances[PATH]
        start_at_plan(grid_of(grids, ALIGNMENT), scene, scene.aligned_plan, True)

    goal_x, goal_y = start_at_plan(path_grid, scene, plan, True)
    if goal_x >= 0:
        goal_grid = grid_of(grids, GOAL)
        start_at(goal_grid, place(goal_grid, goal_x, goal_y))

    # The nose's goal lies beyond the plan's end, seen from the robot.
    nose_plan = plan.copy()
    last_point = plan.shape[0] - 1
    end_x = plan[last_point, 0]
    end_y = plan[last_point, 1]
    end_bearing = math.atan2(end_y - start.y, end_x - start.x)
    nose_plan[last_point, 0] += p.forward_point_distance * math.cos(end_bearing)
    nose_plan[last_point, 1] += p.forward_point_distance * math.sin(end_bearing)
    start_at_plan(grid_of(grids, FRONT), scene, nose_plan, False)


NO_LIMIT = 1 << 60  # obstacle cost that no probe exceeds


class Winner(NamedTuple):
    """Result of a cycle's search. A negative cost means no valid command."""

    cost: float
    number: int  # number of the sample, -1 if none is legal
    steps: int  # number of points of the trajectory
    sample: Velocity
    stored: Velocity  # velocity of the trajectory
    command_w: float  # turn rate of the command [rad/s]: the trajectory's, through a quaternion
    is_aligned: bool  # whether the nose-on-path critic is on


@kernel(error_model="numpy")
def find_best(
    params: Data,
    state: Data,
    grids: Grids,
    scratch: Scratch,
    scene: Scene,
    pose: Triple,
    velocity: Triple,
) -> Winner:
    """Run one cycle: preparation, floods, samples, winner, flags.

    params, state: arrays of one record. pose, velocity: x, y [m], theta [rad] and vx, vy [m/s],
    w [rad/s]. Angles first pass through a quaternion. Then all are rounded to float32.
    """
    p = params[0]
    is_aligned = prepare(params, scratch, scene.plan, pose, velocity)
    start = scratch.start[0]
    begin_floods(p, grids, start, scene, is_aligned)
    axis_counts = sample_axes(p, scratch, scene.plan)
    best_sample = _lowest(p, state[0], grids, scratch, scene, axis_counts)
    if best_sample.number < 0:
        standstill = Velocity(0.0, 0.0, 0.0)
        return Winner(NOTHING_LEGAL, -1, 0, standstill, standstill, 0.0, is_aligned)

    sample = sample_of(scratch, axis_counts, best_sample.number)
    steps = step_count(p, sample)
    stored_velocity = commanded(p, start, sample, steps)
    critics.remember(p, state[0], start, stored_velocity)
    command_w = through_quaternion(stored_velocity.w)
    return Winner(
        best_sample.cost, best_sample.number, steps, sample, stored_velocity, command_w, is_aligned
    )


class Best(NamedTuple):
    """First sample of lowest cost."""

    cost: float  # HUGE if no sample is legal
    number: int  # -1 if no sample is legal


@kernel(error_model="numpy")
def _lowest(
    p: Record,
    state: Record,
    grids: Grids,
    scratch: Scratch,
    scene: Scene,
    axis_counts: SampleCounts,
) -> Best:
    """Return the first sample of lowest cost."""
    keys = scratch.keys
    heap = scratch.heap
    start = scratch.start[0]
    heading = heading_of(start.theta)
    scaled_footprint = np.empty_like(scene.footprint)
    waiting_count = fill_bounds(
        p, state, grids, scratch, scene, axis_counts, heading, scaled_footprint
    )
    best_sample = Best(HUGE, -1)
    while waiting_count > 0:
        sample_number = heap[0]
        # All other samples have higher bounds, or equal ones and higher numbers.
        if keys[sample_number] > best_sample.cost or (
            keys[sample_number] == best_sample.cost and sample_number > best_sample.number
        ):
            break
        sample = sample_of(scratch, axis_counts, sample_number)
        steps = step_count(p, sample)
        stored_velocity = commanded(p, start, sample, steps)

        # Raise the bound with a few poses before the whole trajectory is rolled out.
        is_legal = True
        if p.occdist_scale != 0.0 and not scratch.is_probed[sample_number]:
            scratch.is_probed[sample_number] = 1
            bound = scratch.bounds[sample_number]
            cost_limit = NO_LIMIT
            if best_sample.cost < HUGE:
                other_critics = weighted_sum(p, 0.0, bound, stored_velocity.w)
                cost_limit = int(min((best_sample.cost - other_critics) / p.occdist_scale, 1e9)) + 1
            scale = critics.footprint_scale(p, ground_speed(stored_velocity.vx, stored_velocity.vy))
            critics.scale_footprint(scene.footprint, scale, scaled_footprint)
            obstacle_cost = probe(
                p, scene, scaled_footprint, start, heading, sample, bound.obstacle, cost_limit
            )
            if obstacle_cost > bound.obstacle:
                keys[sample_number] = weighted_sum(p, obstacle_cost, bound, stored_velocity.w)
                sift_down(heap, keys, waiting_count, 0)
                continue
            is_legal = obstacle_cost >= 0

        if is_legal:
            points = np.empty((steps, 3))
            roll_out(p, start, sample, points)
            cost, _ = critics.total_cost(
                p, state, scene, grids, points, stored_velocity, best_sample.cost
            )
            if 0 <= cost < best_sample.cost or (
                cost == best_sample.cost and sample_number < best_sample.number
            ):
                best_sample = Best(cost, sample_number)
        waiting_count = drop_first(heap, keys, waiting_count)
    return best_sample
