"""A course for a world that was read from a file.

It is stated in the file, taken from BARN's path file beside it, or searched for. `sdf_reader` calls it.
"""

from __future__ import annotations

import math
import os
import re
from typing import Optional, Tuple
from xml.etree.ElementTree import Element

import numpy as np
import scipy

from applr_ros1.common.errors import reason

from . import barn, dynabarn, occupancy, search
from .sdf import numbers
from .world import Course, WorldError

NAMESPACE = "applr"  # of our own elements: {applr}course, {applr}waypoints
PATH_FOLDER = "path_files"
ROBOT_RADIUS_M = 0.30  # [m] kept free around a searched path: half a Jackal's diagonal and a little
MARGIN_M = 1.0  # [m] a searched course starts and ends this far outside the obstacles
SEARCH_CELL_M = 0.10  # [m]
DOOR_WIDTH_M = 2.4  # [m]; a gap in a room's walls that is no wider is its door
DOOR_SHARE = 0.1  # share of a room's outline that may be doors
NARROW_WIDTH_M = 5.0  # [m]; obstacles in a narrower area may be passed on the outside
COURSE_REMEDY = "give one: python -m worlds.sdf_writer {} OUT.world --course X Y X Y ..., from start to goal in metres"
PATH_REMEDY = "put the world's own path file there"
MAX_SIDE_M = 50.0  # [m] of the area searched


