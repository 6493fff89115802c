"""Roll-out and scoring of one velocity sample, without ROS or state.

This is TrajectoryPlanner::generateTrajectory. Called for the samples of a cycle, and by
TrajectoryPlanner.score for single samples. All arithmetic is double, in the order of the C++ code,
so that results are equal to the last bit.
"""

import math
from typing import NamedTuple, Tuple

import numpy as np

from applr_ros1.common.arrays import Data
from applr_ros1.common.kernels import kernel
from applr_ros1.planner.costmap.footprint import line_cost
from applr_ros1.planner.costmap.footprint_cost import NO_MARGIN, outline_cost, outline_of
from applr_ros1.planner.costmap.grid import INSCRIBED, map_to_world, world_to_map
from applr_ros1.planner.distance_grid import place, settle
from applr_ros1.planner.sampling_planner import (
    Heading,
    Record,
    Triple,
    Velocity,
    angle_difference,
    heading_of,
)
from applr_ros1.planner.search.best_first import HUGE
from applr_ros1.planner.trajectory.records import (
    TrajectoryGrids,
    TrajectoryScene,
    TrajectoryScratch,
)

COLLISION = -1.0  # cost of a sample off the map, or with the footprint on a lethal or unknown cell
NO_PATH = -2.0  # cost of a sample from which neither path nor goal can be reached
PRUNED = -3.0  # cost of a sample whose scoring stopped because the sample cannot beat the best one


class Score(NamedTuple):
    """Score of one sample, with the last point that was scored, (0, 0, 0) if none was."""

    cost: float  # at least 0, or COLLISION, NO_PATH, PRUNED
    point_count: int
    x: float  # [m]
    y: float  # [m]
    theta: float  # [rad]


@kernel
def new_velocity(target: float, velocity: float, acceleration: float, dt: float) -> float:
    """Return the velocity of one axis after dt [s] of acceleration towards `target`."""
    if target - velocity >= 0:
        return min(target, velocity + acceleration * dt)
    return max(target, velocity - acceleration * dt)


@kernel
def accelerated(p: Record, velocity: Velocity, sample: Velocity, dt: float) -> Velocity:
    """Return the velocity after dt [s] of acceleration from `velocity` towards the sample."""
    vx = new_velocity(sample.vx, velocity.vx, p.acc_lim_x, dt)
    vy = new_velocity(sample.vy, velocity.vy, p.acc_lim_y, dt)
    w = new_velocity(sample.w, velocity.w, p.acc_lim_theta, dt)
    return Velocity(vx, vy, w)


@kernel
def advance(
    x: float, y: float, theta: float, heading: Heading, velocity: Velocity, dt: float
) -> Tuple[float, float]:
    """Return the position (x, y) after dt [s]. heading: direction of theta."""
    vx = velocity.vx
    vy = velocity.vy
    # Without a sideways speed, the terms below would add zeros.
    if vy == 0.0:
        return x + vx * heading.cos * dt, y + vx * heading.sin * dt
    side_angle = math.pi / 2 + theta
    dx = (vx * heading.cos + vy * math.cos(side_angle)) * dt
    dy = (vx * heading.sin + vy * math.sin(side_angle)) * dt
    return x + dx, y + dy


@kernel(error_model="numpy")
def step_count(p: Record, sample: Velocity) -> int:
    """Return the number of steps, at least 1, of a sample.

    As in C++, sim_time does not affect turns.
    """
    if p.heading_scoring:
        return max(int(p.sim_time / p.sim_granularity + 0.5), 1)
    speed = abs(sample.vx)
    if sample.vy != 0.0:
        speed = math.hypot(sample.vx, sample.vy)
    linear_steps = speed * p.sim_time / p.sim_granularity
    angular_steps = abs(sample.w) / p.angular_sim_granularity
    return max(int(max(linear_steps, angular_steps) + 0.5), 1)


@kernel(error_model="numpy")
def last_point(p: Record, start: Record, sample: Velocity) -> Triple:
    """Return the exact (x, y, theta) of the last point that score_below scores."""
    steps = step_count(p, sample)
    dt = p.sim_time / steps
    x = start.x
    y = start.y
    theta = start.theta
    velocity = Velocity(start.vx, start.vy, start.w)
    for _ in range(steps - 1):
        velocity = accelerated(p, velocity, sample, dt)
        # A robot that turns in place keeps its position, which saves most of the time there.
        if velocity.vx != 0.0 or velocity.vy != 0.0:
            x, y = advance(x, y, theta, heading_of(theta), velocity, dt)
        theta = theta + velocity.w * dt
    return x, y, theta


