"""Reader of maps in the format of map_server: a file such as map.yaml, and its image."""

from __future__ import annotations

import os
from typing import Any, Tuple

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field, ValidationError
from typing_extensions import Literal

from applr_ros1.common.angles import transform_point
from applr_ros1.common.arrays import Array
from applr_ros1.common.errors import ApplrError
from applr_ros1.common.files import read_yaml

from .world import Grid

# values of cells
FREE = 0
OCCUPIED = 100
UNKNOWN = -1
WHITE = 255.0  # brightest value of a pixel
TWO_BYTES = 0xFFFF  # brightest value of a pixel in an image of 16 bits


class MapFile(BaseModel):
    """Fields of a map.yaml. The description of a field says what to give in an error message."""

    model_config = ConfigDict(frozen=True, allow_inf_nan=False)

    image: str = Field(min_length=1, description="the path of an image")
    resolution: float = Field(gt=0.0, le=1.0, description="the edge of a cell, up to 1 m")
    origin: Tuple[float, float, float] = Field(description="x, y and yaw [m, m, rad]")
    negate: bool = Field(description="0 or 1")
    occupied_thresh: float = Field(description="a number from 0 to 1")
    free_thresh: float = Field(description="a number from 0 to 1")
    mode: Literal["trinary", "scale", "raw"] = Field("trinary", description="trinary, scale or raw")


def read_map(path: str) -> Grid:
    """Return the map in a YAML file as map_server publishes it.

    Raises:
        ApplrError: The file describes no map, or map_server would misread its image.
    """
    fields = read_fields(path)
    # os.path.join keeps an absolute path of the image, as map_server does.
    pixels = read_pixels(os.path.join(os.path.dirname(path), fields.image))
    # The first row of an image is its top, that of a map its bottom.
    return Grid(cells_of(pixels[::-1], fields), fields.resolution, fields.origin)


def read_fields(path: str) -> MapFile:
    """Return the fields of a map.yaml. Raise ApplrError with the first field that is invalid."""
    content: Any = read_yaml(path)
    try:
        return MapFile.model_validate(content)
    except ValidationError as refusal:
        problem = refusal.errors()[0]
    fields = MapFile.model_fields.items()
    required = [name for name, field in fields if field.is_required()]
    if not isinstance(content, dict) or not content.keys() >= set(required):
        names = ", ".join(required)
        raise ApplrError(f"{path} is no map: give a file with {names}, as map_saver writes it")
    name = str(problem["loc"][0])
    wanted = MapFile.model_fields[name].description
    raise ApplrError(f"{path}: {name} is {content[name]!r:.60}: give {wanted}")


def read_pixels(path: str) -> NDArray[np.uint8]:
    """Return the pixels (rows, columns, channels) of an image.

    They are those that SDL_image gives to map_server. The channels are the colours, followed by the
    opacity if the image has one.

    Raises:
        ApplrError: The image stores no brightness of up to 16 bits.
    """
    from PIL import Image  # The import is slow, and most commands need no map.

    with Image.open(path) as picture:
        # SDL_image expands single bits to black and white for PNG only.
        is_indexed = picture.mode == "1" and picture.format != "PNG"
        if is_indexed or picture.mode in ("P", "PA"):
            raise ApplrError(
                f"{path} has indexed colours, and map_server takes the indexes as grey values: "
                "save it as a grey image"
            )
        if picture.mode.startswith(("I", "F")):
            grey = np.asarray(picture)
            if picture.mode == "F" or grey.max() > TWO_BYTES:
                raise ApplrError(f"{path} has more than 16 bits per pixel: save it with 8 bits")
            # SDL_image keeps the upper 8 bits (png_set_strip_16). Pillow would clip at 255.
            return (grey >> 8).astype(np.uint8)[:, :, np.newaxis]
        has_opacity = "A" in picture.getbands() or "transparency" in picture.info
        channels = "RGBA" if has_opacity else "RGB"
        return np.asarray(picture.convert(channels))


def cells_of(pixels: NDArray[np.uint8], fields: MapFile) -> NDArray[np.int8]:
    """Return the cells (rows, columns) of pixels (rows, columns, channels).

    The steps are those of loadMapFromFile in map_server/image_loader.cpp.
    """
    has_opacity = pixels.shape[2] == 4
    colours = pixels
    if has_opacity and fields.mode != "trinary":
        colours = pixels[:, :, :3]  # Mode trinary averages the opacity as a fourth colour.
    brightness: Array = colours.mean(axis=2)
    if fields.negate:
        brightness = WHITE - brightness
    if fields.mode == "raw":
        return brightness.astype(np.uint8).view(np.int8)

    darkness = (WHITE - brightness) / WHITE
    free = fields.free_thresh
    occupied = fields.occupied_thresh
    cells = np.full(darkness.shape, UNKNOWN, np.int8)
    if fields.mode == "scale":
        between = (darkness >= free) & (darkness <= occupied)
        if has_opacity:
            between &= pixels[:, :, 3] > 0
        # 1 to 99, because 0 and 100 are the values of free and of occupied cells
        share = (darkness[between] - free) / (occupied - free)
        cells[between] = 1 + 98 * share
    cells[darkness < free] = FREE
    cells[darkness > occupied] = OCCUPIED
    return cells


def is_occupied(cells: NDArray[np.int8]) -> NDArray[np.bool_]:
    """Return whether a costmap with default parameters marks cells as lethal.

    Negative values of mode raw wrap to values above 127, as in C++.
    """
    is_high = cells.view(np.uint8) >= OCCUPIED
    marked: NDArray[np.bool_] = is_high & (cells != UNKNOWN)
    return marked


def boxes(grid: Grid) -> Array:
    """Return boxes (n, 5) x, y, yaw, size_x, size_y [m, rad] that cover the occupied cells.

    Each run of cells in a row becomes a rectangle, which extends over all neighbouring rows with
    the same run. The boxes are in the frame of the map.
    """
    # A run begins where the occupancy along a row steps up, and ends where it steps down.
    padded = np.pad(is_occupied(grid.cells), ((0, 0), (1, 1)))
    steps = np.diff(padded.astype(np.int8), axis=1)
    row, first = np.nonzero(steps == 1)
    _, last = np.nonzero(steps == -1)

    # Sorting by columns, then by row, places equal runs of neighbouring rows side by side. The
    # primary key of lexsort is its last one.
    order = np.lexsort((row, last, first))
    runs = np.column_stack([first, last, row])[order]
    changes = np.diff(runs, axis=0, prepend=-2)
    continues = (changes == (0, 0, 1)).all(axis=1)
    begins = np.flatnonzero(~continues)
    ends = np.append(begins[1:], len(runs)) - 1
    first, last, lowest = runs[begins].T
    highest = runs[ends, 2] + 1

    half_cell = 0.5 * grid.resolution
    centre_x = half_cell * (first + last)
    centre_y = half_cell * (lowest + highest)
    x, y = transform_point(grid.origin, centre_x, centre_y)
    yaw = np.full(len(x), grid.origin[2])
    size_x = grid.resolution * (last - first)
    size_y = grid.resolution * (highest - lowest)
    return np.column_stack([x, y, yaw, size_x, size_y])