def from_element(element: Element, path: str) -> Course:
    """The course that our writer put into a world file."""

    def get(tag, count):
        text = element.findtext(f"{{{NAMESPACE}}}{tag}")
        return tuple(numbers(text, count, f"{tag} of the course in {path}"))

    words = (element.findtext(f"{{{NAMESPACE}}}path") or "").split()
    points = get("path", max(4, len(words) // 2 * 2))
    finish = None if element.find(f"{{{NAMESPACE}}}finish_y") is None else get("finish_y", 1)[0]
    ends = get("start", 3), get("goal", 3)
    own = element.find(f"{{{NAMESPACE}}}planner_ends") is not None
    return Course(*ends, finish, get("goal_tolerance", 1)[0], np.array(points).reshape(-1, 2), own)


def beside(path: str, cylinders: np.ndarray, boxes: np.ndarray, movers: tuple) -> Course:
    """The course of the world file `path`: from its path file, DynaBARN's, or searched. Raises WorldError."""
    if movers and not len(cylinders):  # DynaBARN's numbers are BARN's too: a path file beside it is of another world
        return dynabarn.arena_course()
    number = re.search(r"(\d+)$", os.path.splitext(os.path.basename(path))[0])
    if number:
        folder = os.path.dirname(os.path.abspath(path))
        file = os.path.join(folder, PATH_FOLDER, f"path_{number.group(1)}.npy")
        if os.path.lexists(file):
            return _on_barns_grid(file, cylinders)
    if movers:
        return dynabarn.arena_course()
    if _is_barns(cylinders, boxes):
        return _searched_on_barns_grid(path, cylinders)
    return _searched(path, cylinders, boxes)


def read_path_file(file: str) -> np.ndarray:
    """(k, 2) int64 cells from a path_N.npy, its doubled first point once. WorldError where it is of another kind."""
    try:
        cells = np.load(file, allow_pickle=False).astype(np.int64)
    except ValueError as error:
        raise WorldError(f"{file} is not an .npy file of numbers ({reason(error)}); put BARN's there") from None
    return cells[1:] if len(cells) > 2 and np.array_equal(cells[0], cells[1]) else cells


def _on_barns_grid(file: str, cylinders: np.ndarray) -> Course:
    cells = read_path_file(file)
    clear = search.free_space(barn.fill_of(cylinders), 1)
    shut = ~clear[cells[:, 0], cells[:, 1]]
    if shut.any():
        cell = tuple(int(v) for v in cells[shut][0])
        raise WorldError(
            f"{file} runs into an obstacle at cell {cell}: no passage there; {PATH_REMEDY} or clear the way"
        )
    return barn.paper_course(barn.to_xy(cells))


def _is_barns(cylinders: np.ndarray, boxes: np.ndarray) -> bool:
    """Return true for cylinders on BARN's cells, between BARN's two walls."""
    if len(boxes) or not len(cylinders):
        return False
    cells = barn.to_cells(cylinders[:, :2])
    on_grid = np.abs(barn.to_xy(cells) - cylinders[:, :2]).max() < 0.25 * barn.CELL_M
    return bool(on_grid and set(cells[:, 0]) <= set(range(barn.ROWS)) and barn.fill_of(cylinders)[[0, -1]].all())


def _searched_on_barns_grid(path: str, cylinders: np.ndarray) -> Course:
    free = search.free_space(barn.fill_of(cylinders), barn.CLEARANCE_CELLS)
    ends = [(r, c) for c in (0, barn.COLS - 1) for r in range(barn.ROWS)]
    cells = search.shortest_path(free, ends[: barn.ROWS], ends[barn.ROWS :])
    if cells is None:
        passage = f"passage of {barn.CELL_M * (2 * barn.CLEARANCE_CELLS + 1):.2f} m through its field"
        raise WorldError(f"{path} has no {passage}; clear a way or give another world")
    return barn.paper_course(barn.to_xy(cells))


def _searched(path: str, cylinders: np.ndarray, boxes: np.ndarray) -> Course:
    """Inside closed walls from one end to the other, else from below the obstacles (least y) to above them."""
    extent = _extent(cylinders, boxes)
    if extent is None:
        raise WorldError(f"{path} holds no obstacle in a ground robot's way; give a world with boxes or cylinders")
    low, high = extent[0] - MARGIN_M - 0.5 * SEARCH_CELL_M, extent[1] + MARGIN_M
    if max(high - low) > MAX_SIDE_M:
        size = f"{high[0] - low[0]:.0f} x {high[1] - low[1]:.0f} m, too large to search for a course"
        raise WorldError(f"{path} is {size} (at most {MAX_SIDE_M:.0f} m); {COURSE_REMEDY.format(path)}")
    free = free_grid(low, high, cylinders, boxes)
    room = _room(free, low)
    if room is not None:
        axis = int(np.argmax(np.ptp(np.argwhere(room), axis=0)[::-1]) == 0)  # along y where both are as long
        across = np.argwhere(room)
        first, last = across[:, axis].min(), across[:, axis].max()
        cells = search.shortest_path(room, *(across[across[:, axis] == end] for end in (first, last)))
        if cells is not None:
            return _along(path, low + SEARCH_CELL_M * (cells + 0.5), (0.0, math.pi / 2)[axis])
    sides = int(round(MARGIN_M / SEARCH_CELL_M))
    if high[0] - low[0] > NARROW_WIDTH_M:  # through the world, not around it
        free[:sides, sides:-sides] = False
        free[-sides:, sides:-sides] = False
    ends = [[(r, c) for r in range(free.shape[0])] for c in (0, free.shape[1] - 1)]
    cells = search.shortest_path(free, *ends)
    if cells is None:
        wide = f"{2.0 * ROBOT_RADIUS_M:.2f} m"
        raise WorldError(f"{path} has no passage of {wide} along y; clear a way, or {COURSE_REMEDY.format(path)}")
    return _along(path, low + SEARCH_CELL_M * (cells + 0.5), math.pi / 2)


def _room(free: np.ndarray, low: np.ndarray) -> Optional[np.ndarray]:
    """(nx, ny) bool: what walls with doors shut in around the origin, where Gazebo puts a robot; None for nothing.

    Without that the largest room, where all are as wide and long as half of the world.
    """
    beyond = int(DOOR_WIDTH_M / SEARCH_CELL_M)
    around = np.pad(free, beyond, constant_values=True)
    spots, _ = scipy.ndimage.label(
        SEARCH_CELL_M * scipy.ndimage.distance_transform_edt(around) > 0.5 * DOOR_WIDTH_M - ROBOT_RADIUS_M
    )
    away = SEARCH_CELL_M * scipy.ndimage.distance_transform_edt(spots != spots[0, 0])  # from where no door leads to
    outside = (away <= 0.5 * DOOR_WIDTH_M + SEARCH_CELL_M)[beyond:-beyond, beyond:-beyond]
    rooms, _ = scipy.ndimage.label(free & ~outside)
    sides = [np.ptp(np.argwhere(cells), axis=0) for cells in (rooms > 0, ~free) if cells.any()]
    origin = tuple(np.floor(-low / SEARCH_CELL_M).astype(int))
    here = rooms[origin] if all(0 <= i < n for i, n in zip(origin, free.shape)) else 0
    if not here and (len(sides) < 2 or (2 * sides[0] < sides[1]).any()):
        return None
    room = rooms == (here or 1 + int(np.argmax(np.bincount(rooms.ravel())[1:])))
    whole = scipy.ndimage.binary_fill_holes(room)
    edge = whole & ~scipy.ndimage.binary_erosion(whole)
    return room if (edge & scipy.ndimage.binary_dilation(outside & free)).sum() <= DOOR_SHARE * edge.sum() else None


def given(path: str, points: np.ndarray) -> Course:
    """The course along points (n, 2) [m] that a person gives for a file."""
    if len(points) < 2 or not np.isfinite(points).all() or not np.any(points[1] != points[0]):
        raise WorldError(f"the course for {path} is no way; give X Y of two places or more in metres")
    dx, dy = points[1] - points[0]
    return _along(path, points, math.atan2(dy, dx))


def _along(path: str, points: np.ndarray, yaw: float) -> Course:
    """From the first of points (n, 2) [m] to the last one, with this heading [rad] at both ends."""
    (x0, y0), (x1, y1) = points[[0, -1]].tolist()
    if math.hypot(x1 - x0, y1 - y0) <= barn.GOAL_TOLERANCE_M:
        near = f"a course that ends {math.hypot(x1 - x0, y1 - y0):.2f} m from its start, where it counts as driven"
        raise WorldError(f"{path} has {near}; {COURSE_REMEDY.format(path)}")
    return Course((x0, y0, yaw), (x1, y1, yaw), None, barn.GOAL_TOLERANCE_M, points, planner_ends=True)


def _extent(cylinders: np.ndarray, boxes: np.ndarray) -> Optional[Tuple[np.ndarray, np.ndarray]]:
    c, s = np.abs(np.cos(boxes[:, 2])), np.abs(np.sin(boxes[:, 2]))
    across = np.column_stack([c * boxes[:, 3] + s * boxes[:, 4], s * boxes[:, 3] + c * boxes[:, 4]])
    reach = np.concatenate([cylinders[:, [2, 2]], 0.5 * across])
    centres = np.concatenate([cylinders[:, :2], boxes[:, :2]])
    return ((centres - reach).min(axis=0), (centres + reach).max(axis=0)) if len(centres) else None


def free_grid(low: np.ndarray, high: np.ndarray, cylinders: np.ndarray, boxes: np.ndarray) -> np.ndarray:
    """(nx, ny) bool: cells whose centre is at least ROBOT_RADIUS_M from every obstacle."""
    nx, ny = np.ceil((high - low) / SEARCH_CELL_M).astype(int)
    free = np.ones((ny, nx), dtype=bool)
    for block, distance, least in occupancy.around(free, low, SEARCH_CELL_M, cylinders, boxes, ROBOT_RADIUS_M):
        block &= distance >= least
    return free.T