@kernel
def terms(p: Record, path_distance: float, goal_distance: float) -> float:
    """Return the sum of the path and goal terms of a cost. The distances are in cells."""
    return p.path_scale * path_distance + goal_distance * p.goal_scale


@kernel
def score(
    params: Data, scene: TrajectoryScene, grids: TrajectoryGrids, start: Record, sample: Velocity
) -> Score:
    """Return the score of one sample, see score_below. params: array of one record."""
    return score_below(params[0], scene, grids, start, sample, 0.0, np.inf)


@kernel(error_model="numpy")
def score_below(
    p: Record,
    scene: TrajectoryScene,
    grids: TrajectoryGrids,
    start: Record,
    sample: Velocity,
    base_cost: float,
    bound: float,
) -> Score:
    """Score a sample whose trajectory begins at the pose and the velocity of `start`.

    The cost is PRUNED as soon as `base_cost` plus the obstacle term exceeds `bound`.

    Args:
        p: record of PARAMETERS.
        scene: surroundings of this cycle.
        grids: grids of this cycle, flooded further where the trajectory needs it.
        start: START record.
        sample: target velocity.
        base_cost: lower bound of the path and goal terms.
        bound: cost above which the sample cannot win.
    """
    cells, origin_x, origin_y, resolution, footprint, _, plan = scene
    outline = outline_of(scene, footprint)
    # Members of tuples are taken out of the loop, because numba counts references at each access.
    path_grid = grids.path
    goal_grid = grids.goal
    path_distances = path_grid.distance
    goal_distances = goal_grid.distance
    rows, columns = cells.shape
    wall_value = columns * rows  # grid value of an obstacle; larger ones are unreached
    unseen_value = wall_value + 1

    steps = step_count(p, sample)
    dt = p.sim_time / steps
    x = start.x
    y = start.y
    theta = start.theta
    velocity = Velocity(start.vx, start.vy, start.w)
    end_x = end_y = end_theta = elapsed = 0.0
    obstacle_cost = 0
    path_distance = goal_distance = heading_difference = 0.0
    for i in range(steps):
        cell_x, cell_y = world_to_map(x, y, origin_x, origin_y, resolution, columns, rows)
        if cell_x < 0:
            return Score(COLLISION, i, end_x, end_y, end_theta)
        heading = heading_of(theta)

        # Obstacle term: the largest cost under the outline or the centre on the whole way
        cost = outline_cost(outline, x, y, heading.cos, heading.sin, cell_x, cell_y, NO_MARGIN)
        if cost < 0:
            return Score(COLLISION, i, end_x, end_y, end_theta)
        obstacle_cost = max(obstacle_cost, cost, int(cells[cell_y, cell_x]))
        if base_cost + p.occdist_scale * obstacle_cost > bound:
            return Score(PRUNED, i, end_x, end_y, end_theta)

        # Path and goal terms: the last values count, but every point has to be reachable. With
        # heading_scoring, only one point is asked.
        if p.simple_attractor:
            if plan.shape[0] > 0:
                dx = x - plan[plan.shape[0] - 1, 0]
                dy = y - plan[plan.shape[0] - 1, 1]
                goal_distance = dx * dx + dy * dy
        elif (
            not p.heading_scoring
            or p.heading_scoring_timestep <= elapsed < p.heading_scoring_timestep + dt
        ):
            grid_index = place(path_grid, cell_x, cell_y)
            goal_steps = int(goal_distances[grid_index])
            path_steps = int(path_distances[grid_index])
            if goal_steps == unseen_value:
                goal_steps = settle(goal_grid, grid_index, unseen_value)
            if path_steps == unseen_value:
                path_steps = settle(path_grid, grid_index, unseen_value)
            if goal_steps >= wall_value or path_steps >= wall_value:
                return Score(NO_PATH, i, end_x, end_y, end_theta)
            path_distance = float(path_steps)
            goal_distance = float(goal_steps)
            if p.heading_scoring:
                heading_difference = heading_difference_of(scene, cell_x, cell_y, x, y, theta)

        # The point is scored; move on to the next one.
        end_x = x
        end_y = y
        end_theta = theta
        velocity = accelerated(p, velocity, sample, dt)
        x, y = advance(x, y, theta, heading, velocity, dt)
        theta = theta + velocity.w * dt
        elapsed += dt

    total_cost = terms(p, path_distance, goal_distance) + p.occdist_scale * obstacle_cost
    if p.heading_scoring:  # C++ adds the terms in another order here.
        total_cost = p.occdist_scale * obstacle_cost + p.path_scale * path_distance
        total_cost = total_cost + 0.3 * heading_difference + goal_distance * p.goal_scale
    return Score(total_cost, steps, end_x, end_y, end_theta)


