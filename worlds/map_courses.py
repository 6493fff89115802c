"""Courses through the building of a map: the worlds `office.yaml`, of which `office.yaml:7` is one.

Starts are drawn over the whole floor that the robot reaches, and each goal over all cells at 5 to
15 m of path. A small floor has shorter courses as well. For a search and the verdict on it, courses
stay in either half of the floor. The courses depend on the map and on the radius of the circle
around the robot only.
"""

from __future__ import annotations

import functools
import math
import os
from typing import Any, Dict, List, NamedTuple, Optional, Sequence, Tuple

import numpy as np
import scipy

from applr_ros1.common.angles import outside_box, transform_point
from applr_ros1.common.arrays import Array, Ints
from applr_ros1.common.errors import ApplrError

from . import barn, map_reader, search
from .search import Cells
from .world import Course, Grid, World


class Size(NamedTuple):
    """Range of the lengths of the paths [m], and smallest distance to the start of a course [m]."""

    shortest_m: float
    longest_m: float
    apart_m: float


CLEARANCE_M = 0.05  # distance of the robot's circle from obstacles and unknown cells on a path [m]
# Sizes of courses in the order in which they are drawn. The second and third are for a floor with
# few courses of the first, such as a room of 4 x 4 m, which has none.
SIZES = (
    Size(shortest_m=5.0, longest_m=15.0, apart_m=1.0),
    Size(shortest_m=2.5, longest_m=7.5, apart_m=0.5),
    Size(shortest_m=2.0, longest_m=4.0, apart_m=0.25),
)
VISIBLE_M = 12.0  # distance from the path up to which obstacles are kept [m]
AHEAD_M = 0.5  # part of the path along which start and goal are directed [m]
MOST = 100  # largest number of courses anywhere on the floor
ENOUGH = 20  # number of courses, on the floor and in each half, up to which shorter ones are drawn
TRIES = 20_000  # number of cells drawn as starts
SEED = 20261127
ENDS_M = 1.25  # part of the path at each end that is no passage, as a goal may be in a corner [m]
WIDEST_M = 3.0  # largest width of a passage [m]
RAYS = np.arange(32) * math.pi / 16  # directions in which a passage's width is measured [rad]
HALVES = ("choose", "report")  # names of the courses in the lower and in the upper half of a floor


class Floor:
    """Connected floor of a building, on which the robot's centre can move.

    Args:
        cells: Cells of the floor, none of them on the edge of the map.
        resolution: Edge of a cell [m].
    """

    def __init__(self, cells: Cells, resolution: float) -> None:
        self.cells = cells
        self._resolution = resolution

    @functools.cached_property
    def _graph(self) -> Any:
        return search.grid_graph(self.cells)

    def draw(self, sizes: Sequence[Size], others: Sequence[Draw], most: int) -> List[Draw]:
        """Draw courses of the first size, then of the next, until there are `most`.

        Args:
            sizes: Sizes of the courses.
            others: Courses that exist already, from whose starts others keep their distance.
            most: Largest number of courses, with those that exist already.
        """
        draws: List[Draw] = []
        starts = [other_draw.start for other_draw in others]
        start_cells = np.array(starts, np.int64).reshape(-1, 2)
        floor_cells = np.argwhere(self.cells)
        if not len(floor_cells):
            return draws
        rng = np.random.default_rng(SEED)
        drawn_cells = rng.choice(floor_cells, min(TRIES, len(floor_cells)), replace=False)

        # A path is at least as long as the floor's extent from its start along an axis, so the
        # floor has a goal for every start with such an extent.
        cells_below = drawn_cells - floor_cells.min(axis=0)
        cells_above = floor_cells.max(axis=0) - drawn_cells
        largest_extents = self._resolution * np.maximum(cells_below, cells_above).max(axis=1)
        for size in sizes:
            for start_cell in drawn_cells[largest_extents >= size.shortest_m]:
                if len(start_cells) >= most:
                    return draws
                distances = self._resolution * np.hypot(*(start_cells - start_cell).T)
                if (distances >= size.apart_m).all():
                    start_cells = np.vstack([start_cells, start_cell])
                    draws.append(Draw(self, start_cell, size))
        return draws

    def path(self, draw: Draw, number: int) -> Ints:
        """Draw the goal of course `number`, and return the cells (k, 2) of the way to it."""
        shortest_length = draw.size.shortest_m / self._resolution
        longest_length = draw.size.longest_m / self._resolution
        start_index = np.ravel_multi_index(tuple(draw.start), self.cells.shape)
        path_lengths, predecessors = scipy.sparse.csgraph.dijkstra(
            self._graph,
            directed=True,
            indices=start_index,
            return_predecessors=True,
            limit=longest_length,
        )
        has_length = (path_lengths >= shortest_length) & (path_lengths <= longest_length)
        goal_indices = np.flatnonzero(has_length)
        # A course has random numbers of its own, so that it does not depend on other courses.
        rng = np.random.default_rng([SEED, number])
        cell_index = rng.choice(goal_indices)
        path_indices = [cell_index]
        while cell_index != start_index:
            cell_index = predecessors[cell_index]
            path_indices.append(cell_index)
        rows, columns = np.unravel_index(path_indices[::-1], self.cells.shape)
        return np.column_stack([rows, columns])


