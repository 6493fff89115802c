"""Report of an evaluation: each table as CSV, and index.html with them and the paper's figures.

The page begins with a line for each comparison with the baseline.
"""

from __future__ import annotations

import html
import os
from pathlib import Path
from typing import TYPE_CHECKING, Any, Dict, List

from tqdm import tqdm

from applr_ros1.common.files import write_bytes
from applr_ros1.common.pages.colors import color_indices
from applr_ros1.common.pages.page import Page
from applr_ros1.drives.page import SCENE
from training.common.folders import make_folder
from training.evaluate import drives_page
from training.evaluate.evaluation import CONDITIONS
from training.evaluate.profiles import profiles
from training.evaluate.stored import SETS, TEST, Results
from training.evaluate.tables import TABLES
from training.evaluate.verdict import Judged, compared, judged

if TYPE_CHECKING:
    import pandas as pd

FOLDER = "report"

SCRIPTS = (SCENE, Path(__file__).with_name("report.js"))
FEWEST_POINTS = 2  # smallest number of worlds of which times are drawn


def write(folder: os.PathLike[str] | str) -> str:
    """Write folder/report/ of an evaluation and return the path of its index.html.

    Raises:
        ApplrError: There are no trials, or the folder cannot be read or written.
    """
    results = Results(folder)
    report_folder = make_folder(results.folder / FOLDER)
    title = f"Evaluation of {', '.join(results.methods)} in {len(results.worlds)} worlds"
    body = [f"<p>{html.escape(line)}</p>" for line in summary(results)]
    # The scripts draw the figure of times and the parameter profiles there.
    body.append('<div id="times"></div><div id="profiles"></div>')
    for make in TABLES:
        table = make(results)
        if table.rows.empty:
            continue
        rows = table.rows.to_csv(index=False, lineterminator="\n")
        write_bytes(report_folder / f"{table.name}.csv", rows.encode())
        body.append(table.html())

    verdict = headline(results)
    has_drives = drives_page.write(results, report_folder, title, verdict)
    if has_drives:
        link = "All drives in motion, world by world"
        body.append(f'<h2>Drives</h2><p><a href="{drives_page.FILE}">{link}</a></p>')

    values = {
        "baseline": results.baseline,
        "methods": color_indices(results.methods),
        "groups": _groups(results),
        "drives": drives_page.FILE if has_drives else "",
        "profiles": profiles(results),
    }
    page = Page(
        kind="evaluation",
        title=title,
        verdict=verdict,
        scripts=SCRIPTS,
        data=values,
        body="\n".join(body),
        measured=facts(results),
    )
    page_file = report_folder / "index.html"
    write_bytes(page_file, page.html())
    return str(page_file)


def _groups(results: Results) -> List[Dict[str, Any]]:
    """Return mean times of successful trials as JSON values, for the paper's figure of times.

    The worlds of each group are those in which the baseline arrives, ordered by its time.
    """
    groups = []
    for name in SETS:
        arrived = results.trials[results.trials.success & (results.trials.set == name)]
        means = arrived.groupby(["world", "method"]).time_s.mean().unstack()
        # A world in which the baseline never arrived has no place in the order.
        means = means.reindex(columns=results.methods).dropna(subset=[results.baseline])
        means = means.sort_values(results.baseline).round(2)
        if len(means) < FEWEST_POINTS:
            continue
        times = {}
        for method in results.methods:
            # JSON has no NaN, which stands for no arrival.
            times[method] = means[method].astype(object).where(means[method].notna(), None).tolist()
        groups.append({"name": name, "worlds": means.index.tolist(), "times": times})
    return groups


def facts(results: Results) -> List[str]:
    """Return lines that describe how the trials were driven."""
    settings = results.settings
    facts = [
        f"{len(results.trials)} trials of {len(results.methods)} methods in {len(results.worlds)} "
        "worlds, with the same seeds for all methods"
    ]
    conditions = [f"{name} {settings[name]}" for name in (*sorted(CONDITIONS), "ground")]
    facts.append(f"Conditions: {', '.join(conditions)}")
    if "wall_s" in settings:
        facts.append(f"Wall time {tqdm.format_interval(settings['wall_s'])}")
    for session in settings.get("provenance", []):
        versions = ", ".join(map(" ".join, session["versions"].items()))
        session_text = "Driven on {date} with commit {commit} on {cpu} ({cores} cores)".format(
            **session
        )
        facts.append(f"{session_text}; {versions}. Command: {session['command']}")
    return facts


def judged_trials(results: Results) -> pd.DataFrame:
    """Return the trials in the test worlds, or in all worlds if too few of them were driven."""
    # Only worlds that the baseline has driven
    worlds = results.by_difficulty(results.of_set(TEST))
    if len(worlds) < 2:
        worlds = results.worlds
    return results.trials[results.trials.world.isin(worlds)]


def _judged(results: Results) -> List[Judged]:
    """Return the judgement on each rival of the baseline in judged_trials()."""
    return judged(judged_trials(results), results.rivals, results.baseline)


def summary(results: Results) -> List[str]:
    """Return a line per rival: its comparison with the baseline."""
    trials = judged_trials(results)
    return [compared(trials, rival) for rival in _judged(results)]


def headline(results: Results) -> str:
    """Return the line about the best rival."""
    rivals = _judged(results)
    if not rivals:
        return f"{results.baseline} alone was driven."
    # A difference is a method's mean score less the baseline's [s]: the lowest is the best.
    best = min(rivals, key=lambda rival: rival.comparison.difference.value)
    return compared(judged_trials(results), best)
