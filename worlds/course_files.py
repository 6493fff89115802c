"""Courses of worlds read from files, called by `sdf_reader`.

A course is stored in the world file, or taken from BARN's path file beside the world file.
"""

from __future__ import annotations

import io
import math
import os
import re
from typing import Any, Sequence
from xml.etree.ElementTree import Element

import numpy as np

from applr_ros1.common.arrays import Array, Ints
from applr_ros1.common.errors import ApplrError
from applr_ros1.common.files import read_bytes, reading

from . import barn, dynabarn, search
from .sdf import numbers
from .world import Course, Mover

PATH_FOLDER = "path_files"
COURSE_REMEDY = (
    "give one: python -m worlds.sdf_writer {} OUT.world --course X Y X Y ..., "
    "from start to goal in metres"
)


def from_element(element: Element) -> Course:
    """Return the course that `sdf_writer` stored in a world file."""
    texts = {tag.tag.rpartition("}")[2]: tag.text for tag in element}

    def get(tag: str, count: int, rows: bool = False) -> Any:
        return tuple(numbers(texts.get(tag), count, f"{tag} of the course", rows))

    coordinates = get("path", 2, rows=True)
    finish_y = None
    if "finish_y" in texts:
        (finish_y,) = get("finish_y", 1)
    (goal_tolerance,) = get("goal_tolerance", 1)
    return Course(
        start=get("start", 3),
        goal=get("goal", 3),
        finish_y=finish_y,
        goal_tolerance=goal_tolerance,
        path=np.array(coordinates).reshape(-1, 2),
        planner_ends="planner_ends" in texts,
    )


def beside(path: str, cylinders: Array, movers: Sequence[Mover]) -> Course:
    """Return the course of the world file `path`: the course of its path file, or DynaBARN's."""
    folder, file_name = os.path.split(os.path.abspath(path))
    number_match = re.search(r"(\d+)\.world$", file_name)
    # DynaBARN reuses BARN's numbers, but all its cylinders move.
    if number_match and len(cylinders):
        path_file = os.path.join(folder, PATH_FOLDER, f"path_{number_match.group(1)}.npy")
        if os.path.exists(path_file):
            with reading(path_file):
                # A pickle in the file of a stranger would execute code.
                cells = np.load(io.BytesIO(read_bytes(path_file)), allow_pickle=False)
                return _on_barns_grid(cells.astype(np.int64), cylinders)
    if movers:
        return dynabarn.arena_course()
    raise ApplrError(f"the world has no course; {COURSE_REMEDY.format(path)}")


def _on_barns_grid(cells: Ints, cylinders: Array) -> Course:
    """Return the paper's course along the cells (k, 2) of a path_N.npy.

    The first cell may occur twice in the file.
    """
    if len(cells) > 2 and np.array_equal(cells[0], cells[1]):
        cells = cells[1:]
    rows, columns = cells.T
    # BARN's paths keep two cells of clearance: one with less than one cell is of another world.
    free_cells = search.free_space(barn.fill_of(cylinders), clearance=1)
    blocked_cells = cells[~free_cells[rows, columns]]
    if len(blocked_cells):
        raise ApplrError(
            f"the path runs into an obstacle at cell {tuple(blocked_cells[0].tolist())}: there is "
            "no passage; copy the path file of this world there, or remove the obstacle"
        )
    return barn.paper_course(barn.to_xy(cells))


def along(points: Array) -> Course:
    """Return a course along points (n, 2) [m].

    Start and goal have the direction of the first leg.
    """
    distance = 0.0
    if len(points):
        distance = math.dist(points[0], points[-1])
    # A robot at the start of such a course would be at its goal.
    if distance <= barn.GOAL_TOLERANCE_M:
        raise ApplrError("the course has no length; give X Y of at least two points in metres")
    dx, dy = points[1] - points[0]
    yaw = math.atan2(dy, dx)
    start_x, start_y = points[0].tolist()
    goal_x, goal_y = points[-1].tolist()
    return Course(
        start=(start_x, start_y, yaw),
        goal=(goal_x, goal_y, yaw),
        finish_y=None,
        goal_tolerance=barn.GOAL_TOLERANCE_M,
        path=points,
        planner_ends=True,
    )
