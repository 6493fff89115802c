"""Search for the velocity of a cycle without rolling out samples that cannot win.

Called by planner.py. A cycle begins by rounding the pose and starting the four distance grids
(section 3 of docs/explanation/planner_dwa.md). Samples wait in a heap, ordered by a lower bound of
their cost (bounds.py). The critics (critics/) evaluate the sample with the lowest bound, until no
bound beats the best cost. The choice equals that of the C++ planner to the last bit.
"""

import math
from typing import NamedTuple

import numpy as np

from applr_ros1.common.arrays import Data
from applr_ros1.common.kernels import kernel
from applr_ros1.planner.distance_grid import place, reset, start_at, start_at_plan
from applr_ros1.planner.dwa.bounds import fill_bounds, probe_sample
from applr_ros1.planner.dwa.critics import oscillation
from applr_ros1.planner.dwa.critics.obstacle import footprint_scale, scale_footprint
from applr_ros1.planner.dwa.critics.registry import OBSTACLE, lower_bound
from applr_ros1.planner.dwa.records import (
    ALIGNMENT,
    FRONT,
    GOAL,
    PATH,
    DWAGrids,
    DWAScene,
    DWAScratch,
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
from applr_ros1.planner.dwa.total_cost import NOTHING_LEGAL, total_cost
from applr_ros1.planner.sampling_planner import (
    Record,
    Triple,
    Velocity,
    heading_of,
    take_start,
    through_quaternion,
)
from applr_ros1.planner.search.best_first import HUGE, SearchStep, first_step, next_step


@kernel
def prepare(params: Data, scratch: DWAScratch, plan: Data, pose: Triple, velocity: Triple) -> bool:
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
def begin_floods(
    p: Record, grids: DWAGrids, start: Record, scene: DWAScene, is_aligned: bool
) -> None:
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


class DWAWinner(NamedTuple):
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
    grids: DWAGrids,
    scratch: DWAScratch,
    scene: DWAScene,
    pose: Triple,
    velocity: Triple,
) -> DWAWinner:
    """Run one cycle: preparation, floods, samples, winner, flags.

    params, state: arrays of one record. pose, velocity: x, y [m], theta [rad] and vx, vy [m/s],
    w [rad/s]. Angles first pass through a quaternion. Then all are rounded to float32.
    """
    p = params[0]
    is_aligned = prepare(params, scratch, scene.plan, pose, velocity)
    start = scratch.start[0]
    begin_floods(p, grids, start, scene, is_aligned)
    axis_counts = sample_axes(p, scratch, scene.plan)
    last_step = _search(p, state[0], grids, scratch, scene, axis_counts)
    if last_step.best_number < 0:
        standstill = Velocity(0.0, 0.0, 0.0)
        return DWAWinner(NOTHING_LEGAL, -1, 0, standstill, standstill, 0.0, is_aligned)

    sample = sample_of(scratch, axis_counts, last_step.best_number)
    steps = step_count(p, sample)
    stored_velocity = commanded(p, start, sample, steps)
    oscillation.remember(p, state[0], start, stored_velocity)
    command_w = through_quaternion(stored_velocity.w)
    return DWAWinner(
        cost=last_step.best_cost,
        number=last_step.best_number,
        steps=steps,
        sample=sample,
        stored=stored_velocity,
        command_w=command_w,
        is_aligned=is_aligned,
    )


@kernel(error_model="numpy")
def _search(
    p: Record,
    state: Record,
    grids: DWAGrids,
    scratch: DWAScratch,
    scene: DWAScene,
    axis_counts: SampleCounts,
) -> SearchStep:
    """Return the last step of the search for the first sample of lowest cost."""
    bounds = scratch.bounds
    heap = scratch.heap
    is_probed = scratch.is_probed
    known_of = scratch.known
    start = scratch.start[0]
    heading = heading_of(start.theta)
    scaled_footprint = np.empty_like(scene.footprint)
    sample_count = fill_bounds(
        p, state, grids, scratch, scene, axis_counts, heading, scaled_footprint
    )
    step = first_step(bounds, heap, is_probed, sample_count)
    while step.number >= 0:
        sample = sample_of(scratch, axis_counts, step.number)
        steps = step_count(p, sample)
        stored_velocity = commanded(p, start, sample, steps)
        if step.is_exact:
            points = np.empty((steps, 3))
            roll_out(p, start, sample, points)
            answer, _ = total_cost(p, state, scene, grids, points, stored_velocity, step.best_cost)
        else:
            # A closer bound from a few poses, before the whole trajectory is rolled out
            answer = bounds[step.number]
            known_obstacle = known_of[step.number, OBSTACLE]
            if p.occdist_scale != 0.0:
                cost_limit = HUGE
                if step.best_cost < HUGE:
                    raise_limit = (step.best_cost - answer) / p.occdist_scale
                    cost_limit = known_obstacle + raise_limit + 1.0
                speed = ground_speed(stored_velocity.vx, stored_velocity.vy)
                scale_footprint(scene.footprint, footprint_scale(p, speed), scaled_footprint)
                obstacle_cost = probe_sample(
                    p, scene, scaled_footprint, start, heading, sample, known_obstacle, cost_limit
                )
                answer = -1.0
                if obstacle_cost >= 0:
                    known_of[step.number, OBSTACLE] = obstacle_cost
                    answer = lower_bound(p, known_of, step.number, stored_velocity)
        step = next_step(bounds, heap, is_probed, step, answer)
    return step
