"""Courses of worlds read from files, called by `sdf_reader`.

A course is stored in the world file, or taken from BARN's path file beside the world file.
"""

from __future__ import annotations

import math
import os
import re
from typing import Any, Sequence
from xml.etree.ElementTree import Element

import numpy as np

from applr_ros1.common.arrays import Array
from applr_ros1.common.errors import ApplrError

from . import barn, dynabarn, search
from .sdf import NAMESPACE, numbers
from .world import Course, Mover

PATH_FOLDER = "path_files"
COURSE_REMEDY = "give one: python -m worlds.sdf_writer {} OUT.world --course X Y X Y ..., from start to goal in metres"


def from_element(element: Element, path: str) -> Course:
    """Return the course that `sdf_writer` stored in a world file."""

    def get(tag: str, count: int) -> Any:
        text = element.findtext(f"{{{NAMESPACE}}}{tag}")
        return tuple(numbers(text, count, f"{tag} of the course in {path}"))

    words = (element.findtext(f"{{{NAMESPACE}}}path") or "").split()
    points = get("path", max(4, len(words) // 2 * 2))
    finish = None if element.find(f"{{{NAMESPACE}}}finish_y") is None else get("finish_y", 1)[0]
    ends = get("start", 3), get("goal", 3)
    own = element.find(f"{{{NAMESPACE}}}planner_ends") is not None
    return Course(*ends, finish, get("goal_tolerance", 1)[0], np.array(points).reshape(-1, 2), own)


def beside(path: str, cylinders: Array, movers: Sequence[Mover]) -> Course:
    """Return the course of the world file `path`: the course of its path file, or DynaBARN's."""
    folder, name = os.path.split(os.path.abspath(path))
    number = re.search(r"(\d+)\.world$", name)
    file = os.path.join(folder, PATH_FOLDER, f"path_{number.group(1)}.npy") if number else ""
    if len(cylinders) and os.path.exists(file):  # DynaBARN reuses BARN's numbers, but all its cylinders move.
        return _on_barns_grid(file, cylinders)
    if movers:
        return dynabarn.arena_course()
    raise ApplrError(f"{path} has no course; {COURSE_REMEDY.format(path)}")


def _on_barns_grid(file: str, cylinders: Array) -> Course:
    """Return the paper's course along the cells (k, 2) of a path_N.npy. Its first cell may occur twice."""
    cells = np.load(file, allow_pickle=False).astype(np.int64)
    cells = cells[1:] if len(cells) > 2 and np.array_equal(cells[0], cells[1]) else cells
    shut = ~search.free_space(barn.fill_of(cylinders), 1)[cells[:, 0], cells[:, 1]]
    if shut.any():
        where = f"runs into an obstacle at cell {tuple(cells[shut][0].tolist())}: there is no passage"
        raise ApplrError(f"{file} {where}; copy the path file of this world there, or remove the obstacle")
    return barn.paper_course(barn.to_xy(cells))


def along(path: str, points: Array) -> Course:
    """Return a course along points (n, 2) [m] for a world file. Start and goal have the direction of the first leg."""
    if len(points) < 2 or math.dist(points[0], points[-1]) <= barn.GOAL_TOLERANCE_M:
        raise ApplrError(f"the course for {path} has no length; give X Y of at least two points in metres")
    yaw = math.atan2(*(points[1] - points[0])[::-1])
    start, goal = ((*place, yaw) for place in points[[0, -1]].tolist())
    return Course(start, goal, None, barn.GOAL_TOLERANCE_M, points, planner_ends=True)
