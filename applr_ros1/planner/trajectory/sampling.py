"""Choice of the velocity of a cycle: window, samples, winner, flags.

This is TrajectoryPlanner::createTrajectories. Called by planner.py once per control cycle. The
choice equals that of the C++ planner to the last bit. The cycle begins with the two distance grids,
which count steps to the path and to the local goal (base_local_planner/map_grid.cpp). At the end, a
turn in place may replace the best forward sample (docs/explanation/planner.md, section 6.5). The
conditions of a turn have no side effects, so the cheap conditions come first, and most turns are
never rolled out.
"""

from __future__ import annotations

import math
from typing import NamedTuple, Tuple

import numpy as np

from applr_ros1.common.arrays import Data
from applr_ros1.common.kernels import kernel
from applr_ros1.planner.costmap.footprint import farthest, fill_footprint
from applr_ros1.planner.costmap.footprint_cost import NO_MARGIN, outline_cost, outline_of
from applr_ros1.planner.costmap.grid import world_to_map
from applr_ros1.planner.distance_grid import (
    final_distance,
    place,
    reset,
    settle,
    start_at,
    start_at_plan,
)
from applr_ros1.planner.sampling_planner import (
    Record,
    Triple,
    Velocity,
    angle_difference,
    heading_of,
    take_start,
    through_quaternion,
)
from applr_ros1.planner.search.best_first import HUGE
from applr_ros1.planner.trajectory import scoring
from applr_ros1.planner.trajectory.forward import BestSample, best_forward
from applr_ros1.planner.trajectory.records import (
    TrajectoryGrids,
    TrajectoryScene,
    TrajectoryScratch,
)
from applr_ros1.planner.trajectory.scoring import (
    COLLISION,
    NO_PATH,
    score_below,
)


@kernel
def prepare(
    grids: TrajectoryGrids, scene: TrajectoryScene, x: float, y: float, yaw: float
) -> Tuple[int, int]:
    """Reset both grids, start their floods, and return the local goal's cell (x, y).

    Walls under the robot's footprint are passable in the path grid but not in the goal grid. The
    local goal is (-1, -1) if the plan is off the map.
    """
    reset(grids.path, scene.cells)
    reset(grids.goal, scene.cells)
    _open_under_robot(grids, scene, x, y, yaw)
    goal_x, goal_y = start_at_plan(grids.path, scene, scene.plan, True)
    if goal_x >= 0:
        start_at(grids.goal, place(grids.goal, goal_x, goal_y))
    return goal_x, goal_y


@kernel
def _open_under_robot(
    grids: TrajectoryGrids, scene: TrajectoryScene, x: float, y: float, yaw: float
) -> None:
    """Mark the cells under the footprint (`within`) and make them passable in the path grid."""
    _, origin_x, origin_y, resolution, footprint, _, _ = scene
    rows, columns = grids.within.shape
    unseen_value = columns * rows + 1
    grids.within[:] = 0
    fill_footprint(grids.within, 1, origin_x, origin_y, resolution, footprint, (x, y, yaw), False)

    # Only a square around the robot can have marked cells. The robot may be off the map.
    half_width = int(min(farthest(footprint) / resolution, float(columns + rows))) + 2
    cell_x = int(min(max((x - origin_x) / resolution, 0.0), columns - 1.0))
    cell_y = int(min(max((y - origin_y) / resolution, 0.0), rows - 1.0))
    for row in range(max(0, cell_y - half_width), min(rows, cell_y + half_width + 1)):
        for column in range(max(0, cell_x - half_width), min(columns, cell_x + half_width + 1)):
            if grids.within[row, column]:
                grids.path.distance[place(grids.path, column, row)] = unseen_value


@kernel(error_model="numpy")
def best_in_place(
    p: Record,
    state: Record,
    scene: TrajectoryScene,
    grids: TrajectoryGrids,
    start: Record,
    turn_rates: Data,
    turn_rate_step: float,
    obstacle_cost: int,
    best_sample: BestSample,
) -> BestSample:
    """Return the turn in place that replaces the best forward sample, or that sample if none does.

    A turn must not cost more than the best sample or turn so far, must be faster than the step of
    the turn rates, and must not be barred by `state`. The cell heading_lookahead ahead of the
    turned robot must be on the map and nearer to the goal than for all turns accepted before.
    turn_rates, turn_rate_step: turn rates and their step [rad/s]. obstacle_cost: cost at the first
    pose, which all turns share. best_sample: best forward sample.
    """
    rows, columns = scene.cells.shape
    wall_value = columns * rows  # grid value of an obstacle; larger ones are unreached
    nearest_ahead = HUGE
    for i in range(turn_rates.shape[0]):
        # Turns that are too slow, or barred because the robot has turned to and fro
        w = turn_rates[i]
        if not (w > turn_rate_step or w < -turn_rate_step) or w == 0.0:
            continue
        if (state.stuck_left and w < 0) or (state.stuck_right and w > 0):
            continue
        # Many bases do not turn at all at a lower rate.
        w = max(w, p.min_in_place_vel_theta) if w > 0 else min(w, -p.min_in_place_vel_theta)

        # A lower bound of the cost from the last point
        sample = Velocity(0.0, 0.0, w)
        x, y, theta = scoring.last_point(p, start, sample)
        base_cost = 0.0
        if not p.simple_attractor and not p.heading_scoring:
            cell_x, cell_y = world_to_map(x, y, scene.ox, scene.oy, scene.resolution, columns, rows)
            if cell_x < 0:
                continue
            end_index = place(grids.path, cell_x, cell_y)
            path_distance = settle(grids.path, end_index, wall_value + 1)
            goal_distance = settle(grids.goal, end_index, wall_value + 1)
            if path_distance >= wall_value or goal_distance >= wall_value:
                continue
            base_cost = scoring.terms(p, float(path_distance), float(goal_distance))
        if base_cost + p.occdist_scale * obstacle_cost > best_sample.cost:
            continue

        # The distance from the goal ahead of the turned robot, then the whole cost
        distance_ahead = _distance_ahead(p, scene, grids, x, y, theta, nearest_ahead)
        if not 0 <= distance_ahead < nearest_ahead:
            continue
        turn_score = score_below(p, scene, grids, start, sample, base_cost, best_sample.cost)
        if 0 <= turn_score.cost <= best_sample.cost:
            best_sample = BestSample(turn_score.cost, 0.0, w, turn_score.point_count)
            nearest_ahead = float(distance_ahead)
    return best_sample


