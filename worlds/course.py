"""A course for a world that was read from a file.

It is stated in the file, taken from BARN's path file beside it, or searched for. `sdf_reader` calls it.
"""

from __future__ import annotations

import io
import math
import os
import re
from typing import Optional, Tuple
from xml.etree.ElementTree import Element

import numpy as np
from scipy import ndimage

from applr_ros1.common import files
from applr_ros1.common.errors import reason

from . import barn, dynabarn, occupancy, search
from .sdf import numbers
from .world import Course, WorldError

NAMESPACE = "applr"  # of our own elements: {applr}course, {applr}waypoints
PATH_FOLDER = "path_files"
MAX_PATH_BYTES = 2**20
MAX_PATH = 10_000  # points
ROBOT_RADIUS = 0.30  # [m] kept free around a searched path: half a Jackal's diagonal and a little
MARGIN = 1.0  # [m] a searched course starts and ends this far outside the obstacles
SEARCH_CELL = 0.10  # [m]
NARROW = 5.0  # [m]; obstacles in a narrower area may be passed on the outside
GIVE = "give one: python -m worlds.sdf_writer {} OUT.world --course X Y X Y ..., from start to goal in metres"
MAX_SIDE = 50.0  # [m] of the area searched


def from_element(element: Element, path: str) -> Course:
    """The course that our writer put into a world file."""

    def get(tag, count):
        text = element.findtext(f"{{{NAMESPACE}}}{tag}")
        return tuple(numbers(text, count, f"{tag} of the course in {path}"))

    words = (element.findtext(f"{{{NAMESPACE}}}path") or "").split()
    if not 4 <= len(words) <= 2 * MAX_PATH:
        raise WorldError(f"path of the course in {path} has {len(words)} numbers; it needs 2 to {MAX_PATH} points")
    points = get("path", len(words) // 2 * 2)
    finish = element.find(f"{{{NAMESPACE}}}finish_y")
    return Course(
        start=get("start", 3),
        goal=get("goal", 3),
        finish_y=None if finish is None else get("finish_y", 1)[0],
        goal_tolerance=get("goal_tolerance", 1)[0],
        path=np.array(points).reshape(-1, 2),
    )


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
    """(k, 2) int64 cells from a path_N.npy, its doubled first point once. WorldError where it holds anything else."""
    try:
        cells = np.load(io.BytesIO(files.read_bytes(file, MAX_PATH_BYTES)), allow_pickle=False)
    except (ValueError, EOFError, MemoryError) as error:
        raise WorldError(f"{file} is not an .npy file of numbers ({reason(error)}); put BARN's there") from None
    if cells.dtype.kind not in "iu" or cells.ndim != 2 or cells.shape[1] != 2 or not 2 <= len(cells) <= MAX_PATH:
        raise WorldError(f"{file} holds {cells.dtype} of shape {cells.shape}; a path is (k, 2) integer cells, k >= 2")
    cells = cells.astype(np.int64)
    return cells[1:] if len(cells) > 2 and np.array_equal(cells[0], cells[1]) else cells


def _on_barns_grid(file: str, cylinders: np.ndarray) -> Course:
    cells = read_path_file(file)
    outside = np.any((cells < 0) | (cells >= (barn.ROWS, barn.COLS)), axis=1)
    if outside.any():
        raise WorldError(
            f"{file} has the cell {tuple(int(v) for v in cells[outside][0])} outside BARN's {barn.ROWS} x "
            f"{barn.COLS} field; put the world's own path file there"
        )
    if np.abs(np.diff(cells, axis=0)).max() > 1:
        raise WorldError(f"{file} jumps between cells that are not neighbours; put the world's own path file there")
    clear = search.free_space(barn.fill_of(cylinders), 1)
    shut = ~clear[cells[:, 0], cells[:, 1]]
    if shut.any():
        raise WorldError(
            f"{file} runs into an obstacle at cell {tuple(int(v) for v in cells[shut][0])}: no passage there; put the "
            "world's own path file there or clear the way"
        )
    return barn.paper_course(barn.to_xy(cells))


def _is_barns(cylinders: np.ndarray, boxes: np.ndarray) -> bool:
    """Whether these are cylinders on BARN's cells, between BARN's two walls."""
    if len(boxes) or not len(cylinders):
        return False
    cells = barn.to_cells(cylinders[:, :2])
    on_grid = np.abs(barn.to_xy(cells) - cylinders[:, :2]).max() < 0.25 * barn.CELL
    return bool(on_grid and set(cells[:, 0]) <= set(range(barn.ROWS)) and barn.fill_of(cylinders)[[0, -1]].all())


def _searched_on_barns_grid(path: str, cylinders: np.ndarray) -> Course:
    free = search.free_space(barn.fill_of(cylinders), barn.CLEARANCE)
    ends = [(r, c) for c in (0, barn.COLS - 1) for r in range(barn.ROWS)]
    cells = search.shortest_path(free, ends[: barn.ROWS], ends[barn.ROWS :])
    if cells is None:
        raise WorldError(
            f"{path} has no passage of {barn.CELL * (2 * barn.CLEARANCE + 1):.2f} m through its field; "
            "clear a way or give another world"
        )
    return barn.paper_course(barn.to_xy(cells))


def _searched(path: str, cylinders: np.ndarray, boxes: np.ndarray) -> Course:
    """Inside closed walls from one end to the other, else from below the obstacles (least y) to above them."""
    extent = _extent(cylinders, boxes)
    if extent is None:
        raise WorldError(
            f"{path} holds no obstacle that a ground robot could meet; give a world with boxes or cylinders"
        )
    low, high = extent[0] - MARGIN - 0.5 * SEARCH_CELL, extent[1] + MARGIN
    if max(high - low) > MAX_SIDE:
        raise WorldError(
            f"{path} is {high[0] - low[0]:.0f} x {high[1] - low[1]:.0f} m, too large to search for a course (at most "
            f"{MAX_SIDE:.0f} m); {GIVE.format(path)}"
        )
    free = free_grid(low, high, cylinders, boxes)
    room = _room(free, low)
    if room is not None:
        axis = int(np.argmax(np.ptp(np.argwhere(room), axis=0)[::-1]) == 0)  # along y where both are as long
        across = np.argwhere(room)
        first, last = across[:, axis].min(), across[:, axis].max()
        cells = search.shortest_path(room, *(across[across[:, axis] == end] for end in (first, last)))
        if cells is not None:
            return _along(low + SEARCH_CELL * (cells + 0.5), (0.0, math.pi / 2)[axis])
    sides = int(round(MARGIN / SEARCH_CELL))
    if high[0] - low[0] > NARROW:  # through the world, not around it
        free[:sides, sides:-sides] = False
        free[-sides:, sides:-sides] = False
    ends = [[(r, c) for r in range(free.shape[0])] for c in (0, free.shape[1] - 1)]
    cells = search.shortest_path(free, *ends)
    if cells is None:
        raise WorldError(
            f"{path} has no passage of {2.0 * ROBOT_RADIUS:.2f} m along y; clear a way, or {GIVE.format(path)}"
        )
    return _along(low + SEARCH_CELL * (cells + 0.5), math.pi / 2)


def _room(free: np.ndarray, low: np.ndarray) -> Optional[np.ndarray]:
    """(nx, ny) bool: what closed walls shut in, where that is as wide and long as half of the world; else None.

    Of several rooms the one that the origin lies in, where Gazebo puts a robot, or the largest. Nothing outside can be
    reached from there.
    """
    rooms, _ = ndimage.label(free)
    border = np.concatenate([rooms[0], rooms[-1], rooms[:, 0], rooms[:, -1]])
    sizes = np.bincount(rooms.ravel())
    sizes[[0, *np.unique(border)]] = 0
    if not sizes.any():
        return None
    origin = tuple(np.floor(-low / SEARCH_CELL).astype(int))
    here = rooms[origin] if all(0 <= i < n for i, n in zip(origin, free.shape)) else 0
    room = rooms == (here if sizes[here] else int(np.argmax(sizes)))
    sides = [np.ptp(np.argwhere(cells), axis=0) for cells in (room, ~free)]
    return room if (2 * sides[0] >= sides[1]).all() else None


def given(path: str, points: np.ndarray) -> Course:
    """The course along points (n, 2) [m] that a person gives for a file."""
    if len(points) < 2 or not np.isfinite(points).all() or not np.any(points[1] != points[0]):
        raise WorldError(f"the course for {path} is no way; give X Y of two places or more in metres")
    dx, dy = points[1] - points[0]
    return _along(points, math.atan2(dy, dx))


def _along(points: np.ndarray, yaw: float) -> Course:
    """From the first of points (n, 2) [m] to the last one, with this heading [rad] at both ends."""
    return Course(
        start=(float(points[0, 0]), float(points[0, 1]), yaw),
        goal=(float(points[-1, 0]), float(points[-1, 1]), yaw),
        finish_y=None,
        goal_tolerance=barn.GOAL_TOLERANCE,
        path=points,
    )


def _extent(cylinders: np.ndarray, boxes: np.ndarray) -> Optional[Tuple[np.ndarray, np.ndarray]]:
    reach = np.concatenate([cylinders[:, 2], 0.5 * np.hypot(boxes[:, 3], boxes[:, 4])])
    centres = np.concatenate([cylinders[:, :2], boxes[:, :2]])
    if not len(centres):
        return None
    return (centres - reach[:, None]).min(axis=0), (centres + reach[:, None]).max(axis=0)


def free_grid(low: np.ndarray, high: np.ndarray, cylinders: np.ndarray, boxes: np.ndarray) -> np.ndarray:
    """(nx, ny) bool: cells whose centre is at least ROBOT_RADIUS from every obstacle."""
    nx, ny = np.ceil((high - low) / SEARCH_CELL).astype(int)
    free = np.ones((ny, nx), dtype=bool)
    for block, distance, least in occupancy.around(free, low, SEARCH_CELL, cylinders, boxes, ROBOT_RADIUS):
        block &= distance >= least
    return free.T
