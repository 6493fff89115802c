"""Report of an evaluation: each table as CSV, each figure as PNG, and index.html with all of them.

The page begins with a line for each comparison with the baseline. evaluate.py and ./applr tune
write reports.
"""

from __future__ import annotations

import html
import os
from typing import List, Sequence

from tqdm import tqdm

from applr_ros1.common.extras import absent
from applr_ros1.common.files import write_bytes
from training.common.folders import make_folder
from training.evaluate import drives_page, figures
from training.evaluate.stored import TEST, Results
from training.evaluate.tables import TABLES, Made
from training.evaluate.verdict import compared

FOLDER = "report"

STYLE = """body{font:15px/1.45 system-ui,sans-serif;margin:2em auto;max-width:1180px;
padding:0 1em;color:#222}
table{border-collapse:collapse;font-size:13px;margin:.6em 0}
th,td{padding:3px 9px;text-align:right;border-bottom:1px solid #ddd}td{white-space:nowrap}
th{border-bottom:2px solid #888;vertical-align:bottom}th:first-child,td:first-child{text-align:left}
.wide{overflow-x:auto}h1,h2,p{overflow-wrap:anywhere}
#methods+.wide :is(td,th){text-align:left;white-space:normal}
.verdict{font-size:15px}
.note{font-size:12.5px;color:#555;margin:.3em 0;max-width:900px}
img{max-width:100%;border:1px solid #eee;margin:.4em 0}h1{font-size:24px}
h2{font-size:18px;margin-top:1.8em}"""


def write(
    folder: os.PathLike[str] | str,
    above: Sequence[str] = (),
    tables: Sequence[Made] = TABLES,
) -> str:
    """Write folder/report/ and return the path of its index.html.

    Args:
        folder: Folder of an evaluation.
        above: Lines at the top of the page; empty for summary().
        tables: Functions that make the tables. Lines that compare methods by another cost than the
            tables of the paper stand without these tables.

    Raises:
        ApplrError: There are no trials, or the folder cannot be read or written.
    """
    results = Results(folder)
    report_folder = make_folder(results.folder / FOLDER)
    title = f"APPLR: evaluation of {', '.join(results.methods)}"
    filled = []
    for make in tables:
        table = make(results)
        if table.rows.empty:
            continue
        rows = table.rows.to_csv(index=False, lineterminator="\n")
        write_bytes(report_folder / f"{table.name}.csv", rows.encode())
        filled.append(table)

    # Body of the page
    body = [f"<h1>{html.escape(title)}</h1>"]
    for line in above or summary(results):
        body.append(f"<pre class=verdict>{html.escape(line)}</pre>")
    if drives_page.write(results, report_folder, title):
        link = "The drives of all methods side by side, as an animation"
        body.append(f'<p><a href="{drives_page.FILE}">{link}</a></p>')
    for table in filled:
        body.append(table.html())
    # matplotlib is an optional package.
    missing = absent("matplotlib")
    if missing:
        print(f"the report has no figures: {missing}")
    else:
        for figure in figures.write(results, report_folder):
            caption = html.escape(figure.caption)
            body.append(f"<h2>{caption}</h2>")
            body.append(f'<img src="{html.escape(figure.file)}" alt="{caption}">')
    body.append("<h2>How it was measured</h2>")
    for fact in _facts(results):
        body.append(f"<p>{html.escape(fact)}</p>")

    # The page has no other files than its figures, so that it can be passed on.
    viewport = '<meta name=viewport content="width=device-width,initial-scale=1">'
    page_head = (
        f"<meta charset=utf-8>{viewport}<title>{html.escape(title)}</title><style>{STYLE}</style>"
    )
    document = [
        "<!doctype html><html lang=en><head>",
        page_head,
        "</head><body>",
        *body,
        "</body></html>\n",
    ]
    page_file = report_folder / "index.html"
    write_bytes(page_file, "\n".join(document).encode())
    return str(page_file)


def _facts(results: Results) -> List[str]:
    """Return sentences that describe how the trials were driven."""
    settings = results.settings
    planner = settings["planner"]
    if settings["monitor"]:
        planner += ", with the collision monitor"
    if settings["movers"]:
        planner += ", with predicted moving obstacles"
    # An evaluation that was stopped has driven some methods or worlds less often than others.
    counts = results.trials.groupby(["method", "world"]).size()
    trials = str(counts.min())
    if counts.max() > counts.min():
        trials += f" to {counts.max()}"
    facts = [
        f"{len(results.trials)} trials: {len(results.worlds)} worlds × {len(results.methods)} "
        f"methods × {trials} trials. Protocol: {settings['protocol']}. "
        f"Simulator: {settings['simulator']}, ground {settings['ground']}. "
        f"Planner: {planner}."
    ]
    if "wall_s" in settings:
        wall_time = tqdm.format_interval(settings["wall_s"])
        seed = settings["seed"]
        facts.append(f"Wall time {wall_time}; base seed {seed}, the same seeds for all methods.")
    for session in settings.get("provenance", []):
        versions = ", ".join(map(" ".join, session["versions"].items()))
        session_text = "Driven on {date} with commit {commit} on {cpu} ({cores} cores)".format(
            **session
        )
        facts.append(f"{session_text}; {versions}. Command: {session['command']}")
    return facts


def summary(results: Results) -> List[str]:
    """Return a line per rival: its comparison over the test worlds, or over all if too few."""
    # Only worlds that the baseline has driven
    worlds = results.by_difficulty(results.of_set(TEST))
    if len(worlds) < 2:
        worlds = results.worlds
    trials = results.trials[results.trials.world.isin(worlds)]
    lines = []
    for method in results.rivals:
        comparison = results.compare(method, results.baseline, worlds)
        if comparison.worlds:
            lines.append(compared(trials, method, results.baseline, comparison))
    return lines
