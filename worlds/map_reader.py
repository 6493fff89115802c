"""Reader of maps in the format of map_server: a file such as map.yaml, and its image."""

from __future__ import annotations

import io
import os
from typing import Any, Mapping, Tuple

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field, ValidationError
from typing_extensions import Literal

from applr_ros1.common.angles import transform_point
from applr_ros1.common.arrays import Array
from applr_ros1.common.errors import ApplrError, remedy_of, shown
from applr_ros1.common.files import read_bytes, read_yaml, reading

from .world import Grid

# values of cells
FREE = 0
OCCUPIED = 100
UNKNOWN = -1
WHITE = 255.0  # brightest value of a pixel
TWO_BYTES = 0xFFFF  # brightest value of a pixel in an image of 16 bits
# Largest number of cells of a map. Drawing the courses of such a map takes minutes and 7 GB.
MOST_CELLS = 20_000_000
# Kinds of images that SDL_image reads, by Pillow's names; PPM includes PGM. Pillow would start a
# program for some others, such as PostScript.
FORMATS = {"BMP", "GIF", "JPEG", "PNG", "PPM", "TGA", "TIFF", "WEBP"}


class MapFile(BaseModel):
    """Fields of a map.yaml."""

    model_config = ConfigDict(frozen=True, allow_inf_nan=False)

    image: str = Field(min_length=1)
    resolution: float = Field(gt=0.0, le=1.0)
    origin: Tuple[float, float, float]
    negate: bool
    occupied_thresh: float = Field(ge=0.0, le=1.0)
    free_thresh: float = Field(ge=0.0, le=1.0)
    mode: Literal["trinary", "scale", "raw"] = "trinary"


def read_map(path: str) -> Grid:
    """Return the map in a YAML file as map_server publishes it.

    Raises:
        ApplrError: The file describes no map, or map_server would misread its image.
    """
    fields = read_fields(path)
    # os.path.join keeps an absolute path of the image, as map_server does.
    image_path = os.path.join(os.path.dirname(path), fields.image)
    if not os.path.exists(image_path):
        problem = f"its line image: names {fields.image}, but there is no file {image_path}"
        raise ApplrError(f"{path}: {problem}; correct the line")
    pixels = read_pixels(image_path)
    # The first row of an image is its top, that of a map its bottom.
    return Grid(cells_of(pixels[::-1], fields), fields.resolution, fields.origin)


def read_fields(path: str) -> MapFile:
    """Return the fields of a map.yaml. Raise ApplrError with the first field that is invalid."""
    with reading(path):
        try:
            map_file = MapFile.model_validate(read_yaml(path))
        except ValidationError as refusal:
            raise ApplrError(_refused(refusal.errors()[0])) from None
        if map_file.free_thresh > map_file.occupied_thresh:
            raise ApplrError(
                f"free_thresh is {map_file.free_thresh:g}, above occupied_thresh "
                f"({map_file.occupied_thresh:g}): no cell would be unknown, lower it"
            )
        return map_file


def _refused(problem: Mapping[str, Any]) -> str:
    """Return pydantic's error about a field in words."""
    path = problem["loc"]
    if problem["type"] in ("missing", "model_type") and len(path) < 2:
        fields = MapFile.model_fields.items()
        names = ", ".join(name for name, field in fields if field.is_required())
        return f"the file is no map: give one with {names}, as map_saver writes it"
    place = ".".join(map(str, path))
    return f"{place} is {shown(problem['input'])}: {remedy_of(problem)}"