@kernel
def _distance_ahead(
    p: Record,
    scene: TrajectoryScene,
    grids: TrajectoryGrids,
    x: float,
    y: float,
    theta: float,
    limit: float,
) -> int:
    """Return the goal distance [cells] heading_lookahead ahead of a pose.

    The result is -1 if that point is off the map or its distance not below `limit`.
    """
    rows, columns = scene.cells.shape
    wall_value = columns * rows
    ahead_x = x + p.heading_lookahead * math.cos(theta)
    ahead_y = y + p.heading_lookahead * math.sin(theta)
    cell_x, cell_y = world_to_map(
        ahead_x, ahead_y, scene.ox, scene.oy, scene.resolution, columns, rows
    )
    if cell_x < 0:
        return -1
    goal_grid = grids.goal
    ahead_index = place(goal_grid, cell_x, cell_y)
    # A flood that has stopped at the limit has cells left in its queue.
    distance = settle(goal_grid, ahead_index, int(min(limit, wall_value + 1.0)))
    if distance > wall_value and goal_grid.ends[0] < goal_grid.ends[1]:
        return -1
    if distance == wall_value and limit > wall_value:
        return final_distance(goal_grid, ahead_index)
    return distance


class TrajectoryWinner(NamedTuple):
    """Result of a cycle. A negative cost means no valid command, which is then (0, 0)."""

    cost: float
    vx: float  # [m/s]
    w: float  # [rad/s]
    point_count: int
    command_vx: float  # [m/s]
    command_w: float  # turn rate of the command [rad/s]: w, through a quaternion


@kernel(error_model="numpy")
def find_best_path(
    params: Data,
    state: Data,
    grids: TrajectoryGrids,
    scratch: TrajectoryScratch,
    scene: TrajectoryScene,
    pose: Triple,
    velocity: Triple,
) -> TrajectoryWinner:
    """Run one cycle: floods, samples, winner, flags.

    params, state: arrays of one record. pose, velocity: x, y [m], theta [rad] and vx, vy [m/s],
    w [rad/s], first rounded to float32, as in C++.
    """
    # Where the samples start, and their values
    p = params[0]
    start = scratch.start[0]
    take_start(start, pose, velocity)
    prepare(grids, scene, start.x, start.y, start.theta)
    window = velocity_window(p, scene.plan, start)
    speeds = scratch.speeds[: p.vx_samples]
    turn_rates = scratch.turn_rates[: p.vtheta_samples]
    fill_evenly(window.min_vx, window.max_vx, speeds)
    turn_rate_step = fill_evenly(window.min_w, window.max_w, turn_rates)
    if turn_rates.shape[0] == 1:
        # C++ divides by zero here. A single turn passes its test only if the window is inverted.
        turn_rate_step = -np.inf if window.max_w < window.min_w else np.inf

    # Forward samples, except during an escape, then turns in place
    best_sample = BestSample(HUGE, 0.0, 0.0, 0)
    obstacle_cost = first_pose(p, scene, grids, start)
    if obstacle_cost >= 0:
        if not state[0].escaping:
            best_sample = best_forward(
                p, scene, grids, scratch, start, speeds, turn_rates, obstacle_cost
            )
        best_sample = best_in_place(
            p, state[0], scene, grids, start, turn_rates, turn_rate_step, obstacle_cost, best_sample
        )

    # If nothing is legal, the robot backs out, even into an obstacle.
    is_legal = best_sample.point_count > 0
    if not is_legal:
        escape_velocity = Velocity(p.escape_vel, 0.0, 0.0)
        escape_score = score_below(p, scene, grids, start, escape_velocity, 0.0, np.inf)
        best_sample = BestSample(
            escape_score.cost, escape_velocity.vx, 0.0, escape_score.point_count
        )
    remember(p, state[0], start, best_sample.cost, best_sample.vx, best_sample.w, is_legal)
    cost = best_sample.cost
    if cost == COLLISION:
        cost = 1.0
    if cost < 0:
        return TrajectoryWinner(
            cost, best_sample.vx, best_sample.w, best_sample.point_count, 0.0, 0.0
        )
    command_w = through_quaternion(best_sample.w)
    return TrajectoryWinner(
        cost, best_sample.vx, best_sample.w, best_sample.point_count, best_sample.vx, command_w
    )


