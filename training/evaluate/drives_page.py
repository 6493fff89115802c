"""The page drives.html: the drives of all methods side by side, world by world (applr_ros1/drives/page.py).

The page draws the traces that evaluate.py kept, thinned to five poses per second.
"""

from __future__ import annotations

from pathlib import Path
from typing import List

import numpy as np

from applr_ros1.common.files import write_bytes
from applr_ros1.drives.drive import ABORTED, REACHED, Goal
from applr_ros1.drives.page import Scene, Shown, page
from training.common.folders import make_folder
from training.evaluate.figures import colors
from training.evaluate.stored import Results
from training.evaluate.table import read_trace

FILE = "drives.html"
BACK = '<a href="index.html">report</a>'
MOST_TRIALS = 10  # largest number of drives per method and world on the page


def write(results: Results, out: Path, title: str) -> bool:
    """Write the page into the folder `out`. Return False, without a page, if no traces were kept."""
    scenes = []
    for name in results.worlds:
        drives = [
            d
            for place, method in enumerate(results.methods)
            for d in _drives(results, name, method, place)
        ]
        if drives:
            scenes.append(Scene(name, results.load(name), drives))
    if scenes:
        shade, marked = colors(results), bool(results.settings.get("movers"))
        methods = {method: shade[method] for method in results.methods}
        made = page(title, methods, results.space, results.robot["body"], scenes, marked, BACK)
        write_bytes(make_folder(out) / FILE, made)
    return bool(scenes)


def _drives(results: Results, world: str, method: str, place: int) -> List[Shown]:
    """Return the drives of a method in a world for which paths were kept."""
    shown = []
    for row in results.of(method, [world]).head(MOST_TRIALS).itertuples():
        drive = read_trace(results.folder, world, method, row.trial)
        if drive is None:
            continue
        status = REACHED if row.success else ABORTED
        drive.goals = [Goal(world, 0.0, row.time_s, status, row.reason)]
        if row.collided:
            drive.contacts = np.array(
                [row.time_s]
            )  # When the robot touched something is not in the table.
        shown.append(Shown(place, row.trial, drive))
    return shown