@kernel
def roll_out(p: Record, start: Record, sample: Velocity, points: Data) -> None:
    """Write a sample's first poses x, y, theta to `points` (n, 3), as score_below visits them."""
    dt = p.sim_time / step_count(p, sample)
    x = start.x
    y = start.y
    theta = start.theta
    velocity = Velocity(start.vx, start.vy, start.w)
    for i in range(points.shape[0]):
        points[i, 0] = x
        points[i, 1] = y
        points[i, 2] = theta
        velocity = accelerated(p, velocity, sample, dt)
        x, y = advance(x, y, theta, heading_of(theta), velocity, dt)
        theta = theta + velocity.w * dt


@kernel
def heading_difference_of(
    scene: TrajectoryScene, cell_x: int, cell_y: int, x: float, y: float, theta: float
) -> float:
    """Return the angle [rad] from the heading to the farthest plan point in sight, or HUGE.

    The result is HUGE if no point is in sight. A point is in sight if the cells between it and the
    robot's cell cost less than 253 (trajectory_planner.cpp, headingDiff).
    """
    cells, origin_x, origin_y, resolution, _, _, plan = scene
    rows, columns = cells.shape
    for i in range(plan.shape[0] - 1, -1, -1):
        plan_x = plan[i, 0]
        plan_y = plan[i, 1]
        point_x, point_y = world_to_map(
            plan_x, plan_y, origin_x, origin_y, resolution, columns, rows
        )
        if point_x < 0:
            continue
        if not 0 <= line_cost(cells, cell_x, cell_y, point_x, point_y) < INSCRIBED:
            continue
        centre_x, centre_y = map_to_world(point_x, point_y, origin_x, origin_y, resolution)
        bearing = math.atan2(centre_y - y, centre_x - x)
        return abs(angle_difference(theta, bearing))
    return HUGE


# Largest number of points shown per trajectory; all points would take megabytes per message.
POINTS = 12


@kernel
def forward_sample(speeds: Data, turn_rates: Data, speed_number: int, turn_number: int) -> Velocity:
    """Return a forward sample of the speeds [m/s] and turn rates [rad/s] of a cycle.

    Turn 0 is straight ahead, turn i has the value i - 1 of `turn_rates`.
    """
    w = 0.0
    if turn_number > 0:
        w = turn_rates[turn_number - 1]
    return Velocity(speeds[speed_number], 0.0, w)


@kernel
def score_all_samples(
    params: Data, scene: TrajectoryScene, grids: TrajectoryGrids, scratch: TrajectoryScratch
) -> Tuple[Data, Data]:
    """Score all forward samples of the last cycle. The search itself rolls out far fewer.

    params: array of one record.

    Returns:
        Points (n, 4) x, y, theta, cost: up to POINTS points per legal sample, evenly spaced and
        including its last point. Numbers (2,) of samples of cost COLLISION and NO_PATH.
    """
    p = params[0]
    start = scratch.start[0]
    turn_count = scratch.turn_rates.shape[0] + 1  # Each speed is also tried straight ahead.
    sample_count = scratch.speeds.shape[0] * turn_count
    cloud = np.empty((sample_count * POINTS, 4))
    refused_counts = np.zeros(2, np.int64)
    shown_count = 0
    for sample_number in range(sample_count):
        sample = forward_sample(
            scratch.speeds,
            scratch.turn_rates,
            sample_number // turn_count,
            sample_number % turn_count,
        )
        sample_score = score_below(p, scene, grids, start, sample, 0.0, np.inf)
        if sample_score.cost < 0:
            refused_counts[0 if sample_score.cost == COLLISION else 1] += 1
            continue
        point_count = sample_score.point_count
        points = np.empty((point_count, 3))
        roll_out(p, start, sample, points)
        # Counted from the end, which is shown in any case.
        point_step = (point_count + POINTS - 1) // POINTS
        for i in range((point_count - 1) % point_step, point_count, point_step):
            cloud[shown_count, :3] = points[i]
            cloud[shown_count, 3] = sample_score.cost
            shown_count += 1
    return cloud[:shown_count], refused_counts
