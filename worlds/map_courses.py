"""Courses through the building of a map: the worlds `office.yaml`, of which `office.yaml:7` is one.

Starts are drawn over the whole floor that the robot reaches, and each goal over all cells at 5 to 15 m of path. The
courses depend on the map and on the radius of the circle around the robot only.
"""

from __future__ import annotations

import math
import os
from typing import Dict, Optional, Sequence

import numpy as np
import scipy

from applr_ros1.common.angles import outside_box, transform_point
from applr_ros1.common.arrays import Ints
from applr_ros1.common.errors import ApplrError

from . import barn, map_reader, search
from .world import Course, World

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


class Building:
    """Building of a map, with courses for a robot within a circle of `radius` [m]. Raises ApplrError if it has none."""

    def __init__(self, path: str, radius: float) -> None:
        self._name, self._grid = os.path.basename(path), map_reader.read_map(path)
        self._boxes = map_reader.boxes(self._grid)
        self._paths: Dict[int, Ints] = {}
        known = np.pad(self._grid.cells == map_reader.FREE, 1)  # Cells outside the map are unknown.
        distance = scipy.ndimage.distance_transform_edt(known)[1:-1, 1:-1] - 0.5  # to the nearest edge [cells]
        regions, _ = scipy.ndimage.label(self._grid.resolution * distance >= radius + CLEARANCE_M)
        # The robot's centre stays on the largest connected floor.
        self._free = regions == 1 + np.bincount(regions.ravel(), minlength=2)[1:].argmax()
        self._graph = search.grid_graph(self._free)
        floor = np.argwhere(self._free)
        drawn = np.random.default_rng(SEED).choice(floor, min(TRIES, len(floor)), replace=False)
        low, high = floor.min(axis=0, initial=self._free.size), floor.max(axis=0, initial=0)
        reach = self._grid.resolution * np.maximum(drawn - low, high - drawn).max(axis=1)
        self.starts = np.empty((0, 2), np.int64)  # cells at which the courses start
        for place in drawn[reach >= SHORTEST_M]:  # The floor has a goal for these starts.
            away = self._grid.resolution * np.hypot(*(self.starts - place).T)
            if len(self.starts) < MOST and (away >= APART_M).all():
                self.starts = np.vstack([self.starts, place])
        if not len(self.starts):
            where = f"{path} has no path of {SHORTEST_M:g} m for a robot with a radius of {radius:.2f} m"
            raise ApplrError(f"{where}: check resolution, thresholds and negate")

    def path(self, number: int) -> Ints:
        """Return the cells (k, 2) of the shortest path from the start of a course to its goal."""
        if number not in self._paths:
            shortest, longest = SHORTEST_M / self._grid.resolution, LONGEST_M / self._grid.resolution
            start = np.ravel_multi_index(tuple(self.starts[number]), self._free.shape)
            length, before = scipy.sparse.csgraph.dijkstra(self._graph, True, start, True, limit=longest)
            goals = np.flatnonzero((length >= shortest) & (length <= longest))
            cells = [np.random.default_rng([SEED, number]).choice(goals)]
            while cells[-1] != start:
                cells.append(before[cells[-1]])
            self._paths[number] = np.column_stack(np.unravel_index(cells[::-1], self._free.shape))
        return self._paths[number]

    def numbers(self, part: str) -> Optional[Sequence[int]]:
        """Return the courses in one half of the floor alone ("choose", "report"), all for "", else None."""
        every = range(len(self.starts))
        if part not in ("choose", "report"):
            return None if part else every
        floor = np.argwhere(self._free)
        axis = int(np.argmax(np.ptp(floor, axis=0)))  # The line between the halves crosses the longer side.
        side, line = 1 if part == "report" else -1, np.median(floor[:, axis])
        return [number for number in every if (side * (self.path(number)[:, axis] - line) > 0).all()]

    def course(self, number: int) -> World:
        """Return a course with the obstacles near its path."""
        x, y = self._grid.resolution * (self.path(number).T[::-1] + 0.5)
        points = np.column_stack(transform_point(self._grid.origin, x, y))
        step = max(1, round(AHEAD_M / self._grid.resolution))
        ends = (points[0], points[step] - points[0]), (points[-1], points[-1] - points[-1 - step])
        start, goal = ((*place.tolist(), math.atan2(*ahead[::-1])) for place, ahead in ends)
        dx, dy = (points[::step, None] - self._boxes[:, :2]).transpose(2, 0, 1)
        away = np.hypot(*outside_box(dx, dy, self._grid.origin[2], *self._boxes[:, 3:].T)).min(axis=0)
        made = Course(start, goal, None, barn.GOAL_TOLERANCE_M, points, planner_ends=True)
        near = self._boxes[away <= VISIBLE_M]
        return World(f"{self._name}:{number}", np.zeros((0, 3)), near, made, map=self._grid)

    def passage(self, number: int) -> float:
        """Return the width [m] of a course's narrowest passage: the shortest line of free cells across the path."""
        ends, steps = round(ENDS_M / self._grid.resolution), np.arange(1, WIDEST_M / self._grid.resolution)[:, None]
        rows, columns = self.path(number)[ends:-ends].T[:, :, None, None]
        rays = rows + steps * np.sin(RAYS), columns + steps * np.cos(RAYS)  # (cells of the path, steps, directions)
        hits = scipy.ndimage.map_coordinates(map_reader.is_occupied(self._grid.cells), rays, order=0)
        free = np.where(hits.any(axis=1), hits.argmax(axis=1), len(steps))
        lines = free.reshape(len(free), 2, -1).sum(axis=1) + 1  # Opposite rays and the cell itself make a line.
        return min(WIDEST_M, self._grid.resolution * float(lines.min()))