def read_pixels(path: str) -> NDArray[np.uint8]:
    """Return the pixels (rows, columns, channels) of an image.

    They are those that SDL_image gives to map_server. The channels are the colours, followed by the
    opacity if the image has one.

    Raises:
        ApplrError: The image stores no brightness of up to 16 bits, has too many cells, or is of a
            kind that SDL_image does not read.
    """
    from PIL import Image  # The import is slow, and most commands need no map.

    Image.MAX_IMAGE_PIXELS = None  # MOST_CELLS is the limit; Pillow would warn of its own.
    with reading(path), Image.open(io.BytesIO(read_bytes(path))) as image:
        if image.format not in FORMATS:
            raise ApplrError(f"the image is of the kind {image.format}: save it as PGM or PNG")
        columns, rows = image.size
        if columns * rows > MOST_CELLS:
            raise ApplrError(
                f"the map has {1e-6 * columns * rows:.1f} million cells, and at most "
                f"{1e-6 * MOST_CELLS:.0f} million are read: cut it to the building, or save it "
                "with a coarser resolution"
            )
        # SDL_image expands single bits to black and white for PNG only.
        is_indexed = image.mode == "1" and image.format != "PNG"
        if is_indexed or image.mode in ("P", "PA"):
            raise ApplrError(
                "the image has indexed colours, and map_server takes the indexes as grey values: "
                "save it as a grey image"
            )
        if image.mode.startswith(("I", "F")):
            grey_values = np.asarray(image)
            if image.mode == "F" or grey_values.max() > TWO_BYTES:
                raise ApplrError("the image has more than 16 bits per pixel: save it with 8 bits")
            # SDL_image keeps the upper 8 bits (png_set_strip_16). Pillow would clip at 255.
            upper_bits = (grey_values >> 8).astype(np.uint8)
            return upper_bits[:, :, np.newaxis]
        has_opacity = "A" in image.getbands() or "transparency" in image.info
        channels = "RGBA" if has_opacity else "RGB"
        return np.asarray(image.convert(channels))


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
    free_limit = fields.free_thresh
    occupied_limit = fields.occupied_thresh
    cells = np.full(darkness.shape, UNKNOWN, np.int8)
    if fields.mode == "scale":
        is_between = (darkness >= free_limit) & (darkness <= occupied_limit)
        if has_opacity:
            is_between &= pixels[:, :, 3] > 0
        # 1 to 99, because 0 and 100 are the values of free and of occupied cells
        darkness_share = (darkness[is_between] - free_limit) / (occupied_limit - free_limit)
        cells[is_between] = 1 + 98 * darkness_share
    cells[darkness < free_limit] = FREE
    cells[darkness > occupied_limit] = OCCUPIED
    return cells


def is_occupied(cells: NDArray[np.int8]) -> NDArray[np.bool_]:
    """Return whether a costmap with default parameters marks cells as lethal.

    Negative values of mode raw wrap to values above 127, as in C++.
    """
    is_high = cells.view(np.uint8) >= OCCUPIED
    is_marked: NDArray[np.bool_] = is_high & (cells != UNKNOWN)
    return is_marked


def boxes(grid: Grid) -> Array:
    """Return boxes (n, 5) x, y, yaw, size_x, size_y [m, rad] that cover the occupied cells.

    Each run of cells in a row becomes a rectangle, which extends over all neighbouring rows with
    the same run. The boxes are in the frame of the map.
    """
    # A run begins where the occupancy along a row steps up, and ends where it steps down.
    padded_cells = np.pad(is_occupied(grid.cells), ((0, 0), (1, 1)))
    occupancy_steps = np.diff(padded_cells.astype(np.int8), axis=1)
    run_row, run_start = np.nonzero(occupancy_steps == 1)
    _, run_end = np.nonzero(occupancy_steps == -1)

    # Sorting by columns, then by row, places equal runs of neighbouring rows side by side. The
    # primary key of lexsort is its last one.
    order = np.lexsort((run_row, run_end, run_start))
    runs = np.column_stack([run_start, run_end, run_row])[order]

    # A run continues a rectangle if it has the same columns one row higher. Nothing is before the
    # first run, which `prepend` compares with cells that no map has.
    changes = np.diff(runs, axis=0, prepend=-2)
    continues = (changes == (0, 0, 1)).all(axis=1)
    first_runs = np.flatnonzero(~continues)
    last_runs = np.append(first_runs, len(runs))[1:] - 1
    first_column, end_column, first_row = runs[first_runs].T
    end_row = runs[last_runs, 2] + 1

    # A rectangle's centre is halfway between its two edges.
    half_cell = 0.5 * grid.resolution
    centre_x = half_cell * (first_column + end_column)
    centre_y = half_cell * (first_row + end_row)
    x, y = transform_point(grid.origin, centre_x, centre_y)
    yaw = np.full(len(x), grid.origin[2])
    size_x = grid.resolution * (end_column - first_column)
    size_y = grid.resolution * (end_row - first_row)
    return np.column_stack([x, y, yaw, size_x, size_y])
