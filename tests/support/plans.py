"""Plans of buildings of our own making, drawn as maps in map_server's format: an office, a warehouse, a house."""

import numpy as np
from PIL import Image

RESOLUTION = 0.05
FREE, WALL, UNKNOWN = 254, 0, 205


def blank(width, height):
    """Return a floor with outer walls [m] within unknown cells, and functions that draw walls and clear doors."""
    pixels = np.full(
        (round(height / RESOLUTION) + 20, round(width / RESOLUTION) + 20), UNKNOWN, np.uint8
    )

    def fill(x, y, size_x, size_y, value=WALL):
        low = [10 + round(v / RESOLUTION) for v in (y, x)]
        high = [10 + round(v / RESOLUTION) for v in (y + size_y, x + size_x)]
        pixels[low[0] : high[0], low[1] : high[1]] = value

    fill(0, 0, width, height)
    fill(0.2, 0.2, width - 0.4, height - 0.4, FREE)
    return pixels, fill


def office():
    """Return rooms with doors of .9 m along both sides of a corridor of 2 m, with desks, 36 x 14 m."""
    pixels, fill = blank(36.0, 14.0)
    for y in (6.0, 8.1):
        fill(0.0, y - 0.1, 36.0, 0.1)
    for room in range(6):
        for y, desk in ((0.2, 1.0), (8.1, 11.6)):
            if room:
                fill(6.0 * room, y, 0.1, 5.7)
            fill(6.0 * room + 1.2, desk, 1.6, 0.8)
            fill(6.0 * room + 4.0, desk + 0.6, 0.6, 0.6)
        fill(6.0 * room + 2.6, 5.9, 0.9, 0.1, FREE)
        fill(6.0 * room + 3.6, 8.0, 0.9, 0.1, FREE)
    fill(12.0, 3.0, 0.1, 0.9, FREE)
    return pixels


def warehouse():
    """Return shelves of 1 x 8 m with aisles of 1.6 m, 30 x 24 m."""
    pixels, fill = blank(30.0, 24.0)
    for column in range(10):
        for y in (2.5, 13.5):
            fill(2.6 + 2.6 * column, y, 1.0, 8.0)
    return pixels


def house():
    """Return six rooms with doors of .85 m and furniture, 12 x 10 m."""
    pixels, fill = blank(12.0, 10.0)
    fill(0.0, 4.2, 12.0, 0.1)
    fill(0.0, 5.7, 12.0, 0.1)
    for x in (4.0, 8.0):
        fill(x, 0.2, 0.1, 4.0)
        fill(x, 5.8, 0.1, 4.0)
    for x in (1.5, 5.5, 9.5):
        fill(x, 4.2, 0.85, 0.1, FREE)
        fill(x + 0.6, 5.7, 0.85, 0.1, FREE)
    fill(0.2, 0.2, 1.6, 2.0)
    fill(5.2, 1.2, 1.2, 0.8)
    fill(9.0, 8.0, 2.0, 0.9)
    fill(0.6, 8.6, 2.4, 0.8)
    return pixels


PLANS = {"office": office, "warehouse": warehouse, "house": house}


def write(folder, name, pixels=None, suffix="pgm", **changes):
    """Write a plan, or other pixels, as NAME.yaml with its image, and return the path of the file as text."""
    Image.fromarray(PLANS[name]() if pixels is None else pixels).save(folder / f"{name}.{suffix}")
    values = {
        "image": f"{name}.{suffix}",
        "resolution": RESOLUTION,
        "origin": [-5.0, -3.0, 0.0],
        "negate": 0,
    }
    values.update({"occupied_thresh": 0.65, "free_thresh": 0.196, **changes})
    text = "".join(f"{key}: {value}\n" for key, value in values.items() if value is not None)
    (folder / f"{name}.yaml").write_text(text)
    return str(folder / f"{name}.yaml")
