"""movers.csv: the key frames of moving obstacles, in a plain table beside the worlds that name their plugins.

A row per key frame with the columns plugin, length, repeat, time, x, y (see docs/reference/worlds.md). `dynabarn` reads
it when a world is loaded; `python -m worlds.dynabarn_table` writes it.
"""

from __future__ import annotations

import csv
import io
from typing import Dict, List, NamedTuple, Tuple

from applr_ros1.common import files

from .sdf_xml import numbers
from .world import WorldError

NAME = "movers.csv"
COLUMNS = ("plugin", "length", "repeat", "time", "x", "y")
MAX_BYTES = 16 * 2**20  # the Challenge's 60 worlds make .1 MB
MAX_KEY_FRAMES = 1000


class Animation(NamedTuple):
    """length [s], whether it starts again after that, and its key frames ((t, x, y), ...) [s, m, m]."""

    length: float
    repeat: bool
    frames: Tuple[Tuple[float, float, float], ...]


def checked(length: float, repeat: bool, frames: List[Tuple[float, ...]], what: str) -> Animation:
    """An Animation whose times start at 0 or later and never fall. `what` names it in the WorldError."""
    if not 2 <= len(frames) <= MAX_KEY_FRAMES:
        raise WorldError(f"{what} are {len(frames)}; there must be 2 to {MAX_KEY_FRAMES}")
    times = [row[0] for row in frames]
    if times[0] < 0.0 or any(later < earlier for earlier, later in zip(times, times[1:])) or not length > 0.0:
        raise WorldError(f"{what} must have a length above 0 and times that rise from 0; correct them")
    return Animation(length, repeat, tuple((t, x, y) for t, x, y in frames))


def read(path: str) -> Dict[str, Animation]:
    """{plugin: Animation} of a table. Raises WorldError with one line that names the row."""
    text = files.read_bytes(path, MAX_BYTES).decode("utf-8", "replace")
    rows = csv.reader(io.StringIO(text))
    groups: Dict[str, List[Tuple[float, ...]]] = {}
    heads: Dict[str, Tuple[float, bool]] = {}
    try:
        header = next(rows, [])
        if tuple(name.strip() for name in header) != COLUMNS:
            raise WorldError(f"{path} must begin with the line {','.join(COLUMNS)}")
        for row in rows:
            what = f"line {rows.line_num} of {path}"
            if not row:
                continue
            if len(row) != len(COLUMNS) or row[2].strip() not in ("0", "1"):
                raise WorldError(f"{what} must be {','.join(COLUMNS)} with repeat 0 or 1")
            plugin = row[0].strip()
            length, *frame = (numbers(cell, 1, what)[0] for cell in (row[1], *row[3:]))
            head = (length, row[2].strip() == "1")
            if heads.setdefault(plugin, head) != head:
                raise WorldError(f"{what}: length and repeat differ from the earlier rows of {plugin}")
            groups.setdefault(plugin, []).append(tuple(frame))
    except csv.Error as error:
        raise WorldError(f"{path} is no table ({error}); make it again") from None
    return {
        plugin: checked(*heads[plugin], frames, f"key frames of {plugin} in {path}")
        for plugin, frames in groups.items()
    }


def write(path: str, animations: Dict[str, Animation]) -> None:
    """Writes the table, whole or not at all; numbers read back to the last bit. WorldError where that fails."""
    text = io.StringIO()
    table = csv.writer(text, lineterminator="\n")
    table.writerow(COLUMNS)
    for plugin in sorted(animations):
        length, repeat, frames = animations[plugin]
        table.writerows([plugin, repr(length), int(repeat), *map(repr, frame)] for frame in frames)
    files.write_bytes(path, text.getvalue().encode("utf-8"))
