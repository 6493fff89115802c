"""Reader of maps in the format of map_server: a file such as map.yaml, and its image."""

from __future__ import annotations

import os

import numpy as np

from applr_ros1.common.angles import transform_point
from applr_ros1.common.errors import ApplrError
from applr_ros1.common.files import read_yaml

from .world import Grid

KEYS = {"image", "resolution", "origin", "negate", "occupied_thresh", "free_thresh"}  # keys that map_server requires
FREE, OCCUPIED, UNKNOWN = 0, 100, -1  # values of cells


def read_map(path: str) -> Grid:
    """Return the map in a YAML file as map_server publishes it. Raise ApplrError if the file describes no map."""
    from PIL import Image  # The import is slow, and most commands need no map.

    given = read_yaml(path)
    if not isinstance(given, dict) or not given.keys() >= KEYS:
        raise ApplrError(f"{path} is no map: give a file with {', '.join(sorted(KEYS))}, as map_saver writes it")
    mode = given.get("mode", "trinary")
    if mode not in ("trinary", "scale", "raw"):
        raise ApplrError(f"{path} has mode {mode}: give trinary, scale or raw")
    with Image.open(os.path.join(os.path.dirname(path), str(given["image"]))) as picture:
        has_opacity = "A" in picture.getbands() or "transparency" in picture.info
        pixels = np.asarray(picture.convert("RGBA" if has_opacity else "RGB"))[::-1]
    colour = pixels[:, :, : 4 if mode == "trinary" else 3].mean(axis=2)  # map_server averages the opacity, too.
    if given["negate"]:
        colour = 255.0 - colour
    if mode == "raw":
        cells = colour.astype(np.uint8).view(np.int8)
    else:
        dark, cells = (255.0 - colour) / 255.0, np.full(colour.shape, UNKNOWN, np.int8)
        free, occupied = float(given["free_thresh"]), float(given["occupied_thresh"])
        if mode == "scale":
            between = (pixels[:, :, 3] > 0 if has_opacity else True) & (dark >= free) & (dark <= occupied)
            cells[between] = 1 + 98 * ((dark[between] - free) / (occupied - free))
        cells[dark < free] = FREE
        cells[dark > occupied] = OCCUPIED
    x, y, yaw = map(float, given["origin"])
    return Grid(cells, float(given["resolution"]), (x, y, yaw))


def is_occupied(cells: np.ndarray) -> np.ndarray:
    """Return whether a costmap with default parameters marks cells int8 as lethal. Negative values wrap, as in C++."""
    marked: np.ndarray = (cells != UNKNOWN) & (cells.view(np.uint8) >= OCCUPIED)
    return marked


def boxes(grid: Grid) -> np.ndarray:
    """Return boxes (n, 5) x, y, yaw, size_x, size_y [m, rad] that cover the occupied cells, in the frame of the map.

    Each run of cells in a row becomes a rectangle, which extends over all neighbouring rows with the same run.
    """
    steps = np.diff(np.pad(is_occupied(grid.cells), ((0, 0), (1, 1))).astype(np.int8), axis=1)
    (row, first), (_, last) = np.nonzero(steps == 1), np.nonzero(steps == -1)
    runs = np.column_stack([first, last, row])[np.lexsort((row, last, first))]
    begins = np.flatnonzero((np.diff(runs, axis=0, prepend=-2) != (0, 0, 1)).any(axis=1))
    first, last, low = runs[begins].T
    high = runs[np.append(begins[1:], len(runs)) - 1, 2] + 1
    x, y = transform_point(grid.origin, *(0.5 * grid.resolution * np.array([first + last, low + high])))
    sizes = grid.resolution * np.array([last - first, high - low])
    return np.column_stack([x, y, np.full(len(x), grid.origin[2]), *sizes])
