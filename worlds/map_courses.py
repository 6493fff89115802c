"""Courses through the building of a map: the worlds `office.yaml`, of which `office.yaml:7` is one.

Starts are drawn over the whole floor that the robot reaches, and each goal over all cells at 5 to 15 m of path. The
courses depend on the map and on the radius of the circle around the robot only.
"""

from __future__ import annotations

import functools
import math
import os
from typing import List, NamedTuple

import numpy as np
import scipy

from applr_ros1.common.angles import outside_box, transform_point
from applr_ros1.common.errors import ApplrError

from . import barn, map_reader, search
from .world import Course, Grid, World

CLEARANCE_M = 0.05  # distance of the robot's circle from obstacles and unknown cells on a path [m]
SHORTEST_M, LONGEST_M = 5.0, 15.0  # range of the lengths of the paths [m]
APART_M = 1.0  # smallest distance between two starts [m]
VISIBLE_M = 12.0  # distance from the path up to which obstacles are kept [m]
AHEAD_M = 0.5  # part of the path along which start and goal are directed [m]
MOST, TRIES = 100, 20_000  # largest number of courses, and number of cells drawn as their starts
SEED = 20261127
ENDS_M = 1.25  # part of the path at each end that is no passage, because a goal may be in a corner [m]
WIDEST_M = 3.0  # largest width of a passage [m]
RAYS = np.arange(32) * math.pi / 16  # directions in which the width of a passage is measured [rad]


class Building(NamedTuple):
    """A map, its obstacles (n, 5), the cells (rows, columns) that the robot's centre may cross, and starts (k, 2)."""

    grid: Grid
    boxes: np.ndarray
    free: np.ndarray
    starts: np.ndarray


@functools.lru_cache(maxsize=4)
def building(path: str, radius: float) -> Building:
    """Return the building of a map for a robot within a circle of `radius` [m]. Raise ApplrError without a course."""
    grid = map_reader.read_map(path)
    known = np.pad(grid.cells == map_reader.FREE, 1)  # Cells outside the map are unknown.
    free = grid.resolution * (scipy.ndimage.distance_transform_edt(known)[1:-1, 1:-1] - 0.5) >= radius + CLEARANCE_M
    regions, _ = scipy.ndimage.label(free)
    slices = (slice(0, 0), slice(0, 0)), *scipy.ndimage.find_objects(regions)
    bounds = np.array([[rows.start, columns.start, rows.stop, columns.stop] for rows, columns in slices])
    cells = np.flatnonzero(free)
    drawn = np.random.default_rng(SEED).choice(cells, min(TRIES, len(cells)), replace=False)
    places = np.column_stack(np.unravel_index(drawn, free.shape))
    low, high = np.hsplit(bounds[regions[tuple(places.T)]], 2)  # A region this large has a goal for the start.
    starts = np.empty((0, 2), np.int64)
    for place in places[np.maximum(places - low, high - 1 - places).max(axis=1) * grid.resolution >= SHORTEST_M]:
        if len(starts) < MOST and (np.hypot(*(starts - place).T) * grid.resolution >= APART_M).all():
            starts = np.vstack([starts, place])
    if not len(starts):
        where = f"{path} has no path of {SHORTEST_M:g} m for a robot with a radius of {radius:.2f} m"
        raise ApplrError(f"{where}: check resolution, thresholds and negate")
    return Building(grid, map_reader.boxes(grid), free, starts)


@functools.lru_cache(maxsize=2 * MOST)
def path_cells(path: str, radius: float, number: int) -> np.ndarray:
    """Return the cells (k, 2) of the path of course `number`."""
    grid, _, free, starts = building(path, radius)
    reach = int(LONGEST_M / grid.resolution)
    low = np.maximum(starts[number] - reach, 0)
    rows, columns = (slice(first, last) for first, last in zip(low, starts[number] + reach + 1))
    start = starts[number] - low
    length, move = search.shortest_paths(free[rows, columns], *start, reach)
    goals = np.argwhere((length * grid.resolution >= SHORTEST_M) & (length <= reach))
    cells = [goals[np.random.default_rng([SEED, number]).integers(len(goals))]]
    while (cells[-1] != start).any():
        cells.append(cells[-1] - search.MOVES[move[tuple(cells[-1])]])
    path_to_goal: np.ndarray = np.array(cells[::-1]) + low
    return path_to_goal


def half(path: str, radius: float, upper: bool) -> List[int]:
    """Return the numbers of the courses that lie in one half of the floor alone. The line crosses its longer side."""
    _, _, free, starts = building(path, radius)
    floor = np.argwhere(free)
    axis = int(np.argmax(np.ptp(floor, axis=0)))
    side = 1 if upper else -1
    line, paths = np.median(floor[:, axis]), (path_cells(path, radius, n)[:, axis] for n in range(len(starts)))
    return [number for number, along in enumerate(paths) if (side * (along - line) > 0).all()]


def course(path: str, radius: float, number: int) -> World:
    """Return course `number` of a map with the obstacles near its path."""
    grid, boxes, _, _ = building(path, radius)
    cells = path_cells(path, radius, number)[:, ::-1] + 0.5
    points = np.column_stack(transform_point(grid.origin, *(grid.resolution * cells.T)))
    step = min(len(points) - 1, max(1, round(AHEAD_M / grid.resolution)))
    start, goal = (
        (*points[at].tolist(), math.atan2(*(points[to] - points[since])[::-1]))
        for at, since, to in ((0, 0, step), (-1, -1 - step, -1))
    )
    away, (bx, by, _, *sizes) = np.full(len(boxes), np.inf), boxes.T
    for x, y in points[::step]:
        away = np.minimum(away, np.hypot(*outside_box(x - bx, y - by, grid.origin[2], *sizes)))
    made = Course(start, goal, None, barn.GOAL_TOLERANCE_M, points, planner_ends=True)
    return World(f"{os.path.basename(path)}:{number}", np.zeros((0, 3)), boxes[away <= VISIBLE_M], made, map=grid)


def passage(path: str, radius: float, number: int) -> float:
    """Return the width [m] of the narrowest passage on a course: of the shortest line of free cells across its path."""
    grid = building(path, radius).grid
    ends = round(ENDS_M / grid.resolution)
    steps = np.arange(1, int(WIDEST_M / grid.resolution))[:, None, None]
    rays = np.rint(steps * np.column_stack([np.sin(RAYS), np.cos(RAYS)])).astype(np.int64)
    cells = path_cells(path, radius, number)[ends:-ends, None, None] + rays
    rows, columns = np.moveaxis(np.clip(cells, 0, np.subtract(grid.cells.shape, 1)), -1, 0)
    hits = map_reader.is_occupied(grid.cells[rows, columns])  # (cells of the path, steps, rays)
    there, back = np.split(np.where(hits.any(axis=1), hits.argmax(axis=1), len(steps)), 2, axis=1)
    return float(min(WIDEST_M, grid.resolution * (there + back + 1).min()))
