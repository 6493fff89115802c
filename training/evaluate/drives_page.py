"""The page drives.html: the drives of all methods side by side, world by world (applr_ros1/drives/page.py).

The page draws the traces that evaluate.py kept, thinned to five poses per second.
"""

from __future__ import annotations

from pathlib import Path
from typing import List

import numpy as np

from applr_ros1.common.files import write_bytes
from applr_ros1.drives.page import Drive, Scene, page
from training.common.folders import make_folder
from training.evaluate.figures import colors
from training.evaluate.stored import Results
from training.evaluate.table import read_trace

FILE = "drives.html"
BACK = '<a href="index.html">report</a>'
EVERY = 4  # number of control cycles between two poses on the page
MOST_TRIALS = 10  # largest number of drives per method and world on the page


def write(results: Results, out: Path, title: str) -> bool:
    """Write the page into the folder `out`. Return False, without a page, if no traces were kept."""
    scenes = []
    for name in results.worlds:
        drives = [d for place, method in enumerate(results.methods) for d in _drives(results, name, method, place)]
        if drives:
            scenes.append(Scene(name, results.load(name), drives))
    if scenes:
        shade, marked = colors(results), bool(results.settings.get("movers"))
        methods = {method: shade[method] for method in results.methods}
        made = page(title, methods, results.space.names, results.robot["body"], scenes, marked, BACK)
        write_bytes(make_folder(out) / FILE, made)
    return bool(scenes)


def _drives(results: Results, world: str, method: str, place: int) -> List[Drive]:
    """Return the drives of a method in a world for which traces were kept."""
    drives = []
    for row in results.of(method, [world]).head(MOST_TRIALS).itertuples():
        trace = read_trace(results.folder, world, method, row.trial)
        if trace is None or not len(trace["pose"]):
            continue
        last = len(trace["pose"]) - 1
        rows = np.unique(np.append(np.arange(0, last, EVERY), last))
        poses, speeds = trace["pose"][rows], trace["twist"][rows, 0]
        how = row.time_s, row.success, row.collided, row.reason
        actions = np.array([results.space.to_action(theta) for theta in trace["theta"]])
        drives.append(Drive(place, row.trial, *how, poses, speeds, trace["decided"], actions))
    return drives
