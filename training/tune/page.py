"""The page of `./applr tune`: what changed, what it saves, each course, and how to load the set."""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import TYPE_CHECKING, Any, Dict, List, Sequence

from applr_ros1.common.files import read_bytes, write_bytes
from applr_ros1.common.pages.page import Page
from applr_ros1.robots import Robot
from training.evaluate import drives_page
from training.evaluate.report import facts
from training.evaluate.stored import Results
from training.evaluate.trial import BASELINE
from training.evaluate.verdict import SET
from training.tune.found_set import NEXT, Judgement

if TYPE_CHECKING:
    import pandas as pd

FILE = "index.html"
SCRIPTS = (Path(__file__).with_name("page.js"),)
NOT_TRIED = "All drives were simulated: try the set on the robot with a hand at its emergency stop."


def write(
    robot: Robot,
    drives: Path,
    changed: pd.DataFrame,
    judgements: Sequence[Judgement],
    scope: str,
    rule: str,
) -> Path:
    """Write the page into the folder `drives`, and return its path.

    Pages of the drives lie beside it.

    Args:
        robot: Robot that was tuned.
        drives: Folder with the parameter set and the trials of the verdicts.
        changed: Table of the changed parameters, from changes().
        judgements: Verdicts on the set.
        scope: Where the set was searched and is judged, in words.
        rule: What else than time a course costs, in words (score.Aim.rule).
    """
    title = f"Tuned parameters of {robot.name}"
    verdicts: List[Dict[str, Any]] = []
    headlines = []
    measured = scope.splitlines()
    for judgement in judgements:
        folder = drives / judgement.monitor
        results = Results(folder)
        _, comparison, *_ = judgement.lines
        headline = f"{judgement.file}: {comparison}"
        headlines.append(headline)
        has_drives = drives_page.write(results, folder, title, headline, f"../{FILE}")
        courses = [_course(results, world) for world in results.worlds]
        verdicts.append(
            {
                **judgement._asdict(),
                "path": os.path.abspath(judgement.path),
                "courses": courses,
                "drives": f"{folder.name}/{drives_page.FILE}" if has_drives else "",
            }
        )
        measured += [f"{judgement.file}:", *judgement.lines[1:], *facts(results)]
    # The first file that is written, or the first one if none is
    are_better = [judgement.is_better for judgement in judgements]
    headline = headlines[are_better.index(True) if any(are_better) else 0]
    page_values = {
        # Pandas writes null for an interval that a single course does not have.
        "changes": json.loads(changed.to_json(orient="records")),
        "verdicts": verdicts,
        "scope": scope,
        "rule": rule,
        "not_tried": NOT_TRIED,
        "yaml": read_bytes(drives / "tuned.yaml").decode(),
        "robot": robot.folder,
        "next": NEXT,
    }
    page = Page(f"tune · {robot.name}", title, headline, SCRIPTS, page_values, measured=measured)
    write_bytes(drives / FILE, page.html())
    return drives / FILE


def _course(results: Results, world: str) -> Dict[str, Any]:
    """Return how both methods drove a course, as JSON values."""
    course: Dict[str, Any] = {"world": world}
    for before_or_after, method in (("before", BASELINE), ("after", SET)):
        trial = results.of(method, [world]).iloc[0]
        course[before_or_after] = {
            "ok": bool(trial.success),
            "t": float(trial.time_s),
            "why": trial.reason,
        }
    return course
