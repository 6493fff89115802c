"""Search for the velocity of a cycle without rolling out samples that cannot win.

Called by planner.py. A cycle begins by rounding the pose and starting the four distance grids (section 3 of
docs/explanation/planner_dwa.md). Samples wait in a heap, ordered by a lower bound of their cost (bounds.py). The
critics (critics.py) evaluate the sample with the lowest bound, until no bound beats the best cost. The choice equals
that of the C++ planner to the last bit.
"""

import math
from typing import Any, Tuple

import numpy as np

from applr_ros1.common.arrays import Data
from applr_ros1.common.kernels import kernel
from applr_ros1.planner.distance_grid import place, reset, start_at, start_at_plan
from applr_ros1.planner.dwa import critics
from applr_ros1.planner.dwa.bounds import Counts, fill_bounds, probe
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
    sift_down,
    take_start,
    through_quaternion,
)


@kernel
def prepare(params: Data, scratch: Scratch, plan: Data, pose: Triple, velocity: Triple) -> bool:
    """Store pose and velocity, and return whether the nose-on-path critic is on. It is off near the plan's end.

    plan: points (k, 2 or 3) [m], not empty.
    """
    p = params[0]
    start = scratch.start
    take_start(start, pose, velocity)
    last = plan.shape[0] - 1
    dx = start[0] - plan[last, 0]
    dy = start[1] - plan[last, 1]
    ahead = p.forward_point_distance
    aligned = dx * dx + dy * dy > ahead * ahead * p.cheat_factor
    p.alignment_scale = p.path_scale if aligned else 0.0
    return bool(aligned)


@kernel
def begin_floods(p: Record, grids: Grids, start: Data, scene: Scene, aligned: bool) -> None:
    """Reset the grids for the scene's costmap and start each flood. aligned: whether the nose-on-path critic is on."""
    plan, distances = scene.plan, grids.distances
    path, goal = grid_of(grids, PATH), grid_of(grids, GOAL)
    reset(path, scene.cells)
    grids.ends[:] = 0
    distances[GOAL] = distances[PATH]
    distances[FRONT] = distances[PATH]
    grids.facts[0] = 1
    grids.facts[1] = PATH
    if not aligned:
        grids.facts[1] = ALIGNMENT
        distances[ALIGNMENT] = distances[PATH]
        start_at_plan(grid_of(grids, ALIGNMENT), scene, scene.aligned_plan, True)
    goal_x, goal_y = start_at_plan(path, scene, plan, True)
    if goal_x >= 0:
        start_at(goal, place(goal, goal_x, goal_y))
    front = plan.copy()
    last = front.shape[0] - 1
    angle = math.atan2(plan[last, 1] - start[1], plan[last, 0] - start[0])
    front[last, 0] += p.forward_point_distance * math.cos(angle)
    front[last, 1] += p.forward_point_distance * math.sin(angle)
    start_at_plan(grid_of(grids, FRONT), scene, front, False)


NO_LIMIT = 1 << 60  # obstacle cost that no probe exceeds


@kernel(error_model="numpy")
def find_best(
    params: Data,
    state: Data,
    grids: Grids,
    scratch: Scratch,
    scene: Scene,
    pose: Triple,
    velocity: Triple,
) -> Tuple[Any, ...]:
    """Run one cycle: preparation, floods, samples, winner, flags. params, state: arrays of one record.

    Returns (cost, number of the sample, number of points, the sample, the trajectory's velocity, commanded w, whether
    the nose-on-path critic is on). A negative cost means no valid command. Angles first pass through a quaternion. Then
    pose and velocity are rounded to float32.
    """
    p = params[0]
    aligned = prepare(params, scratch, scene.plan, pose, velocity)
    start = scratch.start
    begin_floods(p, grids, start, scene, aligned)
    axes = sample_axes(p, scratch, scene.plan)
    cost, number = _lowest(p, state[0], grids, scratch, scene, axes)
    if cost == HUGE:
        return NOTHING_LEGAL, -1, 0, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0), 0.0, aligned
    sample = sample_of(scratch, axes, number)
    steps = step_count(p, sample)
    stored = commanded(p, start, sample, steps)
    critics.remember(p, state[0], start, stored)
    return cost, number, steps, sample, stored, through_quaternion(stored[2]), aligned


@kernel(error_model="numpy")
def _lowest(
    p: Record, state: Record, grids: Grids, scratch: Scratch, scene: Scene, axes: Counts
) -> Tuple[float, int]:
    """Return (cost, number) of the first sample of lowest cost, or (HUGE, -1) if none is legal."""
    _, _, _, keys, bounds, occupied, heap, probed, start = scratch
    heading = math.cos(start[2]), math.sin(start[2])
    scaled = np.empty_like(scene.footprint)
    count = fill_bounds(p, state, grids, scratch, scene, axes, heading, scaled)
    best = HUGE
    winner = -1
    while count > 0:
        i = heap[0]
        if keys[i] > best or (keys[i] == best and i > winner):
            break
        sample = sample_of(scratch, axes, i)
        steps = step_count(p, sample)
        stored = commanded(p, start, sample, steps)
        speed = ground_speed(stored[0], stored[1])
        hopeless = False
        if p.occdist_scale != 0.0:
            critics.scale_footprint(scene.footprint, critics.footprint_scale(p, speed), scaled)
            if not probed[i]:
                probed[i] = 1
                allowed = NO_LIMIT
                if best < HUGE:
                    rest = weighted_sum(p, 0.0, bounds[i], stored[2])
                    allowed = int(min((best - rest) / p.occdist_scale, 1e9)) + 1
                met = probe(p, scene, scaled, start, heading, sample, occupied[i], allowed)
                hopeless = met < 0
                if met > occupied[i]:
                    occupied[i] = met
                    keys[i] = weighted_sum(p, met, bounds[i], stored[2])
                    sift_down(heap, keys, count, 0)
                    continue
        if not hopeless:
            points = np.empty((steps, 3))
            roll_out(p, start, sample, points)
            cost, _ = critics.total_cost(p, state, scene, grids, points, stored, best)
            if cost >= 0 and (cost < best or (cost == best and i < winner)):
                best, winner = cost, i
        count -= 1
        heap[0] = heap[count]
        sift_down(heap, keys, count, 0)
    return best, winner
