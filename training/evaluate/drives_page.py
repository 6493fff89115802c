"""The page drives.html: the drives of all methods in one map, world by world.

The page draws the traces that ./applr evaluate kept, thinned to five poses per second
(applr_ros1/drives/page.py).
"""

from __future__ import annotations

import html
from pathlib import Path
from typing import List

from applr_ros1.common.files import write_bytes
from applr_ros1.drives.drive import ABORTED, REACHED, Goal
from applr_ros1.drives.page import PageScene, Shown, page
from training.common.folders import make_folder
from training.evaluate.stored import Results
from training.evaluate.table import read_trace

FILE = "drives.html"
MOST_TRIALS = 10  # largest number of drives per method and world on the page


def write(results: Results, out: Path, title: str, verdict: str, back: str = "index.html") -> bool:
    """Write the page into `out`.

    Return False, without a page, if no traces were kept.

    Args:
        results: Trials of an evaluation.
        out: Folder of the page.
        title: Title of the page.
        verdict: What the drives show, in a line.
        back: Address of the report, to which the page links.
    """
    scenes = []
    for world in results.worlds:
        drives = shown_drives(results, world)
        if drives:
            scenes.append(PageScene(world, results.load(world), drives))
    if not scenes:
        return False
    page_bytes = page(
        title=title,
        verdict=verdict,
        methods=results.methods,
        space=results.space,
        outline=results.outline,
        scenes=scenes,
        marked=results.settings["movers"],
        back=f'<p><a href="{html.escape(back)}">Report</a></p>',
    )
    write_bytes(make_folder(out) / FILE, page_bytes)
    return True


def shown_drives(results: Results, world: str) -> List[Shown]:
    """Return the drives in a world for which traces were kept, method by method."""
    shown = []
    # The page knows a method by its number.
    for number, method in enumerate(results.methods):
        for row in results.of(method, [world]).head(MOST_TRIALS).itertuples():
            drive = read_trace(results.folder, world, method, row.trial)
            if drive is None:
                continue
            status = REACHED if row.success else ABORTED
            drive.goals = [Goal(world, 0.0, row.time_s, status, row.reason)]
            shown.append(Shown(number, row.trial, drive))
    return shown
