"""Bound of the time of a drive: the shortest free way at the limits of the base, from rest.

The time of a parameter set above this bound is the room that it leaves a policy.
"""

from __future__ import annotations

import math

import numpy as np
import scipy

from applr_ros1.common.angles import transform_point
from applr_ros1.planner.costmap import footprint
from applr_ros1.robots import Robot
from applr_ros1.robots.geometry import outline
from worlds import World
from worlds.occupancy import OCCUPIED, occupancy
from worlds.search import grid_graph

NEAR = 1.1  # ratio of time and bound up to which a parameter set leaves no room for a policy
ROUTE_CELLS = 250  # number of grid cells in the length of the reference path
# A straight way is at least this share of its moves on the grid, which turn by 45 degrees.
STRAIGHT = math.cos(math.pi / 8)


def bound_s(world: World, robot: Robot) -> float:
    """Return a time [s] below which the robot cannot arrive, even if nothing moves in its way.

    At the end of a course it may still be fast.
    """
    # A robot may turn its narrow side to a gap, but nowhere is it narrower than this circle.
    inscribed_radius, _ = footprint.radii(outline(robot))
    length = shortest_m(world, inscribed_radius)
    acceleration = robot.base.max_acceleration
    last_speed = min(robot.base.max_speed, math.sqrt(2.0 * acceleration * length))
    return length / last_speed + last_speed / (2.0 * acceleration)


def shortest_m(world: World, radius: float) -> float:
    """Return a length [m] that no way of a disc from the start to an arrival falls below.

    Cells of a grid are free if the disc may pass anywhere in them, and lengths are rounded down.
    """
    course = world.course
    grid = occupancy(world, course.route_m / ROUTE_CELLS)
    cell_m = grid.resolution
    # The outermost cells are blocked.
    is_empty = np.pad(grid.cells != OCCUPIED, 1)
    distances = cell_m * scipy.ndimage.distance_transform_edt(is_empty)
    graph = grid_graph(distances > max(0.0, radius - math.sqrt(2.0) * cell_m))

    rows, columns = cell_m * (np.indices(is_empty.shape) - 0.5)
    x, y = transform_point(grid.origin, columns, rows)
    from_start = np.hypot(x - course.start[0], y - course.start[1])
    moves = scipy.sparse.csgraph.dijkstra(graph, indices=from_start.argmin()).reshape(x.shape)
    lengths = np.maximum(from_start, cell_m * (STRAIGHT * moves - 1.0))
    # The planner may report an arrival within the error of the odometry.
    is_arrival = np.vectorize(course.arrived)(x, y, 0.0)
    return float(lengths[is_arrival].min()) - cell_m