class VelocityWindow(NamedTuple):
    """Range of the sampled velocities."""

    min_vx: float  # [m/s]
    max_vx: float
    min_w: float  # [rad/s]
    max_w: float


@kernel(error_model="numpy")
def velocity_window(p: Record, plan: Data, start: Record) -> VelocityWindow:
    """Return the range of this cycle's samples. docs/explanation/planner.md, section 6.3.

    plan: points (k, 2) [m], may be empty. Its end is not passed within sim_time.
    """
    max_vx = p.max_vel_x
    if plan.shape[0] > 0:
        last_point = plan.shape[0] - 1
        end_x = plan[last_point, 0]
        end_y = plan[last_point, 1]
        distance = math.hypot(end_x - start.x, end_y - start.y)
        max_vx = min(max_vx, distance / p.sim_time)
    period = p.sim_period if p.dwa else p.sim_time
    change = p.acc_lim_x * period
    max_vx = max(min(max_vx, start.vx + change), p.min_vel_x)
    min_vx = max(p.min_vel_x, start.vx - change)
    change = p.acc_lim_theta * period
    max_w = min(p.max_vel_theta, start.w + change)
    min_w = max(p.min_vel_theta, start.w - change)
    return VelocityWindow(min_vx, max_vx, min_w, max_w)


@kernel
def fill_evenly(lowest: float, highest: float, values: Data) -> float:
    """Fill `values` (n,) from `lowest` to `highest` in equal steps, and return the step.

    As in C++, the values come from repeated addition. The step is 0 for a single value.
    """
    n = values.shape[0]
    step = 0.0
    if n > 1:
        step = (highest - lowest) / (n - 1)
    value = lowest
    for i in range(n):
        values[i] = value
        value += step
    return step


@kernel
def first_pose(p: Record, scene: TrajectoryScene, grids: TrajectoryGrids, start: Record) -> int:
    """Return the cost under the robot at its current pose, the first point of every sample.

    The result is COLLISION or NO_PATH if that pose makes every sample illegal.
    """
    rows, columns = scene.cells.shape
    cell_x, cell_y = world_to_map(
        start.x, start.y, scene.ox, scene.oy, scene.resolution, columns, rows
    )
    if cell_x < 0:
        return int(COLLISION)
    outline = outline_of(scene, scene.footprint)
    heading = heading_of(start.theta)
    cost = outline_cost(
        outline, start.x, start.y, heading.cos, heading.sin, cell_x, cell_y, NO_MARGIN
    )
    if cost < 0:
        return int(COLLISION)
    if not p.simple_attractor and not p.heading_scoring:
        # Values of the grids; with the second as its limit, a flood goes as far as it must.
        wall_value = columns * rows
        unseen_value = wall_value + 1
        start_index = place(grids.goal, cell_x, cell_y)
        if settle(grids.goal, start_index, unseen_value) >= wall_value:
            return int(NO_PATH)
        if settle(grids.path, start_index, unseen_value) >= wall_value:
            return int(NO_PATH)
    return max(cost, int(scene.cells[cell_y, cell_x]))


@kernel
def remember(
    p: Record, state: Record, start: Record, cost: float, vx: float, w: float, is_legal: bool
) -> None:
    """Update the flags with the choice of the cycle. docs/explanation/planner.md, section 6.6.

    vx, w: chosen velocity [m/s, rad/s]. is_legal: whether the choice is a forward sample or a turn.
    Otherwise the robot backs out, at `cost`.
    """
    # A second turn in the same direction bars the other one, until the robot has moved on.
    if is_legal and not vx > 0:
        if w < 0:
            state.stuck_right = state.stuck_right or state.rotating_right
            state.rotating_right = 1
        elif w > 0:
            state.stuck_left = state.stuck_left or state.rotating_left
            state.rotating_left = 1
        state.prev_x = start.x
        state.prev_y = start.y
    moved_distance = math.hypot(start.x - state.prev_x, start.y - state.prev_y)
    if moved_distance > p.oscillation_reset_dist:
        state.stuck_left = state.stuck_right = 0
        state.rotating_left = state.rotating_right = 0

    # An escape begins where nothing is legal, and ends once the robot is away from there.
    if not is_legal and not state.escaping and cost > NO_PATH:
        state.escape_x = start.x
        state.escape_y = start.y
        state.escape_theta = start.theta
        state.escaping = 1
    backed_distance = math.hypot(start.x - state.escape_x, start.y - state.escape_y)
    escape_turn = abs(angle_difference(state.escape_theta, start.theta))
    if backed_distance > p.escape_reset_dist or escape_turn > p.escape_reset_theta:
        state.escaping = 0