class Draw(NamedTuple):
    """Course as drawn: the floor that it may cross, its start cell (2,) and its size."""

    floor: Floor
    start: Ints
    size: Size


class Building:
    """Building of a map, with courses for a robot within a circle.

    The first courses lie anywhere on the floor. If few of them stay in one half of it, more courses
    with higher numbers are drawn within this half.

    Args:
        path: File of the map.
        radius: Radius of the circle around the robot [m].

    Attributes:
        count: Number of the courses that lie anywhere on the floor.

    Raises:
        ApplrError: The map cannot be read, or the robot has no course in a closed room.
    """

    def __init__(self, path: str, radius: float) -> None:
        self._name = os.path.basename(path)
        self._grid = map_reader.read_map(path)
        if not map_reader.is_occupied(self._grid.cells).any():
            raise ApplrError(f"{path} has no occupied cell: check its thresholds and negate")
        self._boxes = map_reader.boxes(self._grid)
        cells, is_open = closed_floor(self._grid, radius)
        self._floor = Floor(cells, self._grid.resolution)

        self._draws = self._floor.draw(SIZES[:1], [], MOST)
        # The closed room of a building with an open door may be a closet: short courses in it
        # would hide that the building itself counts as outside.
        shortest_m = SIZES[0].shortest_m
        if not is_open:
            self._draws += self._floor.draw(SIZES[1:], self._draws, ENOUGH)
            shortest_m = SIZES[-1].shortest_m
        self.count = len(self._draws)
        self._paths: Dict[int, Ints] = {}
        if not self.count:
            missing_path = f"a path of {shortest_m:g} m for a robot with a radius of {radius:.2f} m"
            remedy = "check resolution, thresholds and negate"
            if is_open:
                remedy = (
                    "free space at the edge of the image is outside; if it is unknown space, "
                    "give free_thresh 0.196, otherwise close the outer doors in the image"
                )
            raise ApplrError(f"{path} has no closed room with {missing_path}: {remedy}")

    def path(self, number: int) -> Ints:
        """Return the cells (k, 2) of the shortest path from the start of a course to its goal."""
        if number not in self._paths:
            draw = self._draws[number]
            self._paths[number] = draw.floor.path(draw, number)
        return self._paths[number]

    def has(self, number: int) -> bool:
        """Return whether there is a course with a number."""
        if number < self.count:
            return True
        return any(number in numbers for numbers in self.halves.values())

    def numbers(self, part: str) -> Optional[Sequence[int]]:
        """Return the numbers of the courses in one of HALVES, or anywhere on the floor for "".

        Return None for any other part.
        """
        if part in HALVES:
            return self.halves[part]
        if part:
            return None
        return range(self.count)

    @functools.cached_property
    def halves(self) -> Dict[str, List[int]]:
        """Numbers of the courses that stay in one half of the floor, by the name of the half.

        A line across the longer side of the floor leaves equally many floor cells on both sides.
        Courses that are not drawn yet are drawn for it.
        """
        floor_cells = np.argwhere(self._floor.cells)
        long_axis = int(np.argmax(np.ptp(floor_cells, axis=0)))
        dividing_line = np.median(floor_cells[:, long_axis])  # crosses the longer side of the floor
        # The cells of an axis, as a column or a row that numpy extends over the other axis.
        axis_cells = np.arange(self._floor.cells.shape[long_axis])
        axis_cells = np.expand_dims(axis_cells, 1 - long_axis)
        lower_name, upper_name = HALVES
        return {
            lower_name: self._numbers_within(self._floor.cells & (axis_cells < dividing_line)),
            upper_name: self._numbers_within(self._floor.cells & (axis_cells > dividing_line)),
        }

    def _numbers_within(self, cells: Cells) -> List[int]:
        """Return the numbers of the courses on some cells. Further ones are drawn if it takes few.

        `cells` is a part of the floor.
        """
        numbers = []
        draws = []
        for number in range(self.count):
            if is_within(cells, self.path(number)):
                numbers.append(number)
                draws.append(self._draws[number])
        if len(numbers) < ENOUGH:
            floor_part = Floor(largest(cells), self._grid.resolution)
            further_draws = floor_part.draw(SIZES, draws, ENOUGH)
            first_number = len(self._draws)
            numbers += range(first_number, first_number + len(further_draws))
            self._draws += further_draws
        return numbers

    def course(self, number: int) -> World:
        """Return a course with the obstacles near its path."""
        path_cells = self.path(number)
        x, y = self._grid.resolution * (path_cells.T[::-1] + 0.5)
        points = np.column_stack(transform_point(self._grid.origin, x, y))
        cells_ahead = max(1, round(AHEAD_M / self._grid.resolution))
        start_x, start_y = points[0].tolist()
        goal_x, goal_y = points[-1].tolist()
        course = Course(
            start=(start_x, start_y, direction(points[0], points[cells_ahead])),
            goal=(goal_x, goal_y, direction(points[-1 - cells_ahead], points[-1])),
            finish_y=None,
            goal_tolerance=barn.GOAL_TOLERANCE_M,
            path=points,
            planner_ends=True,
        )

        # Points of the path at intervals of AHEAD_M are close enough to find the visible boxes.
        box_x, box_y, _, size_x, size_y = self._boxes.T
        dx = points[::cells_ahead, :1] - box_x
        dy = points[::cells_ahead, 1:] - box_y
        yaw = self._grid.origin[2]  # All boxes have the direction of the map.
        offset_along, offset_across = outside_box(dx, dy, yaw, size_x, size_y)
        distances = np.hypot(offset_along, offset_across).min(axis=0)
        visible_boxes = self._boxes[distances <= VISIBLE_M]
        world_name = f"{self._name}:{number}"
        return World(world_name, np.zeros((0, 3)), visible_boxes, course, map=self._grid)

    def passage(self, number: int) -> float:
        """Return the width [m] of a course's narrowest passage, at most WIDEST_M.

        The width is the length of the shortest line of free cells across the path.
        """
        resolution = self._grid.resolution
        end_cells = round(ENDS_M / resolution)
        middle_cells = self.path(number)[end_cells:-end_cells]
        rows, columns = middle_cells.T[:, :, np.newaxis, np.newaxis]

        # From every cell of the path, rays are followed cell by cell: (cells, steps, directions).
        steps = np.arange(1, WIDEST_M / resolution)[:, np.newaxis]
        ray_rows = rows + steps * np.sin(RAYS)
        ray_columns = columns + steps * np.cos(RAYS)
        occupied = map_reader.is_occupied(self._grid.cells)
        hits = scipy.ndimage.map_coordinates(occupied, (ray_rows, ray_columns), order=0)
        first_hits = hits.argmax(axis=1)
        free_counts = np.where(hits.any(axis=1), first_hits, len(steps))

        # Opposite rays and the cell itself make a line. A short course may have no cell but its
        # ends, and then no passage.
        opposite_rays = free_counts.reshape(len(free_counts), 2, len(RAYS) // 2)
        line_lengths = opposite_rays.sum(axis=1) + 1
        longest_line = 2 * len(steps) + 1
        shortest_line = float(line_lengths.min(initial=longest_line))
        width = resolution * shortest_line
        return min(WIDEST_M, width)


def closed_floor(grid: Grid, radius: float) -> Tuple[Cells, bool]:
    """Return the cells of the robot's centre in the largest closed room, and whether one is open.

    Free space that reaches the edge of the image is outside, as the unknown cells are in a map of
    ROS 2's map_saver: its free_thresh of 0.25 makes their grey value of 205 free.

    Args:
        grid: Map with at least one cell that is not free.
        radius: Radius of the circle around the robot [m].
    """
    is_free = grid.cells == map_reader.FREE
    # distance to the nearest edge of an obstacle or an unknown cell [cells]
    edge_distance = scipy.ndimage.distance_transform_edt(is_free) - 0.5
    is_reachable = grid.resolution * edge_distance >= radius + CLEARANCE_M
    regions, _ = scipy.ndimage.label(is_reachable)
    is_border = np.ones(is_free.shape, bool)
    is_border[1:-1, 1:-1] = False
    outside_regions = np.unique(regions[is_border & is_reachable])
    is_closed = is_reachable & ~np.isin(regions, outside_regions)
    return largest(is_closed), len(outside_regions) > 0


def largest(cells: Cells) -> Cells:
    """Return the largest connected region of some cells."""
    regions, _ = scipy.ndimage.label(cells)
    region_sizes = np.bincount(regions.ravel(), minlength=2)
    region_sizes[0] = 0  # label of all other cells
    region: Cells = regions == max(1, region_sizes.argmax())
    return region


def is_within(cells: Cells, path: Ints) -> bool:
    """Return whether a path (k, 2) stays on some cells."""
    rows, columns = path.T
    return bool(cells[rows, columns].all())


def direction(first: Array, second: Array) -> float:
    """Return the direction [rad] from one point (2,) [m] to another."""
    dx, dy = second - first
    return math.atan2(dy, dx)
